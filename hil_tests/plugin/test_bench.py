"""Several units on one bench: on lines of their own, together on a bus; the same every time."""

from __future__ import annotations

from .conftest import Project

SEVERAL = """
import pytest

def test_on_lines(bench):
    a, b = bench.unit("roja1"), bench.unit("zy3", scenario={"parameters": {"exposure_us": 100000}})
    a.boot(), b.boot()
    assert a.obc.parameters(["exposure_us"]) == b.obc.parameters(["exposure_us"])
    b.power_off()
    assert (a.mode, b.mode) == ("STANDBY", "OFF")
    with pytest.raises(Exception, match="never came"):
        b.obc.ping()
    a.obc.ping()

def test_on_one_bus(bench):
    units = [bench.unit("roja1", link="memory:can", node=node, obc=True) for node in (1, 2, 3)]
    bench.until(lambda: all(unit.mode == "STANDBY" for unit in units))
    assert all(unit.obc.ping() < 0.1 for unit in units)
    sync = units[0].obc.set_time_by_sync()
    bench.within(1, lambda: all("TIME_SET" in [e.name for e in unit.obc.events()] for unit in units))
    assert {unit.obc.cyclic("heartbeat").values["mode"] for unit in units} == {2}

def test_one_that_comes_later(bench):
    first = bench.unit("roja1", obc=True)
    bench.run(10)
    second = bench.unit("roja1", obc=True)
    bench.within(0.5, lambda: second.mode == "STANDBY")
    first_ms, second_ms = (unit.obc.housekeeping("STATUS")["uptime_ms"] for unit in (first, second))
    assert 9_950 < first_ms - second_ms <= 10_000, "asked one after the other"

def test_a_link_of_another_time(bench):
    with pytest.raises(Exception, match="this bench is in virtual time"):
        bench.unit("roja1", link="pty")

def test_a_truth_of_a_frame_that_never_was(star_tracker):
    with pytest.raises(Exception, match="frame 7: is none that the unit has processed"):
        star_tracker.truth(7)
    assert star_tracker.truth().error_arcsec(star_tracker.truth().q_icrs_to_sensor) == 0
"""
SAME = """
import pytest

@pytest.mark.parametrize("run", [1, 2, pytest.param(3, marks=pytest.mark.st_speed(100))])
def test_it(star_tracker, obc, bench, run):
    assert (bench.clock.speed is None) == (run < 3)
    obc.set_time()
    obc.acquire()
    bench.run(5)
    star_tracker.power_off()
    bench.run(1)
    star_tracker.power_on()
    bench.run(2)
"""


def test_several_units(project: Project) -> None:
    project.write("test_it.py", SEVERAL)
    run = project.run("-q")
    assert run.status == 0, run.text


def test_the_same_test_gives_the_same_octets_at_any_speed(project: Project) -> None:
    project.write("test_it.py", SAME)
    run = project.run("-q", "--st-journal", "journals")
    assert run.status == 0, run.text
    first, second, paced = [path.read_bytes() for path in sorted((project.folder / "journals").iterdir())]
    assert first == second == paced
    assert first.count(b'"tx"') > 20
