"""From the start of the process to the first byte of telemetry."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from running_unit import RunningUnit


def warm_start_s(unit: str) -> float:
    """With compiled kernels and tables in their caches, as `st-emulator prepare` leaves them."""
    with (
        tempfile.TemporaryDirectory(prefix="st-emulator-bench-") as folder,
        RunningUnit(unit, Path(folder)) as running,
    ):
        return running.first_byte_ns() * 1e-9


def cold_start(unit: str) -> dict[str, Any]:
    """With empty caches: everything is compiled, every table built."""
    with tempfile.TemporaryDirectory(prefix="st-emulator-bench-") as name:
        folder = Path(name)
        caches = {"NUMBA_CACHE_DIR": str(folder / "numba"), "XDG_CACHE_HOME": str(folder / "cache")}
        with RunningUnit(unit, folder, caches) as running:
            seconds = running.first_byte_ns() * 1e-9
            return {"seconds": round(seconds, 2), "peak_memory_mb": round(running.memory_mb()["peak"], 1)}
