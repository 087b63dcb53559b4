"""Network management (CiA 301, 7.2.8): states of a node, commands to it, boot-up and heartbeat."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

COMMAND_IDENTIFIER: Final = 0x000
COMMAND_BYTES: Final = 2
EVERY_NODE: Final = 0
BOOT_UP: Final = b"\x00"


class NodeState(IntEnum):
    """The numbers are those of the heartbeat."""

    INITIALISING = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


class NodeCommand(IntEnum):
    """The first octet of a command; the second is the node, 0 for every one."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


NEXT_STATE: Final = {
    NodeCommand.START: NodeState.OPERATIONAL,
    NodeCommand.STOP: NodeState.STOPPED,
    NodeCommand.ENTER_PRE_OPERATIONAL: NodeState.PRE_OPERATIONAL,
}

#: What a state lets through, besides network management and the heartbeat (CiA 301, table 38).
SPEAKS_SDO: Final = (NodeState.PRE_OPERATIONAL, NodeState.OPERATIONAL)
SPEAKS_SYNC: Final = SPEAKS_SDO
SPEAKS_EMERGENCY: Final = SPEAKS_SDO
SPEAKS_PDO: Final = (NodeState.OPERATIONAL,)


def command_of(data: bytes, node: int) -> NodeCommand | None:
    """The command in a frame, if it is one and means ``node``."""
    if len(data) != COMMAND_BYTES or data[1] not in (EVERY_NODE, node):
        return None
    try:
        return NodeCommand(data[0])
    except ValueError:
        return None
