"""One node: its network management and all that hangs on it. Frames and times in, frames out.

Whoever holds it calls :meth:`CanopenNode.receive` with each frame, :meth:`CanopenNode.poll` when
:meth:`CanopenNode.next_deadline_ns` is due, and takes what is to be sent with :meth:`CanopenNode.take`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto
from functools import partial
from typing import Final

from . import network_management as nmt
from .communication import (
    EMERGENCY_COB_ID,
    EMERGENCY_INHIBIT_TIME,
    ERROR_HISTORY,
    ERROR_REGISTER,
    HEARTBEAT_TIME,
    SYNC_COB_ID,
    SYNC_OVERFLOW,
)
from .data_types import Value
from .dictionary import Dictionary
from .emergency import HISTORY_ERRORS, Emergencies, EmergencyCode
from .network_management import NodeCommand, NodeState
from .pdo import (
    EVENT_TIMER,
    IDENTIFIER_MASK,
    NOT_VALID,
    NS_PER_MS,
    TICK_NS,
    TRANSMISSION_TYPE,
    TRANSMIT_PARAMETERS,
    ReceivePdo,
    TransmitPdo,
    transmission_type_exists,
)
from .sdo import AbortCode
from .sdo_server import SdoServer

MOST_WAITING_EMERGENCIES: Final = (
    8  # ASSUMED: behind an inhibit time; what is more stands in the history alone
)
SDO_TO_SERVER: Final = 0x600
SDO_TO_CLIENT: Final = 0x580
HEARTBEAT: Final = 0x700
PRODUCE_SYNC: Final = 1 << 30
COMMUNICATION: Final = (0x1000, 0x1FFF)


class Kind(Enum):
    """What a frame of the node is."""

    BOOT_UP = auto()
    HEARTBEAT = auto()
    EMERGENCY = auto()
    PDO = auto()
    SDO = auto()


#: Of these a frame that still waits is replaced by a newer one of the same identifier.
LATEST_ONLY: Final = (Kind.HEARTBEAT, Kind.PDO)


@dataclass(frozen=True)
class NodeFrame:
    """A frame that the node sends."""

    identifier: int
    data: bytes
    kind: Kind


class CanopenNode:
    """A node of CiA 301.

    Args:
        node: its number.
        dictionary: its objects; those of communication are made by :mod:`.communication`.
        transmit_pdos, receive_pdos: how many there are.
        sdo_timeout_ns: of a transfer.
        goes_operational: it starts itself after the boot-up message.
        reset_node: called on the command to reset the node.
    """

    def __init__(
        self,
        node: int,
        dictionary: Dictionary,
        *,
        transmit_pdos: int,
        receive_pdos: int,
        sdo_timeout_ns: int,
        goes_operational: bool,
        reset_node: Callable[[], None],
    ) -> None:
        self.node = node
        self.dictionary = dictionary
        self.state = NodeState.INITIALISING
        self.sdo = SdoServer(dictionary, sdo_timeout_ns)
        self.emergencies = Emergencies()
        self.transmit_pdos = [TransmitPdo(dictionary, number + 1) for number in range(transmit_pdos)]
        self.receive_pdos = [ReceivePdo(dictionary, number + 1) for number in range(receive_pdos)]
        self._goes_operational = goes_operational
        self._reset_node = reset_node
        self._heartbeat_ns: int | None = None
        self._waiting: deque[bytes] = deque()  # emergency messages
        self._emergency_free_ns = 0
        self._out: list[NodeFrame] = []
        self._serve()

    def _serve(self) -> None:
        """The objects that are the node's own."""
        dictionary, errors = self.dictionary, self.emergencies
        dictionary.on_read(ERROR_REGISTER, 0, lambda: errors.register)
        dictionary.on_read(ERROR_HISTORY, 0, errors.count)
        for number in range(1, HISTORY_ERRORS + 1):
            dictionary.on_read(ERROR_HISTORY, number, partial(errors.past, number))
        dictionary.on_write(ERROR_HISTORY, 0, self._history_written)
        dictionary.on_write(SYNC_COB_ID, 0, self._sync_identifier_written)
        dictionary.on_write(SYNC_OVERFLOW, 0, self._sync_overflow_written)
        dictionary.on_write(EMERGENCY_COB_ID, 0, self._emergency_identifier_written)
        dictionary.on_write(HEARTBEAT_TIME, 0, self._heartbeat_written)
        for pdo in self.transmit_pdos:
            index = TRANSMIT_PARAMETERS + pdo.number - 1
            dictionary.on_write(index, TRANSMISSION_TYPE, self._transmission_type_written)
            dictionary.on_write(index, EVENT_TIMER, partial(self._timer_written, pdo))

    # -- life

    def start(self, now_ns: int) -> None:
        """Power-on, a reset of the node or of its communication: say so, and be there."""
        self.dictionary.restore(*COMMUNICATION)
        self.sdo.reset()
        self._waiting.clear()
        self._out.append(NodeFrame(HEARTBEAT + self.node, nmt.BOOT_UP, Kind.BOOT_UP))
        self._enter(NodeState.PRE_OPERATIONAL, now_ns)
        self._schedule_heartbeat(now_ns)
        if self._goes_operational:
            self._enter(NodeState.OPERATIONAL, now_ns)

    def stop(self) -> None:
        """It is not there any more; what was to be sent and was not taken is forgotten."""
        self.state = NodeState.INITIALISING
        self.sdo.reset()
        self._heartbeat_ns = None
        self._waiting.clear()
        self._out.clear()

    def _enter(self, state: NodeState, now_ns: int) -> None:
        if state is self.state:
            return
        self.state = state
        if state not in nmt.SPEAKS_SDO:
            self.sdo.reset()
        if state is NodeState.OPERATIONAL:
            for pdo in self.transmit_pdos:
                pdo.start(now_ns)
        for received in self.receive_pdos:
            received.held = None

    def take(self) -> list[NodeFrame]:
        """The frames to be sent now, in their order."""
        frames, self._out = self._out, []
        return frames

    # -- time

    def next_deadline_ns(self) -> int | None:
        """When :meth:`poll` has to be called though nothing happens; None when never."""
        due = [self._heartbeat_ns]
        if self.state in nmt.SPEAKS_SDO:
            due.append(self.sdo.next_deadline_ns())
        if self._waiting and self.state in nmt.SPEAKS_EMERGENCY:
            due.append(self._emergency_free_ns)
        if self.state in nmt.SPEAKS_PDO:
            due += [pdo.next_deadline_ns() for pdo in self.transmit_pdos]
        return min((at_ns for at_ns in due if at_ns is not None), default=None)

    def poll(self, now_ns: int) -> None:
        """Do what the time brings."""
        if self._heartbeat_ns is not None and now_ns >= self._heartbeat_ns:
            self._out.append(NodeFrame(HEARTBEAT + self.node, bytes((self.state,)), Kind.HEARTBEAT))
            self._schedule_heartbeat(now_ns)
        if self.state in nmt.SPEAKS_SDO:
            self._answer(self.sdo.poll(now_ns))
        self._say_emergencies(now_ns)
        if self.state in nmt.SPEAKS_PDO:
            for pdo in self.transmit_pdos:
                if pdo.poll(now_ns):
                    self._send_pdo(pdo)

    def _schedule_heartbeat(self, now_ns: int) -> None:
        period_ms = self.dictionary.number(HEARTBEAT_TIME, 0)
        self._heartbeat_ns = now_ns + period_ms * NS_PER_MS if period_ms else None

    # -- frames in

    def hears(self, identifier: int) -> bool:
        """Whether a data frame of ``identifier`` is for this node."""
        return (
            identifier == nmt.COMMAND_IDENTIFIER
            or identifier == SDO_TO_SERVER + self.node
            or self.is_sync(identifier)
            or any(pdo.takes(identifier) for pdo in self.receive_pdos)
        )

    def is_sync(self, identifier: int) -> bool:
        """Whether it is the identifier of SYNC."""
        return identifier == self.dictionary.number(SYNC_COB_ID, 0) & IDENTIFIER_MASK

    def receive(self, identifier: int, data: bytes, received_ns: int, now_ns: int) -> None:
        """A data frame whose last bit came at ``received_ns`` is processed now."""
        if self.state is NodeState.INITIALISING:
            return
        if identifier == nmt.COMMAND_IDENTIFIER:
            self._command(data, now_ns)
        elif self.is_sync(identifier):
            if self.state in nmt.SPEAKS_SYNC:
                self._sync(data, now_ns)
        elif identifier == SDO_TO_SERVER + self.node:
            if self.state in nmt.SPEAKS_SDO:
                self._answer(self.sdo.receive(data, received_ns))
        elif self.state in nmt.SPEAKS_PDO:
            for pdo in self.receive_pdos:
                if pdo.takes(identifier) and not pdo.receive(data, received_ns):
                    self.raise_error(EmergencyCode.PDO_LENGTH, now_ns, bytes((pdo.number, len(data))))

    def _answer(self, answers: list[bytes]) -> None:
        identifier = SDO_TO_CLIENT + self.node
        self._out += [NodeFrame(identifier, answer, Kind.SDO) for answer in answers]

    def _command(self, data: bytes, now_ns: int) -> None:
        command = nmt.command_of(data, self.node)
        if command is None:
            return
        if command is NodeCommand.RESET_NODE:
            self._reset_node()
        elif command is NodeCommand.RESET_COMMUNICATION:
            self.state = NodeState.INITIALISING
            self.start(now_ns)
        else:
            self._enter(nmt.NEXT_STATE[command], now_ns)

    def _sync(self, data: bytes, now_ns: int) -> None:
        if len(data) != (1 if self.dictionary.number(SYNC_OVERFLOW, 0) else 0):
            self.raise_error(EmergencyCode.SYNC_LENGTH, now_ns, bytes((len(data),)))
            return
        if self.state not in nmt.SPEAKS_PDO:
            return
        for received in self.receive_pdos:
            received.sync()
        for pdo in self.transmit_pdos:
            if pdo.sync(now_ns):
                self._send_pdo(pdo)

    # -- what the device brings

    def pdo_event(self, number: int, now_ns: int) -> None:
        """The objects of a TPDO (from 1) have something new."""
        pdo = self.transmit_pdos[number - 1]
        if self.state in nmt.SPEAKS_PDO and pdo.event(now_ns):
            self._send_pdo(pdo)

    def _send_pdo(self, pdo: TransmitPdo) -> None:
        self._out.append(NodeFrame(pdo.identifier, pdo.data, Kind.PDO))

    def raise_error(self, code: EmergencyCode, now_ns: int, details: bytes = b"") -> None:
        """An error has come up."""
        self._emergency(self.emergencies.raise_error(code, details), now_ns)

    def clear_error(self, code: EmergencyCode, now_ns: int) -> None:
        """An error is over."""
        self._emergency(self.emergencies.clear_error(code), now_ns)

    def _emergency(self, message: bytes | None, now_ns: int) -> None:
        if message is None or self.state is NodeState.INITIALISING:
            return
        if len(self._waiting) < MOST_WAITING_EMERGENCIES:
            self._waiting.append(message)
        self._say_emergencies(now_ns)

    def _say_emergencies(self, now_ns: int) -> None:
        """Those that wait for the inhibit time or for a state that lets them through."""
        while self._waiting and self.state in nmt.SPEAKS_EMERGENCY and now_ns >= self._emergency_free_ns:
            message = self._waiting.popleft()
            cob_id = self.dictionary.number(EMERGENCY_COB_ID, 0)
            if not cob_id & NOT_VALID:
                self._out.append(NodeFrame(cob_id & IDENTIFIER_MASK, message, Kind.EMERGENCY))
                inhibit = self.dictionary.number(EMERGENCY_INHIBIT_TIME, 0)
                self._emergency_free_ns = now_ns + inhibit * TICK_NS

    # -- objects of communication

    def _history_written(self, value: Value, at_ns: int) -> AbortCode | None:
        if value:
            return AbortCode.VALUE
        self.emergencies.forget()
        return None

    def _sync_identifier_written(self, value: Value, at_ns: int) -> AbortCode | None:
        """The card consumes SYNC, and has standard identifiers."""
        assert isinstance(value, int)
        return None if 1 <= value <= IDENTIFIER_MASK else AbortCode.VALUE

    def _sync_overflow_written(self, value: Value, at_ns: int) -> AbortCode | None:
        assert isinstance(value, int)
        return None if value == 0 or 2 <= value <= 240 else AbortCode.VALUE

    def _emergency_identifier_written(self, value: Value, at_ns: int) -> AbortCode | None:
        """A new identifier needs the object to be switched off (CiA 301, 7.5.2.17)."""
        assert isinstance(value, int)
        before = self.dictionary.number(EMERGENCY_COB_ID, 0)
        identifier = value & ~NOT_VALID
        if not 1 <= identifier <= IDENTIFIER_MASK:
            return AbortCode.VALUE
        changed = identifier != before & IDENTIFIER_MASK
        return AbortCode.VALUE if changed and not (before | value) & NOT_VALID else None

    def _heartbeat_written(self, value: Value, at_ns: int) -> AbortCode | None:
        """The new period begins now."""
        self.dictionary[HEARTBEAT_TIME, 0] = value
        self._schedule_heartbeat(at_ns)
        return None

    def _transmission_type_written(self, value: Value, at_ns: int) -> AbortCode | None:
        assert isinstance(value, int)
        return None if transmission_type_exists(value) else AbortCode.VALUE

    def _timer_written(self, pdo: TransmitPdo, value: Value, at_ns: int) -> AbortCode | None:
        """The new period begins now."""
        pdo.timer_from_ns = at_ns
        return None
