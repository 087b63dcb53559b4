"""Directions, aberration, attitude and rate on the ARM, each compared with the Python stage's result.

Where only additions, multiplications, divisions and square roots are done, all of which are rounded alike,
the results are the same bits. Where the C library takes part they differ in a last place now and then.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from st_emulator.firmware_model.attitude import AttitudeSolution
from st_emulator.firmware_model.configuration import CentroidError
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.geometry import CameraGeometry
from st_emulator.firmware_model.work import Work
from tools.arm_timing.machine import ArmMachine, Call
from tools.calibration.steps.step import MismatchError, StageRun
from tools.calibration.struct_layout import place_struct, read_struct, reserve_structs

__all__ = [
    "CHANCE_BOUND",
    "COVARIANCE_BOUND",
    "QUATERNION_BOUND",
    "RATE_BOUND",
    "RESIDUAL_BOUND_RAD",
    "STEPS",
    "VELOCITY_BOUND",
    "place_camera",
    "place_vectors",
]

FloatArray = npt.NDArray[np.float64]

VELOCITY_BOUND = 1e-18  # of the speed of light: a last place of 1e-4
QUATERNION_BOUND = 1e-12  # of an element: a hundred million times less than a centroid's error
RESIDUAL_BOUND_RAD = 1e-12
COVARIANCE_BOUND = 1e-9  # relative to its largest element; it grows with the residuals' squares
CHANCE_BOUND = 1e-9  # relative; an exponential of up to 700
RATE_BOUND = 1e-12  # relative

_DOUBLE_BYTES = 8
_WORD_BYTES = 4
_SCRATCH_DOUBLES = 9  # ST_ATTITUDE_SCRATCH_DOUBLES
_OPTICS = ("focal_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "r2_limit")  # CameraGeometry's parameters


def place_camera(machine: ArmMachine, geometry: CameraGeometry) -> int:
    """An st_camera."""
    return place_struct(
        machine,
        "st_camera",
        **dict(zip(_OPTICS, geometry.kernel_parameters, strict=True)),
        normals=geometry.plane_normals.ravel(),
        width_px=geometry.width_px,
        height_px=geometry.height_px,
    )


def place_vectors(machine: ArmMachine, vectors: Any) -> int:
    """Numbers as doubles, C order."""
    return machine.place(np.ascontiguousarray(vectors, np.float64))


def _require_same(step: str, what: str, found: npt.NDArray[Any], expected: npt.NDArray[Any]) -> None:
    if not np.array_equal(found, expected):
        raise MismatchError(f"{step}: {what} {found}, {expected} in Python")


def _require_near(step: str, what: str, found: FloatArray, expected: FloatArray, bound: float) -> None:
    off = float(np.max(np.abs(found - expected), initial=0.0))
    if not off <= bound:
        raise MismatchError(f"{step}: {what} off by {off:.3g}, {bound:.3g} are allowed")


class VelocityStep:
    """Velocity of the observer from the date."""

    name = "velocity"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        arguments = record.arguments
        low, high = struct.unpack("<II", struct.pack("<q", arguments["tai_ns"]))
        about_earth = place_vectors(machine, arguments["velocity_km_s"])
        over_c = machine.reserve(3 * _DOUBLE_BYTES)
        call = machine.call("st_velocity_over_c", low, high, about_earth, over_c)
        found = machine.read(over_c, np.float64, 3)
        machine.release()
        _require_near(self.name, "velocity over c", found, record.result, VELOCITY_BOUND)
        return [StageRun(self.name, "attitude", call.cost, record.work)]


class UnitVectorsStep:
    """Spots' places to directions: the same bits, with distortion or without."""

    name = "unit_vectors"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        x_px, y_px = record.arguments["x_px"], record.arguments["y_px"]
        count = len(x_px)
        vectors = machine.reserve(3 * _DOUBLE_BYTES * count)
        call = machine.call(
            "st_unit_vectors",
            place_vectors(machine, x_px),
            place_vectors(machine, y_px),
            count,
            place_camera(machine, record.arguments["geometry"]),
            vectors,
        )
        found = machine.read(vectors, np.float64, (count, 3))
        machine.release()
        _require_same(self.name, "vectors", found, record.result)
        return [StageRun(self.name, "centroid", call.cost, record.work)] if count else []


class ApparentStep:
    """Catalogue directions with aberration: the same bits."""

    name = "apparent"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        """One run; none without a velocity, where the kernel copies and nothing is counted."""
        arguments = record.arguments
        rows, velocity = arguments["rows"], arguments["velocity"]
        apparent = machine.reserve(3 * _DOUBLE_BYTES * len(rows))
        call = machine.call(
            "st_apparent",
            machine.place(arguments["unit_vectors"], keep=True),
            machine.place(rows),
            len(rows),
            place_vectors(machine, velocity),
            apparent,
        )
        found = machine.read(apparent, np.float64, (len(rows), 3))
        machine.release()
        _require_same(self.name, "directions", found, record.result)
        return [StageRun(self.name, "attitude", call.cost, record.work)] if record.work.counts else []


class AttitudeStep:
    """Expected errors of the centroids, then the robust q-method: a run each, of the stage attitude."""

    name = "attitude"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        arguments = record.arguments
        count = len(arguments["measured"])
        kept = machine.reserve(_WORD_BYTES * count)
        residuals = machine.reserve(_DOUBLE_BYTES * count)
        result = reserve_structs(machine, "st_attitude_result")
        sigma, errors = self._sigma(machine, arguments)
        solving = machine.call(
            "st_robust_attitude",
            place_vectors(machine, arguments["measured"]),
            place_vectors(machine, arguments["reference"]),
            sigma,
            count,
            float(arguments["tolerance_rad"]),
            int(arguments["least"]),
            kept,
            residuals,
            machine.reserve(_SCRATCH_DOUBLES * _DOUBLE_BYTES * count),
            result,
        )
        solved = read_struct(machine, "st_attitude_result", result)
        indices = np.flatnonzero(machine.read(kept, np.int32, count))
        found = machine.read(residuals, np.float64, count)
        machine.release()
        self._compare(solved, indices, found, *record.result)
        rest = {name: number for name, number in record.work.counts.items() if name != "centroid_errors"}
        weighed = Work({"centroid_errors": record.work["centroid_errors"]})
        runs = [StageRun(self.name, "attitude", errors.cost, weighed)]
        if rest.get("covariance_stars"):
            runs.append(StageRun(self.name, "attitude", solving.cost, Work(rest)))
        return runs

    def _sigma(self, machine: ArmMachine, arguments: dict[str, Any]) -> tuple[int, Call]:
        """Address of the sigmas and the call that computes them; the same bits as in Python."""
        error: CentroidError = arguments["centroid_error"]
        flux_dn, focal_px = arguments["flux_dn"], float(arguments["focal_px"])
        noise_dn = float(arguments["noise_dn"])
        sigma = machine.reserve(_DOUBLE_BYTES * len(flux_dn))
        call = machine.call(
            "st_centroid_sigma_rad",
            place_vectors(machine, flux_dn),
            len(flux_dn),
            noise_dn,
            place_struct(
                machine,
                "st_centroid_error",
                floor_px=error.floor_px,
                photon_px=error.photon_px,
                electrons_per_dn=error.electrons_per_dn,
                window_factor=error.window_factor,
            ),
            focal_px,
            sigma,
        )
        found = machine.read(sigma, np.float64, len(flux_dn))
        _require_same(self.name, "sigmas", found, error.sigma_px(flux_dn, noise_dn) / focal_px)
        return sigma, call

    def _compare(
        self,
        found: np.void,
        indices: npt.NDArray[np.intp],
        residuals: FloatArray,
        solution: AttitudeSolution | None,
        kept: npt.NDArray[np.intp],
    ) -> None:
        q, covariance = found["q"], found["covariance"].reshape(3, 3)
        chi_square, left, solved = float(found["chi_square"]), int(found["left"]), found["solved"]
        _require_same(self.name, "stars kept", indices, kept)
        if bool(solved) != (solution is not None):
            raise MismatchError(f"{self.name}: solved is {solved}, {solution is not None} in Python")
        if solution is None:
            return
        _require_near(self.name, "quaternion", q, solution.q_icrs_to_sensor, QUATERNION_BOUND)
        _require_near(self.name, "residuals", residuals[:left], solution.residuals_rad, RESIDUAL_BOUND_RAD)
        expected = solution.covariance_rad2
        largest = float(np.abs(expected).max())
        _require_near(self.name, "covariance", covariance, expected, COVARIANCE_BOUND * largest)
        if not math.isclose(chi_square, solution.chi_square, rel_tol=COVARIANCE_BOUND, abs_tol=1e-12):
            raise MismatchError(f"{self.name}: chi^2 {chi_square}, {solution.chi_square} in Python")


class FalseSolutionsStep:
    """How likely chance gives as good a solution: the stars' spread, then the logarithms."""

    name = "false_solutions"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        arguments = record.arguments
        b = place_vectors(machine, arguments["b_vectors"])
        spread = machine.call("st_spread", b, len(arguments["b_vectors"]))
        chance = machine.call(
            "st_false_solutions",
            int(arguments["stars"]),
            int(arguments["spots"]),
            int(arguments["matched"]),
            spread.result_pair,
            float(arguments["tolerance_rad"]),
        )
        machine.release()
        if not math.isclose(chance.result_pair, record.result, rel_tol=CHANCE_BOUND):
            raise MismatchError(f"{self.name}: {chance.result_pair}, {record.result} in Python")
        return [StageRun(self.name, "attitude", spread.cost + chance.cost, record.work)]


class RateStep:
    """Angular rate, and whether it is too high to track."""

    name = "rate"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        arguments = record.arguments
        tracking = arguments["tracking"]
        interval_s = float(arguments["interval_s"])
        rate = machine.reserve(3 * _DOUBLE_BYTES)
        turning = machine.call(
            "st_angular_rate",
            place_vectors(machine, arguments["before"]),
            place_vectors(machine, arguments["after"]),
            interval_s,
            rate,
        )
        testing = machine.call(
            "st_rate_too_high",
            rate,
            interval_s,
            place_vectors(machine, arguments["covariance_before_rad2"]),
            place_vectors(machine, arguments["covariance_after_rad2"]),
            float(tracking.rate_rad_s * (1.0 + tracking.rate_margin)),
        )
        covariance = machine.reserve(9 * _DOUBLE_BYTES)
        spreading = machine.call(
            "st_rate_covariance",
            place_vectors(machine, arguments["covariance_before_rad2"]),
            place_vectors(machine, arguments["covariance_after_rad2"]),
            interval_s,
            covariance,
        )
        found = machine.read(rate, np.float64, 3)
        spread = machine.read(covariance, np.float64, (3, 3))
        machine.release()
        largest = float(np.abs(record.result).max())
        _require_near(self.name, "rate", found, record.result, RATE_BOUND * largest)
        expected = arguments["covariance_before_rad2"] + arguments["covariance_after_rad2"]
        _require_same(self.name, "covariance", spread, expected / interval_s**2)
        return [StageRun(self.name, "attitude", turning.cost + testing.cost + spreading.cost, record.work)]


STEPS = (
    VelocityStep(),
    UnitVectorsStep(),
    ApparentStep(),
    AttitudeStep(),
    FalseSolutionsStep(),
    RateStep(),
)
