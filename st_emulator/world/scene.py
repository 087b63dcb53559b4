"""The renderer: from the true sky and trajectory to the numbers that the detector puts out.

One frame is a pure function of (the renderer's arguments, frame index, exposure start, exposure). Pixels are
made when asked for: `RenderedFrame.windows` renders only what it is asked, and every bit of it equals that of
the full frame.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import noise, point_spread, quaternion, time_scales
from .bodies import Body, ObserverState, Stray
from .camera import CameraModel
from .exposed_rows import share_table
from .exposure_path import MAX_STEP_PX, Sight, exposure_path
from .false_spots import FalseSpots
from .lit_scene import Scene
from .star_index import PATH_BLOCK, image_paths, star_index_of
from .stars import SPEED_OF_LIGHT_KM_S, StarField
from .trajectory import Trajectory
from .truth_record import TrueStar, TruthRecord
from .windows import checked_windows, cut_windows, window_offsets

Array = NDArray[np.float64]
U16 = NDArray[np.uint16]

# A star whose brightest pixel gets less than this fraction of the background's noise is left out.
FAINTEST_SHARE_OF_NOISE = 0.05
_NOWHERE = np.array([0.0, 0.0, 1.0, 2.0])  # occults nothing


@dataclass(frozen=True)
class _Light:
    """All that a frame's pixels follow from, but the noise: made once a frame, on first need."""

    number: NDArray[np.int32]
    xs: Array
    ys: Array
    electrons: Array
    box: NDArray[np.int32]
    lit: NDArray[np.int32]
    middle: Array
    steps: int
    row_span: float
    strays: tuple[Stray, ...]
    false_spots: Array
    stray_electrons: float
    glow_columns: NDArray[np.float32]
    glow_rows: NDArray[np.float32]


class RenderedFrame:
    """One exposure, rendered when and where asked: the frame interface that the firmware knows.

    width_px, height_px, bits; full(); windows(rects). Safe to use from another thread; keeps the full frame
    once made. exposure_ns: of each row. row_time_s: a rolling shutter's row begins its exposure so much after
    the row before; 0: a global shutter.
    """

    def __init__(
        self, renderer: SceneRenderer, frame_index: int, exposure_start_ns: int, exposure_ns: int
    ) -> None:
        self._renderer = renderer
        self.frame_index = frame_index
        self.exposure_start_ns = exposure_start_ns
        self.exposure_ns = exposure_ns
        self.width_px = renderer.camera.width_px
        self.height_px = renderer.camera.height_px
        self.bits = renderer.camera.bits
        self.row_time_s = renderer.camera.row_time_s
        self._full: U16 | None = None

    @property
    def exposure_mid_ns(self) -> int:
        """The frame's time: with a rolling shutter that of the middle of its rows."""
        return self.exposure_start_ns + (self.exposure_ns + self._renderer.camera.last_row_start_ns) // 2

    @property
    def exposure_end_ns(self) -> int:
        """Of the last row."""
        return self.exposure_start_ns + self._renderer.camera.last_row_start_ns + self.exposure_ns

    @functools.cached_property
    def light(self) -> _Light:
        return self._renderer._light(self)

    def full(self) -> U16:
        """uint16[height, width], not to be written to."""
        if self._full is None:
            rects = np.array([[0, 0, self.width_px, self.height_px]], dtype=np.int32)
            pixels, _ = self._renderer._pixels(self, rects)
            pixels.setflags(write=False)
            self._full = pixels.reshape(self.height_px, self.width_px)
        return self._full

    def windows(self, rects: ArrayLike) -> tuple[U16, NDArray[np.int64]]:
        """Rectangles int32[n, 4] (x0, y0, x1, y1, half-open) -> (flat uint16[total], offsets int64[n + 1]).

        Window i is flat[offsets[i]:offsets[i + 1]], row by row. Raises ValueError for one outside the image.
        """
        if self._full is not None:
            return cut_windows(self._full, rects)
        return self._renderer._pixels(self, checked_windows(rects, self.width_px, self.height_px))

    def mean_electrons(self, rect: Sequence[int] | None = None) -> NDArray[np.float32]:
        """Expected charge before noise and saturation, of a rectangle or of all: float32[rows, columns]."""
        chosen = (0, 0, self.width_px, self.height_px) if rect is None else rect
        checked = checked_windows([chosen], self.width_px, self.height_px)[0]
        return np.asarray(point_spread.expose(checked, self._renderer._scene(self)))


class SceneRenderer:
    """The sky as one camera sees it along one trajectory."""

    def __init__(
        self,
        camera: CameraModel,
        stars: StarField,
        trajectory: Trajectory,
        *,
        seed: int = 0,
        start_tai_ns: int = 2_145_916_837_000_000_000,
        aberration: bool = True,
        parallax: bool = False,
        bodies: Sequence[Body] = (),
        false_spots: FalseSpots | None = None,
        quick_light: bool = False,
    ) -> None:
        """start_tai_ns: TAI ns since 1958-01-01 at virtual time 0 (default: 2026-01-01T00:00:00 UTC).

        aberration: stars appear where the velocity of the observer (the Earth's about the barycentre plus the
        trajectory's own) puts them; the true attitude is the geometric one, ICRS to sensor, whatever this
        says. parallax: directions from the observer instead of from the barycentre (under 0.8 arcsec, mostly
        far less). bodies: what may blind the camera: `bodies.Sun`, `Moon`, `Earth`. seed: of all noise and
        the fixed pattern. quick_light: a global shutter's light comes as a rolling shutter's always does (see
        `exposed_rows`): 5e-6 of a star's light off, but several times as fast where stars are drawn out.
        """
        self.camera = camera
        self._by_rows = quick_light or camera.rolling_readout_ns > 0
        self.stars = stars
        self.trajectory = trajectory
        self.seed = int(seed)
        self.start_tai_ns = int(start_tai_ns)
        self.aberration = aberration
        self.parallax = parallax
        self.bodies = tuple(bodies)
        self.false_spots = false_spots or FalseSpots()
        self._index = star_index_of(stars)
        self._electrons_s = camera.electrons_per_s_mag0 * 10.0 ** (
            -0.4 * self._index.hp_mag.astype(np.float64)
        )
        self._half_diagonal_rad = camera.half_diagonal_rad()
        self._reach_px = point_spread.SUPPORT_SIGMA * camera.psf_sigma_px
        self._sight = Sight(
            camera.focal_px,
            math.tan(min(self._half_diagonal_rad, 1.4)),
            *(_steps_by_rows_px(camera.psf_sigma_px) if self._by_rows else (MAX_STEP_PX, MAX_STEP_PX)),
        )
        self._share_table = share_table(float(camera.psf_sigma_px), self._reach_px)
        if self._by_rows:
            self._reach_px = self._share_table.shape[1] / 2.0  # all that the table lights
        self._row_starts_ns = camera.row_starts_ns.astype(np.float64)
        cx, cy = camera.principal_point_px
        self._optics = np.array(
            [
                camera.width_px,
                camera.height_px,
                camera.focal_px,
                cx,
                cy,
                camera.k1,
                camera.k2,
                camera.p1,
                camera.p2,
            ]
        )
        self._detector = noise.detector_constants(
            camera.read_noise_electrons,
            camera.electrons_per_dn,
            camera.offset_dn,
            camera.bits,
            camera.full_well_electrons,
        )
        streams = (noise.STREAM_RESPONSE, noise.STREAM_DARK, noise.STREAM_HOT, noise.STREAM_HOT_AMOUNT)
        self.response, self.dark_electrons_s = noise.fixed_pattern(
            np.array([noise.stream_key(self.seed, stream) for stream in streams], dtype=np.uint64),
            noise.NORMAL_TABLE,
            camera.width_px,
            camera.height_px,
            camera.prnu,
            camera.dark_electrons_s,
            camera.dark_nonuniformity,
            camera.hot_pixel_fraction,
            camera.hot_pixel_electrons_s,
        )

    def frame(
        self, frame_index: int, exposure_start_ns: int, exposure_ns: int | None = None
    ) -> RenderedFrame:
        """The frame of one exposure (default: the camera's); costs nothing until pixels are asked for."""
        exposure = self.camera.exposure_ns if exposure_ns is None else int(exposure_ns)
        if exposure <= 0:
            raise ValueError(f"exposure_ns is {exposure}; it has to be positive")
        return RenderedFrame(self, int(frame_index), int(exposure_start_ns), exposure)

    def truth(self, frame: RenderedFrame, limit_mag: float = math.inf) -> TruthRecord:
        """What is true of a frame, with the stars of Hp < limit_mag whose middle lies in the image."""
        light = frame.light
        middle_ns = frame.exposure_mid_ns
        q = self.trajectory.q_icrs_to_sensor(middle_ns)
        ra, dec, roll = quaternion.pointing_from_quaternion(q)
        electrons = light.electrons
        if light.row_span > 0.0:
            x, y, electrons = point_spread.seen_places(self._scene(frame))
        else:
            x, y = light.xs.mean(axis=1), light.ys.mean(axis=1)
        inside = (np.abs(x + 0.5 - frame.width_px / 2) <= frame.width_px / 2) & (
            np.abs(y + 0.5 - frame.height_px / 2) <= frame.height_px / 2
        )
        stars = np.flatnonzero(inside & (light.number >= 0) & (electrons > 0.0))
        magnitudes = self._index.hp_mag[light.number[stars]]
        order = np.lexsort((light.number[stars], magnitudes))
        listed = stars[order][magnitudes[order] < limit_mag]
        return TruthRecord(
            frame_index=frame.frame_index,
            exposure_start_ns=frame.exposure_start_ns,
            exposure_mid_ns=middle_ns,
            exposure_end_ns=frame.exposure_end_ns,
            tai_ns=self.start_tai_ns + middle_ns,
            q_icrs_to_sensor=(float(q[0]), float(q[1]), float(q[2]), float(q[3])),
            rate_rad_s=_triple(self.trajectory.rate_sensor(middle_ns)) or (0.0, 0.0, 0.0),
            ra_deg=ra,
            dec_deg=dec,
            roll_deg=roll,
            sub_steps=light.steps,
            bodies={
                stray.body: {"angle_deg": stray.angle_deg, "stray_electrons_s": stray.electrons_s}
                for stray in light.strays
            },
            position_km=_triple(self.trajectory.position_km(middle_ns)),
            velocity_km_s=_triple(self.trajectory.velocity_km_s(middle_ns)),
            stars=tuple(
                TrueStar(
                    hip=int(self._index.hip[light.number[k]]),
                    x_px=float(x[k]),
                    y_px=float(y[k]),
                    hp_mag=float(self._index.hp_mag[light.number[k]]),
                    electrons=float(electrons[k]),
                    x_mid_px=float(light.middle[k, 0]),
                    y_mid_px=float(light.middle[k, 1]),
                )
                for k in listed
            ),
            false_spots=tuple((float(a), float(b), float(c)) for a, b, c in light.false_spots),
        )

    def _light(self, frame: RenderedFrame) -> _Light:
        camera = self.camera
        start, middle, exposure = frame.exposure_start_ns, frame.exposure_mid_ns, frame.exposure_ns
        exposure_s = exposure * 1e-9
        later = camera.last_row_start_ns
        path = exposure_path(self.trajectory, start, exposure, later, self._sight, self._by_rows)
        row_step = row_span = 0.0
        if self._by_rows:
            steps_per_ns = path.steps / (exposure + later)
            row_step = camera.rolling_readout_ns / camera.height_px * steps_per_ns
            row_span = exposure * steps_per_ns
        spread_rad = path.across_rad
        attitude = quaternion.attitude_matrix(path.at_middle)
        boresight = attitude[2]
        observer = ObserverState.at(self.trajectory, middle, self.start_tai_ns)
        strays, occulting = [], _NOWHERE
        for body in self.bodies:
            stray = body.stray(observer, boresight, frame.exposure_ns, camera, self._half_diagonal_rad)
            if stray is not None:
                strays.append(stray)
                occulting = stray.occulting if stray.occulting is not None else occulting
        beta = observer.velocity_km_s / SPEED_OF_LIGHT_KM_S if self.aberration else np.zeros(3)
        place_au = observer.barycentric_km / time_scales.AU_KM if self.parallax else np.zeros(3)
        margin_rad = (
            (self._reach_px + 1.0) / camera.focal_px + spread_rad + 5e-4
        )  # 5e-4: aberration and parallax
        path_rad = spread_rad * exposure / (exposure + later) if path.even else 0.0
        chosen = self._index.within(
            boresight, self._half_diagonal_rad + margin_rad, self._limit_mag(exposure_s, path_rad)
        )
        spots = self.false_spots.in_frame(self.seed, frame.frame_index, camera.width_px, camera.height_px)
        spots_light = spots.copy()
        spots_light[:, 2] = camera.electrons_per_s_mag0 * exposure_s * 10.0 ** (-0.4 * spots[:, 2])
        number, xs, ys, electrons, box, lit, middles = image_paths(
            chosen,
            self._index.vectors,
            self._index.parallax_rad,
            self._electrons_s,
            place_au,
            beta,
            occulting,
            path.attitudes,
            path.at_middle,
            self._optics,
            self._reach_px,
            exposure_s,
            spots_light,
            row_step,
            row_span,
            PATH_BLOCK * path.step_px + 2.0,
        )
        columns, rows = _glow(strays, attitude, camera, exposure_s)
        return _Light(
            number,
            xs,
            ys,
            electrons,
            box,
            lit,
            middles,
            path.steps,
            row_span,
            tuple(strays),
            spots,
            camera.stray_electrons_s * exposure_s,
            columns,
            rows,
        )

    def _limit_mag(self, exposure_s: float, path_rad: float) -> float:
        """Stars from this magnitude on are left out, see FAINTEST_SHARE_OF_NOISE. path_rad: over which their
        light is spread at least."""
        camera = self.camera
        background = (camera.stray_electrons_s + camera.dark_electrons_s) * exposure_s
        least = FAINTEST_SHARE_OF_NOISE * math.sqrt(background + camera.read_noise_electrons**2)
        peak_share = math.erf(0.5 / (math.sqrt(2.0) * camera.psf_sigma_px)) ** 2
        path_px = path_rad * camera.focal_px
        # a pixel of a streak gets the light of about sqrt(2 pi) sigma of its length
        peak_share *= min(1.0, 2.5 * camera.psf_sigma_px / path_px) if path_px > 0.0 else 1.0
        brightest = camera.electrons_per_s_mag0 * exposure_s * peak_share
        if brightest <= 0.0:
            return -100.0
        return 2.5 * math.log10(brightest / least) if least > 0.0 else 100.0

    def _scene(self, frame: RenderedFrame) -> Scene:
        light = frame.light
        return Scene(
            xs=light.xs,
            ys=light.ys,
            light=light.electrons,
            box=light.box,
            sigma_px=float(self.camera.psf_sigma_px),
            phi_table=point_spread.PHI_TABLE,
            stray=float(light.stray_electrons),
            glow_columns=light.glow_columns,
            glow_rows=light.glow_rows,
            response=self.response,
            dark=self.dark_electrons_s,
            exposure_s=frame.exposure_ns * 1e-9,
            row_starts=self._row_starts_ns * (light.row_span / frame.exposure_ns),
            row_span=light.row_span,
            lit=light.lit,
            share_table=self._share_table,
        )

    def _pixels(self, frame: RenderedFrame, rects: NDArray[np.int32]) -> tuple[U16, NDArray[np.int64]]:
        offsets = window_offsets(rects)
        out = np.empty(int(offsets[-1]), dtype=np.uint16)
        key = noise.stream_key(self.seed, noise.STREAM_FRAME, frame.frame_index)
        point_spread.render(rects, self._scene(frame), key, noise.NORMAL_TABLE, self._detector, offsets, out)
        return out, offsets


def _steps_by_rows_px(sigma_px: float) -> tuple[float, float]:
    """(longest step, that of a short path). A step of one sigma leaves ripples of 1e-8 in a streak; its ends
    are cut where the rows' exposures are, and show in a short one."""
    return min(max(MAX_STEP_PX, sigma_px), 1.0), 0.5 * MAX_STEP_PX


def _glow(
    strays: Sequence[Stray], attitude: Array, camera: CameraModel, exposure_s: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Column and row factors of each body's stray light: level x exp(slope along the image towards the
    body)."""
    cx, cy = camera.principal_point_px
    strays = [stray for stray in strays if stray.electrons_s * exposure_s > 1e-3]
    columns = np.empty((len(strays), camera.width_px), dtype=np.float32)
    rows = np.empty((len(strays), camera.height_px), dtype=np.float32)
    for k, stray in enumerate(strays):
        towards = attitude @ stray.direction
        across = math.hypot(towards[0], towards[1])
        slope = stray.slope_per_rad / camera.focal_px
        slope_x, slope_y = (
            (slope * towards[0] / across, slope * towards[1] / across) if across > 1e-9 else (0.0, 0.0)
        )
        columns[k] = stray.electrons_s * exposure_s * np.exp(slope_x * (np.arange(camera.width_px) - cx))
        rows[k] = np.exp(slope_y * (np.arange(camera.height_px) - cy))
    return columns, rows


def _triple(vector: Array | None) -> tuple[float, float, float] | None:
    return None if vector is None else (float(vector[0]), float(vector[1]), float(vector[2]))
