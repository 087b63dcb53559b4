"""The picture of a turn: a streak with its centroids, rates over time, and compensation or optical flow."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.patches import Patch
from numpy.typing import NDArray

from ..bench.journal import Journal
from ..device.imaging import FrameRecord
from ..firmware_model.image.optical_flow import FlowFrame
from ..firmware_model.star_motion import KeptFrame
from ..protocol.pus.enumerations import Mode
from ..units.profile import UnitProfile
from .pictures import INK, SPOT_COLOUR, STAR_COLOUR, STYLE, WINDOW_COLOUR, _save
from .replaying import emulator_of, feed, refusals_of
from .turning_demo import TurnSeries, spans

Array = NDArray[np.float64]

AXIS_COLOURS = (STAR_COLOUR, WINDOW_COLOUR, "#c58af9")
MODE_COLOURS = {
    Mode.TRACKING: "#1e5631",
    Mode.LOST_IN_SPACE: "#6b4a12",
    Mode.RATE_ONLY: "#1f3f78",
}
OTHER_MODES = "#2b2e33"
NEAREST_PX = 3.0  # between a centroid and the middle of the light of the star that it is
FAINTEST_SHOWN_MAG = 5.5
TRUE_COLOUR = "#69f0ae"
ARROWS = 3.0  # so many times as long as the shifts


@dataclass(frozen=True)
class Centroid:
    """A star of a frame: the centroid of its light as measured, and at mid-exposure; where it truly stood."""

    raw: tuple[float, float]
    compensated: tuple[float, float]
    true: tuple[float, float]
    hp_mag: float


@dataclass
class Replayed:
    """Of a replay: the fastest frame and the one before it, and the centroids of each full frame by index."""

    fastest: FrameRecord | None = None
    before: KeptFrame | None = None
    centroids: dict[int, list[Centroid]] = field(default_factory=dict)


def draw_turn(
    profile: UnitProfile,
    series: TurnSeries,
    journal: Journal,
    where: str,
    truth: dict[int, dict[str, Any]],
    path: Path,
) -> None:
    """Raises ValueError where no frame of the turn has a rate."""
    moving = np.isfinite(series.rate_deg_s).all(axis=1) & np.isfinite(series.speed_deg_s)
    if not moving.any():
        raise ValueError("no frame has a rate")
    fastest = int(np.where(moving, np.nan_to_num(series.speed_deg_s), -1.0).argmax())
    replayed = _replay(journal, where, int(series.frame_index[fastest]), truth)
    if replayed.fastest is None or replayed.fastest.result is None:
        raise ValueError(f"frame {series.frame_index[fastest]} is not in the journal's replay")
    kept = _kept(replayed.fastest)
    flows = kept is not None and kept.flow is not None
    with plt.rc_context(STYLE):
        figure, axes = plt.subplot_mosaic(
            [["streak", "how"], ["rate", "rate"], ["across", "across"], ["about", "about"]],
            figsize=(12, 14),
            height_ratios=[5.2, 2.6, 1.7, 1.7],
            layout="constrained",
        )
        speed = float(series.speed_deg_s[fastest])
        figure.suptitle(
            f"{profile.unit.title}\nat rest, a turn up to {speed:.2f} deg/s and back: the attitude is lost, "
            "the rate is not",
            fontsize=11,
        )
        stars = replayed.centroids.get(replayed.fastest.index, [])
        _streak(axes["streak"], replayed.fastest, stars, speed, flows)
        if flows:
            _flow(axes["how"], replayed, series, fastest)
        else:
            _errors(axes["how"], series, replayed.centroids)
        _rates(axes["rate"], series)
        _residuals(axes["across"], series, (0, 1), "error of the rate about\nx and y, deg/s")
        _residuals(axes["about"], series, (2,), "the same about z\n(boresight), deg/s")
        axes["about"].set_xlabel("time since power-on, s")
        for name in ("rate", "across", "about"):
            _modes(axes[name], series)
            axes[name].set_xlim(0.0, float(series.t_s.max()) + 0.5)
            axes[name].grid(True, lw=0.4)
        _mode_legend(axes["rate"], series)
        _save(figure, path)


def _kept(record: FrameRecord) -> KeptFrame | None:
    return None if record.result is None else record.result.state.previous


def _replay(journal: Journal, where: str, index: int, truth: dict[int, dict[str, Any]]) -> Replayed:
    """All frames once more: centroids are the unit's own, which it does not tell."""
    found = Replayed()

    def completed(record: FrameRecord) -> None:
        kept = _kept(record)
        if record.index == index - 1:
            found.before = kept
        if record.index == index:
            found.fastest = record
        if kept is not None and kept.frame_index == record.index and record.index in truth:
            found.centroids[record.index] = _centroids(record, kept, truth[record.index])

    refusals = refusals_of(journal)
    emulator = emulator_of(
        journal,
        where,
        on_completed=completed,
        transmit=lambda data, t_ns: 0 if (t_ns, data) in refusals else None,
    )
    feed(emulator, journal)
    return found


def _centroids(record: FrameRecord, kept: KeptFrame, true: dict[str, Any]) -> list[Centroid]:
    """The frame's stars, each with the centroid that is nearest to the middle of its light."""
    assert record.result is not None
    if kept.flow is not None:
        x, y = kept.flow.x_px, kept.flow.y_px
        moved_x, moved_y = x, y
    elif kept.table is not None and len(kept.table) == len(record.result.spots):
        x, y = kept.table.spots.x_px, kept.table.spots.y_px
        moved_x, moved_y = record.result.spots.x_px, record.result.spots.y_px
    else:
        return []
    made = []
    for star in true["stars"]:
        if star["hp_mag"] > FAINTEST_SHOWN_MAG or not len(x):
            continue
        off = np.hypot(x - star["x_px"], y - star["y_px"])
        k = int(off.argmin())
        if off[k] <= NEAREST_PX:
            made.append(
                Centroid(
                    (float(x[k]), float(y[k])),
                    (float(moved_x[k]), float(moved_y[k])),
                    (star["x_mid_px"], star["y_mid_px"]),
                    star["hp_mag"],
                )
            )
    return made


def _streak(axes: Any, record: FrameRecord, stars: list[Centroid], speed_deg_s: float, flows: bool) -> None:
    """The brightest star of the fastest frame that is well inside, with what was made of it."""
    assert record.pixels is not None
    pixels = np.asarray(record.pixels.full(), dtype=float)
    rows, columns = pixels.shape
    half = 48
    inside = [s for s in stars if half < s.raw[0] < columns - half and half < s.raw[1] < rows - half]
    if inside:
        x, y = min(inside, key=lambda star: star.hp_mag).raw
    else:
        x, y = columns / 2, rows / 2
    left, top = max(round(x) - half, 0), max(round(y) - half, 0)
    crop = pixels[top : top + 2 * half + 1, left : left + 2 * half + 1]
    low, high = np.percentile(crop, 5), np.percentile(crop, 99.7)
    axes.imshow(
        np.clip((crop - low) / max(high - low, 1.0), 0, 1) ** 0.7,
        cmap="gray",
        extent=(left - 0.5, left + crop.shape[1] - 0.5, top + crop.shape[0] - 0.5, top - 0.5),
        interpolation="nearest",
    )
    shown = [s for s in stars if abs(s.raw[0] - x) < half - 4 and abs(s.raw[1] - y) < half - 4]
    places = {
        name: np.array([getattr(star, name) for star in shown]).reshape(-1, 2)
        for name in ("raw", "compensated", "true")
    }
    marks: list[tuple[str, str, str, str, float]] = [
        ("true", "o", TRUE_COLOUR, "true place at mid-exposure of the frame", 110.0),
        ("raw", "x", SPOT_COLOUR, "centroid of the streak, as measured", 70.0),
    ]
    if not flows:
        marks.append(("compensated", "+", STAR_COLOUR, "the same, rolling shutter compensated", 130.0))
    for name, marker, colour, label, size in marks:
        hollow = {"facecolors": "none", "edgecolors": colour} if marker == "o" else {"color": colour}
        axes.scatter(
            places[name][:, 0],
            places[name][:, 1],
            s=size,
            marker=marker,
            linewidths=1.6,
            label=label,
            **hollow,
        )
    axes.set_title(
        f"(a) frame {record.index}, {speed_deg_s:.2f} deg/s: a star in {record.exposure_ns * 1e-6:g} ms",
        fontsize=10,
    )
    axes.set_xlabel("column, px")
    axes.set_ylabel("row, px")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), fontsize=8, ncols=1, frameon=False)


def _errors(axes: Any, series: TurnSeries, centroids: dict[int, list[Centroid]]) -> None:
    """How far centroids are from where stars stood at mid-exposure, before and after compensation."""
    # a frame without a rate has nothing to compensate with
    known = np.where(np.isfinite(series.rate_deg_s).all(axis=1), series.speed_deg_s, np.nan)
    speeds = dict(zip(series.frame_index.tolist(), known.tolist(), strict=True))
    points: dict[str, list[tuple[float, float]]] = {"raw": [], "compensated": []}
    for index, stars in centroids.items():
        speed = speeds.get(index, math.nan)
        for star in stars if math.isfinite(speed) else ():
            for name, found in points.items():
                place = getattr(star, name)
                found.append((speed, math.hypot(place[0] - star.true[0], place[1] - star.true[1])))
    for name, colour, label in (
        ("raw", SPOT_COLOUR, "as measured"),
        ("compensated", STAR_COLOUR, "compensated"),
    ):
        at = np.array(points[name]).reshape(-1, 2)
        axes.scatter(at[:, 0], at[:, 1], s=5, color=colour, alpha=0.3, linewidths=0)
        edges = np.linspace(0.0, max(5.0, float(at[:, 0].max(initial=0.0))), 11)
        middles, medians = [], []
        for begin, end in pairwise(edges.tolist()):
            there = at[(at[:, 0] >= begin) & (at[:, 0] < end), 1]
            if len(there) >= 3:
                middles.append(0.5 * (begin + end))
                medians.append(float(np.median(there)))
        axes.plot(middles, medians, "o-", color=colour, ms=4, lw=1.6, label=f"{label} (median)")
    axes.set_yscale("log")
    axes.set_ylim(0.02, 30.0)
    axes.set_xlim(left=0.0)
    axes.grid(True, which="major", lw=0.4)
    axes.set_xlabel("rate, deg/s")
    axes.set_ylabel("distance from the true place at mid-exposure, px")
    axes.set_title(
        f"(b) centroids of stars to {FAINTEST_SHOWN_MAG:g} mag, full frames with a rate", fontsize=10
    )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), fontsize=8, ncols=2, frameon=False)


def _flow(axes: Any, replayed: Replayed, series: TurnSeries, fastest: int) -> None:
    """Where the stars of the frame before went, and where the told rate puts them."""
    now = _kept(replayed.fastest) if replayed.fastest is not None else None
    before = replayed.before
    axes.set_title("(b) optical flow from the frame before: every star, one rate", fontsize=10)
    axes.set_xlabel("column, px")
    axes.set_ylabel("row, px")
    axes.set_aspect("equal")
    if now is None or now.flow is None or before is None or before.flow is None:
        axes.annotate("the frame before was not looked at", (0.5, 0.5), xycoords="axes fraction", ha="center")
        return
    first: FlowFrame = before.flow
    second: FlowFrame = now.flow
    axes.set_xlim(0, first.width_px)
    axes.set_ylim(first.height_px, 0)
    axes.scatter(
        first.x_px, first.y_px, s=16, color="#9aa0a6", linewidths=0, label="stars of the frame before"
    )
    axes.scatter(
        second.x_px, second.y_px, s=30, facecolors="none", edgecolors=SPOT_COLOUR, label="stars of this frame"
    )
    focal, cx, cy = _camera(replayed)
    step_s = (now.t_mid_ns - before.t_mid_ns) * 1e-9
    turn = np.radians(series.rate_deg_s[fastest]) * step_s
    u = np.stack([(first.x_px - cx) / focal, (first.y_px - cy) / focal, np.ones(len(first))], axis=1)
    moved = u + np.cross(u, turn)
    shift_x = focal * (moved[:, 0] / moved[:, 2] - u[:, 0])
    shift_y = focal * (moved[:, 1] / moved[:, 2] - u[:, 1])
    axes.quiver(
        first.x_px, first.y_px, shift_x, shift_y,
        angles="xy", scale_units="xy", scale=1.0 / ARROWS, width=0.004, color=STAR_COLOUR,
        label=f"where the measured rate moves them ({ARROWS:g} times as long)",
    )  # fmt: skip
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), fontsize=8, ncols=1, frameon=False)


def _camera(replayed: Replayed) -> tuple[float, float, float]:
    assert replayed.fastest is not None
    geometry = replayed.fastest.settings.configuration.geometry
    return geometry.focal_px, geometry.cx_px, geometry.cy_px


def _rates(axes: Any, series: TurnSeries) -> None:
    for axis, colour in enumerate(AXIS_COLOURS):
        name = "xyz"[axis]
        axes.plot(
            series.t_s,
            series.true_deg_s[:, axis],
            "-",
            lw=3.5,
            alpha=0.35,
            color=colour,
            label=f"{name}, true",
        )
        axes.plot(
            series.t_s, series.rate_deg_s[:, axis], ".", ms=4, color=colour, label=f"{name}, as telemetered"
        )
    axes.set_ylabel("angular rate, deg/s\n(sensor axes)")
    axes.legend(loc="upper left", fontsize=7.5, ncols=3)
    highest = max(1.0, float(np.nanmax(np.abs(series.true_deg_s), initial=0.0)))
    axes.set_ylim(-0.25 * highest, 1.75 * highest)
    axes.set_title("(c) what the OBC was told", fontsize=10, loc="left")


def _residuals(axes: Any, series: TurnSeries, which: tuple[int, ...], label: str) -> None:
    highest = 0.0
    for axis in which:
        colour = AXIS_COLOURS[axis]
        off = series.rate_deg_s[:, axis] - series.true_deg_s[:, axis]
        band = 3.0 * series.sigma_deg_s[:, axis]
        axes.fill_between(
            series.t_s, -band, band, color=colour, alpha=0.25, lw=0, label=f"{'xyz'[axis]}: its own 3 sigma"
        )
        axes.plot(series.t_s, off, ".", ms=4, color=colour, label=f"{'xyz'[axis]}: telemetered minus true")
        known = np.abs(np.concatenate([off[np.isfinite(off)], band[np.isfinite(band)]]))
        if len(known):
            highest = max(highest, float(np.percentile(known, 97.0)))
    reach = 1.8 * max(highest, 1e-6)
    axes.set_ylim(-reach, reach)
    axes.axhline(0.0, color=INK, lw=0.6)
    axes.set_ylabel(label)
    axes.legend(loc="upper left", fontsize=7.5, ncols=4)


def _modes(axes: Any, series: TurnSeries) -> None:
    for begin, end, mode in spans(series.modes, float(series.t_s.max()) + 0.5):
        axes.axvspan(begin, end, color=MODE_COLOURS.get(mode, OTHER_MODES), alpha=0.75, lw=0, zorder=-10)


def _mode_legend(axes: Any, series: TurnSeries) -> None:
    """Which background is which mode, right of what is drawn."""
    patches = [
        Patch(color=colour, alpha=0.75, label=mode.name.replace("_", " ").lower())
        for mode, colour in MODE_COLOURS.items()
        if any(mode is other for _, other in series.modes)
    ]
    patches.append(Patch(color=OTHER_MODES, alpha=0.75, label="other mode"))
    legend = axes.legend(
        handles=patches,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        fontsize=7.5,
        ncols=4,
        borderaxespad=0.2,
    )
    axes.add_artist(legend)
    axes.legend(loc="upper left", fontsize=7.5, ncols=3)
