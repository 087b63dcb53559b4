"""The bench of a test: its units, their time, and what is expected of them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ..dialects.registry import require_wire, with_dialect
from ..errors import ConfigurationError
from ..units.profile import UnitProfile, load_unit
from ..wire.can.wiring import CanWiring
from .clock import BenchClock, RealBenchClock, VirtualBenchClock
from .errors import UnitDiedError, leave_out
from .expectations import Expectations
from .settings import BenchLink, UnitSettings, parse_bench_link, validated_scenario
from .spawned_unit import SpawnedStarTracker
from .star_tracker import PresentStarTracker, StarTracker
from .virtual_unit import Medium, VirtualStarTracker


class Bench(Expectations):
    """Units and their OBCs in one time: virtual in memory, real on a link of the operating system.

    ``settings``: what a unit is when nothing else is said. ``journal_path``: where the journal of the n-th
    unit goes, by n and the unit's name.
    """

    def __init__(self, settings: UnitSettings, journal_path: Callable[[int, str], Path]) -> None:
        self.settings = settings
        self.units: list[StarTracker] = []
        self._journal_path = journal_path
        self._stack = contextlib.ExitStack()
        self._buses: dict[bool, Medium] = {}
        self.virtual = settings.link.place == "memory"
        clock: BenchClock = (
            VirtualBenchClock(settings.speed)
            if self.virtual
            else RealBenchClock(self._watch, self._behind_ns)
        )
        self.clock = clock
        super().__init__(clock, self.state)

    @property
    def now_s(self) -> float:
        """Seconds since the bench was made."""
        return self.clock.now_ns / 1e9

    def unit(
        self,
        unit: str | UnitProfile | None = None,
        *,
        link: str | None = None,
        node: int | None = None,
        dialect: str | None = None,
        scenario: Mapping[str, Any] | str | Path | None = None,
        faults: tuple[Mapping[str, Any], ...] | list[Mapping[str, Any]] = (),
        off: bool = False,
        obc: bool = False,
        **arguments: Any,
    ) -> StarTracker:
        """Put a unit on the bench, power on; what is not said is as the test's options and markers have it.

        ``obc``: its OBC listens before power comes on. Without one a unit on a CAN bus waits a second, in
        vain, for somebody to take each of its packets; ``.obc`` joins one at any time.

        Units in memory with ``link="memory:can"`` share a CAN bus, each with its own ``node``; with
        ``memory`` each has a line. Further ``arguments`` go to the emulator (``seed``, ``store``,
        ``frames``, ...), of units in memory alone.

        Raises:
            ConfigurationError: no such unit, node, link or scenario; one line that says what is allowed.
        """
        settings = self.settings
        if link is not None:
            settings = settings.changed(link=self._link(link))
        if scenario is not None:
            from .settings import scenario_file

            table = scenario if isinstance(scenario, Mapping) else scenario_file(Path(scenario))
            where = "scenario" if isinstance(scenario, Mapping) else str(scenario)
            settings = settings.changed(scenario=table, scenario_where=where)
        if faults:
            settings = settings.changed(faults=(*settings.faults, *faults))
        settings = settings.changed(
            off=off or settings.off, node=settings.node if node is None else node,
            dialect=settings.dialect if dialect is None else dialect,
        )  # fmt: skip
        profile = settings.unit if unit is None else unit
        if settings.link.place == "there":
            leave_out("units of its own")
        if isinstance(profile, str):
            settings = settings.changed(unit=profile)
            profile = load_unit(profile)
        elif not self.virtual:
            raise ConfigurationError("unit: a unit on a link is told by its name or file, not as a profile")
        made = self.put(profile, settings.changed(off=True), arguments)
        if obc:
            _ = made.obc
        if not settings.off:
            made.power_on()
        return made

    def put(
        self, profile: UnitProfile, settings: UnitSettings, arguments: Mapping[str, Any] | None = None
    ) -> StarTracker:
        """Put a unit on the bench as its settings say, power not yet on; it stays until the test's end."""
        if arguments and not self.virtual:
            raise ConfigurationError(f"unit: {', '.join(arguments)}: only for a unit in memory")
        profile = with_dialect(profile, settings.dialect)
        require_wire(profile, settings.link.can, by_option=settings.dialect is not None)
        scenario = validated_scenario(settings)
        number = len(self.units) + 1
        made: StarTracker
        if settings.link.place == "memory":
            assert isinstance(self.clock, VirtualBenchClock)
            wiring = CanWiring(fd=settings.link.fd, node=settings.node) if settings.link.can else None
            made = VirtualStarTracker(
                profile,
                scenario,
                self.clock,
                self,
                self._medium(settings.link),
                wiring=wiring,
                link=settings.link.text,
                journal=self._journal_path(number, profile.name),
                **(arguments or {}),
            )
        elif settings.link.place == "process":
            made = SpawnedStarTracker(
                profile, settings, scenario, self, self._journal_path(number, profile.name)
            )
        else:
            made = PresentStarTracker(
                profile,
                str(settings.link.specification),
                settings.node,
                self,
                self._journal_path(number, profile.name).with_suffix(""),
            )
        self._stack.callback(made.close)
        self.units.append(made)
        return made

    def state(self) -> str:
        """What the units are doing, for a person."""
        return (
            ", ".join(f"{unit.name} is in {mode_of(unit)}" for unit in self.units) or "no unit on the bench"
        )

    def close(self) -> None:
        """Units and OBCs end; no process, port, link or lock is left."""
        self._stack.close()

    def _link(self, text: str) -> BenchLink:
        link = parse_bench_link(text)
        if (link.place == "memory") != self.virtual:
            raise ConfigurationError(
                f"link {text}: this bench is {'in virtual' if self.virtual else 'in real'} time "
                f"({self.settings.link.text}); allowed are links of the same kind"
            )
        return link

    def _medium(self, link: BenchLink) -> Medium:
        """A line of the unit's own, or the bus of all."""
        return self._buses.setdefault(link.fd, Medium()) if link.can else Medium()

    def _behind_ns(self) -> int:
        """How far the unit that is furthest behind the computer's clock is so."""
        behind = [unit.behind_ns() for unit in self.units if isinstance(unit, SpawnedStarTracker)]
        return max([0, *behind])

    def _watch(self) -> None:
        for unit in self.units:
            if isinstance(unit, SpawnedStarTracker):
                unit.process.check()


def mode_of(unit: StarTracker) -> str:
    """Its mode, for a person, whatever state it is in."""
    try:
        if isinstance(unit, PresentStarTracker):
            known = None if unit.joined is None else unit.joined.unit.mode
            return "a mode that nobody has asked for" if known is None else known.name
        return unit.mode
    except (UnitDiedError, OSError, ConfigurationError) as error:
        return f"no mode ({error})"
