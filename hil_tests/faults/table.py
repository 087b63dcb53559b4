"""The table of docs/faults.md: what was seen on the wire when each fault was put in.

``python -m hil_tests.faults.table --write`` runs every exercise and writes it; without ``--write`` it says
whether the written one is that of the runs.
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import hil_tests.faults as here
from hil_tests.faults.exercise import Exercise, Seen, judge
from st_emulator.faults.catalogue import FAULTS
from st_emulator.faults.listing import SEAMS

DOCUMENT = Path(__file__).parents[2] / "docs" / "faults.md"
HEAD = """\
# Faults, and what an OBC sees of them

Written by the tests (`python -m hil_tests.faults.table --write`): every fault was put into a unit that was
tracking, on the wire that the row names, and what came was read by a decoder of its own. Each row was judged:
the unit tracks again within 3 s of the fault's end, a boot adds its time, and nothing is left behind but what
the fault destroyed. `st-emulator faults KIND` has the settings, the interface document's chapter "Faults" the
general words, and [faults_guide.md](faults_guide.md) says how to put one in.

Unless the row says otherwise the unit is roja1 at 4 Hz, with AUTONOMOUS_START; "tracks again" counts from the
fault's end, for an instant from then.
"""
COLUMNS = ("fault", "settings", "lasts", "the OBC saw", "tracks again", "afterwards")


def exercises() -> list[Exercise]:
    """Of every module ``exercises_*``, in the order of the list of faults."""
    found: list[Exercise] = []
    for module in pkgutil.iter_modules(here.__path__):
        if module.name.startswith("exercises_"):
            found += importlib.import_module(f"{here.__name__}.{module.name}").EXERCISES
    order = list(FAULTS)
    return sorted(found, key=lambda one: order.index(str(one.fault["kind"])))


@dataclass(frozen=True)
class Row:
    """A line of the table."""

    title: str
    seam: str
    cells: tuple[str, ...]

    @property
    def line(self) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in self.cells) + " |"


def row_of(exercise: Exercise, seen: Seen, text: str) -> Row:
    """What a judged exercise says in the table."""
    kind = FAULTS[str(exercise.fault["kind"])]
    back_ms = seen.back_ms()
    settings = ", ".join(f"{key} = {value}" for key, value in exercise.fault.items() if key != "kind")
    title = exercise.title + ("" if exercise.unit == "roja1" else f" ({exercise.unit})")
    cells = (
        title,
        settings or "defaults",
        f"{exercise.lasts_ms / 1000:g} s" if exercise.lasts_ms else "an instant",
        text,
        "no" if back_ms is None else f"{back_ms:.0f} ms",
        kind.afterwards,
    )
    return Row(title, kind.seam, cells)


def document(rows: Iterable[Row]) -> str:
    """The whole text."""
    rows, lines = list(rows), [HEAD]
    for seam, meaning in SEAMS.items():
        of_seam = [row for row in rows if row.seam == seam]
        if of_seam:
            lines += [f"## {seam}", "", f"{meaning[0].upper()}{meaning[1:]}.", ""]
            lines += ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
            lines += [row.line for row in of_seam] + [""]
    return "\n".join(lines).rstrip() + "\n"


def written_rows() -> list[str]:
    """The lines of the table that is written."""
    return [
        line
        for line in DOCUMENT.read_text(encoding="utf-8").splitlines()
        if line.startswith("| ") and not line.startswith(f"| {COLUMNS[0]} |")
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help=f"write {DOCUMENT.name} anew")
    options = parser.parse_args(arguments)
    rows = []
    for exercise in exercises():
        print(exercise.title, file=sys.stderr)
        rows.append(row_of(exercise, *judge(exercise)))
    text = document(rows)
    if options.write:
        DOCUMENT.write_text(text, encoding="utf-8")
        return 0
    stale = not DOCUMENT.exists() or DOCUMENT.read_text(encoding="utf-8") != text
    print(f"{DOCUMENT.name}: {'out of date: run this with --write' if stale else 'up to date'}")
    return int(stale)


if __name__ == "__main__":
    sys.exit(main())
