"""Faults of the sensor: the same pixels however they are asked for, the physics of each, runs that replay."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil_tests.faults.sensor_bench import (
    KINDS,
    ArrayFrame,
    exposure_of,
    fault_of,
    flat_frame,
    rendered,
)
from hil_tests.faults.settings_at_random import settings_at_random
from st_emulator.errors import ConfigurationError
from st_emulator.faults.catalogue import FAULTS
from st_emulator.units.profile import load_unit

UNITS = ("roja1", "zy3", "aps_rs")
SOME = settings(max_examples=8, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])


def rects_of(data: st.DataObject, width: int, height: int) -> np.ndarray:
    """Windows anywhere, also at the edges and over each other."""
    rects = []
    for _ in range(data.draw(st.integers(1, 5))):
        x0, y0 = data.draw(st.integers(0, width - 1)), data.draw(st.integers(0, height - 1))
        x1 = data.draw(st.integers(x0 + 1, min(width, x0 + 90)))
        y1 = data.draw(st.integers(y0 + 1, min(height, y0 + 90)))
        rects.append((x0, y0, x1, y1))
    return np.array(rects, dtype=np.int32)


def through(tables: list[dict[str, Any]], unit: str, indices: tuple[int, ...]) -> list[Any]:
    """Frames behind faults, one behind the other."""
    faults = [fault_of(table, unit, seed=7 + number) for number, table in enumerate(tables)]
    found = []
    for index in indices:
        frame = rendered(unit, index)
        for fault in faults:
            if frame is not None:
                frame = fault.expose(frame, exposure_of(unit, index))
        found.append(frame)
    return found


def draw_tables(data: st.DataObject, kinds: list[str], unit: str) -> list[dict[str, Any]] | None:
    tables = [data.draw(settings_at_random(kind)) for kind in kinds]
    try:
        for table in tables:
            fault_of(table, unit)
    except (ValueError, ConfigurationError) as error:
        if "allowed" not in str(error):  # what one that the unit cannot have is refused with
            raise
        return None
    return tables


@pytest.mark.parametrize("kind", KINDS)
@SOME
@given(data=st.data())
def test_full_and_windows_are_the_same_numbers(kind: str, data: st.DataObject) -> None:
    unit = data.draw(st.sampled_from(UNITS))
    tables = draw_tables(data, [kind], unit)
    if tables is None:
        return
    for whole, parts in zip(through(tables, unit, (8, 9)), through(tables, unit, (8, 9)), strict=True):
        if whole is None:
            assert parts is None
            continue
        rects = rects_of(data, whole.width_px, whole.height_px)
        flat, offsets = parts.windows(rects)
        image = whole.full()
        assert image.dtype == flat.dtype == np.uint16
        assert image.max() < 2**whole.bits
        assert (whole.width_px, whole.height_px, whole.bits) == (parts.width_px, parts.height_px, parts.bits)
        for (x0, y0, x1, y1), at, end in zip(rects, offsets[:-1], offsets[1:], strict=True):
            np.testing.assert_array_equal(flat[at:end].reshape(y1 - y0, x1 - x0), image[y0:y1, x0:x1])
        again, _ = whole.windows(rects)
        np.testing.assert_array_equal(again, flat)


@SOME
@given(data=st.data())
def test_faults_one_behind_the_other(data: st.DataObject) -> None:
    kinds = data.draw(st.lists(st.sampled_from(KINDS), min_size=2, max_size=4))
    tables = draw_tables(data, kinds, "roja1")
    if tables is None:
        return
    (_, whole), (_, parts) = through(tables, "roja1", (3, 4)), through(tables, "roja1", (3, 4))
    if whole is None:
        assert parts is None
        return
    rects = rects_of(data, whole.width_px, whole.height_px)
    flat, _ = parts.windows(rects)
    expected, _ = ArrayFrame(whole.full(), whole.bits).windows(rects)
    np.testing.assert_array_equal(flat, expected)


WITH_CHANCE = [kind for kind in KINDS if kind != "sensor.no_frames"]


@pytest.mark.parametrize("kind", WITH_CHANCE)
def test_the_seed_is_all_the_chance_there_is(kind: str) -> None:
    """The same whatever was asked before, another with another seed or in another frame."""
    table: dict[str, Any] = {"kind": kind}
    if kind == "sensor.bright_object":
        table["rate_deg_s"] = 0.5  # still in the field at these frames
    first = fault_of(table, seed=11)
    first.expose(rendered("roja1", 20), exposure_of("roja1", 20))
    once = first.expose(rendered("roja1", 21), exposure_of("roja1", 21))
    later = fault_of(table, seed=11)
    for index in (3, 9, 20):
        frame = later.expose(rendered("roja1", index), exposure_of("roja1", index))
        frame.windows(np.array([[0, 0, 30, 30]], np.int32))
    again = later.expose(rendered("roja1", 21), exposure_of("roja1", 21))
    np.testing.assert_array_equal(once.full(), again.full())
    plain = rendered("roja1", 21).full()
    assert (once.full() != plain).any()
    if kind == "sensor.dead_rows":
        assert (fault_of(table, seed=12).lines != first.lines).any()
    other = fault_of(table, seed=12)
    other.expose(rendered("roja1", 20), exposure_of("roja1", 20))
    assert (other.expose(rendered("roja1", 21), exposure_of("roja1", 21)).full() != once.full()).any()


@pytest.mark.parametrize("kind", KINDS)
def test_windows_are_all_that_is_asked_for(kind: str) -> None:
    profile = load_unit("roja1")
    rects = np.array([[10, 20, 40, 50], [300, 200, 320, 260]], np.int32)
    frame = flat_frame("roja1", 500)
    fault = fault_of({"kind": kind})
    spoilt = fault.expose(frame, exposure_of("roja1", 1))
    if spoilt is None:
        assert frame.asked == []
        return
    assert frame.asked == [], "nothing before it is asked for"
    spoilt.windows(rects)
    assert frame.fulls == 0
    area = sum(int(((one[:, 2] - one[:, 0]) * (one[:, 3] - one[:, 1])).sum()) for one in frame.asked)
    reach = math.ceil(4 * 1.5) if kind == "sensor.defocus" else 0
    most = sum((x1 - x0 + 2 * reach) * (y1 - y0 + 2 * reach) for x0, y0, x1, y1 in rects.tolist())
    assert 0 < area <= most
    assert profile.detector.columns * profile.detector.rows > 20 * most


def test_probability_strikes_frames_by_their_number() -> None:
    fault = fault_of({"kind": "sensor.no_frames", "probability": 0.3})
    frame = flat_frame("roja1", 10)
    struck = [fault.expose(frame, exposure_of("roja1", index)) is None for index in range(2000)]
    assert 0.26 < np.mean(struck) < 0.34
    backwards = [fault.expose(frame, exposure_of("roja1", index)) is None for index in reversed(range(2000))]
    assert backwards[::-1] == struck


# -- the physics of each


def added_electrons(table: dict[str, Any], index: int, electrons: float = 300.0) -> np.ndarray:
    """What a fault adds to even light, electrons."""
    frame = flat_frame("roja1", electrons, seed=index)
    spoilt = fault_of(table).expose(frame, exposure_of("roja1", index)).full()
    return (spoilt.astype(float) - frame.pixels) * load_unit("roja1").detector.electrons_per_dn


def test_a_false_star_has_the_light_of_a_star() -> None:
    """As much as the camera gives a star of this magnitude, in its width."""
    from st_emulator.bench.world_of import camera_model, sky_of
    from st_emulator.world import trajectory
    from st_emulator.world.false_spots import FalseSpots
    from st_emulator.world.scene import SceneRenderer

    profile = load_unit("roja1")
    camera = camera_model(profile).without_noise()
    pointing = trajectory.inertial(ra_deg=0, dec_deg=0, roll_deg=0)

    def light(*spots: tuple[float, float, float]) -> np.ndarray:
        scene = SceneRenderer(
            camera, sky_of(2_145_916_837_000_000_000), pointing, false_spots=FalseSpots(persistent=spots)
        )
        exposure = exposure_of("roja1", 0)
        return np.asarray(scene.frame(0, 0, exposure.duration_ns).mean_electrons(), float)

    table = {"kind": "sensor.false_stars", "number": 1, "brightest_mag": 4.0, "faintest_mag": 4.0}
    fault = fault_of(table)
    totals, expected, widths = [], [], []
    for index in range(60):
        ((x, y, magnitude),) = fault.spots(exposure_of("roja1", index))
        if not (10 < x < 740 and 10 < y < 470):
            continue
        cx, cy = round(x), round(y)
        around = np.s_[cy - 8 : cy + 9, cx - 8 : cx + 9]
        part = added_electrons(table, index)[around]
        totals.append(part.sum())
        widths.append((part * (np.arange(-8, 9) + cx - x) ** 2).sum() / part.sum())
        if not expected:
            camera_star = light((x, y, magnitude)) - light()
            expected.append(camera_star.sum())
            np.testing.assert_allclose(part, camera_star[around], atol=6 * np.sqrt(camera_star.max()) + 10)
    sigma = math.sqrt(expected[0] / len(totals))
    assert np.mean(totals) == pytest.approx(expected[0], abs=4 * sigma + 1)
    assert np.std(totals) == pytest.approx(math.sqrt(expected[0]), rel=0.35), "its own shot noise"
    assert np.mean(widths) == pytest.approx(profile.optics.psf_sigma_px**2 + 1 / 12, rel=0.05)


def test_faint_light_is_added_on_the_average() -> None:
    """Far less than a step of the converter."""
    table = {"kind": "sensor.stray_light", "level_dn": 0.05, "gradient": 0.0}
    assert added_electrons(table, 1).mean() == pytest.approx(0.5, rel=0.05)


def test_light_ends_where_the_pixel_is_full() -> None:
    detector = load_unit("roja1").detector
    table = {"kind": "sensor.false_stars", "number": 50, "brightest_mag": -30, "faintest_mag": -20}
    frame = fault_of(table).expose(flat_frame("roja1", 100), exposure_of("roja1", 1)).full()
    assert frame.max() == min(
        2**detector.bits - 1, detector.full_well_electrons / detector.electrons_per_dn + detector.offset_dn
    )


def test_stray_light_rises_by_its_level_and_towards_its_side() -> None:
    table = {"kind": "sensor.stray_light", "level_dn": 100, "gradient": 0.4, "direction_deg": 0}
    added = added_electrons(table, 2) / 10
    assert added.mean() == pytest.approx(100, rel=0.005)
    assert added[:, :5].mean() == pytest.approx(60, rel=0.02)
    assert added[:, -5:].mean() == pytest.approx(140, rel=0.02)
    even = added_electrons(table | {"gradient": 0.0}, 3)
    assert even.var() == pytest.approx(1000 + 100 / 6, rel=0.03), "shot noise, and places in two steps"


def test_blinding_follows_the_law_of_the_baffle() -> None:
    profile = load_unit("roja1")
    exclusion, detector = profile.exclusion, profile.detector
    exposure_s = profile.timing.exposure_ms / 1000

    def middle(angle_deg: float) -> float:
        table = {"kind": "sensor.blinding", "angle_deg": angle_deg}
        return float(added_electrons(table, 1)[220:260, 356:396].mean())

    edge = exclusion.stray_electrons_s_at_edge * exposure_s
    assert middle(exclusion.sun_deg) == pytest.approx(edge, rel=0.02)
    assert middle(2 * exclusion.sun_deg) == pytest.approx(edge / 8, rel=0.05)
    # inward on a straight line in log-log, to twice what fills a pixel at 80 % of the angle
    full = 2 * max(detector.full_well_electrons, 1023 * detector.electrons_per_dn)
    power = math.log(full / edge) / math.log(1 / 0.8)
    assert middle(0.92 * exclusion.sun_deg) == pytest.approx(edge * 0.92**-power, rel=0.03)
    assert middle(0.8 * exclusion.sun_deg) > 9000
    assert (
        fault_of({"kind": "sensor.blinding", "angle_deg": 10})
        .expose(flat_frame("roja1", 100), exposure_of("roja1", 1))
        .full()
        .min()
        == 1023
    )


def test_a_body_that_the_unit_does_not_know_is_refused() -> None:
    from dataclasses import replace

    from hil_tests.faults.sensor_bench import reach_of
    from st_emulator.faults.faults import settings_of

    reach = reach_of("roja1")
    without = reach.profile.exclusion.model_copy(update={"moon_deg": 0.0})
    reach = replace(reach, profile=reach.profile.model_copy(update={"exclusion": without}))
    settings = settings_of({"kind": "sensor.blinding", "body": "moon"}, "test")
    with pytest.raises(ValueError, match=r"exclusion\.moon_deg = 0\); allowed"):
        FAULTS["sensor.blinding"].make(settings, reach, 1)


def test_a_bright_object_goes_its_way() -> None:
    table = {"kind": "sensor.bright_object", "magnitude": 4.0, "rate_deg_s": 0.5, "direction_deg": 0}
    profile = load_unit("roja1")
    rate_px_s = math.radians(0.5) * profile.focal_px
    start_px = 375.5 - math.hypot(752, 480) / 2 - 4.5 * profile.optics.psf_sigma_px
    for index in (16, 30):
        added = added_electrons(table, index)
        t_s = index * 0.25 + 0.05
        y, x = np.mgrid[:480, :752]
        total = added.sum()
        assert (added * x).sum() / total == pytest.approx(start_px + rate_px_s * t_s, abs=0.2)
        assert (added * y).sum() / total == pytest.approx(239.5, abs=0.2)
        assert total == pytest.approx(profile.electrons_per_s_mag0 * 10 ** (-1.6) * 0.1, rel=0.02)
        lit = np.flatnonzero(added.sum(axis=0) > 100)
        assert lit.max() - lit.min() == pytest.approx(rate_px_s * 0.1, abs=6), "a streak of its exposure"
    fault = fault_of(table)
    gone = flat_frame("roja1", 10)
    assert fault.expose(gone, exposure_of("roja1", 200)) is gone


def test_protons_leave_what_protons_leave() -> None:
    fault = fault_of({"kind": "sensor.proton_streaks", "rate_per_cm2_s": 2000.0})
    tracks = [fault.tracks(exposure_of("roja1", index)) for index in range(100)]
    numbers = [len(one) for one in tracks]
    mean = 2000 * 752 * 480 * 6e-4**2 * 0.1  # rate, cm2, s
    assert np.mean(numbers) == pytest.approx(mean, abs=4 * math.sqrt(mean / 100))
    assert np.var(numbers) == pytest.approx(mean, rel=0.5)
    x0, y0, x1, y1, electrons = np.concatenate(tracks).T
    length_um = np.hypot(x1 - x0, y1 - y0) * 6.0
    chord_um = np.hypot(length_um, 12.0)
    assert np.median(length_um) == pytest.approx(12.0, rel=0.1), "half of an isotropic flux is under 45 deg"
    assert np.mean(chord_um > 24.0) == pytest.approx(0.25, abs=0.03), "a quarter is over 60 deg"
    loss = electrons / chord_um
    assert loss.mean() == pytest.approx(372, rel=0.02)
    assert np.mean(loss > 372) < 0.45, "few lose much: a long tail on one side"
    added = added_electrons({"kind": "sensor.proton_streaks", "rate_per_cm2_s": 2000.0}, 5)
    inside = (np.minimum(x0, x1) > 3).sum() / len(x0)
    frame_tracks = tracks[5]
    assert inside > 0.9
    assert added.sum() == pytest.approx(frame_tracks[:, 4].sum(), rel=0.15), "but for what leaves the field"


def test_hot_pixels_are_always_the_same() -> None:
    table = {"kind": "sensor.hot_pixels", "number": 400, "electrons_s": 20_000.0}
    fault = fault_of(table)
    hot = fault.dark_electrons_s > 0
    assert 395 <= hot.sum() <= 400
    assert fault.dark_electrons_s.sum() / 400 == pytest.approx(20_000, rel=0.2)
    for index in (1, 2):
        added = added_electrons(table, index)
        assert (added[~hot] == 0).all()
        assert added.sum() == pytest.approx(fault.dark_electrons_s.sum() * 0.1, rel=0.02)


@pytest.mark.parametrize(("kind", "name", "axis"), [("dead_rows", "rows", 0), ("dead_columns", "columns", 1)])
def test_dead_lines_show_one_number(kind: str, name: str, axis: int) -> None:
    frame = flat_frame("roja1", 300)
    table = {"kind": f"sensor.{kind}", name: [0, 7, 479], "value_dn": 5000}
    image = np.moveaxis(fault_of(table).expose(frame, exposure_of("roja1", 1)).full(), axis, 0)
    plain = np.moveaxis(frame.pixels, axis, 0)
    assert (image[[0, 7, 479]] == 1023).all(), "the converter's end"
    others = np.setdiff1d(np.arange(len(image)), [0, 7, 479])
    np.testing.assert_array_equal(image[others], plain[others])
    assert fault_of({"kind": f"sensor.{kind}", "number": 30}).lines.sum() == 30
    with pytest.raises(ValueError, match="allowed are 0 to"):
        fault_of({"kind": f"sensor.{kind}", name: [8000]})


def test_gain_goes_with_time() -> None:
    detector = load_unit("roja1").detector
    frame = flat_frame("roja1", 2000)
    fault = fault_of({"kind": "sensor.gain_drift", "factor_per_s": 0.8})
    np.testing.assert_array_equal(fault.expose(frame, exposure_of("roja1", 0)).full(), frame.pixels)
    for index, seconds in ((4, 1.0), (10, 2.5)):
        image = fault.expose(frame, exposure_of("roja1", index)).full().astype(float)
        signal = (frame.pixels - detector.offset_dn).mean()
        assert (image - detector.offset_dn).mean() == pytest.approx(signal * 0.8**seconds, abs=0.05)
    most = fault_of({"kind": "sensor.gain_drift", "factor_per_s": 100.0})
    assert (most.expose(frame, exposure_of("roja1", 4000)).full() == 1023).all()


def test_dust_takes_light_and_its_noise() -> None:
    detector = load_unit("roja1").detector
    table = {"kind": "sensor.dust", "number": 1, "radius_px": 500.0, "depth": 0.75}
    fault = fault_of(table)
    frame = flat_frame("roja1", 4000)
    image = fault.expose(frame, exposure_of("roja1", 1)).full().astype(float)
    x, y = np.clip(np.rint(fault.spots_px[0]).astype(int), [40, 40], [711, 439])
    part = np.s_[y - 25 : y + 25, x - 25 : x + 25]
    share = float(fault.transmission[part].mean())
    charge = (image[part] - detector.offset_dn) * detector.electrons_per_dn
    assert charge.mean() == pytest.approx(4000 * share, rel=0.01)
    noise = (charge - 4000 * fault.transmission[part]).var()
    assert noise == pytest.approx(4000 * share + detector.read_noise_electrons**2 + 100 / 12, rel=0.1)
    small = fault_of(table | {"radius_px": 3.0, "number": 5})
    untouched = small.transmission == 1
    np.testing.assert_array_equal(
        small.expose(frame, exposure_of("roja1", 1)).full()[untouched], frame.pixels[untouched]
    )


def test_defocus_keeps_light_and_noise() -> None:
    detector = load_unit("roja1").detector
    sigma_px = 2.0
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:480, :752]
    star = 9000 * np.exp(-0.5 * ((x - 300) ** 2 + (y - 200) ** 2) / 1.2**2)
    charge = rng.poisson(500 + star) + rng.normal(0, detector.read_noise_electrons, star.shape)
    frame = ArrayFrame(np.floor(charge / detector.electrons_per_dn + detector.offset_dn + 0.5), 10)
    fault = fault_of({"kind": "sensor.defocus", "sigma_px": sigma_px})
    image = fault.expose(frame, exposure_of("roja1", 1)).full().astype(float)
    away = np.s_[300:460, 400:740]
    assert image[away].mean() == pytest.approx(frame.pixels[away].mean(), abs=0.05)
    assert image[away].std() == pytest.approx(frame.pixels[away].std(), rel=0.05)
    around = np.s_[180:221, 280:321]
    level = frame.pixels[away].mean()
    before, after = frame.pixels[around] - level, image[around] - level
    assert after.sum() == pytest.approx(before.sum(), rel=0.03), "no light is lost"
    profile = after.sum(axis=0)
    width = (profile * (np.arange(280, 321) - 300) ** 2).sum() / profile.sum()
    assert width == pytest.approx(1.2**2 + sigma_px**2, rel=0.12)


def test_a_torn_frame_is_of_two() -> None:
    fault = fault_of({"kind": "sensor.torn_frame", "row": 100})
    first, second = flat_frame("roja1", 100, seed=1), flat_frame("roja1", 100, seed=2)
    assert fault.expose(first, exposure_of("roja1", 1)) is first
    torn = fault.expose(second, exposure_of("roja1", 2)).full()
    np.testing.assert_array_equal(torn[:100], second.pixels[:100])
    np.testing.assert_array_equal(torn[100:], first.pixels[100:])
    chosen = {fault_of({"kind": "sensor.torn_frame"}).row(exposure_of("roja1", index)) for index in range(40)}
    assert len(chosen) > 30
    assert min(chosen) >= 1
    assert max(chosen) <= 479
    upper = fault_of({"kind": "sensor.torn_frame", "row": 100})
    upper.expose(first, exposure_of("roja1", 1))
    first.asked.clear()
    upper.expose(second, exposure_of("roja1", 2)).windows(np.array([[5, 10, 20, 99]], np.int32))
    assert first.asked == [], "the frame before is not rendered for what lies above"
    with pytest.raises(ValueError, match="allowed are 1 to 479"):
        fault_of({"kind": "sensor.torn_frame", "row": 480})
