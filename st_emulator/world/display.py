"""A sky on a display behind a collimator: the laboratory rig that stands in front of a real star sensor.

Rufino and Moccia (2002) and Fasano et al. (2013, paper F, section 3): each star is one pixel of a display;
where it moves while a scene is shown, it is the strip of pixels that it runs over in that time. The display's
pixels, the time that each scene is shown and its steps of brightness are part of what the sensor measures.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from . import quaternion
from .bodies import ObserverState
from .sampled import SampledTrajectory
from .scene import RenderedFrame, SceneRenderer, _Light
from .star_index import matrix_of
from .stars import SPEED_OF_LIGHT_KM_S

Array = NDArray[np.float64]
I32 = NDArray[np.int32]

GOLDEN = 0.6180339887498949
SWEEPS_A_ROW = 4  # of a strip, to and fro, in the exposure of a row, where a scene outlasts it
MOST_STEPS, MOST_STEPS_BY_ROWS = 1024, 4096
SPREAD_X, SPREAD_Y = 0.7548776662466927, 0.5698402909980532  # R2 sequence (Roberts 2018)


@dataclass(frozen=True)
class Display:
    """A display at the focus of a collimating lens, square to the sensor's boresight.

    columns, rows; pitch_mm of its pixels; focal_mm of the lens (F table 2). update_hz: scenes a second.
    levels: steps of brightness, linear in light. brightest_mag: magnitude of the highest level; brighter
    stars are shown as that.
    """

    columns: int = 2560
    rows: int = 1600
    pitch_mm: float = 641.0 / 2560
    focal_mm: float = 1300.0
    update_hz: float = 60.0  # ASSUMED: F does not print it; the refresh rate of displays of this kind
    levels: int = 255  # ASSUMED: 8 bits a pixel
    brightest_mag: float = 1.0  # ASSUMED: so that a star of 7 mag is the lowest level

    def __post_init__(self) -> None:
        for name in ("columns", "rows", "pitch_mm", "focal_mm", "update_hz", "levels"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} is {getattr(self, name)}; it has to be positive")

    @property
    def pixel_tangent(self) -> float:
        """A pixel's size over the focal length: of the tangent of a direction."""
        return self.pitch_mm / self.focal_mm

    def shown(self, light: Array, of_mag0: float) -> Array:
        """Light of stars as the display shows it, in its steps; ``of_mag0``: light of a magnitude 0 star."""
        step = of_mag0 * 10.0 ** (-0.4 * self.brightest_mag) / self.levels
        return np.asarray(np.minimum(np.rint(light / step), self.levels) * step)


@njit(nogil=True, error_model="numpy")
def _paths(
    chosen: I32, vectors: Array, beta: Array, matrices: Array, spread: Array, display: Array, optics: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Where the light of the stars' display pixels falls, px: xs, ys [n, steps], and which are shown.

    matrices: float64[steps, 3, 3]; spread: float64[steps, 2], place on the display pixel, -1/2 to 1/2.
    display: [pixel_tangent, columns, rows]. A star that leaves the display is not shown at all.
    """
    pixel, half_columns, half_rows = display[0], display[1] / 2.0, display[2] / 2.0
    focal, cx, cy = optics[2], optics[3], optics[4]
    k1, k2, p1, p2 = optics[5], optics[6], optics[7], optics[8]
    n, steps = chosen.shape[0], matrices.shape[0]
    xs, ys = np.zeros((n, steps)), np.zeros((n, steps))
    shown = np.ones(n, np.bool_)
    inverse_gamma = math.sqrt(1.0 - (beta * beta).sum())
    for k in range(n):
        v = vectors[chosen[k]]
        along = 1.0 + (v[0] * beta[0] + v[1] * beta[1] + v[2] * beta[2]) / (1.0 + inverse_gamma)
        ux = inverse_gamma * v[0] + along * beta[0]
        uy = inverse_gamma * v[1] + along * beta[1]
        uz = inverse_gamma * v[2] + along * beta[2]
        for s in range(steps):
            a = matrices[s]
            z = a[2, 0] * ux + a[2, 1] * uy + a[2, 2] * uz
            if z < 0.05:
                shown[k] = False
                break
            column = math.floor((a[0, 0] * ux + a[0, 1] * uy + a[0, 2] * uz) / z / pixel + half_columns)
            row = math.floor((a[1, 0] * ux + a[1, 1] * uy + a[1, 2] * uz) / z / pixel + half_rows)
            if column < 0 or row < 0 or column >= display[1] or row >= display[2]:
                shown[k] = False
                break
            x = (column + 0.5 + spread[s, 0] - half_columns) * pixel
            y = (row + 0.5 + spread[s, 1] - half_rows) * pixel
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * k2)
            xs[k, s] = cx + focal * (x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x))
            ys[k, s] = cy + focal * (y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y)
    return xs, ys, shown


class DisplayRenderer(SceneRenderer):
    """The sky of a scene, shown to the camera by a display. Sun, Moon and Earth are not there; false spots
    are the detector's own and stay. The true middles of stars (``x_mid_px``) are those of the sky: what the
    display does to them is an error of the measurement.
    """

    def __init__(self, display: Display, *arguments: Any, **more: Any) -> None:
        if more.get("bodies"):
            raise ValueError("a display in a dark room shows no Sun, Moon and Earth")
        super().__init__(*arguments, **more)
        self.display = display

    def _light(self, frame: RenderedFrame) -> _Light:
        light = super()._light(frame)
        camera, display = self.camera, self.display
        instants, steps = self._instants(frame)
        points = len(instants)
        matrices = np.empty((points, 3, 3))
        for s, q in enumerate(self.trajectory.q_icrs_to_sensor(instants)):
            matrix_of(q, matrices[s])
        number = np.arange(points)
        spread = np.stack(
            [(0.5 + number * SPREAD_X) % 1.0 - 0.5, (0.5 + number * SPREAD_Y) % 1.0 - 0.5], axis=1
        )
        observer = ObserverState.at(self.trajectory, frame.exposure_mid_ns, self.start_tai_ns)
        beta = observer.velocity_km_s / SPEED_OF_LIGHT_KM_S if self.aberration else np.zeros(3)
        stars = np.flatnonzero(light.number >= 0)
        xs, ys, shown = _paths(
            light.number[stars],
            self._index.vectors,
            beta,
            matrices,
            spread,
            np.array([display.pixel_tangent, display.columns, display.rows]),
            self._optics,
        )
        of_mag0 = camera.electrons_per_s_mag0 * frame.exposure_ns * 1e-9
        electrons = display.shown(light.electrons[stars], of_mag0)
        shown &= electrons > 0.0
        spots = np.flatnonzero(light.number < 0)
        xs = np.concatenate([xs[shown], np.repeat(light.xs[spots, :1], points, axis=1)])
        ys = np.concatenate([ys[shown], np.repeat(light.ys[spots, :1], points, axis=1)])
        box = np.stack(
            [
                np.floor(xs.min(axis=1, initial=1e6) - self._reach_px + 0.5).clip(0),
                np.floor(ys.min(axis=1, initial=1e6) - self._reach_px + 0.5).clip(0),
                (np.floor(xs.max(axis=1, initial=-1e6) + self._reach_px + 0.5) + 1).clip(
                    None, camera.width_px
                ),
                (np.floor(ys.max(axis=1, initial=-1e6) + self._reach_px + 0.5) + 1).clip(
                    None, camera.height_px
                ),
            ],
            axis=1,
        ).astype(np.int32)
        kept = np.concatenate([stars[shown], spots])
        return dataclasses.replace(
            light,
            number=light.number[kept],
            xs=xs,
            ys=ys,
            electrons=np.concatenate([electrons[shown], light.electrons[spots]]),
            box=np.ascontiguousarray(box),
            lit=np.tile(np.array([0, steps], np.int32), (len(kept), 1)),
            middle=light.middle[kept],
            steps=steps,
            row_span=steps * frame.exposure_ns / self._lasts_ns(frame) if self._by_rows else 0.0,
        )

    def _lasts_ns(self, frame: RenderedFrame) -> int:
        return frame.exposure_end_ns - frame.exposure_start_ns

    def _instants(self, frame: RenderedFrame) -> tuple[NDArray[np.int64], int]:
        """(of which instant of the trajectory the display shows a place while the camera looks, sub-steps).

        All of a scene's strip is lit as long as the scene is shown, so that the places are sampled all over
        the strip at any time. Where rows are exposed each in its own time the points are the ends of
        sub-steps, between which light is spread: there the strip is run over to and fro, without a jump.
        """
        start, lasts = frame.exposure_start_ns, self._lasts_ns(frame)
        update_ns = 1e9 / self.display.update_hz
        strip = self._strip_pixels(start, lasts)
        if self._by_rows:
            # an odd number, so that a strip is left where the next one begins
            sweeps = 2 * math.ceil(max(1.0, 0.5 * SWEEPS_A_ROW * update_ns / frame.exposure_ns)) + 1
            a_scene = sweeps * max(4, math.ceil(2.0 * strip * update_ns / lasts))
            steps = int(min(max(math.ceil(a_scene * lasts / update_ns), 48), MOST_STEPS_BY_ROWS))
            seen = start + np.arange(steps + 1) * (lasts / steps)
        else:
            # two a display pixel and more, so that none of the strip is left out
            steps = int(min(max(48, 4 * math.ceil(strip)), MOST_STEPS))
            seen = start + (np.arange(steps) + 0.5) * lasts / steps
        scene_start = np.floor(seen / update_ns) * update_ns
        if self._by_rows:
            swept = sweeps * (seen - scene_start) / update_ns
            back = np.floor(swept) % 2 == 1
            within = np.where(back, 1.0 - swept % 1.0, swept % 1.0)
        else:
            within = (0.5 + np.arange(steps) * GOLDEN) % 1.0
        scene_end = scene_start + update_ns
        if isinstance(self.trajectory, SampledTrajectory):
            # what is to come is not known yet, nor need the past be: strips are of the exposure alone
            scene_start = np.maximum(scene_start, start)
            scene_end = np.minimum(scene_end, frame.exposure_end_ns)
        return np.floor(scene_start + within * (scene_end - scene_start)).astype(np.int64), steps

    def _strip_pixels(self, start_ns: int, lasts_ns: int) -> float:
        """Display pixels that a star runs over in a time, at most."""
        knots = start_ns + (np.arange(5) * lasts_ns) // 4
        q = self.trajectory.q_icrs_to_sensor(knots)
        turns = quaternion.multiply(q[1:], quaternion.conjugate(q[:-1]))
        angle = float(2.0 * np.arcsin(np.clip(np.linalg.norm(turns[:, :3], axis=1), 0, 1)).sum())
        return angle * (1.0 + math.tan(self._half_diagonal_rad) ** 2) / self.display.pixel_tangent
