"""Documents generated from the code: the interface control document, the DBC and the JSON schemas."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import Any

from pydantic import BaseModel

from ..dialects.pus.dialect import SERVED
from ..dialects.pus.services.functions import allowed_modes
from ..errors import ConfigurationError
from ..firmware_model.modes import TRANSITIONS, Mode
from ..protocol.errors import LocalProtocolError
from ..protocol.exporters.dbc import DbcUnit, can_database
from ..protocol.exporters.icd import interface_control_document
from ..protocol.pus.enumerations import FunctionId
from ..units.profile import load_unit, unit_names
from .fault_list import fault_chapter


def schema_text(model: type[BaseModel]) -> str:
    """JSON schema of a file that ``model`` validates."""
    schema: dict[str, Any] = model.model_json_schema(by_alias=True)
    return json.dumps(schema, indent=2) + "\n"


MODELLED = """\
**Modelled.** The bytes of every packet and the time at which each leaves: the line's baud rate, ten bits
a byte; the frame's exposure, read-out and processing time, from the work that the algorithms really did
on that frame (pixels scanned, pairs compared, stars solved) times the cycles that each unit of work
costs on the processor; telemetry that it builds and telecommands that it receives; late attitudes,
dropped frames; the latency of telecommands; the non-volatile memory.

**Cycles.** The cost of each unit of work is fitted to a reference program in C, compiled for the
ARM926EJ-S and run instruction by instruction in a simulator with the instruction timings and interlocks
of the ARM9EJ-S manual and a model of both caches (4-way, 32-byte lines, fill on a read miss, round
robin). Core cycles and waiting for memory are kept apart: parameter CLOCK_HZ changes the core's time
alone, CACHE_KIB the lines that are read from memory, LINE_FILL the time of one (60, 120 or 180 ns, that
is 24, 48 or 72 cycles at 400 MHz, derived from a 133 MHz bus). The parameters change the model of the
unit; a real unit has no such parameters. Instruction counts are exact for the pinned compiler and
program. Core cycles are good to about 10 %, stages that stream from memory to 20 to 30 %; nothing has
been compared with hardware, and a flight program of other authors may differ by a factor of two.
`st-emulator budget UNIT` prints every figure with its range.

**Not modelled.** In the cycles: the camera's direct memory access competing for the memory, the
translation look-aside buffer, interrupts and the scheduler beyond a fixed cost of each frame (assumed),
a write buffer that fills up. Elsewhere: temperature (a constant); the vendor's boot loader.

**Memories** (service 6): RAM, a patch area of 65536 bytes, readable and writable; NON_VOLATILE, 2048
bytes, the parameters that differ from the factory values as JSON text and zeros behind, read only;
IMAGE, the captured image with its header as in service 13, read only, absent until an image is
captured; PROGRAM, 131072 bytes that stand for the software, readable and writable, copied from its store
at each start. While the unit runs, all its memories come round to be checked within two seconds: a
program or catalogue that is not what was loaded leads to FAULT, and so do two seconds without a frame
from a sensor that was asked for one.

**Telemetry queue.** 32768 bytes wait for the line at most, 16384 more are kept for services 1 and 5. A
packet that finds no room is lost as a whole; its sequence count and message type counter are used up,
so that the gap shows, and event TX_QUEUE_OVERFLOWED tells how many when there is room again.

**Detection.** The detector's noise would allow stars of about 8.4 mag in roja1; the firmware's
magnitude threshold (parameter magnitude_limit) keeps spots brighter than the catalogue's limit, so that
hardly a spot is without a catalogue star.
"""


def unit_notes() -> str:
    """The shipped units' identifiers and lines, as a Markdown table."""
    rows = [
        "| unit | APID | destination | line | frame period | exposure | CAN node | CAN bus | identifiers |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name in unit_names():
        profile = load_unit(name)
        wire, timing, can = profile.wire, profile.timing, profile.can
        rows.append(
            f"| {name} | {wire.apid} (0x{wire.apid:X}) | {wire.source_id} | {wire.baud} baud, 8N1 | "
            f"{timing.frame_period_ms} ms | {timing.exposure_ms:g} ms | {can.node} | {can.bitrate} bit/s, "
            f"CAN FD data {can.data_bitrate} bit/s | {can.identifier_bits} bits |"
        )
    note = (
        "These figures are each unit file's `[wire]`, `[timing]` and `[can]`; a unit file of yours has its "
        "own. The frames of these units on a CAN bus stand in [units.dbc](units.dbc)."
    )
    return "\n".join(rows) + "\n\n" + note + "\n"


def mode_table() -> list[list[str]]:
    """Which event leads from which mode to which, then which telecommand is allowed in which modes."""
    rows = [["mode", "event", "next mode", "meaning"]]
    rows += [[row.mode.name, row.event.name, row.next_mode.name, row.meaning] for row in TRANSITIONS]
    return rows


def telecommand_modes() -> str:
    """The modes in which each telecommand and function is allowed, as a Markdown table."""
    rows = ["| telecommand | allowed in |", "|---|---|"]
    rows += [
        f"| {name} | {_modes(served.modes_for({}))} |"
        for name, served in SERVED.items()
        if name != "function"
    ]
    rows += [f"| function {function.name} | {_modes(allowed_modes(function))} |" for function in FunctionId]
    return "\n".join(rows) + "\n"


def _modes(modes: Sequence[Mode]) -> str:
    return ", ".join(mode.name for mode in modes)


def interface_control_document_text() -> str:
    """The interface control document of the shipped units, Markdown."""
    allowed = (
        "**Telecommands by mode.** In BOOT and OFF the receiver is off and bytes are lost; in a mode that is "
        "not named below a telecommand fails its acceptance with NOT_ALLOWED_IN_MODE.\n\n"
    )
    return interface_control_document(
        unit_notes=unit_notes(),
        mode_table=mode_table(),
        modelled=allowed + telecommand_modes() + "\n" + MODELLED,
        faults=fault_chapter(),
    )


def can_database_text(units: Sequence[str], *, fd: bool = False) -> str:
    """The DBC of a bus with these units, each ``UNIT`` or ``UNIT:NODE``; without any, the shipped ones.

    Raises:
        ConfigurationError: no such unit, a node number that cannot be, or two frames of one identifier.
    """
    chosen = [_can_unit(text) for text in units or unit_names()]
    try:
        return can_database(chosen, fd=fd)
    except LocalProtocolError as error:
        raise ConfigurationError(
            f"{error.field}: found {error.value}; allowed is {error.allowed}. UNIT:NODE gives a unit another "
            "node number"
        ) from error


def _can_unit(text: str) -> DbcUnit:
    name, separator, node = text.rpartition(":")
    if not separator or not re.fullmatch(r"-?[0-9]{1,9}", node):
        name, node = text, ""
    profile = load_unit(name)
    try:
        identifiers = profile.can.identifier_table(int(node) if node else None)
    except ConfigurationError as error:
        raise ConfigurationError(f"{text}: {error}") from error
    return DbcUnit(
        profile.name,
        identifiers,
        profile.can.cycle_times_ms(profile.timing.frame_period_ms),
    )
