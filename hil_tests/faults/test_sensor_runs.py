"""Runs of a unit with faults of sensor and processor: replay, live, what is left, the truth, at random."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rich.console import Console

from hil_tests.faults.settings_at_random import settings_at_random
from hil_tests.faults.truth import against_truth
from hil_tests.unit.conftest import MODE, MS, make
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import Scenario
from st_emulator.commands.replaying import replay_journal
from st_emulator.errors import ConfigurationError
from st_emulator.faults.catalogue import FAULTS
from st_emulator.faults.fault import Exposure
from st_emulator.faults.faults import settings_of
from st_emulator.units.profile import load_unit

KINDS = [name for name in FAULTS if name.startswith(("sensor.", "processor."))]
AUTONOMOUS = {"autonomous_start": 1}


def run_of(kind: str, seed: int = 3, **table: Any) -> tuple[bytes, str]:
    """(what the unit sent, its journal) of a run with the fault from its scenario, and once more live."""
    journal, sent = io.StringIO(), bytearray()
    fault = settings_of({"kind": kind, "start_s": 1.5, "duration_s": 0.8, "probability": 0.7} | table, "test")
    scenario = Scenario(seed=seed, parameters=AUTONOMOUS, faults=[fault])
    emulator = Emulator(
        load_unit("roja1"), scenario, transmit=lambda data, t_ns: sent.extend(data), journal=journal
    )
    emulator.advance(2700 * MS)
    number = emulator.faults.inject({"kind": kind} | table)
    emulator.advance(3300 * MS)
    emulator.faults.clear(number)
    assert not emulator.faults.active()
    emulator.advance(4000 * MS)
    emulator.close()
    return bytes(sent), journal.getvalue()


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_with_it_is_replayed(kind: str, tmp_path: Path) -> None:
    sent, journal = run_of(kind)
    path = tmp_path / "run.jsonl"
    path.write_text(journal, encoding="utf-8")
    assert replay_journal(path, None, None, Console(file=io.StringIO())) == 0
    assert (sent, journal) == run_of(kind), "and a second run is the same"
    assert f"fault 0 {kind} begins" in journal
    assert f"fault 1 {kind} begins" in journal


def test_another_seed_is_another_run() -> None:
    assert (
        run_of("sensor.proton_streaks", rate_per_cm2_s=9000)[0]
        != (run_of("sensor.proton_streaks", rate_per_cm2_s=9000, seed=4)[0])
    )


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_left_of_it(kind: str) -> None:
    """Frames and processor pass as they are when it is over."""
    bench = make("roja1", scenario=Scenario(parameters=AUTONOMOUS))
    bench.run_to(1200)
    settings_before = bench.emulator.device.frame_settings()
    number = bench.emulator.faults.inject({"kind": kind, "duration_s": 1})
    bench.run(1900)
    assert not bench.emulator.faults.active()
    scene = bench.emulator.scene
    assert scene is not None
    frame = scene.frame(99, 0, 100 * MS)
    assert bench.emulator._seams.sensor(frame, Exposure(99, 0, 100 * MS)) is frame
    after = bench.emulator.device.frame_settings().processor
    assert (after.clock_hz, after.cache_kib, after.slow_stages) == (
        settings_before.processor.clock_hz, settings_before.processor.cache_kib, {},
    )  # fmt: skip
    bench.emulator.faults.clear(number)


def test_live_and_cleared() -> None:
    bench = make("roja1", scenario=Scenario(parameters=AUTONOMOUS))
    bench.run_to(2000)
    number = bench.emulator.faults.inject({"kind": "sensor.blinding"})
    bench.run(1500)
    assert bench.emulator.device.mode == MODE["LOST_IN_SPACE"]
    (blinded,) = bench.events("SENSOR_BLINDED")
    assert blinded["background_dn"] > 400
    bench.emulator.faults.clear(number)
    bench.run(800)
    assert bench.emulator.device.mode == MODE["TRACKING"]


@pytest.mark.parametrize("unit", ["roja1", "zy3", "aps_rs"])
@settings(max_examples=10, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_settings_at_random_break_nothing(unit: str, data: st.DataObject) -> None:
    """Several at once, from before the first frame; every refusal names what is allowed."""
    bench = make(unit, scenario=Scenario(parameters=AUTONOMOUS))
    bench.run(bench.emulator.profile.timing.boot_ms - 1)
    for kind in data.draw(st.lists(st.sampled_from(KINDS), min_size=1, max_size=3)):
        try:
            bench.emulator.faults.inject(data.draw(settings_at_random(kind)))
        except ConfigurationError as error:
            if "allowed" not in str(error):
                raise
    bench.run(700)
    assert all(0 <= one["valid"] <= 1 for one in bench.of("attitude_report"))


#: Those under which a unit goes on to give attitudes; how far off the worst valid one may be, arcsec across
#: the boresight. Without a fault it is 0.4 where the unit stands still.
RIGHT = [
    ({"kind": "sensor.false_stars"}, 1.0),
    ({"kind": "sensor.hot_pixels"}, 1.0),
    ({"kind": "sensor.dead_rows"}, 1.0),
    ({"kind": "sensor.dead_columns"}, 1.0),
    ({"kind": "sensor.no_frames", "probability": 0.4}, 1.0),
    ({"kind": "sensor.torn_frame"}, 1.0),
    ({"kind": "sensor.bright_object", "rate_deg_s": 0.5}, 1.0),
    ({"kind": "sensor.dust"}, 1.0),
    ({"kind": "sensor.defocus"}, 3.0),
    ({"kind": "sensor.gain_drift", "factor_per_s": 0.97}, 1.0),
    ({"kind": "sensor.proton_streaks", "rate_per_cm2_s": 5000}, 1.0),
]


@pytest.mark.parametrize(("fault", "limit_arcsec"), RIGHT, ids=lambda one: str(one))
def test_a_valid_attitude_is_right(fault: dict[str, Any], limit_arcsec: float) -> None:
    found = against_truth(fault, 40)
    assert found.valid >= 20
    assert found.in_lost_in_space >= 2
    assert found.worst_arcsec < limit_arcsec
    # roll is as much worse as the field is narrow
    assert max(found.about_arcsec) < 40 * limit_arcsec


def test_a_torn_frame_of_a_turning_unit_is_a_frame_period_old_at_most() -> None:
    """What no unit can see of itself: stars of the frame before alone make a valid attitude."""
    rate_deg_s = (0.15, 0.1, 0.0)
    turning = {
        "kind": "constant_rate", "ra_deg": 100, "dec_deg": 20, "roll_deg": 0, "rate_deg_s": rate_deg_s
    }  # fmt: skip
    found = against_truth({"kind": "sensor.torn_frame", "row": 40}, 40, trajectory=turning)
    a_period_arcsec = (0.15**2 + 0.1**2) ** 0.5 * 0.25 * 3600
    assert found.worst_arcsec == pytest.approx(a_period_arcsec, abs=10)
    assert sum(error > 100 for error in found.across_arcsec) > 10
