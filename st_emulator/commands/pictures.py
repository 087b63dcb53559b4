"""Pictures: a frame with its detection windows and identified stars; a run over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.patches import Rectangle

from ..device.imaging import FrameRecord
from ..errors import ConfigurationError
from ..firmware_model.firmware import FrameResult
from ..protocol.pus.enumerations import Mode
from ..units.profile import UnitProfile

if TYPE_CHECKING:
    from .series import Series

WINDOW_COLOUR = "#ffb000"
STAR_COLOUR = "#40c4ff"
SPOT_COLOUR = "#ff5252"
INK = "#e8eaed"
PAPER = "#14171c"
MOST_LABELS = 14
PICTURE_SUFFIXES = (".png", ".svg", ".pdf", ".jpg")
MODE_ORDER = [
    Mode.OFF,
    Mode.BOOT,
    Mode.SELF_TEST,
    Mode.STANDBY,
    Mode.RATE_ONLY,
    Mode.LOST_IN_SPACE,
    Mode.TRACKING,
]
STYLE: dict[Any, Any] = {
    "figure.facecolor": PAPER,
    "axes.facecolor": "#0c0e12",
    "axes.edgecolor": "#5f6368",
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": "#3c4043",
    "font.size": 9,
    "legend.facecolor": PAPER,
    "legend.edgecolor": "#5f6368",
}


def _frame_on(axes: Any, frame: Any, result: FrameResult) -> None:
    """The image, stretched so that faint stars show, with windows, spots and identified stars."""
    pixels = np.asarray(frame.full(), dtype=float)
    low = float(np.percentile(pixels, 5))
    # Each cell shows its brightest pixel: a star of two pixels must not fall between the dots of the picture.
    step = max(1, round(max(pixels.shape) / 1000))
    rows, columns = (size // step * step for size in pixels.shape)
    cells = pixels[:rows, :columns].reshape(rows // step, step, columns // step, step).max(axis=(1, 3))
    high = low + max(float(np.percentile(cells, 99.9)) - low, 20.0)
    extent = (-0.5, columns - 0.5, rows - 0.5, -0.5)
    axes.imshow(
        np.clip((cells - low) / (high - low), 0, 1) ** 0.6,
        cmap="gray",
        extent=extent,
        interpolation="nearest",
    )
    for x0, y0, x1, y1 in result.rects:
        axes.add_patch(
            Rectangle(
                (x0 - 0.5, y0 - 0.5), x1 - x0, y1 - y0, fill=False, edgecolor=WINDOW_COLOUR, linewidth=0.8
            )
        )
    spots, stars = result.spots, result.stars
    radius = max(pixels.shape) / 90
    axes.scatter(
        spots.x_px, spots.y_px, s=18, facecolors="none", edgecolors=SPOT_COLOUR, linewidths=0.6, label="spots"
    )
    axes.scatter(
        stars.x_px,
        stars.y_px,
        s=60,
        facecolors="none",
        edgecolors=STAR_COLOUR,
        linewidths=1.1,
        label="identified stars",
    )
    for hip, x, y in list(zip(stars.hip, stars.x_px, stars.y_px, strict=True))[:MOST_LABELS]:
        left = x > 0.88 * pixels.shape[1]
        axes.annotate(
            f"HIP {hip}",
            (x, y),
            xytext=(x + (-radius if left else radius), y - radius),
            ha="right" if left else "left",
            fontsize=6.5,
            color=STAR_COLOUR,
        )
    if len(result.rects):
        axes.plot([], [], color=WINDOW_COLOUR, label="detection windows")
    axes.set_xlim(-0.5, pixels.shape[1] - 0.5)
    axes.set_ylim(pixels.shape[0] - 0.5, -0.5)
    axes.set_xlabel("column, px      (dots without a mark: stars fainter than the catalogue, hot pixels)")
    axes.set_ylabel("row, px")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize=7, ncols=3, borderaxespad=0.2)


def require_picture_path(path: Path) -> None:
    """See before the work that a picture can be written afterwards.

    Raises:
        ConfigurationError: a suffix that is no picture's, or a folder that does not exist.
    """
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        raise ConfigurationError(
            f"{path}: suffix {path.suffix or 'missing'}; allowed are {', '.join(PICTURE_SUFFIXES)}"
        )
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise ConfigurationError(f"{path}: cannot be written: allowed is a file in a folder that exists")


def _save(figure: Any, path: Path) -> None:
    try:
        figure.savefig(path, dpi=110)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}") from error
    finally:
        plt.close(figure)


def draw_frame(frame: Any, result: FrameResult, path: Path, title: str) -> None:
    """One frame with what the firmware found in it."""
    with plt.rc_context(STYLE):
        aspect = frame.height_px / frame.width_px
        figure, axes = plt.subplots(figsize=(11, 11 * aspect + 1.2), layout="constrained")
        _frame_on(axes, frame, result)
        axes.set_title(title.replace("$", r"\$"))
        _save(figure, path)


def draw_run(profile: UnitProfile, record: FrameRecord, series: Series, path: Path) -> None:
    """A tracked frame above attitude error and mode over time."""
    assert record.result is not None
    with plt.rc_context(STYLE):
        figure, axes = plt.subplot_mosaic(
            [["frame"], ["cross"], ["roll"], ["mode"]],
            figsize=(10, 13),
            height_ratios=[6, 1.7, 1.7, 1.5],
            layout="constrained",
        )
        _frame_on(axes["frame"], record.pixels, record.result)
        result = record.result
        figure.suptitle(
            f"{profile.unit.title}\n"
            f"frame {record.index}: {len(result.stars)} stars identified in {len(result.rects)} detection "
            f"windows of half-width {result.window_half_width_px} px",
            fontsize=10,
        )
        valid = series.valid
        for axis, name, colour in ((0, "x", STAR_COLOUR), (1, "y", WINDOW_COLOUR)):
            axes["cross"].plot(
                series.t_s[valid],
                series.error_arcsec[valid, axis],
                ".-",
                ms=3,
                lw=0.7,
                color=colour,
                label=name,
            )
        target = profile.requirements.cross_boresight_arcsec
        if target is not None:
            axes["cross"].axhspan(
                -target, target, color="#34a853", alpha=0.18, label=f"1 sigma target {target:g}"
            )
        axes["cross"].set_ylabel("cross-boresight\nerror, arcsec")
        axes["roll"].plot(
            series.t_s[valid], series.error_arcsec[valid, 2], ".-", ms=3, lw=0.7, color="#c58af9"
        )
        axes["roll"].set_ylabel("roll error,\narcsec")
        for name in ("cross", "roll"):
            shown_axes = (0, 1) if name == "cross" else (2,)
            _bounds(axes[name], series.error_arcsec[valid][:, shown_axes])
            _shade_slew(axes[name], series)
            axes[name].grid(True, lw=0.4)
        axes["cross"].legend(loc="upper left", fontsize=7, ncols=4)
        times = [t_s for t_s, _ in series.modes]
        places = [MODE_ORDER.index(mode) for _, mode in series.modes]
        end_s = max(times[-1], float(series.t_s.max())) + 0.5
        axes["mode"].step([*times, end_s], [*places, places[-1]], where="post", color=INK, lw=1.4)
        lost = ~valid
        axes["mode"].plot(
            series.t_s[lost],
            [MODE_ORDER.index(Mode(int(mode))) for mode in series.mode[lost]],
            "x",
            color=SPOT_COLOUR,
            ms=5,
            label="no valid attitude",
        )
        axes["mode"].set_yticks(
            range(len(MODE_ORDER)), [mode.name.replace("_", " ").lower() for mode in MODE_ORDER]
        )
        axes["mode"].set_ylim(-0.4, len(MODE_ORDER) - 0.6)
        axes["mode"].grid(True, axis="y", lw=0.4)
        axes["mode"].set_xlabel("time since power-on, s")
        _shade_slew(axes["mode"], series)
        if lost.any():
            axes["mode"].legend(loc="lower right", fontsize=7)
        limits = (0.0, end_s)
        for name in ("cross", "roll", "mode"):
            axes[name].set_xlim(*limits)
        _save(figure, path)


def _bounds(axes: Any, errors: Any) -> None:
    if len(errors):
        reach = 1.15 * max(float(np.max(np.abs(errors))), 0.8)
        axes.set_ylim(-reach, reach)


def _shade_slew(axes: Any, series: Series) -> None:
    moving = np.flatnonzero(~series.at_rest)
    if len(moving):
        axes.axvspan(series.t_s[moving[0]], series.t_s[moving[-1]], color="#9aa0a6", alpha=0.22, lw=0)
        axes.annotate(
            "slew",
            (series.t_s[moving].mean(), 0.86),
            xycoords=("data", "axes fraction"),
            ha="center",
            fontsize=7,
        )
