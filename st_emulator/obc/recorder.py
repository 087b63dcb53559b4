"""A recording of a session: every packet with its raw bytes, and tables to plot from.

In the folder: `session.json`; `telemetry.jsonl`, one object a packet with its raw bytes;
`telecommands.jsonl`, one object when a telecommand is sent and one when it is finished; `anomalies.jsonl`,
what was no packet and what was missing; and CSV tables: `attitude.csv`, `events.csv`,
`housekeeping_<structure>.csv`, and one by the name of each other message that has plain fields. Of a CAN bus
also `can.log`, every frame of the bus as candump logs it, `cyclic.jsonl`, one object a cyclic frame of the
unit, and `cyclic_<name>.csv`. On-board times are integer TAI nanoseconds since 1958-01-01, `received_s`
counts from the start of the session.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TextIO

from ..clock import NS_PER_S
from ..naming import name_of, plain
from ..protocol.can.frames import candump_line
from ..protocol.can.transport import FrameIgnored, ReceptionFailed
from ..protocol.pus.enumerations import EventId, HousekeepingId
from ..protocol.pus.packets import Malformed, Telemetry
from ..protocol.pus.registry import parse_telemetry
from .errors import RecordingError
from .image import PART_NAMES
from .obc_protocol import FrameLost, MalformedReceived, ObcEvent, SequenceGapDetected, VerificationUpdated
from .observed import EVENT_REPORTS
from .transport import CanFrameLost, CanFrameSeen, CyclicMalformed, CyclicReceived
from .verification import Verification

TELEMETRY_FILE = "telemetry.jsonl"
TELECOMMAND_FILE = "telecommands.jsonl"
ANOMALY_FILE = "anomalies.jsonl"
SESSION_FILE = "session.json"
CYCLIC_FILE = "cyclic.jsonl"
FRAME_FILE = "can.log"
UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
MAX_CHANNEL_NAME = 15  # as of a network interface
_TABLE_NAMES = {"attitude_report": "attitude"}
_WITHOUT_TABLE = (*PART_NAMES, "memory_dump_report")


class Recorder:
    """Writes a recording into `folder`, which is made when missing and must not hold one already.

    Every line is handed to the operating system at once, so that a killed OBC leaves whole lines.
    RecordingError when the folder cannot be used.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder).expanduser()
        self._start_ns = 0
        self._epoch_ns = 0
        self._channel = ""
        self._frames: TextIO | None = None
        self._cyclic: TextIO | None = None
        self._tables: dict[str, tuple[TextIO, list[str]]] = {}
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if (self.folder / TELEMETRY_FILE).exists():
                raise RecordingError(f"{self.folder}: holds a recording already; name a new or empty folder")
            self._telemetry = self._open(TELEMETRY_FILE)
            self._telecommands = self._open(TELECOMMAND_FILE)
            self._anomalies = self._open(ANOMALY_FILE)
        except OSError as error:
            raise RecordingError(f"{self.folder}: cannot record there: {error.strerror}") from error

    def begin(self, start_ns: int, started: datetime, session: Mapping[str, Any]) -> None:
        """Start of the session: `received_s` counts from `start_ns`, which was `started` by civil time;
        `session` is kept for the reader.
        """
        self._start_ns = start_ns
        self._epoch_ns = (started - UNIX_EPOCH) // timedelta(microseconds=1) * 1000 - start_ns
        self._channel = _channel(str(session.get("link", "")))
        text = json.dumps(dict(session) | {"started_utc": started.isoformat()}, indent=2)
        (self.folder / SESSION_FILE).write_text(text + "\n", encoding="utf-8")

    def telemetry(self, telemetry: Telemetry, received_ns: int) -> None:
        """A packet has come."""
        head = {
            "received_s": self._seconds(received_ns),
            "name": telemetry.name,
            "service": telemetry.service,
            "subservice": telemetry.subservice,
            "apid": telemetry.apid,
            "sequence_count": telemetry.sequence_count,
            "message_count": telemetry.message_count,
            "time_tai_ns": telemetry.time.to_ns(),
            "time_status": telemetry.time_status,
        }
        fields = plain(telemetry.fields)
        _write_line(self._telemetry, head | {"fields": fields, "raw": telemetry.raw.hex()})
        if telemetry.name not in _WITHOUT_TABLE:
            self._row(telemetry, head, fields)

    def sent(
        self, name: str, fields: Mapping[str, Any] | None, verification: Verification, line: bytes
    ) -> None:
        """A telecommand has left; `line` is as it went on the wire, framing included (b"" on a CAN bus)."""
        request = verification.request_id
        entry = {
            "sent_s": self._seconds(verification.sent_ns),
            "name": name,
            "apid": request.apid,
            "sequence_count": request.sequence_count,
            "ack": verification.ack,
            "fields": plain(fields or {}),
            "raw": verification.packet.hex(),
        }
        _write_line(self._telecommands, entry | ({"wire": line.hex()} if line else {}))

    def event(self, event: ObcEvent) -> None:
        """Anything else that happened on the wire."""
        if isinstance(event, VerificationUpdated):
            if event.verification.finished:
                self._finished(event.verification, event.time_ns)
        elif isinstance(event, CanFrameSeen):
            self._frame(event)
        elif isinstance(event, CyclicReceived):
            self._cyclic_frame(event)
        elif isinstance(event, SequenceGapDetected):
            gap = {"apid": event.apid, "expected": event.expected, "received": event.received}
            self._anomaly("sequence_gap", gap | {"missing": event.missing}, event.time_ns)
        elif isinstance(event, MalformedReceived):
            malformed = event.malformed
            what = {"reason": malformed.reason.name, "detail": malformed.detail, "raw": malformed.raw.hex()}
            self._anomaly("malformed", what, event.time_ns)
        elif isinstance(event, FrameLost):
            lost = {"reason": event.reason.name, "length": event.length}
            self._anomaly("frame_lost", lost, event.time_ns)
        elif isinstance(event, CyclicMalformed):
            what = {"name": event.name, "raw": event.raw.hex()}
            self._anomaly("cyclic_malformed", what, event.time_ns)
        elif isinstance(event, CanFrameLost):
            self._anomaly("frame_not_sent", {"frame": event.frame.candump()}, event.time_ns)
        elif isinstance(event, ReceptionFailed):
            failed = {"reason": event.reason.name, "length": event.length}
            self._anomaly("reception_failed", failed, event.time_ns)
        elif isinstance(event, FrameIgnored):
            self._anomaly("transfer_frame_ignored", {"reason": event.reason.name}, event.time_ns)

    def close(self) -> None:
        """Close every file."""
        for file, _ in self._tables.values():
            file.close()
        for opened in (self._telemetry, self._telecommands, self._anomalies, self._frames, self._cyclic):
            if opened is not None:
                opened.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exception_type: type[BaseException] | None,
        exception: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _open(self, name: str) -> TextIO:
        return open(self.folder / name, "w", encoding="utf-8", buffering=1, newline="")

    def _seconds(self, time_ns: int) -> float:
        return round((time_ns - self._start_ns) / NS_PER_S, 9)

    def _frame(self, event: CanFrameSeen) -> None:
        if self._frames is None:
            self._frames = self._open(FRAME_FILE)
        line = candump_line(event.frame, max(0, self._epoch_ns + event.time_ns), self._channel)
        self._frames.write(f"{line} {'T' if event.sent else 'R'}\n")

    def _cyclic_frame(self, event: CyclicReceived) -> None:
        if self._cyclic is None:
            self._cyclic = self._open(CYCLIC_FILE)
        head = {"received_s": self._seconds(event.time_ns), "name": event.name}
        _write_line(self._cyclic, head | {"fields": event.values, "raw": event.raw.hex()})
        self._table_row(f"cyclic_{event.name}", {"received_s": head["received_s"], **event.values})

    def _anomaly(self, kind: str, what: Mapping[str, Any], time_ns: int) -> None:
        _write_line(self._anomalies, {"received_s": self._seconds(time_ns), "kind": kind} | dict(what))

    def _finished(self, verification: Verification, time_ns: int) -> None:
        request = verification.request_id
        line = {
            "finished_s": self._seconds(time_ns),
            "name": verification.name,
            "apid": request.apid,
            "sequence_count": request.sequence_count,
            "state": verification.state.value,
            "steps": verification.steps,
            "failure_code": verification.failure_code,
            "failure_name": verification.failure_name,
            "failure_data": verification.failure_data,
            "missing": list(verification.missing),
        }
        _write_line(
            self._telecommands, line | ({"transfer": verification.transfer} if verification.transfer else {})
        )

    def _row(self, telemetry: Telemetry, head: Mapping[str, Any], fields: dict[str, Any]) -> None:
        name = _TABLE_NAMES.get(telemetry.name, telemetry.name)
        if telemetry.name == "hk_report":
            name = "housekeeping_" + name_of(HousekeepingId, fields["structure_id"]).lower()
            fields = fields["values"]
        elif telemetry.name in EVENT_REPORTS:
            name = "events"
            fields = {
                "severity": EVENT_REPORTS[telemetry.name].name.lower(),
                "event_id": fields["event_id"],
                "event": name_of(EventId, fields["event_id"]),
                "data": fields["data"],
            }
        elif "request_id" in fields:  # success and failure reports share one table
            name = "verification"
            empty = {"step": None, "failure_code": None, "failure_data": None}
            request = {key: fields["request_id"][key] for key in ("apid", "sequence_count")}
            fields = (
                {"report": telemetry.name}
                | {f"tc_{key}": value for key, value in request.items()}
                | {key: fields.get(key) for key in empty}
            )
        columns = ("received_s", "time_tai_ns", "time_status", "sequence_count")
        row = {column: head[column] for column in columns}
        row |= {f"packet_{key}" if key in row else key: _cell(value) for key, value in fields.items()}
        self._table_row(name, row)

    def _table_row(self, name: str, row: Mapping[str, Any]) -> None:
        if name not in self._tables:
            file = self._open(f"{name}.csv")
            self._tables[name] = (file, list(row))
            csv.writer(file, lineterminator="\n").writerow(row)
        file, names = self._tables[name]
        csv.writer(file, lineterminator="\n").writerow([row.get(column) for column in names])


def _channel(link_name: str) -> str:
    """What stands for the bus in a candump log: `vcan0` of `can:socketcan/vcan0@1000000`."""
    channel = re.split("[@,]", link_name.rsplit("/", 1)[-1])[0]
    return re.sub(r"[^\w.-]+", "_", channel).strip("_")[:MAX_CHANNEL_NAME] or "can"


def _cell(value: Any) -> Any:
    """A value for a table: what is itself a list or a group is JSON text."""
    return json.dumps(value) if isinstance(value, (dict, list)) else value


def _write_line(file: TextIO, line: Mapping[str, Any]) -> None:
    file.write(json.dumps(line, separators=(",", ":")) + "\n")


@dataclass(frozen=True)
class RecordedTelemetry:
    """A packet of a recording, decoded anew from its raw bytes."""

    telemetry: Telemetry
    received_s: float


def read_recording(folder: str | Path) -> Iterator[RecordedTelemetry]:
    """Every telemetry packet of a recording, in order; only its raw bytes are believed.

    RecordingError names file and line of what is no packet. A last line cut short by a kill ends the
    recording.
    """
    path = Path(folder) / TELEMETRY_FILE
    try:
        lines = path.read_text(encoding="utf-8").split("\n")
    except OSError as error:
        raise RecordingError(f"{path}: {error.strerror}") from error
    for number, line in enumerate(lines[:-1], start=1):
        try:
            entry = json.loads(line)
            parsed = parse_telemetry(bytes.fromhex(entry["raw"]))
            received_s = float(entry["received_s"])
        except (ValueError, KeyError, TypeError) as error:
            raise RecordingError(f"{path}, line {number}: no recorded packet: {error}") from error
        if isinstance(parsed, Malformed):
            raise RecordingError(f"{path}, line {number}: {parsed.reason.name}: {parsed.detail}")
        yield RecordedTelemetry(parsed, received_s)
