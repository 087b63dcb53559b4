"""The chapter of the interface document on the CAN bus, from the table of frames and identifiers."""

from __future__ import annotations

import math

from ..can.cyclic import (
    BASE_STEP,
    CAN_MESSAGES,
    CAN_MESSAGES_BY_NAME,
    EXTENDED_SHIFT,
    NODES,
    RESERVED,
    TELECOMMAND,
    TRANSPORT_NAMES,
    CanMessage,
    Signal,
    default_bases,
    is_broadcast,
)
from ..pus.packets import MAX_TELECOMMAND_BYTES, MAX_TELEMETRY_BYTES
from .can_wording import BUS, BUS_MODEL, CYCLIC, FAILURES, NO_RECEIVER, TIME, TRANSPORT
from .markdown import bit_place, table, value_range_of


def can_chapter() -> list[str]:
    """The lines of the chapter."""
    return [
        *BUS,
        "### Identifiers",
        "",
        *_identifiers(),
        "### Cyclic frames",
        "",
        *CYCLIC,
        *(line for message in CAN_MESSAGES for line in _message(message)),
        "### Packets by ISO-TP",
        "",
        *TRANSPORT,
        *table(("Parameter", "Value", "Meaning"), _parameters()),
        "### Transfers that fail",
        "",
        *FAILURES,
        "### No receiver on the bus",
        "",
        *NO_RECEIVER,
        "### Time distribution",
        "",
        *TIME,
        "### Bus model",
        "",
        *BUS_MODEL,
    ]


def _identifiers() -> list[str]:
    short, long = default_bases(extended=False), default_bases(extended=True)
    rows = []
    for name, base in sorted(short.items(), key=lambda item: item[1]):
        message = CAN_MESSAGES_BY_NAME.get(name)
        from_obc = name == TELECOMMAND if message is None else message.direction == "TC"
        node = "" if is_broadcast(name) else " + node"
        rows.append(
            (
                f"`{name}`",
                "OBC" if from_obc else "unit",
                f"0x{base:03X}{node}",
                f"0x{long[name]:08X}{node}",
                TRANSPORT_NAMES[name] if message is None else message.meaning,
            )
        )
    return [
        f"Each unit has a node number, {NODES[0]} to {NODES[-1]}, so that several share a bus. An identifier",
        "is its base plus the node number; the frames that all units listen to have the base alone. The",
        "unit's file says the bases (`[can.identifiers]`), the node number (`node`) and whether identifiers",
        f"have 11 or 29 bits (`identifier_bits`). A base is a multiple of {BASE_STEP}; all are different.",
        "These are the default ones in the order of their priority on the bus; those of 29 bits are the",
        f"others times 2^{EXTENDED_SHIFT}.",
        "",
        *table(("Name", "Sent by", "11 bits", "29 bits", "What it carries"), rows),
    ]


def _message(message: CanMessage) -> list[str]:
    sender = "OBC to all units" if message.broadcast else "unit to OBC"
    meaning = f"{message.meaning[0].upper()}{message.meaning[1:]}"
    rows = []
    first_bit = 0
    for signal in message.signals:
        rows.append(
            (
                bit_place(first_bit, signal.bits),
                RESERVED if signal.name == RESERVED else f"`{signal.name}`",
                f"{'i' if signal.signed else 'u'}{signal.bits}",
                _scale(signal),
                signal.unit,
                _range(signal),
                signal.meaning,
            )
        )
        first_bit += signal.bits
    size = f"{message.size_bytes} byte{'s' if message.size_bytes > 1 else ''}"
    return [
        f"#### Frame {message.name}",
        "",
        f"{meaning}. {size}, {sender}.",
        "",
        *table(("Byte", "Signal", "Type", "Scale", "Unit", "Range", "Meaning"), rows),
    ]


def _scale(signal: Signal) -> str:
    if signal.scale == 1.0:
        return ""
    exponent = math.log2(signal.scale)
    return f"2^{exponent:.0f}" if exponent.is_integer() else f"{signal.scale:g}"


def _range(signal: Signal) -> str:
    if signal.choices is not None:
        return value_range_of(signal.choices)
    if signal.scale == 1.0:
        return "0..1" if signal.bits == 1 and signal.name != RESERVED else ""
    low, high = signal.limits
    return f"{low:g}..{high:.9g}"


def _parameters() -> list[tuple[str, str, str]]:
    key = "`[can]` "
    return [
        ("addressing", "normal", "the identifier is the whole address; no address byte in the data"),
        (
            "frame length (TX_DL)",
            "8; 64 with CAN FD",
            "longest frames; a frame of CAN FD is filled to a length that exists",
        ),
        (
            "padding",
            key + "`padding`",
            "byte behind the end of the data; -1: frames as short as their content",
        ),
        (
            "longest packet",
            f"{MAX_TELECOMMAND_BYTES} in, {MAX_TELEMETRY_BYTES} out",
            "bytes; a longer first frame is answered by flow control OVFLW",
        ),
        ("BlockSize (BS)", key + "`block_size`", "asked for by the unit; the OBC's own is kept to"),
        (
            "STmin",
            key + "`separation_time_us`",
            "asked for by the unit; the OBC's own is kept to, reserved values count as 127 ms",
        ),
        ("N_As, N_Ar", key + "`timeout_ms`", "a frame leaves the controller within it"),
        ("N_Bs", key + "`timeout_ms`", "flow control comes within it"),
        ("N_Cr", key + "`timeout_ms`", "the next consecutive frame comes within it"),
        ("N_Br, N_Cs", "0", "the unit answers and goes on as soon as the controller takes the frame"),
        ("WAIT in a row", "10", "more, and the transfer fails; the unit itself sends none"),
    ]
