"""The DBC file of units on a CAN bus: every frame that they and their OBC send, for any CAN tool.

The cyclic frames come from the table of :mod:`can_messages`. The frames of the ISO-TP transport are described
too, multiplexed on the type nibble of their protocol control information (ISO 15765-2), so that a log of the
whole bus decodes. The format has no public standard; it is written as the tools read it: numbers of bits as
in a saw tooth, the start bit of a big-endian ("Motorola") signal its most significant one, bit 31 of the
identifier set for 29 bits, names of at most 32 characters with the long ones in attributes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntFlag

from ..can.cyclic import (
    CAN_MESSAGES,
    TELECOMMAND,
    TELEMETRY,
    TRANSPORT_NAMES,
    CanIdentifiers,
    CanMessage,
    Signal,
)
from ..errors import LocalProtocolError
from ..pus.fields import meaning_of

OBC = "OBC"
MAX_NAME = 32
CLASSIC_BYTES = 8
FD_BYTES = 64
_EXTENDED = 0x80000000
_FRAME_FORMATS = ("StandardCAN", "ExtendedCAN", *["reserved"] * 12, "StandardCAN_FD", "ExtendedCAN_FD")
_PCI_TYPES = {0: "SINGLE_FRAME", 1: "FIRST_FRAME", 2: "CONSECUTIVE_FRAME", 3: "FLOW_CONTROL"}
_NONE: Mapping[int, str] = {}
_FLOW_STATUS = {0: "CONTINUE_TO_SEND", 1: "WAIT", 2: "OVERFLOW"}


@dataclass(frozen=True)
class DbcUnit:
    """A unit of the bus. ``cycle_times_ms``: of its cyclic frames by name, 0 or absent: not cyclic."""

    name: str
    identifiers: CanIdentifiers
    cycle_times_ms: Mapping[str, int] = field(default_factory=dict)

    @property
    def node_name(self) -> str:
        """Its name on the bus."""
        return f"{self.name}_{self.identifiers.node}"


@dataclass(frozen=True)
class _Bits:
    """A signal in its place; ``multiplexed``: the value of the multiplexor with which it is there."""

    signal: Signal
    first_bit: int
    multiplexed: int | None = None
    multiplexor: bool = False
    values: Mapping[int, str] = field(default_factory=dict)


@dataclass(frozen=True)
class _Frame:
    """A message of the file."""

    name: str
    identifier: int
    extended: bool
    size_bytes: int
    sender: str
    receivers: tuple[str, ...]
    meaning: str
    signals: tuple[_Bits, ...]
    cycle_ms: int = 0
    fd: bool = False

    @property
    def number(self) -> int:
        """Its identifier as the file writes it."""
        return self.identifier | (_EXTENDED if self.extended else 0)


def can_database(units: Sequence[DbcUnit], *, fd: bool = False) -> str:
    """The DBC text of a bus with these units and an OBC. The same arguments give the same text.

    Messages are named ``<unit>_<node>_<frame>``; a frame for all units stands once. ``fd``: the ISO-TP
    frames are those of CAN FD, up to 64 bytes. LocalProtocolError when a unit and node stands twice or
    an identifier would have two meanings.
    """
    names = [unit.node_name for unit in units]
    for name in names:
        if names.count(name) > 1:
            raise LocalProtocolError("DBC", "units", name, "each unit and node once")
    frames = _frames(units, FD_BYTES if fd else CLASSIC_BYTES)
    frame_names = _short_names(frame.name for frame in frames)
    node_names = _short_names([OBC, *(unit.node_name for unit in units)])
    lines = [
        'VERSION ""',
        "",
        "NS_ :",
        "",
        "BS_:",
        "",
        "BU_: " + " ".join(node_names.values()),
        "",
        *(f"VAL_TABLE_ {name} {_values(table)};" for name, table in sorted(_tables(frames).items())),
        "",
    ]
    for frame in frames:
        sender, name = node_names[frame.sender], frame_names[frame.name]
        receivers = ",".join(node_names[receiver] for receiver in frame.receivers)
        lines.append(f"BO_ {frame.number} {name}: {frame.size_bytes} {sender}")
        lines += [_signal_line(bits, receivers) for bits in frame.signals]
        lines.append("")
    lines += _comments(frames, node_names, units)
    lines += _attributes(frames, frame_names, node_names, fd)
    lines += [
        f"VAL_ {frame.number} {bits.signal.name} {_values(bits.values)};"
        for frame in frames
        for bits in frame.signals
        if bits.values
    ]
    return "\n".join(lines) + "\n"


def _frames(units: Sequence[DbcUnit], transport_bytes: int) -> list[_Frame]:
    """All messages, in the order of the units and of the table, those for all units first."""
    shared: dict[tuple[str, int, bool], _Frame] = {}
    own: list[_Frame] = []
    for unit in units:
        for message in CAN_MESSAGES:
            frame = _cyclic_frame(unit, message)
            if message.broadcast:
                key = (message.name, frame.identifier, frame.extended)
                if key in shared:
                    frame = replace(frame, receivers=shared[key].receivers + frame.receivers)
                shared[key] = frame
            else:
                own.append(frame)
        own += [_transport_frame(unit, name, transport_bytes) for name in TRANSPORT_NAMES]
    names = [name for name, _, _ in shared]
    # Units of other files may have other identifiers for the same frame.
    broadcast = [
        replace(frame, name=f"{name}_{identifier:X}") if names.count(name) > 1 else frame
        for (name, identifier, _), frame in shared.items()
    ]
    frames = broadcast + own
    taken: dict[int, _Frame] = {}
    for frame in frames:
        other = taken.setdefault(frame.number, frame)
        if other is not frame:
            raise LocalProtocolError(
                "DBC", frame.name, f"0x{frame.identifier:X}", f"an identifier that is not {other.name}'s"
            )
    return frames


def _cyclic_frame(unit: DbcUnit, message: CanMessage) -> _Frame:
    telemetry = message.direction == "TM"
    return _Frame(
        name=message.name if message.broadcast else f"{unit.node_name}_{message.name}",
        identifier=unit.identifiers.identifier(message.name),
        extended=unit.identifiers.extended,
        size_bytes=message.size_bytes,
        sender=unit.node_name if telemetry else OBC,
        receivers=(OBC,) if telemetry else (unit.node_name,),
        meaning=message.meaning,
        signals=tuple(
            _Bits(signal, message.first_bit(signal.name), values=_choices(signal))
            for signal in message.carried
        ),
        cycle_ms=unit.cycle_times_ms.get(message.name, 0),
    )


def _transport_frame(unit: DbcUnit, name: str, size_bytes: int) -> _Frame:
    telemetry = name == TELEMETRY
    assert telemetry or name == TELECOMMAND
    return _Frame(
        name=f"{unit.node_name}_{name}",
        identifier=unit.identifiers.identifier(name),
        extended=unit.identifiers.extended,
        size_bytes=size_bytes,
        sender=unit.node_name if telemetry else OBC,
        receivers=(OBC,) if telemetry else (unit.node_name,),
        meaning=TRANSPORT_NAMES[name],
        signals=tuple(_transport_signals(size_bytes)),
        fd=size_bytes > CLASSIC_BYTES,
    )


def _transport_signals(size_bytes: int) -> Iterator[_Bits]:
    """Protocol control information and data bytes (ISO 15765-2, tables of the N_PCI)."""

    def part(
        kind: int, name: str, first_bit: int, bits: int, meaning: str = "", values: Mapping[int, str] = _NONE
    ) -> _Bits:
        return _Bits(Signal(name, bits, meaning=meaning), first_bit, kind, values=values)

    def data(kind: int, prefix: str, first_byte: int, meaning: str) -> Iterator[_Bits]:
        for byte in range(first_byte, size_bytes):
            yield part(kind, f"{prefix}_byte_{byte}", 8 * byte, 8, meaning if byte == first_byte else "")

    yield _Bits(Signal("pci_type", 4, meaning="kind of ISO-TP frame"), 0, multiplexor=True, values=_PCI_TYPES)
    escape = "; 0: the length stands in byte 1, the data start at byte 2 (CAN FD)"
    yield part(0, "sf_length", 4, 4, "bytes of the packet" + (escape if size_bytes > CLASSIC_BYTES else ""))
    yield from data(0, "sf", 1, "byte 1 of the frame: data, and behind them padding")
    yield part(1, "ff_length", 4, 12, "bytes of the packet; 0: they stand in bytes 2 to 5")
    yield from data(1, "ff", 2, "byte 2 of the frame: data")
    yield part(2, "cf_sequence", 4, 4, "sequence number, modulo 16; 1 follows the first frame")
    yield from data(2, "cf", 1, "byte 1 of the frame: data, and in the last one padding behind them")
    yield part(3, "fc_status", 4, 4, "flow status", values=_FLOW_STATUS)
    yield part(3, "fc_block_size", 8, 8, "consecutive frames until the next flow control; 0: all")
    yield part(3, "fc_separation_time", 16, 8, "STmin: 0 to 127 ms, or F1 to F9 for 100 to 900 us")


def _choices(signal: Signal) -> dict[int, str]:
    if signal.choices is None:
        return {}
    named = {int(member): str(member.name) for member in signal.choices}
    return ({0: "NONE"} | named) if issubclass(signal.choices, IntFlag) else named


def _tables(frames: Iterable[_Frame]) -> dict[str, Mapping[int, str]]:
    found: dict[str, Mapping[int, str]] = {"PciType": _PCI_TYPES, "FlowStatus": _FLOW_STATUS}
    for frame in frames:
        for bits in frame.signals:
            if bits.signal.choices is not None:
                found[bits.signal.choices.__name__] = bits.values
    return found


def _values(table: Mapping[int, str]) -> str:
    return " ".join(f'{number} "{name}"' for number, name in sorted(table.items()))


def _start_bit(first_bit: int) -> int:
    """The number of a big-endian signal's most significant bit; in a byte they count from the right."""
    return first_bit // 8 * 8 + 7 - first_bit % 8


def _signal_line(bits: _Bits, receivers: str) -> str:
    signal = bits.signal
    kind = " M" if bits.multiplexor else "" if bits.multiplexed is None else f" m{bits.multiplexed}"
    low, high = signal.limits
    sign = "-" if signal.signed else "+"
    place = f"{_start_bit(bits.first_bit)}|{signal.bits}@0{sign}"
    scale = f"({_number(signal.scale)},{_number(signal.offset)}) [{_number(low)}|{_number(high)}]"
    return f' SG_ {signal.name}{kind} : {place} {scale} "{signal.unit}" {receivers}'


def _number(value: float) -> str:
    """Exact: the shortest text that gives the same number again."""
    return repr(int(value)) if float(value).is_integer() else repr(value)


def _short_names(names: Iterable[str]) -> dict[str, str]:
    """Each name as the file may write it; those over 32 characters are cut and numbered."""
    short: dict[str, str] = {}
    for name in names:
        if len(name) > MAX_NAME:
            number = sum(len(known) > MAX_NAME for known in short)
            short[name] = f"{name[: MAX_NAME - 5]}_{number:04d}"
        else:
            short[name] = name
    return short


def _comments(
    frames: Sequence[_Frame], node_names: Mapping[str, str], units: Sequence[DbcUnit]
) -> Iterator[str]:
    yield f"CM_ {_quoted('Star tracker units and their on-board computer. Generated; do not edit.')};"
    yield f"CM_ BU_ {OBC} {_quoted('on-board computer')};"
    for unit in units:
        text = f"star tracker {unit.name}, node {unit.identifiers.node}"
        yield f"CM_ BU_ {node_names[unit.node_name]} {_quoted(text)};"
    for frame in frames:
        yield f"CM_ BO_ {frame.number} {_quoted(frame.meaning)};"
        for bits in frame.signals:
            if text := _signal_meaning(bits.signal):
                yield f"CM_ SG_ {frame.number} {bits.signal.name} {_quoted(text)};"


def _signal_meaning(signal: Signal) -> str:
    if signal.choices is None or not issubclass(signal.choices, IntFlag):
        return signal.meaning
    bits = "; ".join(f"{int(member)} {member.name}: {meaning_of(member)}" for member in signal.choices)
    return f"{signal.meaning}. A bit each: {bits}"


def _quoted(text: str) -> str:
    return '"' + text.replace('"', "'") + '"'


def _attributes(
    frames: Sequence[_Frame],
    frame_names: Mapping[str, str],
    node_names: Mapping[str, str],
    fd: bool,
) -> Iterator[str]:
    formats = ",".join(f'"{name}"' for name in _FRAME_FORMATS)
    yield 'BA_DEF_ "BusType" STRING ;'
    yield 'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 3600000;'
    yield f'BA_DEF_ BO_ "VFrameFormat" ENUM {formats};'
    yield 'BA_DEF_ BO_ "SystemMessageLongSymbol" STRING ;'
    yield 'BA_DEF_ BU_ "SystemNodeLongSymbol" STRING ;'
    yield 'BA_DEF_DEF_ "BusType" "CAN";'
    yield 'BA_DEF_DEF_ "GenMsgCycleTime" 0;'
    yield 'BA_DEF_DEF_ "VFrameFormat" "StandardCAN";'
    yield 'BA_DEF_DEF_ "SystemMessageLongSymbol" "";'
    yield 'BA_DEF_DEF_ "SystemNodeLongSymbol" "";'
    yield f'BA_ "BusType" "{"CAN FD" if fd else "CAN"}";'
    for name, short in node_names.items():
        if short != name:
            yield f'BA_ "SystemNodeLongSymbol" BU_ {short} "{name}";'
    for frame in frames:
        format_name = ("Extended" if frame.extended else "Standard") + ("CAN_FD" if frame.fd else "CAN")
        yield f'BA_ "VFrameFormat" BO_ {frame.number} {_FRAME_FORMATS.index(format_name)};'
        if frame.cycle_ms:
            yield f'BA_ "GenMsgCycleTime" BO_ {frame.number} {frame.cycle_ms};'
        if frame_names[frame.name] != frame.name:
            yield f'BA_ "SystemMessageLongSymbol" BO_ {frame.number} "{frame.name}";'
