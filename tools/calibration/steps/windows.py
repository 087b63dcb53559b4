"""Detection in windows on the ARM: threshold, clustering and centroid of each window, told apart."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.image.detection import DetectionParameters
from st_emulator.firmware_model.image.spots import Rejections, Spots, WindowSpots
from st_emulator.firmware_model.work import COUNTS, Work
from tools.arm_timing.machine import ArmMachine, Cost
from tools.calibration.steps.detection import (
    BOUNDS,
    FLUX_BOUND,
    SPOT,
    STAGES,
    place_spot_limits,
    spots_of_structs,
)
from tools.calibration.steps.step import MismatchError, StageRun

__all__ = [
    "NOISE_BOUND",
    "STEPS",
    "WindowsRun",
    "WindowsStep",
    "compare",
    "packed_spots",
    "padded",
    "place_window_parameters",
    "place_window_room",
    "run_windows",
]

NOISE_BOUND = 1e-9  # of the noise

_STATISTICS = np.dtype([("background_dn", "<f8"), ("noise_dn", "<f8")])  # st_statistics
_IMAGE = struct.Struct("<I2i")  # st_image
_ROOM = struct.Struct("<10I8i")  # st_window_room
_RUN_BYTES, _CLUSTER_BYTES, _RECT_BYTES, _WORD_BYTES, _DOUBLE_BYTES = 12, 64, 16, 4, 8
_SATURATED, _AT_EDGE = 1, 2  # st_spot.flags
_REASONS = 5


@dataclass(frozen=True)
class WindowsRun:
    """What the kernels found, and what each of ``STAGES`` cost."""

    found: WindowSpots
    costs: dict[str, Cost]


def _place_packed(machine: ArmMachine, form: str, *values: float) -> int:
    return machine.place(np.frombuffer(struct.pack("<" + form, *values), np.uint8))


def place_window_parameters(
    machine: ArmMachine, parameters: DetectionParameters, width_px: int, height_px: int
) -> tuple[int, int]:
    """An st_window_parameters, and the room in bytes that st_measure_spots then needs."""
    limits = place_spot_limits(machine, parameters.spot_limits(in_windows=True))
    room_bytes = machine.call("st_centroid_room_bytes", limits).result
    place = _place_packed(
        machine,
        "2d4iI4x",
        parameters.window_sigma_factor,
        parameters.tau_min_dn,
        parameters.max_runs,
        width_px,
        height_px,
        0,
        limits,
    )
    return place, room_bytes


def place_window_room(machine: ArmMachine, max_runs: int, tallest: int, centroid_bytes: int) -> int:
    """An st_window_room with its arrays."""
    return _place_packed(
        machine,
        "10I8i",
        machine.reserve(_RUN_BYTES * max_runs),
        machine.reserve(_WORD_BYTES * max_runs),
        machine.reserve(_WORD_BYTES * max_runs),
        machine.reserve(_WORD_BYTES * (tallest + 1)),
        machine.reserve(_CLUSTER_BYTES * max_runs),
        machine.reserve(SPOT.itemsize * max_runs),
        machine.reserve(SPOT.itemsize * max_runs),
        machine.reserve(max_runs),
        machine.reserve(2 * _WORD_BYTES * max_runs),
        machine.reserve(centroid_bytes),
        *(0,) * 8,
    )


def padded(
    flat: npt.NDArray[np.uint16], offsets: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.uint16], npt.NDArray[np.int32]]:
    """The windows' pixels with each window on a word of its own, and where each begins."""
    sizes = np.diff(offsets)
    starts = np.concatenate([[0], np.cumsum(sizes + sizes % 2)]).astype(np.int32)
    apart = np.zeros(int(starts[-1]), np.uint16)
    for start, first, end in zip(starts[:-1], offsets[:-1], offsets[1:], strict=True):
        apart[start : start + end - first] = flat[first:end]
    return apart, starts[:-1]


def packed_spots(spots: Spots) -> npt.NDArray[np.void]:
    """Spots as st_spot[n]."""
    packed = np.zeros(len(spots), SPOT)
    for name in ("x_px", "y_px", "flux_dn", "magnitude", "peak_dn", "pixels"):
        packed[name] = getattr(spots, name)
    packed["flags"] = _SATURATED * spots.saturated + _AT_EDGE * spots.at_edge
    return packed


def run_windows(
    machine: ArmMachine,
    flat: npt.NDArray[np.uint16],
    offsets: npt.NDArray[np.int64],
    rects: npt.NDArray[np.int32],
    parameters: DetectionParameters,
    width_px: int,
    height_px: int,
    keep: npt.NDArray[np.int32],
) -> WindowsRun:
    """The kernels of ``windows.detect_in_windows``, window by window, stage by stage."""
    windows = len(rects)
    pixels, starts = padded(flat, offsets)
    first_pixel = machine.dma(pixels)
    limits, room_bytes = place_window_parameters(machine, parameters, width_px, height_px)
    room = place_window_room(
        machine, parameters.max_runs, int(np.max(rects[:, 3] - rects[:, 1], initial=0)), room_bytes
    )
    rect = machine.place(np.ascontiguousarray(rects, np.int32))
    statistics = machine.reserve(_STATISTICS.itemsize * windows)
    spots = machine.reserve(SPOT.itemsize * int(keep.sum()))
    kept = machine.reserve(_WORD_BYTES)
    image = machine.reserve(_IMAGE.size)
    costs: dict[str, list[Cost]] = {stage: [] for stage in STAGES}
    status = np.zeros(windows, np.uint8)
    window_of: list[int] = []
    overflowed = False

    for number, (x0, y0, x1, y1) in enumerate(rects.tolist()):
        shape = _IMAGE.pack(first_pixel + 2 * int(starts[number]), y1 - y0, x1 - x0)
        machine.write(image, np.frombuffer(shape, np.uint8))
        level = statistics + number * _STATISTICS.itemsize
        costs["threshold"].append(machine.call("st_window_runs", image, limits, room, level).cost)
        runs = _room(machine, room)[0]
        if not runs:
            continue
        overflowed |= runs == parameters.max_runs
        costs["clustering"].append(machine.call("st_window_clusters", image, level, room).cost)
        call = machine.call(
            "st_window_spots",
            image,
            rect + number * _RECT_BYTES,
            limits,
            level,
            int(keep[number]),
            float("nan"),
            room,
            spots + len(window_of) * SPOT.itemsize,
            kept,
        )
        costs["centroid"].append(call.cost)
        status[number] = call.result
        window_of += [number] * int(machine.read(kept, np.int32, 1)[0])
    medians = machine.reserve(_STATISTICS.itemsize)
    call = machine.call(
        "st_median_statistics", statistics, windows, machine.reserve(_DOUBLE_BYTES * windows), medians
    )
    costs["threshold"].append(call.cost)

    level_dn, noise_dn = machine.read(medians, np.float64, 2)
    levels = machine.read(statistics, _STATISTICS, windows)
    small, large, sharp, edge, faint = _room(machine, room)[3:]
    return WindowsRun(
        WindowSpots(
            spots_of_structs(
                machine.read(spots, SPOT, len(window_of)),
                Rejections(small, large, sharp, edge, faint),
                float(level_dn),
                float(noise_dn),
                bool(overflowed),
            ),
            np.array(window_of, np.int32),
            status,
            levels["background_dn"].copy(),
            levels["noise_dn"].copy(),
        ),
        {stage: _sum(parts) for stage, parts in costs.items() if parts},
    )


def _room(machine: ArmMachine, room: int) -> tuple[int, ...]:
    """(runs, clusters, spots, rejected[5]) of the window that was looked at last."""
    return _ROOM.unpack(machine.read(room, np.uint8, _ROOM.size).tobytes())[-3 - _REASONS :]


def _sum(costs: Sequence[Cost]) -> Cost:
    total = costs[0]
    for cost in costs[1:]:
        total += cost
    return total


def compare(found: WindowSpots, expected: WindowSpots) -> None:
    """MismatchError unless both have the same windows' statuses and the same spots within the bounds."""

    def same(name: str, ours: object, theirs: object) -> None:
        if not np.array_equal(np.asarray(ours), np.asarray(theirs)):
            raise MismatchError(f"windows: {name} is {ours}, {theirs} in Python")

    def near(name: str, ours: npt.ArrayLike, theirs: npt.ArrayLike, bound: float, relative: float) -> None:
        off = np.abs(np.asarray(ours) - np.asarray(theirs)) - bound - relative * np.abs(theirs)
        if not np.all(off <= 0.0):
            place = int(np.argmax(np.ravel(off)))
            raise MismatchError(
                f"windows: {name} {np.ravel(ours)[place]!r}, {np.ravel(theirs)[place]!r} in Python"
            )

    same("status", found.status, expected.status)
    same("window", found.window, expected.window)
    near("background_dn", found.background_dn, expected.background_dn, 0.0, 0.0)
    near("noise_dn", found.noise_dn, expected.noise_dn, 0.0, NOISE_BOUND)
    ours, theirs = found.spots, expected.spots
    for name in ("pixels", "saturated", "at_edge", "overflowed"):
        same(name, getattr(ours, name), getattr(theirs, name))
    for reason in ("small", "large", "sharp", "edge", "faint"):
        same(f"rejected.{reason}", getattr(ours.rejected, reason), getattr(theirs.rejected, reason))
    for name, bound in (BOUNDS | {"background_dn": 0.0}).items():
        near(name, getattr(ours, name), getattr(theirs, name), bound, 0.0)
    near("flux_dn", ours.flux_dn, theirs.flux_dn, 0.0, FLUX_BOUND)
    near("noise_dn", ours.noise_dn, theirs.noise_dn, 0.0, NOISE_BOUND)


class WindowsStep:
    """Step 4 of tracking, Sarvi et al. 2014: centroids inside the windows only."""

    name = "windows"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        """One run of each of ``STAGES``; none of a stage that no window came to."""
        try:
            run = run_windows(machine, **record.arguments)
        finally:
            machine.release()
        compare(run.found, record.result)
        return [
            StageRun(self.name, stage, cost, _part(record.work, stage)) for stage, cost in run.costs.items()
        ]


def _part(work: Work, stage: str) -> Work:
    return Work({name: number for name, number in work.counts.items() if COUNTS[name].stage == stage})


STEPS = (WindowsStep(),)
