"""Speed, delays, memory and start of the emulator on this machine: JSON on standard output."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import bare_line
import can_image
import identification
import numpy as np
import real_time
import starting
import throughput
import typer
import vcan
import vcan_session
from machine import machine
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from spread import of_rounds

from st_emulator.errors import ConfigurationError
from st_emulator.links import LinkError
from st_emulator.report import Check, all_hold, check, show_checks, write_json

UNITS = ("zy3", "roja1")
LARGE_UNIT = "zy3"  # 1024 x 1024: the targets of speed are its
LOST_IN_SPACE_TARGET_HZ = 60
TRACKING_TARGET_HZ = 400
DELAY_TARGET_MS = 2
MEMORY_TARGET_MB = 400
START_TARGET_S = 5
FLOOR_PINGS = 150
CAN_UNIT = "roja1"
CAN_DELAY_TARGET_MS = 5
IMAGE_SHARE_TARGET = 0.9
PARTS = ("speed", "real_time", "start", "can", "identification", "cold")
# The pyramid's median on one core: from centroids of 20 deg scenes to names.
IDENTIFICATION_TARGETS_MS = {"no_false_stars": 0.15, "50_false_stars": 5}
RIGHT_TARGET = 0.99  # of the scenes, by the best of the algorithms
SEARCHES = ("lost_in_space", "tracking", "tracking_turning")


class Bench:
    """Figures as they come, with progress."""

    def __init__(self, quick: bool, units: Sequence[str], console: Console, progress: Progress) -> None:
        self._quick = quick
        self._units = units
        self._console = console
        self._progress = progress

    def run(self, parts: Sequence[str]) -> tuple[dict[str, Any], list[Check]]:
        """Measure the parts asked for, of :data:`PARTS`."""
        figures: dict[str, Any] = {"machine": machine(), "quick": self._quick}
        checks: list[Check] = []
        if "speed" in parts:
            figures["frames_per_second"], figures["stages_ms"] = self._speed()
            if LARGE_UNIT in self._units:
                rates = figures["frames_per_second"][LARGE_UNIT]
                for search, target in (
                    ("lost_in_space", LOST_IN_SPACE_TARGET_HZ),
                    ("tracking", TRACKING_TARGET_HZ),
                ):
                    name = f"frames_per_second_{search}"
                    checks.append(check(name, rates[search]["median"], ">=", target, "1/s"))
        if "real_time" in parts:
            figures["real_time"] = {unit: self._real_time(unit) for unit in self._units}
            for unit, item in figures["real_time"].items():
                ping = item["ping"]["above_modelled_delay"]["p99_ms"]
                jitter = item["jitter"]["about_median"]["p99_ms"]
                peak = item["memory_mb"]["peak"]
                checks.append(check(f"{unit}_ping_p99_ms", ping, "<=", DELAY_TARGET_MS, "ms"))
                checks.append(check(f"{unit}_jitter_p99_ms", jitter, "<=", DELAY_TARGET_MS, "ms"))
                checks.append(check(f"{unit}_memory_mb", peak, "<=", MEMORY_TARGET_MB, "MB"))
                checks.append(
                    check(f"{unit}_late_or_dropped", item["frames_late_or_dropped"], "==", 0, "frames")
                )
        if "start" in parts:
            figures["start_s"] = {unit: self._start(unit) for unit in self._units}
            for unit, item in figures["start_s"].items():
                checks.append(check(f"{unit}_start_s", item["median"], "<=", START_TARGET_S, "s"))
        if "can" in parts:
            figures["can"] = self._can()
            delay = figures["can"]["vcan0"]["verification_above_modelled_delay"]
            share = figures["can"]["image_virtual_time"]["share"]
            missing = figures["can"]["vcan0"]["frames_missing"]
            checks.append(
                check("vcan0_verification_p99_ms", delay["p99_ms"], "<=", CAN_DELAY_TARGET_MS, "ms")
            )
            checks.append(check("can_image_share_of_bus", share, ">=", IMAGE_SHARE_TARGET, ""))
            checks.append(check("vcan0_attitudes_missing", missing, "==", 0, "frames"))
        if "identification" in parts:
            figures["identification"] = self._identification()
            for case, target in IDENTIFICATION_TARGETS_MS.items():
                solvers = figures["identification"]["cases"][case]
                median = solvers["pyramid"]["median_ms"]
                ours = [solvers[name] for name in identification.ALGORITHMS]
                best = max(item["right"] / item["scenes"] for item in ours)
                wrong = sum(item["wrong"] for item in ours)
                checks.append(check(f"pyramid_ms_{case}", median, "<=", target, "ms"))
                right = figures["identification"]["cases"][case]["pyramid"]
                share = right["right"] / right["scenes"]  # a quick refusal is no solution
                checks.append(check(f"pyramid_right_{case}", share, ">=", RIGHT_TARGET, ""))
                checks.append(check(f"best_right_{case}", best, ">=", RIGHT_TARGET, ""))
                checks.append(check(f"wrong_attitudes_{case}", wrong, "==", 0, "scenes"))
        if "cold" in parts:
            figures["cold_start"] = {unit: self._cold(unit) for unit in self._units}
        figures["load_average_after"] = [round(load, 2) for load in os.getloadavg()]
        return figures, checks

    def _task(self, doing: str, total: int) -> tuple[TaskID, Callable[[], None]]:
        if not self._console.is_terminal:
            self._console.print(doing)
        task = self._progress.add_task(doing, total=total)
        return task, lambda: self._progress.advance(task)

    def _speed(self) -> tuple[dict[str, Any], dict[str, Any]]:
        rates: dict[str, Any] = {}
        stages: dict[str, Any] = {}
        for unit in self._units:
            rates[unit], stages[unit] = {}, {}
            for search in SEARCHES:
                results = self._rounds(unit, search, stages=False)
                rates[unit][search] = of_rounds([item["frames"] / item["seconds"] for item in results])
                # On a busy machine the core is not all ours: what it would be.
                cpu = of_rounds([item["frames"] / item["cpu_seconds"] for item in results])
                rates[unit][search]["median_per_cpu_second"] = cpu["median"]
                by_stage: defaultdict[str, list[float]] = defaultdict(list)
                for item in self._rounds(unit, search, stages=True):
                    for stage, value in item["stages_ms"].items():
                        by_stage[stage].append(value)
                stages[unit][search] = {
                    stage: round(float(np.median(values)), 4) for stage, values in by_stage.items()
                }
        return rates, stages

    def _rounds(self, unit: str, search: str, *, stages: bool) -> list[dict[str, Any]]:
        count = 3 if self._quick or stages else 9
        # A turning unit soon looks at another sky, perhaps one with too few stars.
        frames = {"lost_in_space": 100, "tracking": 400, "tracking_turning": 60}[search]
        if self._quick or stages:
            frames //= 2
        task, advance = self._task(f"{unit}: {search}{', stages' if stages else ''}", count)
        command = [
            *(sys.executable, throughput.__file__, unit, search),
            *("--rounds", str(count), "--frames", str(frames), *(["--stages"] if stages else [])),
        ]
        results = []
        for item in on_one_thread(command):
            results.append(item)
            advance()
        self._progress.remove_task(task)
        return results

    def _real_time(self, unit: str) -> dict[str, Any]:
        seconds = 15.0 if self._quick else 65.0
        expected = round(seconds / (sum(real_time.PAUSE_S) / 2 + 0.006))
        task, advance = self._task(f"{unit}: pings in real time, {seconds:g} s", expected)
        before = bare_line.floor(FLOOR_PINGS)
        figures = real_time.measure(unit, seconds, advance)
        after = bare_line.floor(FLOOR_PINGS)
        self._progress.remove_task(task)
        return figures | {"bare_pty": {"before": before, "after": after}}

    def _start(self, unit: str) -> dict[str, Any]:
        count = 3 if self._quick else 7
        task, advance = self._task(f"{unit}: start to first telemetry", count)
        seconds = []
        for _ in range(count):
            seconds.append(starting.warm_start_s(unit))
            advance()
        self._progress.remove_task(task)
        return of_rounds(seconds)

    def _can(self) -> dict[str, Any]:
        """Over a real vcan0 (in a guest where the kernel has none), and an image in virtual time."""
        seconds = 15.0 if self._quick else 60.0
        task, advance = self._task(f"{CAN_UNIT}: image by ISO-TP in virtual time", 1)
        image = can_image.measure(CAN_UNIT)
        advance()
        self._progress.remove_task(task)
        expected = round(seconds / (sum(vcan_session.PAUSE_S) / 2 + 0.012))
        task, advance = self._task(f"{CAN_UNIT}: pings over vcan0, {seconds:g} s", expected)
        session = vcan.measure(CAN_UNIT, seconds, advance)
        self._progress.remove_task(task)
        return {"unit": CAN_UNIT, "vcan0": session, "image_virtual_time": image}

    def _identification(self) -> dict[str, Any]:
        """All algorithms, and the peers that are installed, on the same centroids."""
        scenes = identification.QUICK_SCENES if self._quick else identification.SCENES
        cases = len(identification.CASES)
        task, advance = self._task(
            "identification: algorithms and peers", cases * scenes // identification.TURN
        )
        figures: dict[str, Any] = {}
        for item in on_one_thread([sys.executable, identification.__file__, "--scenes", str(scenes)]):
            figures = item.get("figures", figures)
            advance()
        self._progress.remove_task(task)
        return figures

    def _cold(self, unit: str) -> dict[str, Any]:
        task, advance = self._task(f"{unit}: first start with empty caches", 1)
        figures = starting.cold_start(unit)
        advance()
        self._progress.remove_task(task)
        return figures


def on_one_thread(command: Sequence[str]) -> Iterator[dict[str, Any]]:
    """The JSON objects that a process with one thread prints, a line each; SystemExit when it fails."""
    environment = {**os.environ, **throughput.ONE_THREAD}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout is not None
        for line in process.stdout:
            yield json.loads(line)
    if process.returncode != 0:
        raise SystemExit(f"{' '.join(command)}: ended with status {process.returncode}")


def main(
    json_path: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the JSON to a file as well.")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer rounds, 15 s of real time, no start with empty caches.")
    ] = False,
    only: Annotated[
        list[str] | None,
        typer.Option("--only", metavar="PART", help=f"Only this part: {', '.join(PARTS)} (repeatable)."),
    ] = None,
    unit: Annotated[
        list[str] | None, typer.Option("--unit", "-u", metavar="UNIT", help="Only this unit (repeatable).")
    ] = None,
) -> None:
    """Measure speed, delays, memory and start of the emulator on this machine; print JSON.

    Exit status 0 when every target is met, else 1. Other work on the machine shows in the figures: see the
    load averages in the JSON, and beside the pings the same over a bare pty, without an emulator.
    """
    parts = [part for part in PARTS if not (quick and part == "cold")]
    unknown = [part for part in only or [] if part not in PARTS]
    if unknown:
        raise typer.BadParameter(f"{unknown[0]}: allowed are {', '.join(PARTS)}", param_hint="--only")
    console = Console(stderr=True)
    columns = (TextColumn("{task.description:<44}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    try:
        with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
            figures, checks = Bench(quick, unit or UNITS, console, progress).run(only or parts)
        write_json("-", figures, checks)
        write_json(json_path, figures, checks)
    except (ConfigurationError, LinkError) as error:
        console.print(f"[red]{error}[/]")
        raise SystemExit(2) from error
    show_checks(console, checks)
    raise SystemExit(0 if all_hold(checks) else 1)


if __name__ == "__main__":
    typer.run(main)
