"""Detection in windows on the ARM: threshold, clustering and centroid of each window, told apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.image.detection import DetectionParameters
from st_emulator.firmware_model.image.spots import Rejections, WindowSpots
from st_emulator.firmware_model.work import COUNTS, Work
from tools.arm_timing.machine import ArmMachine, Cost
from tools.calibration.steps.detection import (
    BOUNDS,
    FLUX_BOUND,
    STAGES,
    place_spot_limits,
    read_statistics,
    spots_of_structs,
)
from tools.calibration.steps.step import MismatchError, StageRun
from tools.calibration.struct_layout import (
    layout_of,
    place_struct,
    read_struct,
    read_structs,
    reserve_structs,
)

__all__ = [
    "NOISE_BOUND",
    "STEPS",
    "WindowsRun",
    "WindowsStep",
    "compare",
    "padded",
    "place_rects",
    "place_window_parameters",
    "place_window_room",
    "read_rects",
    "run_windows",
]

NOISE_BOUND = 1e-9  # of the noise

_WORD_BYTES, _DOUBLE_BYTES = 4, 8
_EDGES = ("x0", "y0", "x1", "y1")  # of st_rect, and the columns of the Python stage's windows


@dataclass(frozen=True)
class WindowsRun:
    """What the kernels found, and what each of ``STAGES`` cost."""

    found: WindowSpots
    costs: dict[str, Cost]


def place_window_parameters(
    machine: ArmMachine, parameters: DetectionParameters, width_px: int, height_px: int
) -> tuple[int, int]:
    """An st_window_parameters, and the room in bytes that st_measure_spots then needs."""
    limits = place_spot_limits(machine, parameters.spot_limits(in_windows=True))
    room_bytes = machine.call("st_centroid_room_bytes", limits).result
    place = place_struct(
        machine,
        "st_window_parameters",
        sigma_factor=parameters.window_sigma_factor,
        tau_min_dn=parameters.tau_min_dn,
        max_runs=parameters.max_runs,
        image_width=width_px,
        image_height=height_px,
        reserved=0,
        limits=limits,
    )
    return place, room_bytes


def place_window_room(machine: ArmMachine, max_runs: int, tallest: int, centroid_bytes: int) -> int:
    """An st_window_room with its arrays."""
    layout = layout_of(machine, "st_window_room")
    counts = {
        "runs": max_runs,
        "run_background": max_runs,
        "label": max_runs,
        "row_start": tallest + 1,
        "clusters": max_runs,
        "spots": max_runs,
        "ordered": max_runs,
        "outcome": max_runs,
        "order": 2 * max_runs,
    }
    return place_struct(
        machine,
        "st_window_room",
        **{name: machine.reserve(layout.items_bytes(name, count)) for name, count in counts.items()},
        centroid_room=machine.reserve(centroid_bytes),
        run_count=0,
        cluster_count=0,
        spot_count=0,
        rejected=np.zeros(layout.dtype["rejected"].shape, np.int32),
    )


def place_rects(machine: ArmMachine, rects: npt.NDArray[np.int32]) -> int:
    """st_rect[n] of windows int32[n, 4]: x0, y0, x1, y1."""
    columns = dict(zip(_EDGES, rects.T, strict=True))
    return machine.place(layout_of(machine, "st_rect").pack_array(len(rects), **columns))


def read_rects(machine: ArmMachine, address: int, count: int) -> npt.NDArray[np.int32]:
    """The windows int32[n, 4] of st_rect[n]."""
    rects = read_structs(machine, "st_rect", address, count)
    return np.stack([rects[name] for name in _EDGES], axis=1)


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
    rect = place_rects(machine, rects)
    statistics = reserve_structs(machine, "st_statistics", windows)
    spots = reserve_structs(machine, "st_spot", int(keep.sum()))
    kept = machine.reserve(_WORD_BYTES)
    image, layout = reserve_structs(machine, "st_image"), layout_of(machine, "st_image")
    nbytes = {name: layout_of(machine, name).nbytes for name in ("st_statistics", "st_spot", "st_rect")}
    costs: dict[str, list[Cost]] = {stage: [] for stage in STAGES}
    status = np.zeros(windows, np.uint8)
    window_of: list[int] = []
    overflowed = False

    for number, (x0, y0, x1, y1) in enumerate(rects.tolist()):
        pixel = first_pixel + 2 * int(starts[number])
        machine.write(image, layout.pack(pixels=pixel, rows=y1 - y0, columns=x1 - x0))
        level = statistics + number * nbytes["st_statistics"]
        costs["threshold"].append(machine.call("st_window_runs", image, limits, room, level).cost)
        runs = read_struct(machine, "st_window_room", room)["run_count"]
        if not runs:
            continue
        overflowed |= runs == parameters.max_runs
        costs["clustering"].append(machine.call("st_window_clusters", image, level, room).cost)
        call = machine.call(
            "st_window_spots",
            image,
            rect + number * nbytes["st_rect"],
            limits,
            level,
            int(keep[number]),
            float("nan"),
            room,
            spots + len(window_of) * nbytes["st_spot"],
            kept,
        )
        costs["centroid"].append(call.cost)
        status[number] = call.result
        window_of += [number] * int(machine.read(kept, np.int32, 1)[0])
    medians = reserve_structs(machine, "st_statistics")
    call = machine.call(
        "st_median_statistics", statistics, windows, machine.reserve(_DOUBLE_BYTES * windows), medians
    )
    costs["threshold"].append(call.cost)

    level_dn, noise_dn = read_statistics(machine, medians)
    levels = read_structs(machine, "st_statistics", statistics, windows)
    rejected = read_struct(machine, "st_window_room", room)["rejected"]
    return WindowsRun(
        WindowSpots(
            spots_of_structs(
                read_structs(machine, "st_spot", spots, len(window_of)),
                Rejections(*rejected.tolist()),
                level_dn,
                noise_dn,
                bool(overflowed),
            ),
            np.array(window_of, np.int32),
            status,
            levels["background_dn"].copy(),
            levels["noise_dn"].copy(),
        ),
        {stage: _sum(parts) for stage, parts in costs.items() if parts},
    )


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
