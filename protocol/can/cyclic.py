"""The frames of the unit on a CAN bus that need no transport: one table, and the identifiers of a unit.

From :data:`CAN_MESSAGES` come the codec (a construct BitStruct of each message), the DBC, the chapter of the
interface document and the tests. Numbers are big-endian ("Motorola"), packed without gaps, most significant
bit first. Values here are physical: a signal's raw number times its scale plus its offset.

Sources: the frames are this interface's own. SYNC and the time that follows it are after the time
distribution of ECSS-E-ST-50-15C (known second-hand, through CANopen's SYNC and TIME objects of CiA 301).
ASSUMED: the bases of the identifiers; like CANopen's predefined connection set they keep the node number in
the low 7 bits and give what must not wait (SYNC, time, attitude) the low numbers that win the arbitration.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum, IntFlag
from functools import cached_property
from typing import Any, Literal

import construct

from ...firmware_model.modes import Mode
from ...firmware_model.reasons import Reason
from ..errors import LocalProtocolError
from .vocabulary import CanState

Direction = Literal["TM", "TC"]
RESERVED = "reserved"


@dataclass(frozen=True)
class Signal:
    """Some bits of a frame. ``physical = raw * scale + offset``; ``raw`` is two's complement if ``signed``.

    ``choices`` names values (IntEnum) or bits (IntFlag). Bits of the name "reserved" are sent as 0 and carry
    nothing.
    """

    name: str
    bits: int
    signed: bool = False
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""
    meaning: str = ""
    choices: type[IntEnum] | type[IntFlag] | None = None

    @property
    def raw_limits(self) -> tuple[int, int]:
        """The lowest and highest raw number."""
        if self.signed:
            return -(1 << (self.bits - 1)), (1 << (self.bits - 1)) - 1
        return 0, (1 << self.bits) - 1

    @property
    def limits(self) -> tuple[float, float]:
        """The lowest and highest physical value (int where the signal is a plain number)."""
        low, high = self.raw_limits
        return self.physical(low), self.physical(high)

    def physical(self, raw: int) -> int | float:
        """The physical value of a raw number: an int where scale is 1 and offset 0."""
        if self.scale == 1.0 and self.offset == 0.0:
            return raw
        return raw * self.scale + self.offset

    def raw(self, value: Any, message: str) -> int:
        """The raw number nearest to a physical value (half to even), saturated at the limits.

        LocalProtocolError, naming ``message``, for what is no finite number.
        """
        low, high = self.raw_limits
        number = _number(value)
        if number is None:
            span = self.limits
            raise LocalProtocolError(message, self.name, value, f"a number, {span[0]:.9g}..{span[1]:.9g}")
        if isinstance(number, float) or self.scale != 1.0 or self.offset != 0.0:
            try:
                number = (number - self.offset) / self.scale
            except OverflowError:  # an int beyond any float
                return high if number > 0 else low
        # The limits first: what is far outside may not even be finite any more, and does not round.
        return high if number >= high else low if number <= low else round(number)


def _number(value: Any) -> int | float | None:
    """``value`` as a finite Python number, None when it is none."""
    try:
        return operator.index(value)
    except TypeError:
        pass
    if isinstance(value, (str, bytes, bytearray)):
        return None
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


@dataclass(frozen=True)
class CanMessage:
    """One frame: its signals in the order of the bits. ``broadcast``: its identifier is the base alone, one
    frame for all units of the bus. ``may_be_empty``: a frame without data stands for one of zeros.
    """

    name: str
    direction: Direction
    meaning: str
    signals: tuple[Signal, ...]
    broadcast: bool = False
    may_be_empty: bool = False

    @property
    def size_bytes(self) -> int:
        """Its data bytes."""
        return sum(signal.bits for signal in self.signals) // 8

    @cached_property
    def carried(self) -> tuple[Signal, ...]:
        """Its signals without the reserved bits."""
        return tuple(signal for signal in self.signals if signal.name != RESERVED)

    @cached_property
    def layout(self) -> construct.Construct:
        """Its construct: raw numbers <-> bytes."""
        return construct.BitStruct(
            *(
                construct.Padding(signal.bits)
                if signal.name == RESERVED
                else signal.name / construct.BitsInteger(signal.bits, signed=signal.signed)
                for signal in self.signals
            )
        )

    def first_bit(self, name: str) -> int:
        """Where a signal starts: bits before it, 0 is the most significant bit of byte 0."""
        place = 0
        for signal in self.signals:
            if signal.name == name:
                return place
            place += signal.bits
        raise KeyError(name)


_FRAME_COUNTER = Signal(
    "counter", 8, meaning="low byte of the frame's index: frames of one image agree in it"
)
_SYNC_COUNTER = Signal("sync_counter", 8, meaning="counter of the SYNC")
_FRACTION = Signal("fraction", 24, scale=2.0**-24, unit="s", meaning="its fraction (CUC, 3 octets)")
_RESERVED_4 = Signal(RESERVED, 4)


def _flag(name: str, meaning: str) -> Signal:
    return Signal(name, 1, meaning=meaning)


def _quaternion_part(name: str, meaning: str) -> Signal:
    return Signal(name, 28, signed=True, scale=2.0**-27, meaning=meaning)


def _rate(axis: str) -> Signal:
    meaning = f"mean angular rate since the frame before, sensor frame to ICRS, sensor axis {axis}"
    return Signal(f"rate_{axis}", 18, signed=True, scale=2.0**-19, unit="rad/s", meaning=meaning)


def _seconds(meaning: str) -> Signal:
    return Signal("seconds", 32, unit="s", meaning=meaning)


CAN_MESSAGES: tuple[CanMessage, ...] = (
    CanMessage(
        "heartbeat",
        "TM",
        "the unit lives: its mode, at a fixed period",
        (
            Signal("counter", 8, meaning="up by 1 with each heartbeat, modulo 256"),
            Signal("mode", 8, meaning="present mode", choices=Mode),
            _flag("attitude_valid", "1: the last attitude is valid"),
            _flag("time_set", "1: the on-board time has been set"),
            Signal("can_state", 2, meaning="state of the CAN controller", choices=CanState),
            _RESERVED_4,
            Signal("boot_count", 8, meaning="starts of the unit so far, low byte"),
            Signal("uptime_s", 32, unit="s", meaning="whole seconds since the start"),
        ),
    ),
    CanMessage(
        "attitude_1",
        "TM",
        "first half of q_icrs_to_sensor; belongs to the attitude_2 of the same counter",
        (
            _FRAME_COUNTER,
            _quaternion_part("q_x", "q_icrs_to_sensor, vector part x"),
            _quaternion_part("q_y", "q_icrs_to_sensor, vector part y"),
        ),
    ),
    CanMessage(
        "attitude_2",
        "TM",
        "second half of q_icrs_to_sensor; belongs to the attitude_1 of the same counter",
        (
            _FRAME_COUNTER,
            _quaternion_part("q_z", "q_icrs_to_sensor, vector part z"),
            _quaternion_part("q_w", "q_icrs_to_sensor, scalar part, 0 or positive"),
        ),
    ),
    CanMessage(
        "rates",
        "TM",
        "angular rate",
        (
            _FRAME_COUNTER,
            _flag("rate_valid", "1: the rate is valid"),
            Signal(RESERVED, 1),
            _rate("x"),
            _rate("y"),
            _rate("z"),
        ),
    ),
    CanMessage(
        "status",
        "TM",
        "what the attitude of the frame rests on, and why it is not valid",
        (
            _FRAME_COUNTER,
            Signal("mode", 8, meaning="mode in which the frame was processed", choices=Mode),
            _flag("valid", "1: the attitude is valid"),
            _flag("rate_valid", "1: the rate is valid"),
            _flag("late", "1: the frame overran its budget"),
            _flag("time_set", "1: the on-board time has been set"),
            _RESERVED_4,
            Signal("reasons", 16, meaning="why the attitude is not valid; 0 when it is", choices=Reason),
            Signal("stars_identified", 8, meaning="stars that the attitude rests on; 255: 255 or more"),
            Signal("spots_detected", 8, meaning="spots found; 255: 255 or more"),
            Signal("frames_dropped_before", 8, meaning="frames dropped just before; 255: 255 or more"),
        ),
    ),
    CanMessage(
        "mid_exposure_time",
        "TM",
        "on-board time of mid-exposure: the time of the attitude of the same counter",
        (_FRAME_COUNTER, _seconds("whole seconds of TAI since 1958-01-01"), _FRACTION),
    ),
    CanMessage(
        "sync_time",
        "TM",
        "answer to a SYNC: the unit's on-board time at its reception",
        (_SYNC_COUNTER, _seconds("whole seconds of TAI since 1958-01-01"), _FRACTION),
    ),
    CanMessage(
        "sync",
        "TC",
        "SYNC: every unit latches its on-board time when the last bit of this frame is in",
        (Signal("sync_counter", 8, meaning="which SYNC it is; without data it counts as 0"),),
        broadcast=True,
        may_be_empty=True,
    ),
    CanMessage(
        "time_at_sync",
        "TC",
        "the time at which the SYNC of this counter was received: sets the on-board time",
        (_SYNC_COUNTER, _seconds("whole seconds of TAI since 1958-01-01"), _FRACTION),
        broadcast=True,
    ),
)
"""Every frame that is read without a transport."""

CAN_MESSAGES_BY_NAME: dict[str, CanMessage] = {message.name: message for message in CAN_MESSAGES}

TELECOMMAND = "telecommand"
TELEMETRY = "telemetry"
TRANSPORT_NAMES: dict[str, str] = {
    TELECOMMAND: "ISO-TP, OBC to unit: telecommand packets, and flow control of the telemetry",
    TELEMETRY: "ISO-TP, unit to OBC: telemetry packets, and flow control of the telecommands",
}
"""The identifiers that carry packets by ISO-TP, and what travels on each."""

DEFAULT_BASES: dict[str, int] = {
    "sync": 0x080,
    "time_at_sync": 0x100,
    "attitude_1": 0x180,
    "attitude_2": 0x280,
    "rates": 0x380,
    "sync_time": 0x400,
    "status": 0x480,
    "mid_exposure_time": 0x500,
    TELEMETRY: 0x580,
    TELECOMMAND: 0x600,
    "heartbeat": 0x700,
}
"""11-bit bases of the identifiers by name, in the order of their priority on the bus."""

IDENTIFIER_NAMES: tuple[str, ...] = tuple(DEFAULT_BASES)
NODES = range(1, 128)
BASE_STEP = 128
"""Bases are multiples of it, so that no node number leads from one base to another."""
EXTENDED_SHIFT = 18
"""An 11-bit base stands in the upper 11 of 29 bits by default: the same priorities."""


def default_bases(extended: bool) -> dict[str, int]:
    """The bases of a unit whose file says nothing about them."""
    shift = EXTENDED_SHIFT if extended else 0
    return {name: base << shift for name, base in DEFAULT_BASES.items()}


def highest_base(extended: bool) -> int:
    """The highest base that leaves room for the node number."""
    return ((1 << (29 if extended else 11)) - 1) & ~(BASE_STEP - 1)


def is_broadcast(name: str) -> bool:
    """Whether the identifier of this name carries no node number."""
    message = CAN_MESSAGES_BY_NAME.get(name)
    return message is not None and message.broadcast


@dataclass(frozen=True)
class CanIdentifiers:
    """The identifiers of one unit: base plus node number, or the base alone of a broadcast frame.

    ``bases`` holds one base for each of :data:`IDENTIFIER_NAMES`, multiples of 128, all different; without
    it, the default ones. LocalProtocolError otherwise.
    """

    node: int
    extended: bool = False
    bases: Mapping[str, int] = field(default_factory=dict, hash=False)
    _names: dict[int, str] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        bases = dict(self.bases) or default_bases(self.extended)
        if self.node not in NODES:
            raise LocalProtocolError("CanIdentifiers", "node", self.node, "1..127")
        if set(bases) != set(IDENTIFIER_NAMES):
            raise LocalProtocolError(
                "CanIdentifiers", "bases", sorted(bases), f"one each of {', '.join(IDENTIFIER_NAMES)}"
            )
        highest = highest_base(self.extended)
        for name, base in bases.items():
            if not 0 <= base <= highest or base % BASE_STEP:
                allowed = f"multiples of {BASE_STEP} up to 0x{highest:X}"
                raise LocalProtocolError("CanIdentifiers", name, base, allowed)
        if len(set(bases.values())) != len(bases):
            raise LocalProtocolError("CanIdentifiers", "bases", bases, "different bases")
        object.__setattr__(self, "bases", bases)
        object.__setattr__(self, "_names", {self.identifier(name): name for name in bases})

    def identifier(self, name: str) -> int:
        """The identifier of a frame of :data:`CAN_MESSAGES`, of ``telecommand`` or of ``telemetry``."""
        try:
            base = self.bases[name]
        except KeyError:
            allowed = f"one of {', '.join(IDENTIFIER_NAMES)}"
            raise LocalProtocolError("CanIdentifiers", "name", name, allowed) from None
        return base if is_broadcast(name) else base + self.node

    @property
    def telecommand(self) -> int:
        """Of the ISO-TP frames from the OBC to the unit."""
        return self.identifier(TELECOMMAND)

    @property
    def telemetry(self) -> int:
        """Of the ISO-TP frames from the unit to the OBC."""
        return self.identifier(TELEMETRY)

    def name_of(self, identifier: int, extended: bool | None = None) -> str | None:
        """What the frame of an identifier is, None when it is nothing of this unit's.

        ``extended``: whether the frame has a 29-bit identifier, where that is known; a frame of the other
        width is nothing of this unit's.
        """
        if extended is not None and extended != self.extended:
            return None
        return self._names.get(identifier)


def encode_can_message(name: str, values: Mapping[str, Any]) -> bytes:
    """The data bytes of a frame.

    ``values``: the physical value of each signal, reserved bits left out; each is rounded to the nearest
    step (half to even) and saturated at the signal's range. LocalProtocolError for an unknown name, a
    missing or unknown signal, and a value that is no finite number.
    """
    message = _defined(name)
    raw = {}
    for signal in message.carried:
        if signal.name not in values:
            raise LocalProtocolError(name, signal.name, None, "a number for each signal")
        raw[signal.name] = signal.raw(values[signal.name], name)
    if len(values) != len(raw):
        extra = next(key for key in values if key not in raw)
        raise LocalProtocolError(name, extra, values[extra], f"only {', '.join(raw)}")
    return bytes(message.layout.build(raw))


def decode_can_message(name: str, data: bytes) -> dict[str, Any] | None:
    """The physical values of a frame's signals (ints where the scale is 1), reserved bits left out.

    None when ``data`` has not the frame's length: whoever received it counts it. Values of enumerations
    come as plain numbers, whether they have a name or not. LocalProtocolError for an unknown name.
    """
    message = _defined(name)
    if not data and message.may_be_empty:
        data = bytes(message.size_bytes)
    if len(data) != message.size_bytes:
        return None
    raw = message.layout.parse(data)
    return {signal.name: signal.physical(raw[signal.name]) for signal in message.carried}


def _defined(name: str) -> CanMessage:
    message = CAN_MESSAGES_BY_NAME.get(name)
    if message is None:
        raise LocalProtocolError("CAN frame", "name", name, f"one of {', '.join(CAN_MESSAGES_BY_NAME)}")
    return message
