"""The parts of an attitude one by one: q-method, residuals and covariance of as many stars as there may be.

In a frame all of them take the same stars, and only their sum can be told; identifications use the first
alone. Here each runs for itself, so that each of its counts has its own cost.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from st_emulator.firmware_model.attitude import covariance_kernel, quaternion_kernel, residuals_kernel
from st_emulator.firmware_model.frame_trace import StepRecord
from st_emulator.firmware_model.work import Work
from tools.arm_timing.machine import ArmMachine
from tools.calibration.steps.attitude import RESIDUAL_BOUND_RAD, place_vectors
from tools.calibration.steps.step import MismatchError, StageRun

__all__ = ["PARTS", "STEPS", "AttitudePartStep", "own_records"]

FloatArray = npt.NDArray[np.float64]

MOST_STARS = 40
_NOISE_RAD = 5e-5


def _quaternion(b: FloatArray, r: FloatArray, weights: FloatArray, q: FloatArray) -> tuple[FloatArray, Work]:
    found = np.empty(4)
    rotations = int(quaternion_kernel(b, r, weights, len(b), found))
    return found, Work({"qmethod_stars": len(b), "qmethod_solves": 1, "jacobi_rotations": rotations})


def _residuals(b: FloatArray, r: FloatArray, weights: FloatArray, q: FloatArray) -> tuple[FloatArray, Work]:
    found = np.empty(len(b))
    residuals_kernel(b, r, len(b), q, found)
    return found, Work({"residual_stars": len(b)})


def _covariance(b: FloatArray, r: FloatArray, weights: FloatArray, q: FloatArray) -> tuple[FloatArray, Work]:
    found = np.empty((3, 3))
    covariance_kernel(b, weights, len(b), found)
    return found, Work({"covariance_stars": len(b), "covariance_solves": 1})


_Part = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], tuple[FloatArray, Work]]
_PYTHON: dict[str, _Part] = {"quaternion": _quaternion, "residuals": _residuals, "covariance": _covariance}
PARTS = tuple(_PYTHON)


class AttitudePartStep:
    """One part of an attitude: the same bits as in Python, residuals within ``RESIDUAL_BOUND_RAD``.

    Its caches are warm, as in a frame, where each part runs several times in a row: what the first time reads
    into them is in the runs of whole attitudes.
    """

    name = "attitude_part"

    def run(self, machine: ArmMachine, record: StepRecord) -> Sequence[StageRun]:
        """One run of the stage attitude. MismatchError: see the class."""
        arguments = record.arguments
        part, expected = arguments["part"], record.result
        b, r, weights, q = (place_vectors(machine, arguments[name]) for name in ("b", "r", "weights", "q"))
        out = machine.reserve(expected.nbytes)
        stars = len(arguments["b"])
        call: tuple[int, ...] = {
            "quaternion": (b, r, weights, stars, out),
            "residuals": (b, r, stars, q, out),
            "covariance": (b, weights, stars, out),
        }[part]
        machine.call(f"st_{part}", *call)
        cost = machine.call(f"st_{part}", *call).cost
        found = machine.read(out, np.float64, expected.shape)
        machine.release()
        off = float(np.max(np.abs(found - expected)))
        if not off <= (RESIDUAL_BOUND_RAD if part == "residuals" else 0.0):
            raise MismatchError(f"{self.name}: {part} is off by {off:.3g}")
        return [StageRun(self.name, "attitude", cost, record.work)]


def own_records(seed: int, n: int) -> list[StepRecord]:
    """``n`` parts in turn, of random fields of stars; the same for the same seed."""
    rng = np.random.default_rng([seed, 17])
    return [_record(rng, PARTS[number % len(PARTS)]) for number in range(n)]


def _record(rng: np.random.Generator, part: str) -> StepRecord:
    stars = int(rng.integers(3, MOST_STARS + 1))
    radius = float(rng.choice([0.02, 0.07, 0.25]))
    b = np.column_stack([rng.uniform(-radius, radius, (stars, 2)), np.ones(stars)])
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    turn = Rotation.random(random_state=rng)
    r = np.ascontiguousarray(turn.apply(b + rng.normal(0, _NOISE_RAD, b.shape)))
    r /= np.linalg.norm(r, axis=1, keepdims=True)
    weights = rng.uniform(1e8, 1e10, stars)
    q = np.empty(4)
    quaternion_kernel(b, r, weights, stars, q)
    result, work = _PYTHON[part](b, r, weights, q)
    return StepRecord(
        "attitude_part", {"part": part, "b": b, "r": r, "weights": weights, "q": q}, result, work
    )


STEPS = (AttitudePartStep(),)
