"""Cycles of each count of work on an ARM926EJ-S, from its kernels; or a check of the committed figures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from st_emulator.campaigns.workers import Progress
from st_emulator.errors import ConfigurationError
from st_emulator.report import require_json_path, write_json
from tools.calibration import check as checking
from tools.calibration.calibration import (
    CHECK_FRAMES,
    FRAMES,
    HELD_OUT_SHARE,
    QUICK_FRAMES,
    KernelError,
    Plan,
    simulate_set,
)
from tools.calibration.compiler import (
    COMPILER_PROGRAM,
    Build,
    BuildError,
    CompilerMissingError,
    find_compiler,
    shared_build,
)
from tools.calibration.document import (
    ASSUMED,
    COMMITTED,
    SampleSet,
    document_of,
    predictor,
    read_document,
    text_of,
)
from tools.calibration.fit import fit
from tools.calibration.frames import FIT, HELD_OUT
from tools.calibration.packages import require_compiler
from tools.calibration.plot import draw, require_plot_path, write_plot
from tools.calibration.tables import show_document
from tools.calibration.validation import within_limits

FAILED, BAD_INPUT, MISSING = 1, 2, 3


class Session:
    """One run of the command: what it builds, simulates and prints."""

    def __init__(self, console: Console, plan: Plan) -> None:
        self._console = console
        self._plan = plan
        self.held_out: SampleSet | None = None  # once simulated

    def simulated(self, build: Build, seed: int, doing: str) -> SampleSet:
        """The set of a seed."""
        cases = self._plan.cases(seed)
        if not self._console.is_terminal:
            self._console.print(f"{doing}: {len(cases)} sequences")
        found = simulate_set(build, cases, self._plan, Progress(self._console, doing))
        if seed == HELD_OUT:
            self.held_out = found
        return found

    def calibrate(self) -> tuple[dict[str, Any], SampleSet]:
        """The document and the held out samples it was validated with."""
        missing = require_compiler(COMPILER_PROGRAM, "calibrate_cycles")
        if missing:
            raise CompilerMissingError(missing)
        build = shared_build()
        fitted = self.simulated(build, FIT, "Frames of the fit")
        held_out = self.simulated(build, HELD_OUT, "Held out frames")
        found = fit(fitted.samples)
        for warning in found.collinear:
            self._console.print(str(warning), style="yellow", markup=False, soft_wrap=True)
        for name, item in ASSUMED.items():
            self._console.print(f"assumed: {name}: {item.reason}", markup=False, soft_wrap=True)
        return document_of(build, found, fitted, held_out), held_out

    def check(self, document: dict[str, Any], require: bool) -> checking.Finding | None:
        """The committed figures against the sources; None without a compiler, which as root is installed
        where it is required.
        """
        if require and (missing := require_compiler(COMPILER_PROGRAM, "calibrate_cycles")):
            self._console.print(missing, markup=False, soft_wrap=True)
        return checking.check(
            document,
            find_compiler(),
            shared_build,
            lambda build: self.simulated(build, HELD_OUT, "Held out frames"),
        )


def main(
    check: Annotated[
        bool, typer.Option("--check", help="Compare the committed figures; write none.")
    ] = False,
    require: Annotated[
        bool, typer.Option("--require", help="With --check: a missing cross compiler ends with status 3.")
    ] = False,
    frames: Annotated[
        int | None,
        typer.Option(
            "--frames", metavar="N", min=1, help=f"Frames of the fit ({FRAMES}); with --check: to check."
        ),
    ] = None,
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", metavar="N", min=1, help="Processes (one a core).")
    ] = None,
    json_path: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the figures there, not where they are committed."),
    ] = None,
    plot_path: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Predicted against simulated cycles.")
    ] = None,
    restart: Annotated[
        bool, typer.Option("--restart", help="Use no results of a run that was stopped.")
    ] = False,
    quick: Annotated[
        bool, typer.Option("--quick", help=f"{QUICK_FRAMES} frames; no figures to commit.")
    ] = False,
) -> None:
    """Compile the kernels for ARM926EJ-S, run them in a simulator over many frames, and fit what one of each
    count costs. The figures go to firmware_model/cycle_costs/arm926ej_s.json.

    Exit status 0; 1 when a check fails, an error is over its limit, or a kernel's output is wrong; 2 for bad
    input; 3 without the cross compiler, but 0 for --check without --require.
    """
    console = Console(stderr=True, highlight=False)
    try:
        if require and not check:
            raise ConfigurationError("--require is for --check")
        if quick and frames is not None:
            raise ConfigurationError("--quick and --frames both say how many frames")
        require_json_path(json_path)
        if plot_path is not None:
            require_plot_path(plot_path)
        if check:
            plan = Plan(0, frames or CHECK_FRAMES, jobs, restart)
        else:
            fitted = frames or (QUICK_FRAMES if quick else FRAMES)
            plan = Plan(fitted, -(-fitted // HELD_OUT_SHARE), jobs, restart)
        session = Session(console, plan)
        if check:
            status = _check(console, session, require, json_path, plot_path)
        else:
            status = _calibrate(console, session, json_path, plot_path, commit=not quick and frames is None)
    except (BuildError, KernelError) as error:
        status = _told(console, error, FAILED)
    except CompilerMissingError as error:
        status = _told(console, error, MISSING)
    except ConfigurationError as error:
        status = _told(console, error, BAD_INPUT)
    raise SystemExit(status)


def _told(console: Console, error: Exception, status: int) -> int:
    console.print(f"calibrate_cycles: {error}", style="red", markup=False, soft_wrap=True)
    return status


def _calibrate(
    console: Console, session: Session, json_path: Path | None, plot_path: Path | None, *, commit: bool
) -> int:
    document, held_out = session.calibrate()
    show_document(console, document)
    if plot_path is not None:
        write_plot(plot_path, draw(held_out, predictor(document)))
    target = json_path or (COMMITTED if commit else None)
    if target is None:
        console.print("Fewer frames than the committed figures have: nothing is written without --json FILE.")
    elif str(target) == "-":
        print(text_of(document), end="")
    else:
        try:
            target.write_text(text_of(document), encoding="utf-8")
        except OSError as error:
            raise ConfigurationError(f"--json {target}: cannot be written: {error.strerror}") from error
        console.print(f"Written: {target}", markup=False, soft_wrap=True)
    return 0 if within_limits(document) else FAILED


def _check(
    console: Console, session: Session, require: bool, json_path: Path | None, plot_path: Path | None
) -> int:
    document = read_document(COMMITTED)
    found = session.check(document, require)
    if found is None:
        console.print(checking.MISSING_COMPILER, soft_wrap=True)
        return MISSING if require else 0
    for note in found.notes:
        console.print(note, markup=False, soft_wrap=True)
    for failure in found.failures:
        console.print(failure, style="red", markup=False, soft_wrap=True)
    if plot_path is not None and session.held_out is not None:
        write_plot(plot_path, draw(session.held_out, predictor(document)))
    write_json(json_path, {"holds": found.holds, "failures": list(found.failures), **found.figures}, [])
    console.print("The committed figures hold." if found.holds else "The committed figures do not hold.")
    return 0 if found.holds else FAILED


if __name__ == "__main__":
    typer.run(main)
