"""What the plugin costs: a run that does not use it next to nothing, a minute of STANDBY a few steps."""

from __future__ import annotations

from .conftest import Project

NOT_LOADED = """
import sys
def test_nothing_is_loaded_until_a_unit_is_asked_for():
    assert "st_emulator.pytest_plugin" in sys.modules
    ours = {name for name in sys.modules if name.startswith("st_emulator")}
    assert ours == {"st_emulator", "st_emulator.pytest_plugin"}
    assert not {"numpy", "numba", "pydantic", "can", "serial"} & set(sys.modules)
"""
MINUTE = """
def test_a_minute(star_tracker, bench):
    star_tracker.boot()
    before = bench.clock.events
    star_tracker.run(60)
    assert bench.clock.events - before < 20 * 60, "a few steps a second, whatever the computer does"
    assert star_tracker.emulator.device.frame_counters.frames_processed == 0
    assert star_tracker.emulator.now_ns == bench.clock.now_ns

def test_time_is_never_slept(star_tracker, obc, bench, monkeypatch):
    import time
    def never(*arguments):
        raise AssertionError("virtual time waits for nothing")
    for name in ("sleep", "monotonic_ns", "time", "monotonic"):
        monkeypatch.setattr(time, name, never)
    obc.wait(3600)
    bench.never(lambda: star_tracker.mode != "STANDBY", for_s=60)
    monkeypatch.undo()
"""


def test_a_run_without_units_loads_nothing(project: Project) -> None:
    project.write("test_it.py", NOT_LOADED)
    run = project.run("-q")
    assert run.status == 0, run.text


def test_a_minute_of_standby_is_a_few_steps(project: Project) -> None:
    project.write("test_it.py", MINUTE)
    run = project.run("-q", "-n0")
    assert run.status == 0, run.text
