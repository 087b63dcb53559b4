"""Frames for the faults of the sensor: rendered ones, and plain arrays that tell what they were asked for."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from hil_tests.unit.conftest import Bench, make
from st_emulator.faults.catalogue import FAULTS
from st_emulator.faults.fault import Exposure, Reach
from st_emulator.faults.faults import settings_of
from st_emulator.units.profile import load_unit
from st_emulator.world.windows import cut_windows

KINDS = [name for name in FAULTS if name.startswith("sensor.")]


@lru_cache(maxsize=4)
def bench_of(unit: str) -> Bench:
    return make(unit)


def reach_of(unit: str) -> Reach:
    return bench_of(unit).emulator._reach()


def exposure_of(unit: str, index: int) -> Exposure:
    profile = load_unit(unit)
    return Exposure(index, index * profile.frame_period_ns, round(profile.timing.exposure_ms * 1e6))


def rendered(unit: str, index: int) -> Any:
    """A frame of the unit's sky, fresh: nothing of it is kept."""
    scene = bench_of(unit).emulator.scene
    assert scene is not None
    exposure = exposure_of(unit, index)
    return scene.frame(exposure.index, exposure.start_ns, exposure.duration_ns)


def fault_of(table: dict[str, Any], unit: str = "roja1", seed: int = 5) -> Any:
    """A fault that began at power-on."""
    settings = settings_of(table, "test")
    fault = FAULTS[settings.kind].make(settings, reach_of(unit), settings.seed or seed)
    fault.begin()
    return fault


class ArrayFrame:
    """An array as a frame; it keeps what it was asked for."""

    def __init__(self, pixels: np.ndarray, bits: int) -> None:
        self.pixels = pixels.astype(np.uint16)
        self.height_px, self.width_px = pixels.shape
        self.bits = bits
        self.fulls = 0
        self.asked: list[np.ndarray] = []

    def full(self) -> np.ndarray:
        self.fulls += 1
        return self.pixels

    def windows(self, rects: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self.asked.append(np.array(rects))
        return cut_windows(self.pixels, rects)


def flat_frame(unit: str, electrons: float, seed: int = 1) -> ArrayFrame:
    """Even light with the noise of the unit's detector."""
    profile = load_unit(unit)
    detector = profile.detector
    chance = np.random.default_rng(seed)
    charge = chance.poisson(electrons, (detector.rows, detector.columns)) + chance.normal(
        0, detector.read_noise_electrons, (detector.rows, detector.columns)
    )
    numbers = np.floor(charge / detector.electrons_per_dn + detector.offset_dn + 0.5)
    return ArrayFrame(np.clip(numbers, 0, 2**detector.bits - 1), detector.bits)
