"""The interface document of the card, from the tables of its messages."""

from __future__ import annotations

from collections.abc import Iterable

from ...device.commands import Command, Reset
from ...firmware_model.modes import Mode
from ...protocol.canopen.card import (
    CARD_OBJECTS,
    DEFAULT_NODE,
    OBC_NODE,
    RECEIVE_PDOS,
    TRANSITIONS,
    TRANSMIT_PDOS,
    CardState,
)
from ...protocol.canopen.communication import PdoDefinition, communication_objects
from ...protocol.canopen.data_types import DataType
from ...protocol.canopen.emergency import EMERGENCIES
from ...protocol.canopen.network_management import NodeCommand, NodeState
from ...protocol.canopen.node import HEARTBEAT, MOST_WAITING_EMERGENCIES, SDO_TO_CLIENT, SDO_TO_SERVER
from ...protocol.canopen.objects import DictionaryObject
from ...protocol.canopen.sdo import ABORT_MEANINGS
from ...protocol.exporters.markdown import table
from .card import RESETS, STATE_OF_MODE
from .dialect import EMERGENCY_OF_FAULT, HARDWARE_VERSION, SOFTWARE_VERSION
from .settings import CanopenSettings
from .telecommands import TELECOMMANDS, WRITABLE_OBJECTS

INTRODUCTION = """\
# Dialect canopen

CANopen (CiA 301) on classic CAN, as the star tracker card of OreSat 1 speaks it. This document is made
from the tables of the messages (`st-emulator` checks that it is fresh); it shows node {node} =
{node:02X}h. The facts are those of the package `oresat-configs` 1.2.0 (the card's object dictionary) and
of the card's published software. What they do not say is marked `ASSUMED:`; `(unconfirmed)` has one weak
source.

A unit speaks it with `dialect = "canopen"` in its section `[wire]`, on a CAN link. Without LSS, without a
serial line.
"""

FRAMES = """\
## Bus and identifiers

CAN 2.0A, 11-bit identifiers, up to 8 octets; bit rate of the link or of `[can] bitrate` (the real card: 1
Mbit/s, unconfirmed). Numbers are little-endian. Remote frames, 29-bit identifiers and CAN FD frames are
ignored.
"""

LIFE = """\
## Life

With power the device boots ({boot}); nothing is sent and nothing heard. Then the boot-up message (700h +
node, one octet 00) and, where `goes_operational` is set, the node is operational at once (unconfirmed); else
pre-operational until it is told. The heartbeat (700h + node, one octet, the state of the node) follows
every 1017h ms, the first one period behind the boot-up message. ASSUMED: PDO timers begin when the node
becomes operational, and nothing is sent at that instant.

ASSUMED: a frame is processed `telecommand_latency_us` of the unit file behind its last bit, SYNC as well.
ASSUMED: frames leave in the order in which they were made, as from the queue of a driver, whatever their
identifiers; against other nodes they take part by identifier. Of PDOs and heartbeats that the bus does
not take only the newest waits.
"""

SDO = """\
## SDO

One server: requests on {request:03X}h, answers on {answer:03X}h, 8 octets each (others are ignored).
Octet 0 is the command; index (u16), sub-index (u8) and four octets of data follow where a transfer
begins.

Time-out of a transfer: `sdo_timeout_ms`, counted from the last frame in either direction; then abort
05040000h. ASSUMED: a new request ends the transfer under way without an abort. Blocks have up to 127
segments both ways; a lost segment is asked for again by the acknowledgement. The CRC of block transfers
is x^16 + x^12 + x^5 + 1 from 0.
"""

SDO_COMMANDS = (
    ("download, expedited", "2F xx / 2B / 23 (1, 2, 4 octets), index, sub, data", "60, index, sub"),
    ("download, segmented", "21, index, sub, u32 size; then 0tnc, 7 octets", "60, index, sub; then 20 / 30"),
    ("upload, expedited", "40, index, sub", "4F / 4B / 47 / 43 (1 to 4 octets), index, sub, data"),
    ("upload, segmented", "40, index, sub; then 60 / 70", "41, index, sub, u32 size; then 0tnc, 7 octets"),
    (
        "download by blocks",
        "C6 (size, CRC), index, sub, u32 size; segments 01.. (80h + last); C1 + 4 unused, CRC",
        "A4, index, sub, block size; A2, last segment, block size; A1",
    ),
    (
        "upload by blocks",
        "A4 (CRC), index, sub, block size, switch; A3; A2, last segment, block size; A1",
        "C6, index, sub, u32 size; segments; C1 + 4 unused, CRC",
    ),
    ("abort", "80, index, sub, u32 code", "80, index, sub, u32 code"),
)

PDOS = """\
## PDOs

Transmission types 0 (at the SYNC behind an event), 1 to 240 (at each n-th SYNC), FEh and FFh (event,
event timer); 241 to 253 are refused. An inhibit time holds an event back, and the values are those of the
moment of sending. TPDO 3, 4 and 5 are sent in this order after each solved image, none when an image is
not solved. A synchronous RPDO is in force at the next SYNC. An RPDO that is too short is not processed
(emergency 8210h); octets behind its objects are ignored. Mappings are constants. SYNC (1005h, default
080h) has no data, or one octet where 1019h is not 0.
"""

EMERGENCY = """\
## Emergency messages

Identifier {identifier:03X}h, 8 octets: u16 code, u8 error register (1001h), 5 octets of details. A
lasting error stays in the register until it is over; that is told by code 0000h with what is left in the
register. 1003h keeps the newest eight (code, first two details). ASSUMED: which event raises which code;
up to {waiting} messages wait for an inhibit time (1015h), and those of a stopped node until it is not
stopped any more.
"""

STATES = """\
## States

Object 4000h. A write asks for a state; one that cannot follow is acknowledged and ignored (quirk,
`ignores_bad_states`). BOOT ends by itself, `boot_ms` behind the start or with the device's own boot.
ASSUMED: it is seen on the bus only where `boot_ms` is longer than that. ASSUMED: LOW_POWER is a standby,
and no figure of the device differs. ASSUMED: with the parameter `autonomous_start` the card goes from
BOOT to STAR_TRACK. ERROR is the device's FAULT, also when it is asked for.
"""

MEANING = """\
## Images, time, attitude

- STAR_TRACK: the device looks for the attitude and tracks. `delay` (4001h:2) is the least time between
  two images that are reported; 0: one solved image, then STANDBY. ASSUMED: it runs from exposure to
  exposure. A lost attitude is looked for again, the state stays; so it does where the card turns too fast
  and the device measures the rate alone (RATE_ONLY): no image is solved then, and no object holds a rate.
- CAPTURE: images one behind the other, `delay` between them, until there are `num_of_images` or
  `duration` is over; then STANDBY. Those that the filter (4003h) refuses are not counted. ASSUMED: with
  `enable` 0 every image is taken; the delay does not hold up the end.
- `last_capture` is the last captured or solved image: rows from the top, 16 bits a pixel, little-endian
  (ASSUMED). `last_display_image`: a PNG of 8 bits grey, at most 640 x 480 px, of the upper 8 bits
  (ASSUMED), averaged to size (ASSUMED); both are empty when there is none. ASSUMED: making it takes no
  time.
- `scet`: u32 seconds, u24 microseconds, u8 0; `utc`: u16 days, u32 milliseconds of the day, u16
  microseconds; both since 1970 UTC. Written by SDO or RPDO 1 they are the time at which the last bit of
  the frame came in, in force with the next frame of the sensor. Until then the card's clock counts from
  1970-01-01 at power-on (ASSUMED).
- `time_since_midnight` and `last_capture_time` are those of mid-exposure (ASSUMED), both whole Unix
  seconds (quirk of the former).
- The quaternion (i, j, k, real) turns ICRS components of a vector into those of the device's frame: +Z
  boresight, x along columns, y along rows (ASSUMED: direction and frame are not documented; settings
  `direction`, `boresight`).
- 3003h:1: 1 restarts the device and keeps its time, 2 restarts it, 3 restores its parameters and restarts
  it, 4 shuts it down; the write is acknowledged first. NMT reset node is 2.
"""


ABSENT = """\
Objects of the card's files, updater, logs, daemons and operating system (1023h, 3004h to 3008h) are there as
far as a PDO holds them: ASSUMED to be 0, for the device has none of these. 1010h, 1011h and 1016h are not
there, as on the card.
"""


def _hex(number: int, digits: int = 4) -> str:
    return f"{number:0{digits}X}h"


def _command(command: Command) -> str:
    name = type(command).__name__
    return f"{name} ({command.cause.name})" if isinstance(command, Reset) else name


def _default(item: DictionaryObject, sub: int) -> str:
    value = item.subs[sub].default
    if isinstance(value, (str, bytes)):
        return f'"{value}"' if isinstance(value, str) else "empty"
    if item.index in range(0x1000, 0x2000) and item.subs[sub].type is DataType.UNSIGNED32 and value:
        return f"{value:X}h"
    return f"{value:g}"


def _object_rows(objects: Iterable[DictionaryObject]) -> Iterable[tuple[str, ...]]:
    for item in objects:
        for entry in item.entries:
            place = _hex(item.index) if item.is_variable else f"{_hex(item.index)}:{entry.sub}"
            name = item.name if item.is_variable else f"{item.name}.{entry.name}"
            kind = entry.type.name.lower()
            meaning = entry.meaning or item.meaning
            unit = f" ({entry.unit})" if entry.unit else ""
            yield (place, f"`{name}`", kind, entry.access.value, _default(item, entry.sub), meaning + unit)


def _objects() -> list[DictionaryObject]:
    settings = CanopenSettings.model_validate({})
    return communication_objects(
        settings.node,
        name="(name of the unit)",
        hardware_version=HARDWARE_VERSION,
        software_version=SOFTWARE_VERSION,
        heartbeat_ms=settings.heartbeat_ms,
        receive=[(pdo, pdo.base + settings.obc_node) for pdo in RECEIVE_PDOS],
        transmit=[(pdo, pdo.base + settings.node) for pdo in TRANSMIT_PDOS],
        fixed_pdo_parameters=settings.fixed_pdo_parameters,
    )


def _pdo_rows(pdos: Iterable[PdoDefinition], kind: str, node: int) -> Iterable[tuple[str, ...]]:
    names = {(item.index, entry.sub): (item, entry) for item in CARD_OBJECTS for entry in item.entries}
    for pdo in pdos:
        start = 0
        for mapped in pdo.mapping:
            item, entry = names[mapped.index, mapped.sub]
            size = mapped.bits // 8
            place = f"{start}" if size == 1 else f"{start}..{start + size - 1}"
            name = item.name if item.is_variable else f"{item.name}.{entry.name}"
            first = not start
            yield (
                f"{kind} {pdo.number}" if first else "",
                _hex(pdo.base + node, 3) if first else "",
                place,
                f"`{name}`",
                entry.type.name.lower(),
                pdo.when + (f", {pdo.event_timer_ms} ms" if pdo.event_timer_ms else "") if first else "",
            )
            start += size


def document() -> str:
    """The whole document."""
    node = DEFAULT_NODE
    identifiers = [
        ("000h", "to the card", "NMT: u8 command, u8 node (0: every one)"),
        ("080h", "to the card", "SYNC"),
        (_hex(0x80 + node, 3), "from it", "emergency messages"),
        (_hex(0x180 + OBC_NODE, 3), "to the card", "RPDO 1"),
        *[(_hex(pdo.base + node, 3), "from it", f"TPDO {pdo.number}") for pdo in TRANSMIT_PDOS],
        (_hex(SDO_TO_CLIENT + node, 3), "from it", "SDO answers"),
        (_hex(SDO_TO_SERVER + node, 3), "to the card", "SDO requests"),
        (_hex(HEARTBEAT + node, 3), "from it", "boot-up message and heartbeat"),
    ]
    states = [
        (
            f"{state.value:02X}h",
            state.name,
            ", ".join(mode.name for mode in Mode if STATE_OF_MODE[mode] is state) or "STANDBY",
            ", ".join(one.name for one in TRANSITIONS[state]) or "none",
        )
        for state in CardState
    ]
    emergencies = [
        (
            _hex(code),
            "lasting" if meaning.lasting else "of the moment",
            _hex(int(meaning.register) | 1, 2),
            meaning.meaning,
            meaning.details,
            ", ".join(cause.name for cause, one in EMERGENCY_OF_FAULT.items() if one is code),
        )
        for code, meaning in EMERGENCIES.items()
    ]
    settings = [
        (f"`{name}`", str(field.default), str(field.description))
        for name, field in CanopenSettings.model_fields.items()
    ]
    resets = [
        (str(int(kind)), kind.name, ", ".join(map(_command, commands)) or "none")
        for kind, commands in RESETS.items()
    ]
    lines = [
        INTRODUCTION.format(node=node),
        FRAMES,
        *table(("Identifier", "Way", "What"), identifiers),
        LIFE.format(boot="`boot_ms` of the unit's section `[timing]`"),
        *table(("NMT command", "Name"), [(str(int(one)), one.name) for one in NodeCommand]),
        *table(
            ("Heartbeat", "State of the node", "Lets through"),
            [
                (_hex(NodeState.STOPPED, 2), "STOPPED", "NMT, heartbeat"),
                (_hex(NodeState.OPERATIONAL, 2), "OPERATIONAL", "everything"),
                (_hex(NodeState.PRE_OPERATIONAL, 2), "PRE_OPERATIONAL", "everything but PDOs"),
            ],
        ),
        SDO.format(request=SDO_TO_SERVER + node, answer=SDO_TO_CLIENT + node),
        *table(("Transfer", "Client (octets, hexadecimal)", "Server"), SDO_COMMANDS),
        *table(("Abort code", "Meaning"), [(_hex(code, 8), text) for code, text in ABORT_MEANINGS.items()]),
        PDOS,
        *table(
            ("PDO", "Identifier", "Octet", "Object", "Type", "When"),
            [*_pdo_rows(RECEIVE_PDOS, "RPDO", OBC_NODE), *_pdo_rows(TRANSMIT_PDOS, "TPDO", node)],
        ),
        EMERGENCY.format(identifier=0x80 + node, waiting=MOST_WAITING_EMERGENCIES),
        *table(("Code", "How long", "Register", "Meaning", "Details", "Faults of the device"), emergencies),
        STATES,
        *table(("4000h", "State", "Modes of the device", "Can be asked for then"), states),
        MEANING,
        *table(("3003h:1", "Name", "Commands to the device"), resets),
        "## Object dictionary\n",
        *table(
            ("Object", "Name", "Type", "Access", "Default", "Meaning"),
            _object_rows([*_objects(), *CARD_OBJECTS]),
        ),
        ABSENT,
        "## Settings and quirks\n",
        "Keys of the unit file's table `[dialects.canopen]`.\n",
        *table(("Key", "Default", "Meaning"), settings),
        "## Telecommands of a scenario\n",
        *table(("Name", "Meaning"), [(f"`{name}`", text) for name, (_, text) in TELECOMMANDS.items()]),
        "Objects to write: " + ", ".join(f"`{name}`" for name in WRITABLE_OBJECTS) + ".",
        "`raw_hex` is the record of a frame (pcap link type 227).",
    ]
    return "\n".join(lines).rstrip("\n") + "\n"
