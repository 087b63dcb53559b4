"""What a failed test tells of its units: the last telemetry, the mode, the faults, where the journal lies."""

from __future__ import annotations

import contextlib
import json
from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..clock import NS_PER_S
from ..naming import event_text, name_of, plain
from ..obc.listening import TelemetryListener
from ..obc.observed import EVENT_REPORTS
from ..obc.watching import attitude_line
from ..protocol.can.cyclic import CAN_MESSAGES_BY_NAME, CanIdentifiers, decode_can_message
from ..protocol.can.frames import RecordDecoder
from ..protocol.pus.enumerations import FailureCode, HousekeepingId
from .bench import mode_of
from .star_tracker import PresentStarTracker, StarTracker

if TYPE_CHECKING:
    from ..protocol.pus.packets import Telemetry

SHOWN_PACKETS = 20
READ_BYTES = 1 << 18
"""Of the journal's end: the last twenty packets are within."""
LONGEST_LINE = 160


def failure_text(unit: StarTracker) -> str:
    """All of it, in lines for a person."""
    lines = [f"link: {unit.link}" + ("" if unit.node is None else f", node {unit.node}")]
    lines.append(f"mode: {mode_of(unit)}")
    if not isinstance(unit, PresentStarTracker):
        lines.append(f"active faults: {_faults_text(unit)}")
    lines.append("last telemetry (seconds since power-on):")
    lines += [f"  {line}" for line in last_telemetry(unit)] or ["  none"]
    lines.append(f"journal: {unit.journal if unit.journal is not None else 'none is kept'}")
    return "\n".join(lines)


def _faults_text(unit: StarTracker) -> str:
    try:
        return "; ".join(fault_text(fault) for fault in unit.faults.active()) or "none"
    except Exception as error:  # whatever state the unit is in, the rest is told
        return f"not known ({error})"


def fault_text(fault: dict[str, Any]) -> str:
    """A fault in a line."""
    rest = {name: value for name, value in fault.items() if name not in ("number", "kind")}
    settings = ", ".join(f"{name}={value}" for name, value in rest.items())
    return f"{fault['number']} {fault['kind']}" + (f" ({settings})" if settings else "")


def last_telemetry(unit: StarTracker) -> list[str]:
    """The last packets that left the unit, decoded; of another language than ours its octets."""
    if unit.journal is None or isinstance(unit, PresentStarTracker):
        heard = [] if unit.joined is None else unit.joined.telemetry_since(0)[-SHOWN_PACKETS:]
        begun_ns = 0 if unit.joined is None else unit.joined.started_ns
        return [packet_text(entry.time_ns - begun_ns, entry.telemetry) for entry in heard]
    with contextlib.suppress(Exception):  # it has died, or had no power yet: the file holds what there is
        unit.supervised.flush()
    groups = list(_sent(unit.journal))
    if unit.profile.wire.dialect != "pus":
        return [f"{_at(t_ns)}  {data.hex(' ')[:LONGEST_LINE]}" for t_ns, data in groups[-SHOWN_PACKETS:]]
    can = unit.profile.can.identifier_table(unit.node) if unit.on_can else None
    listener = TelemetryListener(can=can, fd=unit.link.endswith(",fd"))
    for t_ns, data in groups:
        listener.transmitted(data, t_ns)
    packets = [packet_text(t_ns, telemetry) for t_ns, telemetry in listener.packets[-SHOWN_PACKETS:]]
    return packets + ([] if can is None else _frames_beside(can, groups))


def _frames_beside(can: CanIdentifiers, groups: Iterable[tuple[int, bytes]]) -> list[str]:
    """The last cyclic frame of each kind."""
    last: dict[str, str] = {}
    decoder = RecordDecoder()
    for t_ns, data in groups:
        for frame in decoder.receive(data):
            name = can.name_of(frame.identifier, frame.extended)
            values = decode_can_message(name, frame.data) if name in CAN_MESSAGES_BY_NAME else None
            if name is not None and values is not None:
                last[name] = f"{_at(t_ns)}  frame {name} {_compact(values)}"[:LONGEST_LINE]
    return list(last.values())


def packet_text(t_ns: int, telemetry: Telemetry) -> str:
    """A telemetry packet in a line."""
    return f"{_at(t_ns)}  {_content(telemetry)}"[:LONGEST_LINE]


def _content(telemetry: Telemetry) -> str:
    from ..obc.attitude import Attitude

    fields = telemetry.fields
    if telemetry.name == "attitude_report":
        return f"attitude_report {attitude_line(Attitude.from_fields(fields, 0))}"
    if telemetry.name in EVENT_REPORTS:
        severity = EVENT_REPORTS[telemetry.name].name.lower()
        return f"event ({severity}) {event_text(fields['event_id'], fields['data'])}"
    if telemetry.name == "hk_report":
        name = name_of(HousekeepingId, fields["structure_id"])
        return f"hk_report {name} {_compact(fields['values'])}"
    if "request_id" in fields:
        request = fields["request_id"]
        failure = f" {name_of(FailureCode, fields['failure_code'])}" if "failure_code" in fields else ""
        return f"{telemetry.name} of telecommand {request['sequence_count']}{failure}"
    return f"{telemetry.name} {_compact(fields)}"


def _compact(fields: Any) -> str:
    return json.dumps(plain(fields), separators=(", ", "="), default=str).replace('"', "").strip("{}")


def _at(t_ns: int) -> str:
    return f"{t_ns / NS_PER_S:12.6f}"


def _sent(path: Path) -> Iterator[tuple[int, bytes]]:
    """(time, octets or record) of the last groups in the journal that left the unit."""
    try:
        with path.open("rb") as file:
            size = file.seek(0, 2)
            file.seek(max(0, size - READ_BYTES))
            lines = deque(file.read().split(b"\n"))
    except OSError:
        return
    if size > READ_BYTES:
        lines.popleft()  # cut
    for line in lines:
        if b'"tx"' in line:
            try:
                entry = json.loads(line)
                yield entry["t_ns"], bytes.fromhex(entry["tx"])
            except (ValueError, KeyError):
                continue
