"""Options, ini file and markers: which unit a test gets; wrong ones are told in a line."""

from __future__ import annotations

import pytest

from .conftest import Project

GETS = """
import pytest

def test_by_option(star_tracker, obc):
    assert (star_tracker.name, star_tracker.link) == ("zy3", "memory:can")
    assert (star_tracker.node, star_tracker.on_can) == (5, True)
    assert obc.ping() < 0.1

@pytest.mark.st_unit("roja1")
@pytest.mark.st_link("memory")
def test_by_marker(star_tracker):
    assert (star_tracker.name, star_tracker.link) == ("roja1", "memory")

@pytest.mark.st_link("serial")
def test_any_of_a_kind(star_tracker):
    assert not star_tracker.on_can
"""
SCENARIOS = """
import pytest
pytestmark = pytest.mark.st_scenario("base.toml", seed=5)

@pytest.mark.st_scenario(parameters={"exposure_us": 50000})
def test_file_and_keys(star_tracker, obc):
    scenario = star_tracker.emulator.scenario
    assert (scenario.name, scenario.seed) == ("base", 5)
    assert obc.parameters(["exposure_us"]) == {"exposure_us": 50000}

@pytest.mark.st_fault("line.frames_lost", duration_s=2, start_s=1)
@pytest.mark.st_fault("line.bits_flipped", probability=0.5)
def test_faults_from_power_on(star_tracker, bench):
    assert [fault["kind"] for fault in star_tracker.faults.active()] == ["line.bits_flipped"]
    bench.until(lambda: len(star_tracker.faults.active()) == 2)
    assert bench.now_s == 1
    star_tracker.faults.clear()
    assert star_tracker.faults.active() == []
    number = star_tracker.faults.inject("line.frames_lost", direction="to_unit")
    assert star_tracker.faults.active()[0]["number"] == number == 2

@pytest.mark.st_off
def test_power_comes_when_it_is_told_to(star_tracker, obc, bench):
    bench.never(lambda: obc.telemetry_since(0), for_s=5)
    assert star_tracker.mode == "OFF"
    star_tracker.power_on()
    bench.within(1, lambda: obc.events())
    assert [event.name for event in obc.events()] == ["BOOT_COMPLETED"]
"""
SAGITTA = """
def test_octets(star_tracker, bench):
    line = star_tracker.line
    star_tracker.boot()
    line.read()
    line.write(bytes.fromhex("c0"))
    star_tracker.run(1)

def test_no_obc_for_it(obc):
    pass
"""


def test_markers_go_before_options_and_options_before_the_ini_file(project: Project) -> None:
    project.write("test_it.py", GETS)
    ini = "addopts = --import-mode=importlib\nst_unit = nosuch\nst_link = memory:can\nst_node = 5\n"
    project.write("pytest.ini", f"[pytest]\n{ini}")
    run = project.run("-q", "--st-unit", "zy3")
    assert run.status == 0, run.text


def test_scenarios_faults_and_power(project: Project) -> None:
    project.write("base.toml", 'schema = 1\nname = "base"\nseed = 2\n')
    project.write("test_it.py", SCENARIOS)
    run = project.run("-q")
    assert run.status == 0, run.text


def test_another_language(project: Project) -> None:
    project.write("test_it.py", SAGITTA)
    run = project.run("-q", "--st-dialect", "sagitta")
    assert "1 passed, 1 error" in run.last
    assert "speaks sagitta: the OBC simulator speaks pus alone" in run.text


WRONG_MARKERS = {
    'st_scenario("nosuch.toml")': "nosuch.toml: cannot be read",
    "st_scenario(sed=3)": "st_scenario: sed: is not a known key; allowed are",
    'st_fault("nosuch")': "found 'nosuch'; allowed are",
    'st_link("usb")': "--st-link usb: link 'usb': unknown kind of link; allowed are",
    'st_speed("fast")': "--st-speed fast: allowed are virtual, or a number",
    'st_unit("nosuch")': "no unit 'nosuch': shipped are",
    "st_unit(node=200)": "--st-node 200: allowed is a whole number from 1 to 127",
}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--st-unit", "nosuch"], "no unit 'nosuch': shipped are"),
        (["--st-link", "none"], "--st-link none: has no other end; allowed are memory"),
        (["--st-speed", "3", "--st-link", "pty"], "a unit on pty keeps real time; allowed is 1"),
    ],
)
def test_wrong_options_are_told_in_a_line(project: Project, arguments: list[str], said: str) -> None:
    project.write("test_it.py", "def test_it():\n    pass\n")
    run = project.run("-q", *arguments)
    assert run.status == pytest.ExitCode.USAGE_ERROR
    assert said in run.text
    assert "Traceback" not in run.text


def test_wrong_markers_are_told(project: Project) -> None:
    tests = [
        f"@pytest.mark.{marker}\ndef test_{number}(star_tracker):\n    pass\n"
        for number, marker in enumerate(WRONG_MARKERS)
    ]
    project.write("test_it.py", "import pytest\n" + "".join(tests))
    run = project.run("-q")
    assert run.status == 1
    for said in WRONG_MARKERS.values():
        assert said in run.text


def test_help_and_markers_teach(project: Project) -> None:
    text = project.run("--help").text
    for option in ("unit", "dialect", "link", "speed", "node", "journal", "present"):
        assert f"--st-{option}" in text
    text = project.run("--markers").text
    for marker in ("scenario", "fault", "unit", "link", "speed", "off"):
        assert f"@pytest.mark.st_{marker}" in text
    text = project.run("--fixtures", "-q").text
    for fixture in ("bench", "star_tracker", "obc", "truth", "faults"):
        assert f"\n{fixture} -- " in text


def test_a_projects_own_fixture_stands_in_place_of_ours(project: Project) -> None:
    project.write("test_it.py", "import pytest\n@pytest.fixture\ndef obc():\n    return 7\n"
                  "def test_it(obc):\n    assert obc == 7\n")  # fmt: skip
    run = project.run("-q", "--st-link", "serial:/dev/nosuch")
    assert run.status == 0, run.text
