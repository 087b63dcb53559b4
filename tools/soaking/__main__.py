"""tools/soak: a day of operation in virtual time with faults in random order, and what must hold of it."""

from __future__ import annotations

import gzip
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from st_emulator.errors import ConfigurationError
from st_emulator.report import (
    Check,
    all_hold,
    check,
    require_json_path,
    show_checks,
    show_figures,
    write_json,
)
from st_emulator.units.profile import load_unit

from .judging import count, growth_kib_per_hour, replayed
from .run import Soak

BAD_INPUT = 2
LEAST_HOURS = 0.02
GROWTH_TARGET_KIB_PER_HOUR = 1024
GROWTH_FROM_HOURS = 1.0  # before, what is loaded and kept once is most of it

HELP = """
Runs a unit for so many virtual hours as fast as the computer can, an OBC on its line and faults of every kind
in random order with random settings, each with an end; then reads the journal with a decoder of its own and
replays it.

\b
What must hold (exit status 0; 1 when something does not):
  - virtual time is exact, and so is the unit's: to the nanosecond, whenever it was set and nothing was wrong
  - a frame began each period while there was power, none more and none less
  - in the stretches without a fault the journal has as many attitude reports as the unit's counters say
  - after each fault the unit tracks again, by itself or led by its OBC
  - the memory is flat (from an hour on)
  - the replay of the journal is the same line for line

Ctrl-C stops it: what ran until then is judged, and the exit status is 1. 24 hours at 4 Hz are 345,600 frames;
at 300 frames a second they take twenty minutes, and the replay as long again.
"""

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


class Stopping:
    """Whether somebody wants to end the run."""

    def __init__(self) -> None:
        self.asked = False

    @contextmanager
    def by_signal(self) -> Iterator[None]:
        """SIGINT and SIGTERM ask for it; a second one ends the program."""
        before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

        def ask(number: int, frame: Any) -> None:
            self.asked = True
            signal.signal(number, before[number])

        for number in before:
            signal.signal(number, ask)
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


@app.command(help=HELP)
def soak(
    hours: Annotated[
        float, typer.Option("--hours", min=LEAST_HOURS, max=24 * 366, help="Virtual hours.")
    ] = 24.0,
    unit: Annotated[
        str, typer.Option("--unit", "-u", metavar="UNIT", help="A unit that speaks pus.")
    ] = "roja1",
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the sky, the faults and the OBC.")] = 1,
    json_path: Annotated[
        str | None,
        typer.Option("--json", metavar="FILE", help="Figures and checks as JSON (- for standard output)."),
    ] = None,
    journal: Annotated[
        Path | None,
        typer.Option(
            "--journal",
            metavar="FILE.gz",
            help="Keep the journal here. Default: it is deleted when all holds.",
        ),
    ] = None,
    replay: Annotated[bool, typer.Option("--replay/--no-replay", help="Replay the journal, too.")] = True,
) -> None:
    require_json_path(json_path)
    if load_unit(unit).wire.dialect != "pus":
        raise ConfigurationError(f"--unit {unit}: its OBC here speaks pus; allowed are units of that dialect")
    if journal is not None and journal.suffix != ".gz":
        raise ConfigurationError(f"--journal {journal}: allowed is a name that ends in .gz")
    folder = None if journal is not None else Path(tempfile.mkdtemp(prefix="st-emulator-soak-"))
    path = journal or Path(folder or ".") / "journal.jsonl.gz"
    console = Console(stderr=True)
    figures, checks = _run(unit, hours, seed, path, replay, console)
    show_figures(console, f"soak of {unit}, seed {seed}", figures)
    show_checks(console, checks)
    write_json(json_path, figures, checks)
    holds = all_hold(checks)
    if folder is not None and holds:
        shutil.rmtree(folder)
    elif not holds:
        console.print(f"the journal: {path}")
    raise typer.Exit(0 if holds else 1)


def _run(
    unit: str, hours: float, seed: int, path: Path, replay: bool, console: Console
) -> tuple[dict[str, Any], list[Check]]:
    stopping = Stopping()
    progress = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:.2f} of {task.total:g} h"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    )
    try:
        path.touch()
    except OSError as error:
        raise ConfigurationError(f"--journal {path}: cannot be written: {error.strerror}") from error
    with progress, stopping.by_signal():
        began = time.monotonic()
        with gzip.open(path, "wt", compresslevel=1, encoding="utf-8", newline="\n") as file:
            bar = progress.add_task("running", total=hours)
            run = Soak(
                unit,
                hours,
                seed,
                file,
                lambda done: progress.update(bar, completed=done),
                lambda: stopping.asked,
            )
            outcome = run.run()
        ran_s = time.monotonic() - began
        done_h = run.emulator.now_ns / 3.6e12
        progress.update(bar, completed=done_h)
        counted = count(path, outcome.stretches)
        difference, replay_s = None, None
        if replay:
            began = time.monotonic()
            bar = progress.add_task("replaying", total=done_h)
            difference = replayed(path, lambda done: progress.update(bar, completed=done))
            replay_s = time.monotonic() - began
    errors = [
        abs(found - stretch.frames)
        for found, stretch in zip(counted.in_stretch, outcome.stretches, strict=True)
    ]
    growth = growth_kib_per_hour(outcome.memory)
    figures: dict[str, Any] = {
        "hours": done_h,
        "stopped": outcome.stopped,
        "frames": run.grid.started,
        "wall_s": round(ran_s, 1),
        "frames_per_s": round(run.grid.started / ran_s, 1),
        "replay_wall_s": None if replay_s is None else round(replay_s, 1),
        "faults": sum(outcome.faults.values()),
        "faults_of_kind": dict(sorted(outcome.faults.items())),
        "settings_refused": outcome.refused,
        "led_back_by_the_obc": outcome.led_back,
        "never_back": outcome.never_back,
        "quiet_stretches": len(outcome.stretches),
        "frames_in_quiet_stretches": sum(stretch.frames for stretch in outcome.stretches),
        "times_set": outcome.times_set,
        "packets": counted.packets,
        "frames_that_are_no_packets": counted.broken,
        "attitude_reports": counted.attitude_reports,
        "journal_mib": round(path.stat().st_size / 2**20, 1),
        "memory_mib": [round(mib, 1) for _, mib in outcome.memory[:: max(1, len(outcome.memory) // 10)]],
        "memory_growth_kib_per_hour": None if growth is None else round(growth, 1),
        "first_difference": "not replayed" if not replay else difference or "none",
    }
    checks = [
        check("hours_missing", hours - done_h, "==", 0, "h"),
        check("clock_error", outcome.most_clock_error_ns, "==", 0, "ns"),
        check("frames_missing", run.grid.expected - run.grid.started, "==", 0, ""),
        check("attitude_reports_missing", sum(errors), "==", 0, ""),
        check("never_back", len(outcome.never_back), "==", 0, ""),
    ]
    if replay:
        checks.append(check("replay_differences", int(difference is not None), "==", 0, ""))
    if growth is not None and done_h >= GROWTH_FROM_HOURS:
        checks.append(check("memory_growth", growth, "<=", GROWTH_TARGET_KIB_PER_HOUR, "KiB/h"))
    return figures, checks


def main() -> None:
    """Entry point: a problem that the user can mend is one line on standard error and exit status 2."""
    try:
        app(prog_name="tools/soak")
    except ConfigurationError as error:
        print("tools/soak:", error, file=sys.stderr)
        sys.exit(BAD_INPUT)


if __name__ == "__main__":
    main()
