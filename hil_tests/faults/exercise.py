"""Every fault over the wire: what is put in, what the OBC must see, and that nothing is left behind.

The unit acquires by itself and tracks; the fault begins at ``START_MS``, lasts, and ends. Everything is
judged by the octets that the unit sent, read by a decoder made with struct alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from hil_tests.unit.conftest import MODE, MS, Bench, Packet, make
from st_emulator.bench.scenario import Scenario
from st_emulator.faults.faults import settings_of
from st_emulator.wire.can.wiring import CanWiring

START_MS = 4000
BACK_MS = 3000  # after its end the unit tracks again within this; a reboot adds its boot time


@dataclass
class Seen:
    """What came on the wire. Times in ms of virtual time; the fault was from ``start_ms`` to ``end_ms``."""

    bench: Bench
    start_ms: float
    end_ms: float
    sent: list[Packet]  # what could be read, of the whole run
    broken: list[bytes]  # frames that are no packets
    figures: dict[str, Any] = field(default_factory=dict)  # for what ``meanwhile`` found

    def between(self, start_ms: float, end_ms: float, name: str | None = None) -> list[Packet]:
        return [
            one for one in self.sent
            if start_ms * MS < one.t_ns <= end_ms * MS and (name is None or one.name == name)
        ]  # fmt: skip

    def before(self, name: str | None = None) -> list[Packet]:
        return self.between(0, self.start_ms, name)

    def during(self, name: str | None = None) -> list[Packet]:
        return self.between(self.start_ms, self.end_ms, name)

    def after(self, name: str | None = None) -> list[Packet]:
        return self.between(self.end_ms, float("inf"), name)

    def back_ms(self) -> float | None:
        """From the fault's end to the first valid attitude in TRACKING; None: none came."""
        for one in self.after("attitude_report"):
            if one.fields["valid"] and one.fields["mode"] == MODE["TRACKING"]:
                return one.t_ns / MS - self.end_ms
        return None


@dataclass(frozen=True)
class Exercise:
    """One fault and its judge.

    Args:
        fault: ``kind`` and its own settings; no times.
        seen: asserts what the OBC must see, and says it in one line with figures, for docs/faults.md.
        name: beside the kind, where there are several.
        on_can: on the CAN bus; else on the serial line.
        unit: its name.
        lasts_ms: the fault's time (0: it is an instant).
        reboots: the unit boots anew meanwhile.
        meanwhile: what the OBC does while the fault lasts; time goes on in it as it lets it.
        scenario: further keys of the scenario.
        back_ms: how soon the unit tracks again; None: it does not (say why in ``seen``).
    """

    fault: dict[str, Any]
    seen: Callable[[Seen], str]
    name: str = ""
    on_can: bool = False
    unit: str = "roja1"
    lasts_ms: float = 3000
    reboots: bool = False
    meanwhile: Callable[[Bench, Seen], None] | None = None
    scenario: dict[str, Any] = field(default_factory=dict)
    back_ms: float | None = BACK_MS

    @property
    def title(self) -> str:
        return " ".join(filter(None, (str(self.fault["kind"]), self.name, "on CAN" if self.on_can else "")))

    def run(self) -> Seen:
        """The whole run; what comes after is judged by :func:`judge`."""
        times = {"start_s": START_MS / 1000}
        if self.lasts_ms:
            times["duration_s"] = self.lasts_ms / 1000
        keys = dict(self.scenario)
        parameters = {"autonomous_start": 1} | keys.pop("parameters", {})
        scenario = Scenario(
            parameters=parameters, faults=[settings_of(self.fault | times, "exercise")], **keys
        )
        bench = make(self.unit, scenario=scenario, **({"can": CanWiring()} if self.on_can else {}))
        bench.broken = []
        end_ms = START_MS + self.lasts_ms
        seen = Seen(bench, START_MS, end_ms, bench.packets, bench.broken)
        bench.run_to(START_MS - 1)
        assert bench.emulator.device.mode == MODE["TRACKING"], "it does not track before the fault"
        bench.run_to(START_MS)
        if self.meanwhile is not None:
            self.meanwhile(bench, seen)
        bench.run_to(max(end_ms, bench.now_ms))
        boot_ms = bench.emulator.profile.timing.boot_ms if self.reboots else 0
        bench.run(boot_ms + BACK_MS + 500)
        return seen


def judge(exercise: Exercise) -> tuple[Seen, str]:
    """Run and judge; returns what came and the line for the table."""
    seen = exercise.run()
    text = exercise.seen(seen)
    back_ms = seen.back_ms()
    if exercise.back_ms is None:
        assert back_ms is None
        return seen, text
    limit_ms = exercise.back_ms
    if exercise.reboots:
        limit_ms += seen.bench.emulator.profile.timing.boot_ms
    assert back_ms is not None, "it does not track again"
    assert back_ms <= limit_ms
    assert not seen.bench.emulator.faults.active()
    return seen, text
