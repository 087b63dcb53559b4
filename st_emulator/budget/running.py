"""``st-emulator budget``: options checked, everything looked at, tables, JSON, page and plot, exit status."""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from ..bench.scenario import Scenario, load_scenario
from ..bench.scenario_inputs import check_inputs, parameters_of
from ..campaigns.results_file import ResultsFile, identity_hash, program_fingerprint
from ..campaigns.workers import Progress, Workers
from ..commands.state_folder import state_folder
from ..errors import ConfigurationError
from ..report import require_json_path, write_json
from ..units.profile import load_unit
from .assessment import Assessment, Order, assess
from .figures import Costing
from .modes import LOST_IN_SPACE
from .samples import TRACKED, Instant, Look, SkySample, look
from .subject import Subject, subject_of
from .worst_case import OBJECTIVES, place_from_json

FITS, DOES_NOT_FIT = 0, 1  # 2: bad input


@dataclass(frozen=True)
class BudgetOptions:
    """The options of the command line."""

    unit: str
    scenario: Path | None = None
    n: int = 400
    seed: int = 1
    evaluations: int = 900
    clock_hz: int | None = None
    cache_kib: int | None = None
    line_fill: str | None = None
    workers: int | None = None
    dask: str | None = None
    results: Path | None = None
    restart: bool = False
    json_path: str | None = None
    html: Path | None = None
    plot: Path | None = None
    rerun: Path | None = None

    def command(self) -> str:
        """The command that gives the same figures."""
        words = ["st-emulator", "budget", self.unit]
        for name, value in (
            ("--scenario", self.scenario),
            ("--n", self.n),
            ("--seed", self.seed),
            ("--evaluations", self.evaluations),
            ("--clock", self.clock_hz),
            ("--cache", self.cache_kib),
            ("--line-fill", self.line_fill),
        ):
            if value is not None:
                words += [name, str(value)]
        return shlex.join(words)


def run_budget(options: BudgetOptions, console: Console) -> int:
    """Work out a budget and print it; returns the exit status: FITS or DOES_NOT_FIT.

    Raises ConfigurationError naming the option or file and what is allowed.
    """
    subject, scenario = _inputs(options)
    if options.rerun is not None:
        return _rerun(subject, scenario, options.rerun, console)
    order = Order(subject, options.n, options.seed, options.evaluations, scenario)
    results = _results(options, order)
    with Progress(console, f"budget {subject.profile.name}") as progress:
        workers = Workers(options.workers, progress, dask=options.dask, results=results)
        try:
            assessment = assess(order, workers)
        except BaseException:
            if results.usable and workers.done:
                where = f"{workers.done} skies are kept in {results.path}"
                console.print(
                    escape(f"stopped: {where}; the same command goes on from there"), soft_wrap=True
                )
            raise
    if workers.resumed:
        console.print(f"{workers.resumed} of {workers.done} were there from a run before")
    status = _tell(assessment, options, console)
    results.finished()
    return status


def _inputs(options: BudgetOptions) -> tuple[Subject, Scenario | None]:
    require_json_path(options.json_path)
    if options.html is not None:
        from .page import require_page_path

        require_page_path(options.html)
    if options.plot is not None:
        from ..campaigns.plotting import require_plot_path

        require_plot_path(options.plot)
    if options.dask is not None and options.workers is not None:
        raise ConfigurationError("--workers: with --dask the cluster decides how many there are")
    if options.results is not None and options.restart:
        raise ConfigurationError("--restart: with --results delete the file, or give another")
    profile = load_unit(options.unit)
    scenario = None if options.scenario is None else load_scenario(options.scenario)
    check_inputs(profile, scenario or Scenario())
    subject = subject_of(
        profile,
        parameters=None if scenario is None else parameters_of(scenario),
        clock_hz=options.clock_hz,
        cache_kib=options.cache_kib,
        line_fill=options.line_fill,
    )
    return subject, scenario


def _tell(assessment: Assessment, options: BudgetOptions, console: Console) -> int:
    from . import report, terminal  # what prints is not needed by the workers

    terminal.show(console, assessment)
    command = options.command()
    if options.plot is not None:
        from .drawing import write_plot

        write_plot(options.plot, assessment)
    if options.html is not None:
        from .page import write_page

        write_page(options.html, assessment, command)
    write_json(options.json_path, report.figures(assessment, command), report.checks(assessment))
    return FITS if report.fits(assessment) else DOES_NOT_FIT


def _results(options: BudgetOptions, order: Order) -> ResultsFile:
    """The file that the user named, else one of the user's state folder."""
    identity: dict[str, object] = {
        "campaign": "budget",
        "unit": order.subject.profile.model_dump_json(),
        "parameters": [list(item) for item in order.subject.changed],
        "scenario": None if order.scenario is None else order.scenario.model_dump_json(),
        "n": order.n,
        "seed": order.seed,
        "evaluations": order.evaluations,
        "program": program_fingerprint(),
    }
    if options.results is not None:
        if options.results.is_dir():
            raise ConfigurationError(f"--results {options.results}: is a folder")
        if not options.results.absolute().parent.is_dir():
            raise ConfigurationError(f"--results {options.results}: there is no such folder")
        return ResultsFile(options.results, identity, named=True)
    name = f"budget-{order.subject.profile.name}-{identity_hash(identity)}.jsonl"
    return ResultsFile(state_folder() / "campaigns" / name, identity, named=False, fresh=options.restart)


def _rerun(subject: Subject, scenario: Scenario | None, path: Path, console: Console) -> int:
    """Run the worst frames of a report again; DOES_NOT_FIT where their cycles are not those of the report."""
    same = True
    for case in _kept_cases(path):
        inputs = case["inputs"]
        changed = tuple(sorted((str(name), value) for name, value in inputs["parameters"].items()))
        own = Subject(subject.profile, changed)
        place = place_from_json(json.dumps(inputs))
        if isinstance(place, Instant) and scenario is None:
            raise ConfigurationError(f"--rerun {path}: is of a scenario: give it with --scenario")
        sample = look(subject.profile, scenario, Look(place, own.changed))
        figure = Costing(own.processor).cost(_counts(sample, case)).frame
        kept = float(case["cycles"]["frame"]["value"])
        same = same and figure.value == kept
        word = "the same" if figure.value == kept else f"the report says {kept:.0f}"
        bounds = f"({figure.low:.0f}..{figure.high:.0f})"
        told = f"{case['mode']}, {case['search']}: {figure.value:.0f} {bounds} cycles: {word}"
        console.print(escape(told), soft_wrap=True)
    return FITS if same else DOES_NOT_FIT


def _counts(sample: SkySample, case: dict[str, Any]) -> Any:
    if case["mode"] == LOST_IN_SPACE:
        flown = case["search"] == OBJECTIVES[0].search
        return sample.lost.counts if flown else sample.lost.whole_counts
    return sample.tracked[int(case["inputs"]["frame"]) - 1].counts


def _kept_cases(path: Path) -> list[dict[str, Any]]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        cases = document["worst_cases"]
        for case in cases:
            place_from_json(json.dumps(case["inputs"]))
            float(case["cycles"]["frame"]["value"])
            dict(case["inputs"]["parameters"])
            if not 0 <= int(case["inputs"]["frame"]) <= TRACKED:
                raise ValueError("no such frame")
            str(case["mode"]), str(case["search"])
    except OSError as error:
        raise ConfigurationError(f"--rerun {path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigurationError(f"--rerun {path}: is no report of `st-emulator budget --json`") from error
    return list(cases)


__all__ = ["BudgetOptions", "run_budget"]
