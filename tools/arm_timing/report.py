"""A run's cost as a person and as a program read it, with what may be said of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from st_emulator.firmware_model.cycle_table import LINE_FILLS, MemoryTiming

from .cost import Cost, Run

UNCERTAINTY = (
    "Instruction counts exact; core cycles about +-10 %; memory +-20 to 30 %; not validated on hardware."
)
NOT_MODELLED = (
    "Not modelled: TLB, a full write buffer, time of write-backs, interrupts, other bus masters, "
    "fetches beyond a taken branch."
)


@dataclass(frozen=True)
class Conditions:
    """What a run's cycles become time with."""

    clock_hz: int
    cache_kib: int  # of each of the two caches; 0: they are off
    line_fill: str  # one of LINE_FILLS
    memory: MemoryTiming = field(default_factory=MemoryTiming)

    @property
    def simulated_kib(self) -> tuple[int, ...]:
        return (self.cache_kib,) if self.cache_kib else ()

    def memory_access_cycles(self, line_fill: str) -> float:
        """Core cycles of one line fill, or of one access where caches are off."""
        times = self.memory.line_fill_ns if self.cache_kib else self.memory.access_ns
        return round(times[line_fill] * 1e-9 * self.clock_hz, 6)

    def memory_cycles(self, cost: Cost, line_fill: str) -> int:
        return round(cost.memory_cycles(self.memory_access_cycles(line_fill), self.cache_kib))

    def total_cycles(self, cost: Cost, line_fill: str) -> int:
        return cost.core_cycles + self.memory_cycles(cost, line_fill)


def document_of(program: Path, entry: str, run: Run, conditions: Conditions) -> dict[str, Any]:
    """All figures, for JSON."""
    cost, kib = run.cost, conditions.cache_kib
    totals = {name: conditions.total_cycles(cost, name) for name in LINE_FILLS}
    return {
        "program": program.name,
        "entry": entry,
        "ended": "returned" if run.exit_code is None else "exit call",
        "exit_code": run.exit_code,
        "result": run.result,
        "clock_hz": conditions.clock_hz,
        "cache_kib": kib,
        "line_fill": conditions.line_fill,
        "instructions": cost.instructions,
        "core_cycles": cost.core_cycles,
        "interlock_cycles": cost.interlock_cycles,
        "fetches": cost.fetches,
        "data_accesses": cost.data_accesses,
        "fetch_fills": cost.fetch_fills[kib] if kib else 0,
        "data_fills": cost.data_fills[kib] if kib else 0,
        "write_backs": cost.write_backs[kib] if kib else 0,
        "memory_access_cycles": {name: conditions.memory_access_cycles(name) for name in LINE_FILLS},
        "memory_cycles": {name: conditions.memory_cycles(cost, name) for name in LINE_FILLS},
        "total_cycles": totals,
        "time_s": {name: total / conditions.clock_hz for name, total in totals.items()},
        "class_counts": dict(cost.class_counts),
        "uncertainty": UNCERTAINTY,
        "not_modelled": NOT_MODELLED,
    }


def show(console: Console, document: dict[str, Any]) -> None:
    """Print the figures as tables."""
    kib, chosen = document["cache_kib"], document["line_fill"]
    caches = f"caches {kib} + {kib} KiB" if kib else "caches off"
    clock = f"{document['clock_hz'] / 1e6:g} MHz"
    table = Table(title=escape(f"{document['program']}, {document['entry']}: {clock}, {caches}"))
    table.title_justify = "left"
    table.add_column("figure")
    table.add_column("value", justify="right")
    ended = "returned" if document["exit_code"] is None else f"exit code {document['exit_code']}"
    rows: list[tuple[str, str]] = [("ended", ended), ("result (r0)", _word(document["result"]))]
    rows += [
        ("instructions", f"{document['instructions']:,}"),
        ("core cycles", f"{document['core_cycles']:,}"),
        ("  of which interlocks", f"{document['interlock_cycles']:,}"),
        ("core cycles an instruction", f"{document['core_cycles'] / max(document['instructions'], 1):.3f}"),
    ]
    if kib:
        rows += [
            ("line fills, instructions", f"{document['fetch_fills']:,}"),
            ("line fills, data", f"{document['data_fills']:,}"),
            ("lines written back", f"{document['write_backs']:,}"),
        ]
    else:
        rows += [("fetches", f"{document['fetches']:,}"), ("data accesses", f"{document['data_accesses']:,}")]
    for figure, value in rows:
        table.add_row(figure, value)
    console.print(table)
    _show_times(console, document, chosen)
    _show_classes(console, document)
    console.print(UNCERTAINTY, style="bold", soft_wrap=True)
    console.print(NOT_MODELLED, soft_wrap=True)


def _show_times(console: Console, document: dict[str, Any], chosen: str) -> None:
    what = "a line fill" if document["cache_kib"] else "an access"
    table = Table(title="Cycles and time by the speed of memory", title_justify="left")
    for column in ("memory", f"cycles of {what}", "memory cycles", "total cycles", "time, ms"):
        table.add_column(column, justify="left" if column == "memory" else "right")
    for name in LINE_FILLS:
        table.add_row(
            name,
            f"{document['memory_access_cycles'][name]:.1f}",
            f"{document['memory_cycles'][name]:,}",
            f"{document['total_cycles'][name]:,}",
            f"{document['time_s'][name] * 1e3:,.6g}",
            style="bold" if name == chosen else "",
        )
    console.print(table)


def _show_classes(console: Console, document: dict[str, Any]) -> None:
    table = Table(title="Instructions by kind", title_justify="left")
    for column in ("kind", "instructions", "share"):
        table.add_column(column, justify="left" if column == "kind" else "right")
    counts: dict[str, int] = document["class_counts"]
    for name, count in sorted(counts.items(), key=lambda item: -item[1]):
        table.add_row(name, f"{count:,}", f"{count / max(document['instructions'], 1):.1%}")
    console.print(table)


def _word(value: int) -> str:
    signed = value - (1 << 32) if value >> 31 else value
    return f"{signed} (0x{value:08x})"
