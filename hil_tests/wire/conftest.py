"""Tests that speak only the wire: they know the interface document, and run on any link that the unit has.

    pytest hil_tests/wire                                       # in virtual time
    pytest hil_tests/wire --st-link memory:can                  # the same packets by ISO-TP
    pytest hil_tests/wire --st-link pty                         # a unit in a process of its own, in real time
    pytest hil_tests/wire --st-link serial:/dev/ttyUSB0         # hardware; `can:socketcan/can0` likewise

Packets are made and read by the reference decoder, which shares no code with the unit; st-emulator's OBC only
carries them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from hil_tests.vectors import reference_decoder as wire
from hil_tests.vectors.received import FUNCTION, Packet, Received

SOURCE = 0x2A
STATUS, LINK = 1, 2
BOOT, SELF_TEST, STANDBY, LOST_IN_SPACE, TRACKING, FAULT, OFF = range(7)


class Wire(Received):
    """An OBC with a source identity and sequence counts of its own."""

    def __init__(self, obc: Any, bench: Any, star_tracker: Any) -> None:
        self._obc = obc
        self._bench = bench
        self.profile = star_tracker.profile
        self.period_s = self.profile.timing.frame_period_ms / 1000
        self.count = -1
        self._mark = 0
        self._packets: list[Packet] = []
        self._read = 0

    # -- out

    def packet(
        self, name: str, fields: dict[str, Any] | None = None, *, ack: int = 15, **header: int
    ) -> bytes:
        """A telecommand with the next sequence count."""
        self.count = header.pop("count", (self.count + 1) & 0x3FFF)
        header.setdefault("apid", self.profile.apid)
        header.setdefault("source_id", SOURCE)
        return wire.encode_telecommand(name, fields or {}, sequence_count=self.count, ack=ack, **header)

    def put(self, packet: bytes) -> None:
        """Send a packet, whatever it says."""
        self._obc.send_raw(packet, framed=True)

    def send(self, name: str, fields: dict[str, Any] | None = None, **header: int) -> int:
        """Send a telecommand; its sequence count."""
        self.put(self.packet(name, fields, **header))
        return self.count

    def function(self, name: str, arguments: dict[str, Any] | None = None, **header: int) -> int:
        return self.send("function", {"function_id": FUNCTION[name], "arguments": arguments or {}}, **header)

    # -- in

    @property
    def packets(self) -> list[Packet]:
        """What has come since the last `forget`, decoded anew from its octets."""
        for entry in self._obc.telemetry_since(self._read):
            self._read = entry.number + 1
            self._packets.append(Packet(entry.time_ns, wire.decode_telemetry(entry.telemetry.raw)))
        return self._packets

    def forget(self) -> None:
        """What has come so far counts no more."""
        _ = self.packets
        self._packets = []

    # -- time

    def run(self, seconds: float) -> None:
        self._bench.run(seconds)

    def await_(self, condition: Callable[[], Any], limit_s: float = 5.0) -> None:
        self._bench.until(condition, limit_s)

    def await_end(self, count: int, limit_s: float = 5.0) -> list[str]:
        """The stages of a telecommand, when one has come that is its last."""
        self.await_(lambda: any(name.startswith("completion") or name == "acceptance_failure"
                                for name in self.stages(count)), limit_s)  # fmt: skip
        return self.stages(count)

    # -- what tests often do

    def done(self, name: str, fields: dict[str, Any] | None = None, **header: int) -> int:
        """A telecommand that the unit completes."""
        count = self.send(name, fields, **header)
        assert self.await_end(count)[-1] == "completion_success"
        return count

    def housekeeping(self, structure: int) -> dict[str, Any]:
        """A structure, asked for now."""
        return self.answer("hk_one_shot", {"structure_ids": [structure]}, "hk_report")["values"]

    def answer(self, name: str, fields: dict[str, Any], reply: str) -> dict[str, Any]:
        """The fields of the telemetry that answers a telecommand."""
        before = len(self.of(reply))
        self.send(name, fields, ack=0)
        self.await_(lambda: len(self.of(reply)) > before)
        return self.of(reply)[before]

    def parameters(self, *numbers: int) -> dict[int, float]:
        values = self.answer("parameter_report", {"parameter_ids": list(numbers)}, "parameter_values")[
            "values"
        ]
        return {entry["parameter_id"]: entry["value"] for entry in values}

    def set_parameters(self, values: dict[int, float]) -> None:
        settings = [{"parameter_id": number, "value": value} for number, value in values.items()]
        self.done("parameter_set", {"settings": settings})

    def mode(self) -> int:
        return self.housekeeping(STATUS)["mode"]

    def acquire(self) -> None:
        """To TRACKING."""
        count = self.function("START_ACQUISITION")
        assert self.await_end(count, 10)[-1] == "completion_success"
        self.await_(lambda: any(fields["mode"] == TRACKING for fields in self.of("attitude_report")))


@pytest.fixture
def line(obc: Any, bench: Any, star_tracker: Any) -> Wire:
    """A unit in STANDBY, quiet: no periodic housekeeping, counters at zero."""
    made = Wire(obc, bench, star_tracker)
    made.send("hk_disable", {"structure_ids": [1, 2, 3, 4]}, ack=0)
    made.done("function", {"function_id": FUNCTION["CLEAR_COUNTERS"], "arguments": {}})
    made.forget()
    return made


@pytest.fixture
def keeping_parameters(line: Wire) -> Iterator[Callable[[dict[int, float]], None]]:
    """Sets parameters for the test: afterwards they are as they were, for a unit that is there for longer."""
    before: dict[int, float] = {}

    def set_for_now(values: dict[int, float]) -> None:
        before.update({n: v for n, v in line.parameters(*values).items() if n not in before})
        line.set_parameters(values)

    yield set_for_now
    if before:
        line.await_(lambda: line.mode() != BOOT)
        line.set_parameters(before)
