"""The unit of the multi-poles paper: the figures that follow from its file, and what tau_pre does."""

from __future__ import annotations

import numpy as np
import pytest

from st_emulator.device.calibration import firmware_configuration
from st_emulator.device.parameters import default_parameters
from st_emulator.firmware_model.identification import multi_poles
from st_emulator.firmware_model.image.detection import detect
from st_emulator.units.profile import load_unit, parse_unit, unit_text

UNIT = load_unit("aps_rs")
EXPOSURE_S = UNIT.timing.exposure_ms / 1000
BACKGROUND_ELECTRONS = (UNIT.detector.stray_electrons_s + UNIT.detector.dark_electrons_s) * EXPOSURE_S


def test_the_papers_figures() -> None:
    assert UNIT.electrons_per_s_mag0 == pytest.approx(7.3e6, rel=1e-5)  # G0
    assert UNIT.field_deg == pytest.approx((20.0, 20.0), abs=0.15)
    assert UNIT.frame_period_ns == 200_000_000
    assert UNIT.timing.exposure_ms == UNIT.timing.frame_period_ms  # no gap
    assert pytest.approx(6000.0) == UNIT.detector.stray_electrons_s * EXPOSURE_S
    assert pytest.approx(100.0) == UNIT.detector.dark_electrons_s * EXPOSURE_S
    assert pytest.approx(5.0) == UNIT.detector.dark_nonuniformity * 100.0
    configuration = firmware_configuration(UNIT, default_parameters(UNIT))
    assert configuration.identify is multi_poles.identify
    assert configuration.identification.tolerance_rad == pytest.approx(np.radians(100 / 3600))
    assert configuration.identification.multi_poles.least_recognised == 5  # t*
    assert configuration.detection.tau_min_dn * UNIT.detector.electrons_per_dn == pytest.approx(500.0)


def image(
    rng: np.random.Generator, blocks: list[tuple[int, int, float]], noise_electrons: float
) -> np.ndarray:
    """Background and noise with blocks of 2 x 2 px so many electrons over it."""
    electrons = rng.normal(BACKGROUND_ELECTRONS, noise_electrons, (256, 256))
    for x, y, over in blocks:
        electrons[y : y + 2, x : x + 2] = BACKGROUND_ELECTRONS + over
    return np.clip(
        np.rint(electrons / UNIT.detector.electrons_per_dn + UNIT.detector.offset_dn), 0, 4095
    ).astype(np.uint16)


def found(text: str, noise_electrons: float, over: float) -> int:
    """How many of sixteen blocks are found."""
    profile = parse_unit(text, "test")
    parameters = firmware_configuration(profile, default_parameters(profile)).detection
    blocks = [(20 + 60 * i, 20 + 60 * j, over) for i in range(4) for j in range(4)]
    spots, _ = detect(image(np.random.default_rng(1), blocks, noise_electrons), parameters)
    near = [
        any(abs(x - bx - 0.5) < 2 and abs(y - by - 0.5) < 2 for bx, by, _ in blocks)
        for x, y in zip(spots.x_px, spots.y_px, strict=True)
    ]
    assert all(near)
    return len(near)


def test_pixels_over_tau_pre_are_kept_and_noise_rules_where_it_is_more() -> None:
    text = unit_text("aps_rs")[1].replace("magnitude_limit = 6.5", "magnitude_limit = 9.0")
    without = text.replace("tau_pre_electrons = 500.0", "tau_pre_electrons = 0.0")
    quiet = 30.0  # electrons: five times it is well below tau_pre
    assert (found(text, quiet, 420.0), found(text, quiet, 580.0)) == (0, 16)
    assert (found(without, quiet, 420.0), found(without, quiet, 580.0)) == (16, 16)
    loud = 200.0
    assert (found(text, loud, 580.0), found(text, loud, 1500.0)) == (0, 16)


def test_a_frame_without_stars_has_next_to_no_spots() -> None:
    rng = np.random.default_rng(2)
    detector = UNIT.detector
    parameters = firmware_configuration(UNIT, default_parameters(UNIT)).detection
    spots = 0
    for _ in range(10):
        electrons = rng.poisson(detector.stray_electrons_s * EXPOSURE_S, (1024, 1024))
        electrons = electrons + rng.normal(100.0, 5.0, (1024, 1024)) + rng.normal(0.0, 50.0, (1024, 1024))
        dn = np.rint(electrons / detector.electrons_per_dn + detector.offset_dn)
        spots += len(detect(dn.astype(np.uint16), parameters)[0])
    assert spots == 0
