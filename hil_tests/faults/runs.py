"""Runs with faults, told by every group of octets that the unit sent: for what must be the same, or not."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import Any, Literal, get_args, get_origin

from hypothesis import strategies as st

from hil_tests.unit.conftest import MS, Bench, make
from st_emulator.bench.journal import read_journal
from st_emulator.bench.scenario import Scenario
from st_emulator.commands.replaying import emulator_of, feed, refusals_of
from st_emulator.faults.catalogue import FAULTS
from st_emulator.faults.fault import FaultKind
from st_emulator.faults.faults import settings_of
from st_emulator.wire.can.wiring import CanWiring

START_S, END_S, LAST_S = 2.0137, 3.5139, 5.5  # the unit tracks from 1 s on
Groups = list[tuple[int, bytes]]


@dataclass
class Run:
    """``groups``: (virtual time, octets) that the unit sent; ``journal``: its text."""

    bench: Bench
    groups: Groups
    journal: str

    def after(self, ms: float) -> Groups:
        """From ``ms`` behind the fault's end on."""
        return [group for group in self.groups if group[0] > END_S * 1000 * MS + ms * MS]

    def before(self) -> Groups:
        return [group for group in self.groups if group[0] < START_S * 1000 * MS]

    def during(self) -> Groups:
        return [group for group in self.groups if START_S * 1000 * MS <= group[0] <= END_S * 1000 * MS]


def started(on_can: bool, **keys: Any) -> Bench:
    """A unit that acquires by itself."""
    scenario = Scenario(parameters={"autonomous_start": 1}, **keys.pop("scenario", {}))
    bench = make(scenario=scenario, **({"can": CanWiring()} if on_can else {}), **keys)
    bench.broken = []
    return bench


def run(fault: dict[str, Any] | None, *, on_can: bool, pings: bool = False, live: bool = False) -> Run:
    """With one fault from ``START_S`` to ``END_S``, of the scenario or put in and cleared by hand."""
    journal = io.StringIO()
    faults = []
    if fault is not None and not live:
        faults.append(settings_of(fault | {"start_s": START_S, "end_s": END_S}, "run"))
    bench = started(on_can, scenario={"faults": faults}, journal=journal)

    def go(until_s: float) -> None:
        while bench.now_ms < until_s * 1000:
            bench.run_to(min(bench.now_ms + 100, until_s * 1000))
            if pings and bench.now_ms > 1000:
                bench.send("ping")

    go(START_S)
    number = bench.emulator.faults.inject(fault) if live and fault is not None else None
    go(END_S)
    if number is not None:
        bench.emulator.faults.clear(number)
    go(LAST_S)
    assert not bench.emulator.faults.active()
    bench.emulator.close()
    return Run(bench, bench.groups, journal.getvalue())


def replayed(text: str, folder: Path) -> Groups:
    """What a fresh unit sends by a journal."""
    path = folder / "journal.jsonl"
    path.write_text(text, encoding="utf-8")
    journal = read_journal(path)
    groups: Groups = []
    refusals = refusals_of(journal)

    def transmit(data: bytes, t_ns: int) -> int:
        if (t_ns, data) in refusals:
            return 0
        groups.append((t_ns, data))
        return len(data)

    feed(emulator_of(journal, str(path), transmit=transmit), journal)
    return groups


def within_chance(count: int, number: int, probability: float) -> bool:
    """Whether ``count`` of ``number`` are no farther off than 5 sigma of the binomial distribution."""
    sigma = (number * probability * (1 - probability)) ** 0.5
    return abs(count - number * probability) <= 5 * sigma


def kinds_of(seam: str, wire: str) -> list[str]:
    """Names of the kinds of a seam that a wire has."""
    return [name for name, kind in FAULTS.items() if kind.seam == seam and wire in kind.wires]


# -- random settings

_TIMES = ("kind", "start_s", "end_s", "duration_s", "seed")


def _values(annotation: Any, metadata: list[Any]) -> st.SearchStrategy[Any]:
    for part in get_args(annotation):
        if get_origin(part) is None and hasattr(part, "__metadata__"):
            metadata = [*metadata, *part.__metadata__]
    options = get_args(annotation)
    if get_origin(annotation) is Literal:
        return st.sampled_from(options)
    if NoneType in options:
        (other,) = [option for option in options if option is not NoneType]
        return st.none() | _values(other, metadata)
    limits = {}
    for item in metadata:
        for name in ("ge", "le", "gt"):
            if (limit := getattr(item, name, None)) is not None:
                limits["max_value" if name == "le" else "min_value"] = limit
                if name == "gt":
                    limits["exclude_min"] = True
    if annotation is bool:
        return st.booleans()
    if annotation is int:
        limits.pop("exclude_min", None)
        return st.integers(**limits)
    assert annotation is float, annotation
    return st.floats(**limits, allow_nan=False)


def settings_for(kind: FaultKind, times: bool = True) -> st.SearchStrategy[dict[str, Any]]:
    """Any settings that the kind's model allows, as a table; times within the first seconds."""
    fields = {
        name: _values(field.annotation, list(field.metadata))
        for name, field in kind.settings.model_fields.items()
        if name not in _TIMES
    }
    given: dict[str, st.SearchStrategy[Any]] = {
        "kind": st.just(kind.name),
        "seed": st.none() | st.integers(0, 2**63 - 1),
    }
    if times:
        given |= {"start_s": st.floats(0, 2), "duration_s": st.none() | st.floats(0, 1.5)}
    return st.fixed_dictionaries(given, optional=fields)
