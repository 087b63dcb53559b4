"""Frames a second of the whole chain on one core: sky, pixels with full noise, firmware, telemetry bytes.

Run as a process of its own, so that one core and one thread are all it has; prints one JSON object a round.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator
from typing import Any

FIRST_FRAMES_S = 2.5  # boot, acquisition, first frames: not counted
ACQUIRE_S = 0.6
LEAST_VALID = 0.8  # of the frames, for the figure to stand for what it says
ONE_THREAD = {
    "NUMBA_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "RAYON_NUM_THREADS": "1",
}
# Across the sky, dense and sparse, Sun and Moon far away: (right ascension, declination), degrees.
POINTINGS_DEG = ((84.0, -1.5), (10.0, 60.0), (190.0, 57.0), (300.0, 40.0), (330.0, 25.0), (150.0, -50.0))


def rounds(unit: str, search: str, count: int, frames: int, stages: bool) -> Iterator[dict[str, Any]]:
    """One result for each round: frames, seconds, and milliseconds a frame by stage when asked for."""
    from stages import stopwatch

    for number in range(count):
        pointing = POINTINGS_DEG[number % len(POINTINGS_DEG)]
        if not stages:
            yield one_round(unit, search, pointing, frames)
            continue
        with stopwatch() as watch:
            result = one_round(unit, search, pointing, frames, watch.seconds.clear)
        milliseconds = {stage: 1e3 * value / result["frames"] for stage, value in watch.seconds.items()}
        whole = 1e3 * result["seconds"] / result["frames"]
        yield result | {"stages_ms": milliseconds | {"rest": whole - sum(milliseconds.values())}}


def one_round(
    unit: str,
    search: str,
    pointing_deg: tuple[float, float],
    frames: int,
    at_start: Any = lambda: None,
) -> dict[str, Any]:
    """Run an emulator in virtual time until ``frames`` frames are through.

    search: ``lost_in_space`` starts a new search after each frame; ``tracking`` at rest;
    ``tracking_turning`` at half of the unit's largest rate, with the smear that goes with it.
    """
    from st_emulator.bench.emulator import Emulator
    from st_emulator.bench.scenario import (
        ConstantRateTrajectory,
        InertialTrajectory,
        Scenario,
        ScenarioTelecommand,
    )
    from st_emulator.device.commands import Acquire
    from st_emulator.device.imaging import FrameRecord
    from st_emulator.units.profile import load_unit

    profile = load_unit(unit)
    ra_deg, dec_deg = pointing_deg
    look = {"ra_deg": ra_deg, "dec_deg": dec_deg, "roll_deg": 20.0}
    trajectory: Any = InertialTrajectory(kind="inertial", **look)
    if search == "tracking_turning":
        rate = profile.tracking.rate_deg_s / 2
        trajectory = ConstantRateTrajectory(
            kind="constant_rate", **look, rate_deg_s=(0.8 * rate, 0.6 * rate, 0.0)
        )
    acquire = ScenarioTelecommand(
        at_s=ACQUIRE_S, name="function", fields={"function_id": "START_ACQUISITION", "arguments": {}}
    )
    transmitted = processed = valid = 0
    wanted_mode = "LOST_IN_SPACE" if search == "lost_in_space" else "TRACKING"

    def transmit(data: bytes, t_ns: int) -> None:
        nonlocal transmitted
        transmitted += len(data)

    def completed(record: FrameRecord) -> None:
        nonlocal processed, valid
        assert record.result is not None
        assert record.acquisition is not None
        processed += 1
        valid += record.result.valid and record.acquisition.name == wanted_mode
        if search == "lost_in_space":
            emulator.device.execute(Acquire())  # the frame in flight is given up unprocessed

    emulator = Emulator(
        profile,
        Scenario(trajectory=trajectory, telecommands=[acquire]),
        transmit=transmit,
        on_completed=completed,
    )
    emulator.advance(int(FIRST_FRAMES_S * 1e9))
    transmitted = processed = valid = 0
    at_start()
    begun, cpu_begun = time.perf_counter(), time.process_time()
    while processed < frames:
        emulator.advance(emulator.now_ns + profile.frame_period_ns)
    seconds, cpu_seconds = time.perf_counter() - begun, time.process_time() - cpu_begun
    if valid < LEAST_VALID * processed:
        raise SystemExit(f"{unit}: {search} at {pointing_deg}: only {valid} of {processed} frames are valid")
    return {
        "frames": processed,
        "valid": valid,
        "seconds": seconds,
        "cpu_seconds": cpu_seconds,
        "bytes": transmitted,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("unit")
    parser.add_argument("search", choices=("lost_in_space", "tracking", "tracking_turning"))
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--stages", action="store_true")
    options = parser.parse_args()
    os.environ.update(ONE_THREAD)
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    from st_emulator.commands.warm_up import warm_up
    from st_emulator.units.profile import load_unit

    warm_up(load_unit(options.unit))
    for result in rounds(options.unit, options.search, options.rounds, options.frames, options.stages):
        print(json.dumps(result), flush=True)
    sys.exit(0)


if __name__ == "__main__":
    main()
