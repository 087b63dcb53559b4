"""The faults of one run: they begin and end by the virtual clock, from a list and live."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from ..clock import ScheduledEvent
from ..errors import ConfigurationError
from ..units.validation import validate
from .catalogue import FAULTS, FaultTable, settings_table
from .fault import Fault, FaultSettings, Reach, SettingsT
from .seams import Seams

MOST_FAULTS = 1_000_000
"""ASSUMED: so many in one run are a slip of who puts them in."""

Told = Callable[[int, str, str], None]
Done = Callable[[str, Any], None]


@dataclass
class InForce:
    """A fault of the run: ``number`` from 0 in the order in which they were put in, ``active`` from its begin
    to its end; ``fault``: None from there on."""

    number: int
    settings: FaultSettings
    start_ns: int
    end_ns: int | None
    fault: Fault[Any] | None
    active: bool = False
    over: bool = False
    _events: tuple[ScheduledEvent, ...] = ()

    def text(self) -> str:
        """A line for people."""
        return f"fault {self.number}: {self.settings.kind}"


class Faults:
    """Puts faults in at their seams.

    Args:
        seams: of the run.
        seed: of the run; a fault without its own takes it with its number.
        told: called when a fault begins or ends, with its number, its kind and what happens.
        done: called with what is done to the run from outside: "inject" and settings, "stand" and those of a
            fault of one's own, "clear" and a number.
    """

    def __init__(
        self,
        seams: Seams,
        seed: int,
        told: Told = lambda number, kind, what: None,
        done: Done = lambda what, content: None,
    ) -> None:
        self._done = done
        self._seams = seams
        self._seed = seed
        self._told = told
        self._reach: Reach | None = None
        self.all: list[InForce] = []

    def attach(self, reach: Reach, settings: Iterable[FaultSettings], where: str) -> None:
        """The unit is whole: the faults of a scenario are scheduled from now on. Before power comes on.

        Raises:
            ConfigurationError: one that this unit or its wire cannot have.
        """
        self._reach = reach
        for number, one in enumerate(settings):
            self._put_in(one, self._make(one, f"{where}: faults.{number}"))

    def inject(self, fault: FaultSettings | Mapping[str, Any]) -> int:
        """Put a fault in live; its times are virtual, from power-on, and the past counts as now. Returns its
        number.

        Raises:
            ConfigurationError: names what is wrong and what is allowed.
        """
        settings = fault if isinstance(fault, FaultSettings) else settings_of(fault, "fault")
        fault_made, number = self._make(settings, "fault"), len(self.all)
        self._done("inject", settings.model_dump(mode="json", exclude_defaults=True))
        self._put_in(settings, fault_made)
        return number

    @property
    def reach(self) -> Reach:
        """What a fault of this run may lay its hands on."""
        assert self._reach is not None
        return self._reach

    def stand(self, make: Callable[[SettingsT, Reach, int], Fault[SettingsT]], settings: SettingsT) -> int:
        """Put in a fault of one's own: ``make(settings, reach, seed)`` makes it, its class as a rule. Its
        kind is a name that the list does not have. Returns its number.

        A journal of the run says that it stood, and cannot stand it again.

        Raises:
            ConfigurationError: the kind is one of the list, or there are too many faults.
        """
        where = f"fault of one's own {settings.kind!r}"
        if settings.kind in FAULTS:
            raise ConfigurationError(f"{where}: the list has such a kind; allowed is any other name")
        number = len(self.all)
        fault = make(settings, self.reach, self._seed_of(settings, where))
        self._done("stand", settings.model_dump(mode="json", exclude_defaults=True) | {"kind": settings.kind})
        self._put_in(settings, fault)
        return number

    def clear(self, number: int) -> None:
        """End a fault now, or before it begins.

        Raises:
            ConfigurationError: no fault of the run has this number.
        """
        if not 0 <= number < len(self.all):
            raise ConfigurationError(
                f"fault {number}: there is none; allowed are 0 to {len(self.all) - 1}"
                if self.all
                else f"fault {number}: there is none in this run"
            )
        one = self.all[number]
        if one.over:
            return
        self._done("clear", number)
        for event in one._events:
            event.cancel()
        self._told(number, one.settings.kind, "is cleared")
        if one.active:
            self._end(one, told=False)
        one.over, one.fault = True, None

    def active(self) -> list[InForce]:
        """Those that have begun and not ended."""
        return [one for one in self.all if one.active]

    def _make(self, settings: FaultSettings, where: str) -> Fault[Any]:
        reach = self._reach
        assert reach is not None
        kind = FAULTS[settings.kind]
        if reach.wire not in kind.wires:
            raise ConfigurationError(
                f"{where}: {kind.name} is for a unit on {_WIRES[kind.wires[0]]}, and this one is on "
                f"{_WIRES[reach.wire]}; allowed are {', '.join(_allowed_on(reach))}"
            )
        language = reach.profile.wire.dialect
        if not kind.spoken_in(language):
            spoken = f"is not for {language}"
            if kind.dialects is not None:
                spoken = f"is for the dialects {', '.join(kind.dialects)}, and this unit speaks {language}"
            raise ConfigurationError(
                f"{where}: {kind.name} {spoken}; allowed are {', '.join(_allowed_on(reach))}"
            )
        seed = self._seed_of(settings, where)
        try:
            return kind.make(settings, reach, seed)
        except ValueError as error:
            raise ConfigurationError(f"{where}: {kind.name}: {error}") from error

    def _seed_of(self, settings: FaultSettings, where: str) -> int:
        number = len(self.all)
        if number >= MOST_FAULTS:
            raise ConfigurationError(f"{where}: more than {MOST_FAULTS} faults in one run")
        return _seed(self._seed, number) if settings.seed is None else settings.seed

    def _put_in(self, settings: FaultSettings, fault: Fault[Any]) -> None:
        reach = self._reach
        assert reach is not None
        number = len(self.all)
        start_ns, end_ns = settings.window_ns(reach.clock.now_ns)
        one = InForce(number, settings, start_ns, end_ns, fault)
        self.all.append(one)
        if start_ns <= reach.clock.now_ns:
            self._begin(one)
        else:
            one._events = (reach.clock.at(start_ns, lambda: self._begin(one)),)

    def _begin(self, one: InForce) -> None:
        assert self._reach is not None
        fault = one.fault
        assert fault is not None
        one.active = True
        self._told(one.number, one.settings.kind, "begins")
        self._seams.add(fault)
        if one.end_ns is not None and not fault.instant:
            one._events = (self._reach.clock.at(one.end_ns, lambda: self._end(one)),)
        fault.begin()
        if fault.instant and one.active:
            self._end(one, told=False)

    def _end(self, one: InForce, *, told: bool = True) -> None:
        fault = one.fault
        assert fault is not None
        one.active, one.over = False, True
        self._seams.remove(fault)
        if told:
            self._told(one.number, one.settings.kind, "ends")
        fault.end()
        one.fault, one._events = None, ()  # some hold whole images, and a run of days has thousands of them


_WIRES = {"serial": "a serial line", "can": "a CAN bus"}


def _allowed_on(reach: Reach) -> list[str]:
    language = reach.profile.wire.dialect
    return [kind.name for kind in FAULTS.values() if reach.wire in kind.wires and kind.spoken_in(language)]


def settings_of(table: Mapping[str, Any], where: str) -> FaultSettings:
    """A fault's settings from a table.

    Raises:
        ConfigurationError: names the key and what is allowed.
    """
    return settings_table(validate(FaultTable, {"fault": dict(table)}, where, inside="fault"))


def _seed(run_seed: int, number: int) -> int:
    return int.from_bytes(hashlib.sha256(f"fault {run_seed} {number}".encode()).digest()[:8], "big") >> 1
