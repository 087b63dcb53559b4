"""A scenario's telecommands by name: the records of an OBC's frames, several for a segmented transfer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

from ...protocol.can.frames import CanFrame, encode_record
from ...protocol.canopen import card
from ...protocol.canopen.card import CARD_OBJECTS, CardState
from ...protocol.canopen.data_types import encode_value
from ...protocol.canopen.network_management import COMMAND_IDENTIFIER, EVERY_NODE, NodeCommand
from ...protocol.canopen.node import SDO_TO_SERVER
from ...protocol.canopen.objects import READABLE, WRITABLE, Entry
from ...protocol.canopen.sdo import ClientCommand
from ...protocol.canopen.time_codes import scet_of
from ...protocol.errors import LocalProtocolError
from .settings import CanopenSettings

SYNC_IDENTIFIER = 0x80
MICROSECOND_PARTS = 1_000_000
EXPEDITED_BYTES = 4

#: Objects that a scenario can write, by name: "status", "capture.delay".
WRITABLE_OBJECTS: dict[str, tuple[int, Entry]] = {
    item.name if item.is_variable else f"{item.name}.{entry.name}": (item.index, entry)
    for item in CARD_OBJECTS
    for entry in item.entries
    if entry.access in WRITABLE
}
#: Those that it can read.
READABLE_OBJECTS: dict[str, tuple[int, Entry]] = {
    item.name if item.is_variable else f"{item.name}.{entry.name}": (item.index, entry)
    for item in CARD_OBJECTS
    for entry in item.entries
    if entry.access in READABLE
}

Fields = Mapping[str, Any]


def _only(message: str, fields: Fields, *names: str) -> None:
    for name in fields:
        if name not in names:
            allowed = ", ".join(names) if names else "no fields"
            raise LocalProtocolError(message, name, fields[name], allowed)
    for name in names:
        if name not in fields:
            raise LocalProtocolError(message, name, None, "a value: it is missing")


def _member(message: str, field: str, value: Any, choices: type[CardState] | type[NodeCommand]) -> int:
    if isinstance(value, str) and value.upper() in choices.__members__:
        return int(choices[value.upper()])
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= 0xFF:
        return value
    names = ", ".join(choices.__members__)
    raise LocalProtocolError(message, field, value, f"0 to 255 or one of {names}")


def _frames(*frames: tuple[int, bytes]) -> bytes:
    return b"".join(encode_record(CanFrame(identifier, data)) for identifier, data in frames)


def _place(index: int, sub: int) -> bytes:
    return index.to_bytes(2, "little") + bytes((sub,))


def download(node: int, index: int, sub: int, data: bytes) -> bytes:
    """The records of an SDO download: expedited, or segmented where it is longer."""
    identifier = SDO_TO_SERVER + node
    if 1 <= len(data) <= EXPEDITED_BYTES:
        first = ClientCommand.INITIATE_DOWNLOAD << 5 | (EXPEDITED_BYTES - len(data)) << 2 | 3
        return _frames((identifier, (bytes((first,)) + _place(index, sub) + data).ljust(8, b"\0")))
    first = ClientCommand.INITIATE_DOWNLOAD << 5 | 1
    frames = [(identifier, bytes((first,)) + _place(index, sub) + len(data).to_bytes(4, "little"))]
    for number, start in enumerate(range(0, len(data), 7)):
        part = data[start : start + 7]
        command = (number & 1) << 4 | (7 - len(part)) << 1 | (start + 7 >= len(data))
        frames.append((identifier, (bytes((command,)) + part).ljust(8, b"\0")))
    return _frames(*frames)


def upload(node: int, index: int, sub: int) -> bytes:
    """The record of the request of an SDO upload; of a long object it is the first one only."""
    first = ClientCommand.INITIATE_UPLOAD << 5
    return _frames((SDO_TO_SERVER + node, (bytes((first,)) + _place(index, sub)).ljust(8, b"\0")))


def _nmt(node: int, settings: CanopenSettings, fields: Fields) -> bytes:
    fields = {"node": node, **fields}
    _only("nmt", fields, "node", "command")
    command = _member("nmt", "command", fields["command"], NodeCommand)
    target = fields["node"]
    if not isinstance(target, int) or isinstance(target, bool) or not EVERY_NODE <= target <= 127:
        raise LocalProtocolError("nmt", "node", target, "1 to 127, or 0 for every node")
    return _frames((COMMAND_IDENTIFIER, bytes((command, target))))


def _sync(node: int, settings: CanopenSettings, fields: Fields) -> bytes:
    _only("sync", fields)
    return _frames((SYNC_IDENTIFIER, b""))


def _time(node: int, settings: CanopenSettings, fields: Fields) -> bytes:
    _only("time", fields, "utc")
    moment = fields["utc"]
    if isinstance(moment, str):
        try:
            moment = datetime.fromisoformat(moment)
        except ValueError:
            moment = None
    if not isinstance(moment, datetime) or moment.tzinfo is None or moment.year < 1970:
        allowed = "a date and time since 1970 with its zone, such as 2026-01-15T00:00:00Z"
        raise LocalProtocolError("time", "utc", fields["utc"], allowed)
    since = moment - datetime(1970, 1, 1, tzinfo=UTC)
    unix_us = (since.days * 86_400 + since.seconds) * MICROSECOND_PARTS + since.microseconds
    return _frames((0x180 + settings.obc_node, scet_of(unix_us).to_bytes(8, "little")))


def _status(node: int, settings: CanopenSettings, fields: Fields) -> bytes:
    _only("status", fields, "state")
    state = _member("status", "state", fields["state"], CardState)
    return download(node, card.STATUS, 0, bytes((state,)))


def _write(node: int, settings: CanopenSettings, fields: Fields) -> bytes:
    _only("write", fields, "object", "value")
    found = WRITABLE_OBJECTS.get(fields["object"]) if isinstance(fields["object"], str) else None
    if found is None:
        raise LocalProtocolError("write", "object", fields["object"], ", ".join(WRITABLE_OBJECTS))
    index, entry = found
    value = fields["value"]
    if isinstance(value, bool):
        value = int(value)
    if not isinstance(value, int) or not 0 <= value <= (entry.highest or 0):
        raise LocalProtocolError("write", "value", value, f"0 to {entry.highest}")
    return download(node, index, entry.sub, encode_value(entry.type, value))


def _read(node: int, settings: CanopenSettings, fields: Fields) -> bytes:
    _only("read", fields, "object")
    found = READABLE_OBJECTS.get(fields["object"]) if isinstance(fields["object"], str) else None
    if found is None:
        raise LocalProtocolError("read", "object", fields["object"], ", ".join(READABLE_OBJECTS))
    return upload(node, found[0], found[1].sub)


def _raw(node: int, settings: CanopenSettings, fields: Fields) -> bytes:
    _only("frame", fields, "identifier", "data_hex")
    try:
        return _frames((fields["identifier"], bytes.fromhex(fields["data_hex"])))
    except (TypeError, ValueError) as error:
        allowed = "an identifier of 11 bits, and text of up to 8 octets"
        raise LocalProtocolError("frame", "data_hex", fields["data_hex"], allowed) from error


TELECOMMANDS: dict[str, tuple[Callable[[int, CanopenSettings, Fields], bytes], str]] = {
    "nmt": (_nmt, "network management: command (START, ..., RESET_NODE); node where it is another"),
    "sync": (_sync, "SYNC"),
    "time": (_time, "RPDO 1 with the SCET of a moment: utc"),
    "status": (_status, "SDO write of 4000h: state by name or number"),
    "write": (_write, "SDO write of one of the card's objects: object (capture.delay), value"),
    "read": (_read, "SDO read request of one of the card's objects: object"),
    "frame": (_raw, "any data frame: identifier, data_hex"),
}
"""Name: what encodes it, and what it is."""


def encode_named(node: int, settings: CanopenSettings, name: str, fields: Fields) -> bytes:
    """The records of a telecommand.

    Raises:
        LocalProtocolError: no such telecommand, or a wrong field.
    """
    if name not in TELECOMMANDS:
        raise LocalProtocolError("telecommand", "name", name, ", ".join(TELECOMMANDS))
    return TELECOMMANDS[name][0](node, settings, fields)
