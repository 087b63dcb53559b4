"""Full-frame detection in C: the Python stage's spots, plain numpy, and the bounds that calibration holds."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy import ndimage, optimize

from st_emulator.campaigns.bench import Chain, random_pointings, with_section
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.image.background import frame_statistics
from st_emulator.firmware_model.image.detection import DetectionParameters, detect
from st_emulator.firmware_model.image.spots import Spots
from st_emulator.firmware_model.work import COUNTS, Work
from st_emulator.units.profile import load_unit
from st_emulator.world.false_spots import FalseSpots
from st_emulator.world.trajectory import ConstantRateTrajectory
from tools.arm_timing.machine import ArmMachine
from tools.calibration.steps import detection as binding
from tools.calibration.steps.detection import DetectionRun, compare, run_detection
from tools.calibration.steps.step import MismatchError
from tools.calibration.struct_layout import layout_of, place_struct, read_structs, reserve_structs

Image = NDArray[np.uint16]
SHARED_MACHINE = settings(
    deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
(DETECT,) = binding.STEPS


def random_sky(rng: np.random.Generator, bits: int, rows: int, columns: int, stars: int = 25) -> Image:
    """A slope, noise, Gaussian stars and streaks anywhere, some far too bright, and hot pixels."""
    y, x = np.mgrid[:rows, :columns]
    full = 2**bits - 1
    image = rng.uniform(0.02, 0.2) * full + rng.uniform(-0.1, 0.1) * x + rng.uniform(-0.1, 0.1) * y
    for _ in range(int(rng.integers(0, stars + 1))):
        x0, y0 = rng.uniform(-2, columns + 2), rng.uniform(-2, rows + 2)
        peak, sigma = 10 ** rng.uniform(0.5, np.log10(full) + 1), rng.uniform(0.5, 1.5)
        length, angle = rng.choice([0.0, 0.0, rng.uniform(0, 30)]), rng.uniform(0, np.pi)
        for along in np.linspace(-0.5, 0.5, 1 + int(2 * length)) * length:
            dx, dy = x - x0 - along * np.cos(angle), y - y0 - along * np.sin(angle)
            image += peak / (1 + length) * np.exp(-(dx**2 + dy**2) / (2 * sigma**2))
    image += rng.normal(0, rng.uniform(0.0, 0.01) * full + 0.3, image.shape)
    for _ in range(int(rng.integers(0, 6))):
        image[rng.integers(rows), rng.integers(columns)] = rng.uniform(0, 1.2) * full
    return np.clip(np.rint(image), 0, full).astype(np.uint16)


def random_parameters(rng: np.random.Generator, bits: int) -> DetectionParameters:
    return DetectionParameters(
        sigma_factor=rng.uniform(4, 6),
        tau_min_dn=rng.uniform(0.5, 10),
        min_pixels=int(rng.integers(2, 4)),
        max_pixels=int(rng.choice([50, 2000])),
        max_extent_px=int(rng.choice([10, 128])),
        centroid_half_window_px=int(rng.integers(1, 5)),
        max_peak_fraction=rng.uniform(0.2, 0.85),
        magnitude_limit=float(rng.choice([99.0, 9.0])),
        saturation_dn=2**bits - 1,
        average_pixels=int(rng.choice([16, 37, 64, 256, 1000])),
        max_runs=int(rng.choice([20, 16384, 16384])),
        max_spots=int(rng.choice([5, 1000])),
        centroid=str(rng.choice(["com", "gaussian"])),
        psf_sigma_px=rng.uniform(0.5, 1.2),
        interpolation_half_height_px=int(rng.integers(0, 2)),
    )


def found_in(machine: ArmMachine, image: Image, parameters: DetectionParameters) -> DetectionRun:
    try:
        return run_detection(machine, image, parameters)
    finally:
        machine.release()


def checked(machine: ArmMachine, image: Image, parameters: DetectionParameters) -> tuple[DetectionRun, bool]:
    """The kernels' run, compared with the Python stage; and whether its runs are the same to the pixel."""
    run = found_in(machine, image, parameters)
    return run, compare(run, image, parameters, detect(image, parameters)[0])


def mask_of(runs: NDArray[np.int32], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    mask = np.zeros(shape, np.bool_)
    for row, first, end in runs:
        mask[row, first:end] = True
    return mask


@pytest.mark.parametrize(
    ("unit", "false_stars", "rate_deg_s", "centroid"),
    [
        ("roja1", 0, 0.0, "com"),
        ("roja1", 500, 2.0, "gaussian"),
        ("zy3", 100, 0.3, "gaussian"),
        ("aps_rs", 30, 1.0, "com"),
        ("science_cam", 200, 0.1, "com"),
    ],
)
def test_frames_of_the_units(
    machine: ArmMachine, unit: str, false_stars: int, rate_deg_s: float, centroid: str
) -> None:
    profile = with_section(load_unit(unit), "detection", centroid=centroid)
    profile = with_section(profile, "detector", hot_pixel_fraction=2e-5, hot_pixel_electrons_s=2e5)
    chain = Chain.of(profile, 7)
    chain.scene.false_spots = FalseSpots(false_stars, 2.5, profile.detection.magnitude_limit)
    turning = np.radians(rate_deg_s) * np.array([0.8, 0.6, 0.0])
    chain.look(ConstantRateTrajectory(random_pointings(1, 7)[0], turning))
    image, parameters = chain.expose(0).full(), chain.configuration.detection
    spots, work = detect(image, parameters)
    record = StepRecord("detect", {"image": image, "parameters": parameters}, spots, work)
    run, same = checked(machine, image, parameters)
    assert same
    assert len(run.spots) > 0.3 * false_stars
    assert bool(work["centroid_interpolations"]) == (centroid == "gaussian")
    parts = DETECT.run(machine, record)
    assert [part.stage for part in parts] == list(binding.STAGES)
    together = sum((part.work for part in parts), Work())
    assert together == work
    assert all(part.cost.core_cycles > 1000 for part in parts)


def test_random_skies_and_parameters(machine: ArmMachine) -> None:
    """Any size, 8 to 16 bits; runs are the same to the pixel in all but a very few frames."""
    seen: Counter[str] = Counter()
    for seed in range(150):
        rng = np.random.default_rng(seed)
        bits = int(rng.choice([8, 10, 12, 14, 16]))
        image = random_sky(rng, bits, int(rng.integers(1, 120)), int(rng.integers(2, 160)))
        run, same = checked(machine, image, random_parameters(rng, bits))
        spots = run.spots
        seen.update(
            same=same,
            spots=len(spots),
            saturated=int(spots.saturated.sum()),
            at_edge=int(spots.at_edge.sum()),
            overflowed=spots.overflowed,
        )
        seen.update({name: getattr(spots.rejected, name) for name in spots.rejected.__slots__})
    assert seen["same"] >= 148
    assert min(seen.values()) > 2, seen  # none of what can happen was left out


def test_places_of_drawn_stars(machine: ArmMachine) -> None:
    """Against what was drawn, not against Python: no noise, so the centroid is where the star is."""
    rng = np.random.default_rng(3)
    x_true = 20.0 * np.arange(1, 9) + rng.uniform(-0.5, 0.5, 8)
    y_true = np.full(8, 30.0) + rng.uniform(-0.5, 0.5, 8)
    y, x = np.mgrid[:60, :180]
    image = np.full((60, 180), 1000.0)
    for x0, y0 in zip(x_true, y_true, strict=True):
        image += 5000 * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / (2 * 0.8**2))
    parameters = DetectionParameters(saturation_dn=16383, centroid_half_window_px=3)
    spots = found_in(machine, np.rint(image).astype(np.uint16), parameters).spots
    order = np.argsort(spots.x_px)
    assert spots.x_px[order] == pytest.approx(x_true, abs=2e-3)
    assert spots.y_px[order] == pytest.approx(y_true, abs=2e-3)
    assert spots.flux_dn == pytest.approx(5000 * 2 * np.pi * 0.8**2, rel=2e-3)
    assert spots.background_dn == pytest.approx(1000.0, abs=0.5)


@SHARED_MACHINE
@given(
    arrays(
        np.uint16,
        st.tuples(st.integers(1, 90), st.integers(2, 90)),
        elements=st.sampled_from([0, 1, 2, 3, 100, 4095, 65535]) | st.integers(0, 65535),
    )
)
def test_statistics_are_those_of_python_to_the_bit(machine: ArmMachine, image: Image) -> None:
    picture = binding.place_image(machine, machine.place(image), image.shape)
    out = reserve_structs(machine, "st_statistics")
    machine.call("st_frame_statistics", picture, out)
    found = binding.read_statistics(machine, out)
    machine.release()
    assert found == frame_statistics(image)[:2]


@SHARED_MACHINE
@given(
    arrays(
        np.uint16,
        st.tuples(st.integers(1, 12), st.integers(2, 140)),
        elements=st.sampled_from([0, 1, 9, 4095]) | st.integers(0, 4095),
    ),
    st.floats(0.2, 400.0),
    st.sampled_from([16, 64, 256]),
)
def test_narrow_and_wide_pixels_are_scanned_alike(
    machine: ArmMachine, image: Image, over_dn: float, average_pixels: int
) -> None:
    """Two pixels are summed in a word where 16 words cannot overflow, else by themselves: no difference."""
    common = {"sigma_factor": 1e-9, "tau_min_dn": over_dn, "average_pixels": average_pixels}
    narrow = found_in(machine, image, DetectionParameters(saturation_dn=4095, **common))
    wide = found_in(machine, image, DetectionParameters(saturation_dn=65535, **common))
    for name in ("runs", "averages", "row_start", "label"):
        assert np.array_equal(getattr(narrow, name), getattr(wide, name))
    labels, count = ndimage.label(mask_of(narrow.runs, image.shape), np.ones((3, 3)))
    assert count == len(narrow.clusters)
    pixels = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    assert sorted(narrow.clusters["pixels"]) == sorted(pixels)


def test_bright_pixels_of_sixteen_bits(machine: ArmMachine) -> None:
    """A background over half of what 16 bits hold: every block is looked at pixel by pixel."""
    rng = np.random.default_rng(8)
    image = np.clip(rng.normal(50_000, 30, (64, 160)), 0, 65535).astype(np.uint16)
    image[30:33, 70:73] = 65535
    parameters = DetectionParameters()
    spots, work = detect(image, parameters)
    run, same = checked(machine, image, parameters)
    assert same
    assert work["block_pixels"] == image.size
    assert len(run.spots) == len(spots) == 1


def test_a_run_over_many_blocks(machine: ArmMachine) -> None:
    image = np.full((9, 200), 100, np.uint16)
    image[4, 30:131] = 900  # over four block boundaries
    image[5, 150:] = 900  # to the end of the row
    image[6, :] = 900
    run, same = checked(
        machine, image, DetectionParameters(tau_min_dn=300.0, average_pixels=10**6, max_extent_px=500)
    )
    assert same
    assert run.runs.tolist() == [[4, 30, 131], [5, 150, 200], [6, 0, 200]]
    assert run.row_start.tolist() == [0, 0, 0, 0, 0, 1, 2, 3, 3, 3]


def test_equal_fluxes_stay_in_their_order(machine: ArmMachine) -> None:
    fluxes = np.random.default_rng(2).integers(1, 9, 200).astype(np.float64)
    spots = np.zeros(200, layout_of(machine, "st_spot").dtype)
    spots["flux_dn"], spots["pixels"] = fluxes, np.arange(200)
    for count, most in ((200, 200), (200, 17), (1, 1), (0, 5), (3, 3)):
        ordered = reserve_structs(machine, "st_spot", count)
        order = machine.reserve(8 * count)
        call = machine.call("st_order_spots", machine.place(spots[:count]), count, most, order, ordered)
        expected = np.argsort(-fluxes[:count], kind="stable")[:most]
        assert call.result == len(expected)
        found = read_structs(machine, "st_spot", ordered, len(expected))
        assert found["pixels"].tolist() == expected.tolist()
        machine.release()


def frames(n: int, seed: int) -> list[tuple[Image, DetectionParameters]]:
    """Stars from none to very many, over frames of two sizes."""
    found = []
    for number in range(n):
        rng = np.random.default_rng([seed, number])
        rows, columns = ((120, 240), (200, 208))[number % 2]
        image = np.full((rows, columns), 60.0)
        y, x = np.mgrid[-5:6, -5:6]
        for _ in range(int(rng.choice([3, 20, 80, 200]))):
            column, row = int(rng.integers(5, columns - 6)), int(rng.integers(5, rows - 6))
            (x0, y0), spread = rng.uniform(-0.5, 0.5, 2), 2 * rng.uniform(0.6, 1.0) ** 2
            star = 10 ** rng.uniform(1.5, 3) * np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / spread)
            image[row - 5 : row + 6, column - 5 : column + 6] += star
        image += rng.normal(0, 2.0, image.shape)
        parameters = DetectionParameters(
            saturation_dn=1023, centroid=("com", "gaussian")[int(rng.integers(2))], sigma_factor=5.0
        )
        found.append((np.clip(np.rint(image), 0, 1023).astype(np.uint16), parameters))
    return found


@pytest.fixture(scope="module")
def one_sky() -> tuple[Image, DetectionParameters, Spots]:
    ((image, parameters),) = frames(1, 5)
    spots, _ = detect(image, parameters)
    assert len(spots) > 5
    return image, parameters, spots


def moved(values: NDArray[Any], by: float) -> NDArray[Any]:
    changed = values.copy()
    changed[-1] += by
    return changed


@pytest.mark.parametrize(
    "change",
    [
        {"x_px": 2e-3},
        {"y_px": -2e-3},
        {"peak_dn": 2e-3},
        {"magnitude": 2e-3},
        {"pixels": 1},
    ],
    ids=lambda change: next(iter(change)),
)
def test_what_is_beyond_a_bound_is_found(
    machine: ArmMachine, one_sky: tuple[Image, DetectionParameters, Spots], change: dict[str, float]
) -> None:
    image, parameters, expected = one_sky
    run = found_in(machine, image, parameters)
    assert compare(run, image, parameters, expected)
    changed = {name: moved(getattr(run.spots, name), by) for name, by in change.items()}
    with pytest.raises(MismatchError, match=next(iter(change))):
        compare(replace(run, spots=replace(run.spots, **changed)), image, parameters, expected)


def test_other_differences_are_found(
    machine: ArmMachine, one_sky: tuple[Image, DetectionParameters, Spots]
) -> None:
    image, parameters, expected = one_sky
    run = found_in(machine, image, parameters)

    def refused(what: str, **changed: Any) -> None:
        with pytest.raises(MismatchError, match=what):
            compare(replace(run, **changed), image, parameters, expected)

    spots = run.spots
    refused("flux_dn", spots=replace(spots, flux_dn=spots.flux_dn * 1.0002 + 1e-3))
    refused("saturated", spots=replace(spots, saturated=~spots.saturated))
    refused("order", spots=spots.take(slice(None, None, -1)))
    refused("number", spots=spots.take(slice(1, None)))
    refused("rejected", spots=replace(spots, rejected=replace(spots.rejected, small=-1)))
    refused("background_dn", spots=replace(spots, background_dn=spots.background_dn + 1e-9))
    refused("noise_dn", spots=replace(spots, noise_dn=spots.noise_dn + 1e-9))
    label = run.label.copy()
    label[-1] = 0
    refused("label", label=label)
    clusters = run.clusters.copy()
    clusters["sum"][0] += binding.ONE_DN
    refused("sum", clusters=clusters)
    runs = run.runs.copy()
    runs[0, 2] += 1
    refused("runs or their backgrounds|judged", runs=runs)
    refused("runs or their backgrounds", averages=run.averages + binding.ONE_DN)


def test_a_threshold_that_is_a_whole_number_may_be_rounded_otherwise(machine: ArmMachine) -> None:
    """The average stays at 100 DN + 1e-5, the threshold at 110: a pixel of 110 is over it or not."""
    image = np.full((40, 64), 100, np.uint16)
    image[20, 10:13] = image[21, 10:13] = 130
    image[20, 13] = 110
    parameters = DetectionParameters(tau_min_dn=10.0 - 1e-9, saturation_dn=4095, max_peak_fraction=1.0)
    expected = detect(image, parameters)[0]
    run = found_in(machine, image, parameters)
    assert expected.pixels.tolist() == [7]
    assert run.spots.pixels.tolist() == [6]
    assert not compare(run, image, parameters, expected)
    image[20, 13] = 112
    with pytest.raises(MismatchError, match="judged"):
        compare(run, image, parameters, detect(image, parameters)[0])


def stage_runs(machine: ArmMachine, cases: list[tuple[Image, DetectionParameters]]) -> list[Any]:
    parts = []
    for image, parameters in cases:
        spots, work = detect(image, parameters)
        arguments = {"image": image, "parameters": parameters}
        parts += DETECT.run(machine, StepRecord("detect", arguments, spots, work))
    return parts


def test_counts_predict_the_core_cycles_of_each_stage(machine: ArmMachine) -> None:
    """A linear fit over some frames is within 10 % on others that it has not seen."""
    known, others = stage_runs(machine, frames(24, 1)), stage_runs(machine, frames(12, 2))
    for stage in binding.STAGES:
        names = [name for name, count in COUNTS.items() if count.stage == stage]

        def table(parts: list[Any], stage: str, names: list[str]) -> tuple[Any, Any]:
            rows = [part for part in parts if part.stage == stage]
            counts = np.array([[part.work[name] for name in names] for part in rows], np.float64)
            return counts, np.array([part.cost.core_cycles for part in rows], np.float64)

        counts, cycles = table(known, stage, names)
        scale = np.maximum(counts.max(axis=0), 1.0)
        cost, _ = optimize.nnls(counts / scale / cycles[:, None], np.ones(len(cycles)), maxiter=1000)
        counts, cycles = table(others, stage, names)
        assert np.abs(counts / scale @ cost / cycles - 1).max() < 0.1, stage
        assert cycles.max() / cycles.min() > (1.2 if stage == "threshold" else 5.0)


def test_the_threshold_scan_takes_few_cycles_a_pixel(machine: ArmMachine) -> None:
    """A word at a time with the moving average: a trial of such a loop took 3.3 core cycles a pixel."""
    image = np.random.default_rng(1).normal(60, 2, (480, 752)).clip(0, 1023).astype(np.uint16)
    picture = binding.place_image(machine, machine.place(image), image.shape)
    threshold = place_struct(
        machine,
        "st_threshold",
        background_dn=60.0,
        over_dn=12.0,
        average_pixels=256,
        capacity=100,
        bits=10,
        reserved=0,
    )
    runs = reserve_structs(machine, "st_run", 100)
    tables = [machine.reserve(nbytes) for nbytes in (400, 4 * 481, 8 * 24)]
    call = machine.call("st_threshold_scan", picture, threshold, runs, *tables)
    assert call.result < 100
    assert call.cost.core_cycles / image.size == pytest.approx(3.6, abs=0.3)
    # every pixel comes from memory once: 16 in a line
    assert call.cost.line_fills(32) / image.size == pytest.approx(1 / 16, rel=0.02)
