"""Full-frame detection on the ARM: threshold, clustering and centroid, told apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.image import centroid, clustering
from st_emulator.firmware_model.image.cluster_centroid import measure_clusters
from st_emulator.firmware_model.image.clustering import BLOCK_PX, RUN_FIELDS
from st_emulator.firmware_model.image.detection import DetectionParameters, spots_of_table, streaks_seen
from st_emulator.firmware_model.image.spots import Rejections, Spots
from st_emulator.firmware_model.work import COUNTS, Work
from tools.arm_timing.machine import ArmMachine, Cost
from tools.calibration.steps.step import MismatchError, StageRun
from tools.calibration.struct_layout import (
    layout_of,
    place_struct,
    read_struct,
    read_structs,
    reserve_structs,
)

__all__ = [
    "BACKGROUND_BOUND_DN",
    "BOUNDS",
    "FLUX_BOUND",
    "FLUX_BOUND_DN",
    "LIMIT_BOUND_DN",
    "ONE_DN",
    "STAGES",
    "STEPS",
    "DetectStep",
    "DetectionRun",
    "compare",
    "packed_spots",
    "place_image",
    "place_spot_limits",
    "read_runs",
    "read_statistics",
    "run_detection",
    "spots_of_structs",
    "threshold_levels",
]

STAGES = ("threshold", "clustering", "centroid")

# Largest differences from the Python stage; background and noise of the frame are equal.
BOUNDS = {"x_px": 1e-3, "y_px": 1e-3, "magnitude": 1e-3, "peak_dn": 1e-3}
FLUX_BOUND, FLUX_BOUND_DN = 1e-4, 1e-3  # of the flux, and of rounding where there is hardly any
BACKGROUND_BOUND_DN = 5e-4  # of a run
# A pixel may be judged otherwise that equals the threshold where that is so near to a whole number.
LIMIT_BOUND_DN = 5e-4

ONE_DN = 1 << 15  # ST_BACKGROUND_BITS
_BYTES_OF_WORD = 4
_SATURATED, _AT_EDGE = 1, 2  # st_spot.flags
_REASONS = 5
_MOST_DN = 0xFFFF
_MEASURED = ("x_px", "y_px", "flux_dn", "magnitude", "peak_dn", "pixels")  # st_spot and Spots


@dataclass(frozen=True)
class DetectionRun:
    """What the kernels made of a frame, and what each of ``STAGES`` cost.

    runs: int32[n, 3]; averages: int32[n], DN times ``ONE_DN``; row_start, label as in ``clustering.py``;
    clusters: st_cluster[m]; outcome: int8[m].
    """

    spots: Spots
    runs: npt.NDArray[np.int32]
    averages: npt.NDArray[np.int32]
    row_start: npt.NDArray[np.int32]
    label: npt.NDArray[np.int32]
    clusters: npt.NDArray[np.void]
    outcome: npt.NDArray[np.int8]
    costs: dict[str, Cost]


def place_spot_limits(machine: ArmMachine, limits: centroid.SpotLimits) -> int:
    """An st_spot_limits; its address."""
    terms = limits.interpolation
    interpolation = {
        "wanted": terms.wanted,
        "half_height_px": terms.half_height_px,
        "first": [terms.first_0, terms.first_1, terms.first_2],
        "second": [terms.second_0, terms.second_1, terms.second_2],
        "least_square_ratio": terms.least_square_ratio,
    }
    members = limits._asdict() | {"interpolation": interpolation, "reserved": 0}
    return place_struct(machine, "st_spot_limits", **members)


def place_image(machine: ArmMachine, pixels: int, shape: tuple[int, int]) -> int:
    """An st_image of the pixels at an address; shape: (rows, columns)."""
    return place_struct(machine, "st_image", pixels=pixels, rows=shape[0], columns=shape[1])


def read_runs(machine: ArmMachine, address: int, count: int) -> npt.NDArray[np.int32]:
    """int32[count, 3] of st_run: the columns of the Python stage's table of runs."""
    runs = read_structs(machine, "st_run", address, count)
    return np.stack([runs[name] for name in ("row", "first", "end")], axis=1)


def packed_spots(machine: ArmMachine, spots: Spots) -> npt.NDArray[np.void]:
    """Spots as st_spot[n]."""
    return layout_of(machine, "st_spot").pack_array(
        len(spots),
        flags=_SATURATED * spots.saturated + _AT_EDGE * spots.at_edge,
        **{name: getattr(spots, name) for name in _MEASURED},
    )


def read_statistics(machine: ArmMachine, address: int) -> tuple[float, float]:
    """(background_dn, noise_dn) of an st_statistics."""
    found = read_struct(machine, "st_statistics", address)
    return float(found["background_dn"]), float(found["noise_dn"])


def spots_of_structs(
    packed: npt.NDArray[np.void],
    rejected: Rejections,
    background_dn: float,
    noise_dn: float,
    overflowed: bool,
) -> Spots:
    """Spots of st_spot[n]."""
    return Spots(
        **{name: packed[name].copy() for name in _MEASURED},
        saturated=(packed["flags"] & _SATURATED) != 0,
        at_edge=(packed["flags"] & _AT_EDGE) != 0,
        background_dn=background_dn,
        noise_dn=noise_dn,
        rejected=rejected,
        overflowed=overflowed,
    )


def run_detection(
    machine: ArmMachine, image: npt.NDArray[np.uint16], parameters: DetectionParameters
) -> DetectionRun:
    """The kernels of ``detection.detect``, stage by stage. ``image``: uint16[rows, columns]."""
    rows, columns = image.shape
    picture = place_image(machine, machine.dma(image), (rows, columns))
    statistics = reserve_structs(machine, "st_statistics")
    cost = machine.call("st_frame_statistics", picture, statistics).cost
    background, noise = read_statistics(machine, statistics)

    over = max(parameters.sigma_factor * noise, parameters.tau_min_dn)
    # No pixel has more bits than the largest that there can be, or that there is.
    bits = max(min(parameters.saturation_dn, _MOST_DN), int(image.max())).bit_length()
    threshold = place_struct(
        machine,
        "st_threshold",
        background_dn=background,
        over_dn=over,
        average_pixels=parameters.average_pixels,
        capacity=parameters.max_runs,
        bits=bits,
        reserved=0,
    )
    run_table = reserve_structs(machine, "st_run", parameters.max_runs)
    average_table = machine.reserve(_BYTES_OF_WORD * parameters.max_runs)
    starts = machine.reserve(_BYTES_OF_WORD * (rows + 1))
    room = machine.reserve(2 * _BYTES_OF_WORD * (-(-columns // BLOCK_PX)))
    call = machine.call("st_threshold_scan", picture, threshold, run_table, average_table, starts, room)
    costs = {"threshold": cost + call.cost}
    result = call.result - (call.result >> 31 << 32)
    overflowed, count = result < 0, result if result >= 0 else -1 - result

    labels = machine.reserve(_BYTES_OF_WORD * count)
    call = machine.call("st_join_runs", run_table, count, starts, rows, labels)
    number = call.result
    table = reserve_structs(machine, "st_cluster", number)
    sums = machine.call("st_sum_clusters", picture, run_table, count, average_table, labels, table, number)
    costs["clustering"] = call.cost + sums.cost
    if parameters.piece_gap_px > 0:
        seen = machine.call("st_streaks_seen", table, number)
        costs["clustering"] += seen.cost
        if seen.result:
            joining_room = machine.reserve(2 * _BYTES_OF_WORD * number)
            call = machine.call(
                "st_join_pieces",
                *(run_table, count, starts, rows, labels, number, parameters.piece_gap_px, joining_room),
            )
            number = call.result
            sums = machine.call(
                "st_sum_clusters", picture, run_table, count, average_table, labels, table, number
            )
            costs["clustering"] += call.cost + sums.cost

    limits = place_spot_limits(machine, parameters.spot_limits())
    found = reserve_structs(machine, "st_spot", number)
    outcome, rejected = machine.reserve(number), machine.reserve(_BYTES_OF_WORD * _REASONS)
    work_room = machine.reserve(machine.call("st_centroid_room_bytes", limits).result)
    if parameters.centroid == "cluster":
        call = machine.call("st_measure_clusters", picture, table, number, limits, found, outcome, rejected)
    else:
        call = machine.call(
            "st_measure_spots",
            *(picture, run_table, starts, labels, table, number),
            noise,
            *(1, 1, limits, found, outcome, rejected, work_room),
        )
    measured = call.result
    ordered = reserve_structs(machine, "st_spot", measured)
    order = machine.reserve(2 * _BYTES_OF_WORD * measured)
    ordering = machine.call("st_order_spots", found, measured, parameters.max_spots, order, ordered)
    costs["centroid"] = call.cost + ordering.cost

    reasons = machine.read(rejected, np.int32, _REASONS).tolist()
    return DetectionRun(
        spots_of_structs(
            read_structs(machine, "st_spot", ordered, ordering.result),
            replace(Rejections(*reasons), surplus=measured - ordering.result),
            background,
            noise,
            overflowed,
        ),
        read_runs(machine, run_table, count),
        machine.read(average_table, np.int32, count),
        machine.read(starts, np.int32, rows + 1),
        machine.read(labels, np.int32, count),
        read_structs(machine, "st_cluster", table, number),
        machine.read(outcome, np.int8, number),
        costs,
    )


def threshold_levels(
    image: npt.NDArray[np.uint16], background_dn: float, over_dn: float, average_pixels: int
) -> npt.NDArray[np.float64]:
    """float64[rows, blocks]: average + ``over_dn`` of each block, as ``threshold_scan`` has it."""
    rows, columns = image.shape
    blocks = -(-columns // BLOCK_PX)
    levels = np.empty((rows, blocks))
    average = background_dn
    for row in range(rows):
        order = range(blocks) if row % 2 == 0 else range(blocks - 1, -1, -1)
        for block in order:
            pixels = image[row, block * BLOCK_PX : (block + 1) * BLOCK_PX].astype(np.float64)
            levels[row, block] = average + over_dn
            kept = np.minimum(pixels, np.floor(average + over_dn))
            average += (kept.sum() - len(pixels) * average) / max(average_pixels, BLOCK_PX)
    return levels


def compare(
    run: DetectionRun, image: npt.NDArray[np.uint16], parameters: DetectionParameters, expected: Spots
) -> bool:
    """MismatchError unless the kernels made the same of a frame as the Python stage, within the bounds.

    Returns whether the runs are the same to the pixel; where a threshold was rounded otherwise they need not
    be, and the rest is then compared with what the Python stages make of the kernels' runs.
    """
    _same("background_dn", run.spots.background_dn, expected.background_dn)
    _same("noise_dn", run.spots.noise_dn, expected.noise_dn)
    over = max(parameters.sigma_factor * expected.noise_dn, parameters.tau_min_dn)
    runs = np.empty((parameters.max_runs, RUN_FIELDS), np.int32)
    averages = np.empty(parameters.max_runs)
    row_start = np.empty(image.shape[0] + 1, np.int32)
    count, overflowed, _ = clustering.threshold_scan(
        image, expected.background_dn, over, parameters.average_pixels, runs, averages, row_start
    )
    levels = run.averages / ONE_DN
    same_runs = np.array_equal(run.runs, runs[:count]) and bool(
        np.all(np.abs(levels - averages[:count]) <= BACKGROUND_BOUND_DN)
    )
    if same_runs:
        _same("row_start", run.row_start, row_start)
        _same("overflowed", run.spots.overflowed, overflowed)
    elif not overflowed and not run.spots.overflowed:
        limits = threshold_levels(image, expected.background_dn, over, parameters.average_pixels)
        _judged_at_the_limit(image, limits, parameters.average_pixels, run.runs, runs[:count])
    label = np.empty(len(run.runs), np.int32)
    clusters, _ = clustering.join_runs(run.runs, len(run.runs), run.row_start, label)
    table = clustering.sum_clusters(image, run.runs, len(run.runs), run.averages / ONE_DN, label, clusters)
    if parameters.piece_gap_px > 0 and streaks_seen(table):
        gap = parameters.piece_gap_px
        clusters, _ = clustering.join_pieces(run.runs, len(run.runs), run.row_start, label, clusters, gap)
    _same("label", run.label, label)
    table = clustering.sum_clusters(
        image, run.runs, len(run.runs), run.averages / ONE_DN, run.label, clusters
    )
    _compare_clusters(run.clusters, table)
    if not same_runs:
        expected = _spots_of_runs(run, image, parameters, table)
    _compare_spots(run.spots, expected)
    return same_runs


def _same(name: str, ours: object, theirs: object) -> None:
    if not np.array_equal(np.asarray(ours), np.asarray(theirs)):
        raise MismatchError(f"detect: {name} is {ours}, {theirs} in Python")


def _near(name: str, ours: npt.ArrayLike, theirs: npt.ArrayLike, bound: float, relative: float = 0.0) -> None:
    off = np.abs(np.asarray(ours) - np.asarray(theirs)) - bound - relative * np.abs(theirs)
    if not np.all(off <= 0.0):
        place = int(np.argmax(np.ravel(off)))
        raise MismatchError(
            f"detect: {name} {np.ravel(ours)[place]!r}, {np.ravel(theirs)[place]!r} in Python"
        )


def _mask(runs: npt.NDArray[np.int32], shape: tuple[int, ...]) -> npt.NDArray[np.bool_]:
    edges = np.zeros((shape[0], shape[1] + 1), np.int8)
    np.add.at(edges, (runs[:, 0], runs[:, 1]), 1)
    np.add.at(edges, (runs[:, 0], runs[:, 2]), -1)
    return np.asarray(np.cumsum(edges, axis=1)[:, :-1] > 0)


def _judged_at_the_limit(
    image: npt.NDArray[np.uint16],
    levels: npt.NDArray[np.float64],
    average_pixels: int,
    ours: npt.NDArray[np.int32],
    theirs: npt.NDArray[np.int32],
) -> None:
    """MismatchError unless rounding explains that runs or their averages differ.

    A block whose threshold is that near to a whole number, with a pixel over it, may have been given the next
    limit: then each such pixel counts for 1 DN more or less in the average that follows.
    """
    rows, columns = np.nonzero(_mask(ours, image.shape) != _mask(theirs, image.shape))
    padding = -image.shape[1] % BLOCK_PX
    largest = np.pad(image, ((0, 0), (0, padding))).reshape(*levels.shape, BLOCK_PX).max(axis=2)
    doubtful = np.abs(levels - np.round(levels)) <= LIMIT_BOUND_DN
    if not np.any(doubtful & (largest >= np.round(levels))):
        raise MismatchError("detect: runs or their backgrounds differ, and no threshold is a whole number")
    bound = LIMIT_BOUND_DN + BLOCK_PX / max(average_pixels, BLOCK_PX)
    wrong = np.abs(levels[rows, columns // BLOCK_PX] - image[rows, columns]) > bound
    if wrong.any():
        x, y = columns[wrong][0], rows[wrong][0]
        raise MismatchError(f"detect: pixel {x}, {y} is judged otherwise than in Python")


def _compare_clusters(ours: npt.NDArray[np.void], table: npt.NDArray[np.float64]) -> None:
    whole = {
        "pixels": clustering.PIXELS,
        "first_x": clustering.FIRST_X,
        "last_x": clustering.LAST_X,
        "first_y": clustering.FIRST_Y,
        "last_y": clustering.LAST_Y,
    }
    for name, column in whole.items():
        _same(name, ours[name], table[:, column])
    level = ours["background"] / ONE_DN
    _near("cluster background", level, table[:, clustering.BACKGROUND], BACKGROUND_BOUND_DN)
    _near("peak", np.maximum(ours["brightest_dn"] - level, 0.0), table[:, clustering.PEAK], 1e-6)
    total = ours["sum"] / ONE_DN
    _near("sum", total, table[:, clustering.SUM], 1e-6, 1e-9)
    for moment, origin, column in (
        ("sum_x", "origin_x", clustering.SUM_X),
        ("sum_y", "origin_y", clustering.SUM_Y),
    ):
        _near(moment, ours[moment] / ONE_DN + total * ours[origin], table[:, column], 1e-3, 1e-9)


def _spots_of_runs(
    run: DetectionRun,
    image: npt.NDArray[np.uint16],
    parameters: DetectionParameters,
    table: npt.NDArray[np.float64],
) -> Spots:
    """What the Python stage measures of the kernels' clusters."""
    measured = np.empty((len(table), centroid.SPOT_FIELDS))
    tally = np.zeros(centroid.TALLIES, np.int64)
    outcome = np.empty(len(table), np.int8)
    if parameters.centroid == "cluster":
        rows, columns = image.shape
        limits = parameters.spot_limits()
        found = measure_clusters(columns, rows, table, limits, measured, outcome, tally)
    else:
        found = centroid.measure_spots(
            image,
            *(run.runs, run.row_start, run.label, table, run.spots.noise_dn, True, 1),
            *(parameters.spot_limits(), measured, outcome, tally),
        )
    order = np.argsort(-measured[:found, centroid.FLUX], kind="stable")[: parameters.max_spots]
    rejected = replace(Rejections(*tally[: centroid.FAINT + 1].tolist()), surplus=found - len(order))
    spots = run.spots
    return spots_of_table(measured[order], rejected, spots.background_dn, spots.noise_dn, spots.overflowed)


def _compare_spots(ours: Spots, theirs: Spots) -> None:
    _same("rejected", ours.rejected, theirs.rejected)
    _same("number of spots", len(ours), len(theirs))
    if np.any(np.diff(ours.flux_dn) > 0.0):
        raise MismatchError("detect: spots are not in the order of their flux")
    # Fluxes that are nearly equal may have changed places.
    ours, theirs = (
        spots.take(np.lexsort((spots.x_px.round(2), spots.y_px.round(1)))) for spots in (ours, theirs)
    )
    for name in ("pixels", "saturated", "at_edge"):
        _same(name, getattr(ours, name), getattr(theirs, name))
    for name, bound in BOUNDS.items():
        _near(name, getattr(ours, name), getattr(theirs, name), bound)
    _near("flux_dn", ours.flux_dn, theirs.flux_dn, FLUX_BOUND_DN, FLUX_BOUND)


class DetectStep:
    """Steps 1 to 3 of the papers' chains: threshold, clusters, centroids of a full frame."""

    name = "detect"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        """One run of each of ``STAGES``."""
        image, parameters = record.arguments["image"], record.arguments["parameters"]
        try:
            run = run_detection(machine, image, parameters)
        finally:
            machine.release()
        compare(run, image, parameters, record.result)
        return [
            StageRun(self.name, stage, cost, _part(record.work, stage)) for stage, cost in run.costs.items()
        ]


def _part(work: Work, stage: str) -> Work:
    return Work({name: number for name, number in work.counts.items() if COUNTS[name].stage == stage})


STEPS = (DetectStep(),)
