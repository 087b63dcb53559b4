"""The run: quiet stretches in which everything is counted, and between them faults by chance."""

from __future__ import annotations

import gc
import os
import random
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from st_emulator.bench.emulator import Emulator
from st_emulator.bench.journal import TextSink
from st_emulator.bench.scenario import parse_scenario
from st_emulator.clock import NS_PER_S
from st_emulator.errors import ConfigurationError
from st_emulator.faults.chance import kinds_of, settings_by_chance
from st_emulator.faults.fault import FaultKind
from st_emulator.firmware_model.modes import Mode
from st_emulator.units.profile import load_unit

from .obc import BUSY, QUIET, SoakObc

SCENARIO = """
name = "soak"
start_utc = 2026-01-15T00:00:00Z
[parameters]
autonomous_start = 1
[trajectory]
kind = "constant_rate" # about the boresight: other stars in other places, and never too few
ra_deg = 83.0
dec_deg = -3.0
rate_deg_s = [0.0, 0.0, 0.05]
"""
SETTLED_S = 3.0  # within so much of a fault's end the unit tracks again; a boot adds its time
QUIET_S = (4.0, 26.0)
FAULT_S = (0.05, 6.0)
IN_FLIGHT = 0.9  # of a frame period: no frame is being exposed, worked on or told then
TRIES = 3


@dataclass(frozen=True)
class Stretch:
    """A quiet stretch: what the unit counted between two virtual times."""

    start_ns: int
    end_ns: int
    frames: int


@dataclass
class Grid:
    """The frames that there must be: one a period from each power-on, as long as there is power."""

    period_ns: int
    started: int = 0
    expected: int = 0
    on_ns: int | None = None
    last_ns: int = -1

    def on(self, now_ns: int) -> None:
        self.on_ns = now_ns

    def begins(self, now_ns: int) -> None:
        """A frame period."""
        self.started += 1
        self.last_ns = now_ns

    def off(self, now_ns: int) -> None:
        """A period that begins at this very instant counts when it has begun."""
        if self.on_ns is not None:
            whole, rest = divmod(now_ns - self.on_ns, self.period_ns)
            self.expected += whole + int(rest > 0 or self.last_ns == now_ns)
        self.on_ns = None


@dataclass
class Outcome:
    """What came of a run."""

    faults: Counter[str] = field(default_factory=Counter)
    refused: int = 0
    led_back: int = 0
    never_back: list[str] = field(default_factory=list)
    stretches: list[Stretch] = field(default_factory=list)
    most_clock_error_ns: int = 0
    times_set: int = 0
    memory: list[tuple[float, float]] = field(default_factory=list)  # hours, MiB
    stopped: bool = False


class Soak:
    """A unit on its serial line for so many virtual hours.

    Args:
        unit: a unit's name or file.
        hours: virtual.
        seed: of everything.
        journal: where it is written.
        progress: called with the virtual hours reached.
        stop: asked between steps whether somebody wants to end it.
    """

    def __init__(
        self,
        unit: str,
        hours: float,
        seed: int,
        journal: TextSink,
        progress: Callable[[float], None] = lambda hours: None,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        self.end_ns = round(hours * 3600 * NS_PER_S)
        self._chance = random.Random(seed)
        self._progress = progress
        self._stop = stop
        self._sampled = -1.0
        self._hours = hours
        profile = load_unit(unit)
        self.grid = Grid(profile.frame_period_ns)
        self.outcome = Outcome()
        self.emulator = Emulator(profile, parse_scenario(SCENARIO, "soak"), seed=seed, journal=journal)
        self.grid.on(0)
        self._watch()
        self._obc = SoakObc(self.emulator, self._chance)
        self._kinds: list[FaultKind] = []

    def _watch(self) -> None:
        """Look on when power comes and goes, and when a frame period begins."""
        device, grid, clock = self.emulator.device, self.grid, self.emulator.clock
        power_on, power_off, frame_started = device.power_on, device.power_off, device.frame_started

        def on() -> None:
            if not device.powered:
                grid.on(clock.now_ns)
            power_on()

        def off() -> None:
            if device.powered:
                grid.off(clock.now_ns)
            power_off()

        def started(frame_index: int) -> None:
            grid.begins(clock.now_ns)
            frame_started(frame_index)

        for name, watched in (("power_on", on), ("power_off", off), ("frame_started", started)):
            setattr(device, name, watched)

    # -- the run

    def run(self) -> Outcome:
        """To the end, or until somebody stops it."""
        self._obc.wait(2.0)
        while self._goes_on(60.0):
            self._quiet()
            if self._goes_on(30.0):
                self._trouble()
        self.outcome.stopped = self._stop()
        if not self.outcome.stopped:
            self.emulator.advance(self.end_ns)
        self.grid.off(self.emulator.now_ns)
        self.emulator.close()
        return self.outcome

    def _goes_on(self, needs_s: float) -> bool:
        hours = self.emulator.now_ns / NS_PER_S / 3600
        self._progress(hours)
        if hours - self._sampled >= max(self._hours / 200, 0.001):
            self._sampled = hours
            self.outcome.memory.append((hours, resident_mib()))
        return not self._stop() and self.emulator.now_ns + round(needs_s * NS_PER_S) < self.end_ns

    def _tracks(self) -> bool:
        """Whether it tracks and can be spoken to: one that hangs tracks no more, whatever its mode was."""
        device = self.emulator.device
        return device.mode == Mode.TRACKING and device.listening

    def _to_between_frames(self) -> None:
        """To where no frame is on its way."""
        grid, now_ns = self.grid, self.emulator.now_ns
        assert grid.on_ns is not None
        place = round(grid.period_ns * IN_FLIGHT)
        ahead = (place - (now_ns - grid.on_ns)) % grid.period_ns
        self.emulator.advance(now_ns + (ahead or grid.period_ns))

    def _frames_told(self) -> int:
        counters = self.emulator.device.frame_counters
        return counters.frames_processed + counters.frames_dropped

    def _quiet(self) -> None:
        """Nothing is wrong: frames and time are exact."""
        if not self._tracks() or self.emulator.faults.active():
            return
        emulator, obc, chance = self.emulator, self._obc, self._chance
        seconds, at_ns = obc.set_time()
        obc.wait(2 * self.grid.period_ns / NS_PER_S + 0.1)
        self._to_between_frames()
        start_ns, counted = emulator.now_ns, self._frames_told()
        end_ns = start_ns + round(chance.uniform(*QUIET_S) * NS_PER_S)
        while emulator.now_ns < end_ns:
            obc.wait(chance.uniform(0.1, 8.0))
            if chance.random() < 0.5:
                obc.some(QUIET)
        self._to_between_frames()
        if self._tracks():
            found = self._frames_told() - counted
            self.outcome.stretches.append(Stretch(start_ns, emulator.now_ns, found))
        told_ns = emulator.device.time.tai_ns(emulator.now_ns)
        error_ns = told_ns - (seconds * NS_PER_S + emulator.now_ns - at_ns)
        self.outcome.times_set += 1
        self.outcome.most_clock_error_ns = max(self.outcome.most_clock_error_ns, abs(error_ns))

    def _next_kind(self) -> FaultKind:
        """Each kind once, in another order every time."""
        if not self._kinds:
            self._kinds = kinds_of("serial", self.emulator.profile.wire.dialect)
            self._chance.shuffle(self._kinds)
        return self._kinds.pop()

    def _inject(self) -> float:
        """A fault by chance from now on; returns how long it lasts, s."""
        kind, lasts_s = self._next_kind(), round(self._chance.uniform(*FAULT_S), 3)
        table: dict[str, Any] = settings_by_chance(kind, self._chance) | {"duration_s": lasts_s}
        try:
            self.emulator.faults.inject(table)
        except ConfigurationError:
            self.outcome.refused += 1  # settings that may not stand together
            return 0.0
        self.outcome.faults[kind.name] += 1
        return lasts_s

    def _trouble(self) -> None:
        """One fault or two, and an OBC that goes on; then the unit has to come back."""
        obc, chance = self._obc, self._chance
        obc.wait(chance.uniform(0.0, 0.5))
        names = sum(self.outcome.faults.values())
        lasts_s = max(self._inject() for _ in range(chance.choice((1, 1, 1, 2))))
        until_ns = self.emulator.now_ns + round(lasts_s * NS_PER_S)
        for _ in range(chance.choice((0, 0, 1, 2, 3))):
            obc.some(BUSY)
            obc.wait(min(chance.uniform(0.0, 2.0), max(0.0, (until_ns - self.emulator.now_ns) / NS_PER_S)))
        self.emulator.advance(max(until_ns, self.emulator.now_ns))
        boot_s = self.emulator.profile.timing.boot_ms / 1000
        obc.wait(SETTLED_S + boot_s)
        if self._tracks():
            return
        for _ in range(TRIES):
            self.outcome.led_back += 1
            obc.start_anew()
            obc.wait(SETTLED_S + boot_s)
            if self._tracks():
                return
            self.emulator.faults.inject({"kind": "power.cut", "duration_s": 0.5})
            obc.wait(0.5 + boot_s + 0.1)
        kinds = [one.settings.kind for one in self.emulator.faults.all[names:]]
        self.outcome.never_back.append(f"{self.emulator.now_ns / NS_PER_S:.3f} s: {', '.join(kinds)}")


def resident_mib() -> float:
    """Memory of this process."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
