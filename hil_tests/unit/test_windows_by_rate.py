"""[tracking] windows_by_rate: smaller windows where the last rate puts the stars, which are found in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil_tests.arm.conftest import require_compiler
from st_emulator.bench.frame_context import synchronised_context
from st_emulator.bench.star_tables import star_tables
from st_emulator.campaigns.bench import Chain
from st_emulator.errors import ConfigurationError
from st_emulator.firmware_model.attitude import angular_rate
from st_emulator.firmware_model.firmware import FrameResult, process_frame
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.modes import Mode
from st_emulator.firmware_model.tracking import ahead_by_rate
from st_emulator.units.profile import UnitProfile, parse_unit, unit_text
from st_emulator.world.trajectory import constant_rate
from tools.arm_timing.machine import ArmMachine
from tools.calibration.compiler import shared_build
from tools.calibration.registry import steps_by_name

RATE_DEG_S = (0.5, -0.4, 0.3)
FRAMES = 10


def unit(name: str, asked_for: bool) -> UnitProfile:
    text = unit_text(name)[1].replace(
        "[tracking]\n", f"[tracking]\nwindows_by_rate = {str(asked_for).lower()}\n"
    )
    return parse_unit(text, "unit.toml")


def tracked(name: str, asked_for: bool) -> tuple[list[FrameResult], list[StepRecord]]:
    """What tracking gives at a constant rate, and the records of its plans."""
    chain = Chain.of(unit(name, asked_for), 1)
    chain.look(constant_rate(ra_deg=83.0, dec_deg=-3.0, rate_deg_s=RATE_DEG_S))
    results: list[FrameResult] = []
    plans: list[StepRecord] = []
    for index in range(FRAMES):
        frame = chain.expose(index)
        context = synchronised_context(frame, index, chain.acquisition, chain.scene.start_tai_ns)
        records: list[StepRecord] = []
        result = process_frame(
            frame, context, chain.state, chain.configuration, star_tables(chain.profile), records.append
        )
        if context.acquisition is Mode.TRACKING:
            results.append(result)
            plans += [record for record in records if record.step == "plan"]
        chain.state, chain.acquisition = result.state, result.acquisition_after
    return results, plans


def area_px(result: FrameResult) -> int:
    sides = result.rects[:, 2:] - result.rects[:, :2]
    return int((sides[:, 0] * sides[:, 1]).sum())


@pytest.mark.parametrize("name", ["aps_rs", "iris"])
def test_windows_shrink_and_the_stars_are_found(name: str) -> None:
    wide, _ = tracked(name, False)
    narrow, plans = tracked(name, True)
    assert len(narrow) == len(wide) >= FRAMES - 3
    assert all(result.valid for result in (*wide, *narrow))
    # the first attitude of all may have no rate yet
    for a, b in zip(wide[2:], narrow[2:], strict=True):
        assert b.window_half_width_px < a.window_half_width_px
        assert area_px(b) < 0.8 * area_px(a)
        assert b.work["window_pixels"] < a.work["window_pixels"]
        assert len(b.stars) >= len(a.stars) - 1
    require_compiler()
    machine = ArmMachine(shared_build().elf)
    for record in plans[2:4]:
        steps_by_name()["plan"].run(machine, record)  # a mismatch is an error


def test_the_attitude_ahead_is_turned_by_the_rate() -> None:
    chain = Chain.of(unit("aps_rs", True), 1)
    parameters, geometry = chain.configuration.tracking, chain.configuration.geometry
    q = np.array([0.1, -0.5, 0.3, 0.8])
    q /= np.linalg.norm(q)
    rate = np.radians(RATE_DEG_S)
    ahead, shrunk = ahead_by_rate(q, rate, 1e-10 * np.eye(3), parameters, geometry, 0.2, 0.2, 0.2)
    np.testing.assert_allclose(angular_rate(q, ahead, 0.2), rate, atol=1e-12)
    assert shrunk.rate_rad_s < 0.5 * parameters.rate_rad_s
    # a rate that nobody knows makes no window smaller
    unsure, same = ahead_by_rate(q, rate, 1e-3 * np.eye(3), parameters, geometry, 0.2, 0.2, 0.2)
    assert same is parameters
    assert unsure is q
    assert not replace(parameters, windows_by_rate=False).windows_by_rate


def test_a_unit_that_measures_no_rate_is_told() -> None:
    with pytest.raises(ConfigurationError, match=r"unit\.toml: .*windows_by_rate.*\[rate\]"):
        unit("roja1", True)


@pytest.mark.parametrize("value", ['"no"', "0", '"false"'])
def test_a_switch_is_true_or_false(value: str) -> None:
    text = unit_text("aps_rs")[1].replace("max_windows =", f"windows_by_rate = {value}\nmax_windows =")
    with pytest.raises(ConfigurationError, match=r"tracking\.windows_by_rate: found .*; allowed is true or"):
        parse_unit(text, "unit.toml")
