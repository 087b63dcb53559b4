"""The pytest plugin: a star tracker as a fixture. Installed with the package; ``docs/testing_your_obc.md``
shows how to use it.

Every pytest run of an environment loads this module, so it imports nothing of st-emulator's until a test asks
for a unit.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from .obc import Obc
    from .testing.bench import Bench
    from .testing.settings import UnitSettings
    from .testing.star_tracker import StarTracker, UnitFaults

OPTIONS = {
    "unit": ("NAME", "The unit under test: shipped (`st-emulator units`) or a unit file. Default: roja1."),
    "dialect": ("NAME", "Its language, as --dialect of `st-emulator run`. Default: the unit file's."),
    "link": (
        "LINK",
        "Where the unit is. In this process, in virtual time: memory (the default; a serial line), "
        "memory:can, memory:can,fd. Started for each test, in real time: pty, pty:PATH, "
        "can:socketcan/vcan0[,fd]. There already, as hardware is: serial:/dev/ttyUSB0[@BAUD], "
        "can:socketcan/can0[@BITRATE][,fd], can:slcan/dev/ttyACM0.",
    ),
    "speed": (
        "virtual|N",
        "virtual (the default): as fast as the computer can; N: at most N times real time. Links other than "
        "memory keep real time.",
    ),
    "node": ("N", "Its node number on a CAN bus. Default: a free one if it is started, else its file's."),
    "journal": (
        "DIR",
        "Keep the journals of all tests here (`st-emulator replay FILE` runs one again). Default: in "
        "pytest's temporary folder, named when a test fails.",
    ),
}  # fmt: skip
MARKERS = (
    "st_scenario(file, **keys): the world of the test's unit: a scenario file, beside the test's or from the "
    'root folder, and/or keys of one: st_scenario("slew.toml", seed=3), '
    'st_scenario(parameters={"exposure_us": 50000}). A marker nearer to the test adds to and replaces what '
    "others say. Left out on hardware.",
    "st_fault(kind, **settings): a fault of the test's unit from power-on, or by its start_s, end_s or "
    'duration_s; several may stand: st_fault("bits_flipped", probability=1e-4, duration_s=5). `st-emulator '
    "faults` lists kinds and settings. Left out on hardware.",
    "st_unit(name, dialect=None, node=None): the unit of the test, whatever --st-unit says.",
    "st_link(link): the link that the test needs, as --st-link takes it, or any of a kind: can, serial. "
    "Hardware of that kind will do; on other hardware the test is left out.",
    "st_speed(speed): virtual, or at most so many times real time, whatever --st-speed says.",
    "st_off: power has not come on when the test begins; star_tracker.power_on() lets it.",
)
FIXTURES = ("bench", "star_tracker", "obc", "truth", "faults")
NEEDS = {"truth": "a truth", "faults": "a fault"}
BENCH = pytest.StashKey["Bench"]()


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("st-emulator", "star tracker under test (st-emulator)")
    for name, (metavar, text) in OPTIONS.items():
        group.addoption(f"--st-{name}", metavar=metavar, default=None, help=text)
        parser.addini(f"st_{name}", f"As --st-{name}, which goes before it.", default="")
    group.addoption(
        "--st-present",
        action="store_true",
        help="The unit is there already, on a link on which one would be started: nothing is started, and "
        "tests that need a truth, a fault or a scenario are left out, as on hardware.",
    )


def pytest_configure(config: pytest.Config) -> None:
    for line in MARKERS:
        config.addinivalue_line("markers", line)
    if not hasattr(config, "workerinput") and any(_given(config, name) for name in OPTIONS):
        from .errors import ConfigurationError

        try:
            _check(config)
        except ConfigurationError as error:
            raise pytest.UsageError(str(error)) from error


def _given(config: pytest.Config, name: str) -> str:
    """The option, else the ini file's value, else nothing."""
    return str(config.getoption(f"st_{name}") or config.getini(f"st_{name}") or "")


def _check(config: pytest.Config) -> None:
    """That what was given once for all tests makes sense."""
    from .testing.settings import node_number, parse_bench_link, parse_bench_speed

    link = parse_bench_link(_given(config, "link") or "memory", config.getoption("st_present"))
    parse_bench_speed(_given(config, "speed"), link)
    node_number(_given(config, "node"))
    if unit := _given(config, "unit"):
        from .units.profile import load_unit

        load_unit(unit)


# -- what a test gets


def settings_of(item: pytest.Item) -> UnitSettings:
    """What a test's unit is, by its markers, the options and the ini file, in this order."""
    from .testing.settings import (
        DEFAULT_UNIT,
        UnitSettings,
        marked_link,
        node_number,
        parse_bench_link,
        parse_bench_speed,
        scenario_file,
    )

    config = item.config
    present = config.getoption("st_present")
    link = parse_bench_link(_given(config, "link") or "memory", present)
    speed: str = _given(config, "speed")
    if (marker := item.get_closest_marker("st_link")) is not None and link.place != "there":
        link = marked_link(str(marker.args[0]), link, present)
        speed = speed if link.place == "memory" else ""
    if (marker := item.get_closest_marker("st_speed")) is not None and link.place != "there":
        speed = str(marker.args[0])
    unit, dialect, node = _given(config, "unit"), _given(config, "dialect") or None, _given(config, "node")
    if (marker := item.get_closest_marker("st_unit")) is not None:
        unit = str(marker.args[0]) if marker.args else unit
        dialect = marker.kwargs.get("dialect", dialect)
        node = marker.kwargs.get("node", node)
    scenario: dict[str, Any] | None = None
    where = "st_scenario"
    for marker in reversed(list(item.iter_markers("st_scenario"))):
        scenario = scenario or {}
        for name in marker.args:
            path = next((path for path in _beside(item, name) if path.exists()), Path(name))
            scenario |= scenario_file(path)
            where = str(path)
        scenario |= marker.kwargs
    faults = tuple(
        ({"kind": marker.args[0]} if marker.args else {}) | dict(marker.kwargs)
        for marker in reversed(list(item.iter_markers("st_fault")))
    )
    return UnitSettings(
        link=link,
        unit=unit or DEFAULT_UNIT,
        dialect=dialect,
        speed=parse_bench_speed(speed, link),
        node=node_number(node),
        scenario=scenario,
        scenario_where=where,
        faults=faults,
        off=item.get_closest_marker("st_off") is not None,
    )


def _beside(item: pytest.Item, name: str) -> Iterator[Path]:
    yield item.path.parent / name
    yield item.config.rootpath / name


def missing_of(item: pytest.Item, settings: UnitSettings) -> str | None:
    """What a test needs that a unit which is there already has not; None: nothing."""
    if settings.link.place != "there":
        return None
    names = getattr(item, "fixturenames", ())
    for name, need in NEEDS.items():
        if name in names:
            return need
    for name, need in (("st_fault", "a fault"), ("st_scenario", "a scenario"), ("st_off", "a power switch")):
        if item.get_closest_marker(name) is not None:
            return need
    if (marker := item.get_closest_marker("st_link")) is not None:
        from .testing.settings import lacking

        if (missing := lacking(str(marker.args[0]), settings.link)) is not None:
            return missing
    if (marker := item.get_closest_marker("st_speed")) is not None and str(marker.args[0]) != "1":
        return "virtual time"
    return None


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    if not set(FIXTURES) & set(getattr(item, "fixturenames", ())) or _overridden(item):
        return
    from .errors import ConfigurationError
    from .testing.errors import leave_out

    try:
        need = missing_of(item, settings_of(item))
    except ConfigurationError as error:
        pytest.fail(str(error), pytrace=False)
    if need is not None:
        leave_out(need)


def _overridden(item: pytest.Item) -> bool:
    """Whether a project's own fixture of the same name stands in place of ours, which then has no say."""
    definitions = getattr(item, "_fixtureinfo", None)
    if definitions is None:
        return True
    found = [
        definitions.name2fixturedefs[name][-1] for name in FIXTURES if name in definitions.name2fixturedefs
    ]
    return not any(definition.func.__module__ == __name__ for definition in found)


@pytest.fixture
def bench(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """The test's bench: units (`bench.unit("roja1", ...)`), their time (`bench.run(2.5)`), expectations:
    `bench.within(3, condition)`, `bench.until(condition, limit_s=60)`, `bench.never(condition, for_s=10)`.
    """
    from .testing.bench import Bench

    item = request.node
    given = _given(request.config, "journal")
    folder = Path(given).absolute() if given else tmp_path_factory.getbasetemp() / "star_trackers"
    stem = re.sub(r"[^\w.-]+", "-", item.nodeid).strip("-")[-150:]

    def journal_path(number: int, name: str) -> Path:
        return folder / f"{stem}{'' if number == 1 else f'-{number}-{name}'}.journal.jsonl"

    made = Bench(settings_of(item), journal_path)
    item.stash[BENCH] = made
    yield made
    made.close()


@pytest.fixture
def star_tracker(request: pytest.FixtureRequest, bench: Bench) -> StarTracker:
    """The unit under test, power on: `.mode`, `.truth()`, `.faults`, `.run(s)`, `.power_off()`,
    `.power_on()`; `.link`, `.device` and `.node` say where an OBC of your own finds it, `.line` is the line's
    other end for octets of yours.
    """
    from .units.profile import load_unit

    settings = bench.settings
    unit = bench.put(load_unit(settings.unit), settings)
    if "obc" in request.fixturenames:
        _ = unit.obc  # it is there before power comes on, so that it misses nothing
    if not settings.off and settings.link.place != "there":
        unit.power_on()
    return unit


@pytest.fixture
def obc(star_tracker: StarTracker, bench: Bench) -> Obc:
    """Our OBC (`st_emulator.obc.Obc`) joined to the unit under test, which has booted; on its clock, so that
    waiting costs no time where the unit's is virtual. On hardware the unit is reset.
    """
    joined = star_tracker.obc
    if not bench.settings.off:
        star_tracker.boot()
    return joined


@pytest.fixture
def truth(star_tracker: StarTracker) -> Any:
    """`truth()`: what is true of the unit under test now; `truth(frame_index)`: at a frame. As
    `star_tracker.truth`, and says by its name that the test needs one: on hardware it is left out.
    """
    return star_tracker.truth


@pytest.fixture
def faults(star_tracker: StarTracker) -> UnitFaults:
    """Faults of the unit under test, live: `faults.inject("silence", duration_s=2)`, `.active()`, `.clear()`.
    As `star_tracker.faults`; on hardware the test is left out.
    """
    return star_tracker.faults


def pytest_unconfigure() -> None:
    if (spawned := sys.modules.get(f"{__package__}.testing.spawned_unit")) is not None:
        spawned.close_server()


# -- what is told


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    report: pytest.TestReport = yield  # type: ignore[assignment]
    made = item.stash.get(BENCH, None)
    if report.failed and made is not None and report.when != "teardown":
        from .testing.failure import failure_text

        for unit in made.units:
            report.sections.append((f"star tracker {unit.name}", failure_text(unit)))
    return report  # type: ignore[return-value]


def pytest_terminal_summary(terminalreporter: Any) -> None:
    counts = left_out_counts(terminalreporter.stats.get("skipped", ()))
    if counts:
        terminalreporter.write_line(left_out_text(counts), yellow=True)


def left_out_counts(reports: Any) -> dict[str, int]:
    """How many tests were left out, by what they need."""
    counts: dict[str, int] = {}
    for report in reports:
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else ""
        match = re.match(r"(?:Skipped: )?left out: needs (.+)", reason)
        if match:
            counts[match.group(1)] = counts.get(match.group(1), 0) + 1
    return counts


def left_out_text(counts: dict[str, int]) -> str:
    """`3 tests left out: need a truth`; of several reasons each with its count."""
    number = sum(counts.values())
    need = "needs" if number == 1 else "need"
    if len(counts) == 1:
        what = f"{need} {next(iter(counts))}"
    else:
        what = f"{need} " + ", ".join(f"{name} ({count})" for name, count in sorted(counts.items()))
    return f"{number} {'test' if number == 1 else 'tests'} left out: {what}"
