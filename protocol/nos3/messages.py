"""Every message of the language, once: codec and interface document come from these tables.

Source: nasa-itc/generic_star_tracker: fsw/shared (driver) and sim/src (simulator), which agree with each
other (layout ``code``), and its README, which contradicts both (layout ``readme``). Everything is big-endian
and unsigned, there is no checksum.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from ..errors import LocalProtocolError

HEADER: Final = b"\xde\xad"
TRAILER: Final = b"\xbe\xef"

_CODES: Final = {1: "B", 2: "H", 4: "I"}


@dataclass(frozen=True)
class Field:
    """An unsigned whole number of ``octets`` octets; ``fixed``: the only value that it may have."""

    name: str
    octets: int
    meaning: str
    fixed: int | None = None

    @property
    def highest(self) -> int:
        return (1 << 8 * self.octets) - 1


@dataclass(frozen=True)
class Message:
    """Octets of a fixed length: ``fields`` one behind the other."""

    name: str
    fields: tuple[Field, ...]

    @cached_property
    def _struct(self) -> struct.Struct:
        return struct.Struct(">" + "".join(_CODES[field.octets] for field in self.fields))

    @property
    def octets(self) -> int:
        """Length of the message."""
        return self._struct.size

    @property
    def variables(self) -> tuple[Field, ...]:
        """The fields that are not fixed."""
        return tuple(field for field in self.fields if field.fixed is None)

    def encode(self, values: Mapping[str, int]) -> bytes:
        """The octets with ``values`` by the names of the fields, all of them.

        Raises:
            LocalProtocolError: names the field and what is allowed.
        """
        known = [field.name for field in self.variables]
        for name in values:
            if name not in known:
                raise LocalProtocolError(self.name, name, values[name], ", ".join(known) or "no field")
        numbers = []
        for field in self.fields:
            value = values.get(field.name) if field.fixed is None else field.fixed
            if type(value) is not int or not 0 <= value <= field.highest:
                raise LocalProtocolError(
                    self.name, field.name, value, f"a whole number from 0 to {field.highest}"
                )
            numbers.append(value)
        return self._struct.pack(*numbers)

    def decode(self, raw: bytes) -> dict[str, int] | None:
        """The values of the fields that are not fixed; None: the octets are no such message."""
        if len(raw) != self.octets:
            return None
        numbers = dict(zip(self.fields, self._struct.unpack(raw), strict=True))
        if any(field.fixed not in (None, number) for field, number in numbers.items()):
            return None
        return {field.name: number for field, number in numbers.items() if field.fixed is None}


def _framed(name: str, *fields: Field) -> Message:
    return Message(
        name,
        (
            Field("header", 2, "start of the message", int.from_bytes(HEADER)),
            *fields,
            Field("trailer", 2, "end of the message", int.from_bytes(TRAILER)),
        ),
    )


_COUNT = Field("count", 4, "command counter, see there; it wraps")
_ATTITUDE = (
    Field("q0", 2, "vector part, x"),
    Field("q1", 2, "vector part, y"),
    Field("q2", 2, "vector part, z"),
    Field("q3", 2, "scalar part"),
    Field("valid", 1, "1: the quaternion is valid; 0: it is the last valid one"),
)

COMMAND: Final = _framed(
    "command",
    Field("command", 1, "number of the command"),
    Field("payload", 4, "argument: the configuration for config, without meaning for the others"),
)
HOUSEKEEPING: Final = _framed("housekeeping", _COUNT)
DATA: Final = _framed("data", *_ATTITUDE)
README_HOUSEKEEPING: Final = _framed(
    "housekeeping",
    _COUNT,
    Field("configuration", 4, "payload of the last config command; 0 from a start on"),
    Field("status", 4, "0: healthy; each bit an error, set until the next start"),
)
README_DATA: Final = _framed("data", _COUNT, *_ATTITUDE)


@dataclass(frozen=True)
class CommandDefinition:
    """One command: its number, and the reply that follows its echo (None: the echo is all)."""

    name: str
    number: int
    reply: Message | None
    meaning: str


@dataclass(frozen=True)
class Layout:
    """Numbers and replies that belong together."""

    name: str
    source: str
    commands: tuple[CommandDefinition, ...]

    def by_number(self, number: int) -> CommandDefinition | None:
        """The command of a number, or None."""
        return next((command for command in self.commands if command.number == number), None)

    def by_name(self, name: str) -> CommandDefinition | None:
        """The command of a name, or None."""
        return next((command for command in self.commands if command.name == name), None)


_CONFIG_MEANING = "set the configuration, a number that changes nothing"
CODE: Final = Layout(
    "code",
    "the driver's and the simulator's code",
    (
        CommandDefinition("noop", 0, None, "nothing; shows that the unit is there"),
        CommandDefinition("housekeeping", 1, HOUSEKEEPING, "ask for the command counter"),
        CommandDefinition("data", 2, DATA, "ask for the attitude"),
        CommandDefinition("config", 3, None, _CONFIG_MEANING),
    ),
)
README: Final = Layout(
    "readme",
    "the README of the same repository",
    (
        CommandDefinition("housekeeping", 0, README_HOUSEKEEPING, "ask for counter, configuration, status"),
        CommandDefinition("data", 1, README_DATA, "ask for the attitude"),
        CommandDefinition("config", 2, None, _CONFIG_MEANING),
    ),
)
LAYOUTS: Final[Mapping[str, Layout]] = {layout.name: layout for layout in (CODE, README)}


def encode_command(layout: Layout, name: str, payload: int = 0) -> bytes:
    """The nine octets of a command by its name.

    Raises:
        LocalProtocolError: the layout has no such command, or the payload is no u32.
    """
    command = layout.by_name(name)
    if command is None:
        allowed = ", ".join(known.name for known in layout.commands)
        raise LocalProtocolError(f"layout {layout.name}", "command", name, allowed)
    return COMMAND.encode({"command": command.number, "payload": payload})
