"""A unit on a pseudo-terminal that is spun up to 5 deg/s and down again: what the OBC's side reads of it.

The unit lives in virtual time, its bytes go through a real terminal, and they are read by the decoder that is
made with ``struct`` alone. The truth is the journal of truth: two attitudes and the time between them.
"""

from __future__ import annotations

import io
import itertools
import json
import os
import tty
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_tests.vectors import reference_decoder as wire
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import Scenario
from st_emulator.links.pty import PtyLink
from st_emulator.units.profile import load_unit

from .conftest import MODE, MS

Array = NDArray[np.float64]
AXIS = np.array([1.0, 0.5, 0.3]) / np.linalg.norm([1.0, 0.5, 0.3])
SHARE_WITHIN_3_SIGMA = 0.99
STEP_NS = 100 * MS  # of reading: a report or two, far under what a terminal holds
CALM_S = 2.5  # at rest before, with the start and the acquisition, and after


def ramps(most_deg_s: float, ramp_s: float, hold_s: float, axis: Array) -> dict[str, Any]:
    return {
        "kind": "rate",
        "duration_s": 2.0 * ramp_s + hold_s,
        "rate_deg_s": (most_deg_s * axis).tolist(),
        "ramp_s": ramp_s,
    }


def steps() -> list[dict[str, Any]]:
    """Up and down at once, by 1 deg/s, constant between."""
    rates = (1.0, 2.0, 3.0, 4.0, 5.0, 4.0, 3.0, 2.0, 1.0)
    return [
        {"kind": "rate", "duration_s": 1.6, "rate_deg_s": (r * AXIS).tolist(), "ramp_s": 0.0} for r in rates
    ]


SEVERAL_AXES = [
    ramps(3.5, 3.0, 1.0, np.array([-0.6, 0.8, 0.0])),
    ramps(3.0, 3.0, 1.0, np.array([0.48, 0.36, 0.8])),
]


@dataclass(frozen=True)
class Told:
    """One attitude report beside the truth of its time. error: of the rate, in its sigmas; None: no rate."""

    mode: int
    valid: bool
    reasons: int
    true_deg_s: float
    error: Array | None
    sigma_deg_s: Array


def turn_vector(before: Array, after: Array) -> Array:
    """The turn from one attitude to the other, q = [x, y, z, w] both; in sensor axes."""
    # Shuster's order, A(p q) = A(p) A(q), with p = after and q = the inverse of before
    p, q = after[:3], -before[:3]
    v = after[3] * q + before[3] * p - np.cross(p, q)
    scalar = float(after[3] * before[3] - p @ q)
    size = float(np.linalg.norm(v))
    if size == 0.0:
        return np.zeros(3)
    return np.asarray(v * (2.0 * np.arctan2(size, abs(scalar)) / size * (1.0 if scalar >= 0.0 else -1.0)))


def reports_of(unit: str, segments: list[dict[str, Any]], path: Path) -> tuple[list[dict], list[dict]]:
    """All telemetry that arrives at the terminal's other side, and the truth of the frames."""
    scenario = Scenario.model_validate(
        {
            "sky": {"sun": False, "moon": False, "earth": False},
            "trajectory": {
                "kind": "slew", "ra_deg": 83.0, "dec_deg": -3.0, "roll_deg": 10.0,
                "segments": [{"kind": "hold", "duration_s": CALM_S}, *segments],
            },
            "parameters": {"autonomous_start": 1},
        }
    )  # fmt: skip
    truth = io.StringIO()
    received = bytearray()
    lasts_s = CALM_S + sum(segment["duration_s"] for segment in segments) + CALM_S
    with PtyLink(path, monotonic_ns=lambda: 0) as link:  # however slow the machine, no byte is old
        terminal = os.open(link.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            tty.setraw(terminal)
            emulator = Emulator(
                load_unit(unit),
                scenario,
                seed=1,
                truth=truth,
                transmit=lambda data, _: link.write(data),
            )
            for until_ns in range(STEP_NS, int(lasts_s * 1e9), STEP_NS):
                emulator.advance(until_ns)
                try:
                    while chunk := os.read(terminal, 65536):
                        received += chunk
                except BlockingIOError:
                    pass
            emulator.close()
        finally:
            os.close(terminal)
        assert link.dropped_bytes == 0
    packets = [wire.decode_telemetry(frame) for frame in wire.slip_frames(bytes(received))]
    return packets, [json.loads(line) for line in truth.getvalue().splitlines()]


def beside_the_truth(packets: list[dict], truth: list[dict]) -> list[Told]:
    true = {line["frame_index"]: line for line in truth}
    told = []
    for packet in packets:
        if packet["name"] != "attitude_report":
            continue
        fields = packet["fields"]
        index = fields["frame_index"]
        now, before = true[index], true.get(index - 1 - fields["frames_dropped_before"])
        if before is None:
            assert not fields["rate_valid"], "nothing was exposed before"
            before = now | {"exposure_mid_ns": 0}
        interval_s = (now["exposure_mid_ns"] - before["exposure_mid_ns"]) * 1e-9
        turn = turn_vector(np.array(before["q_icrs_to_sensor"]), np.array(now["q_icrs_to_sensor"]))
        rate = turn / interval_s
        error, sigma = None, np.zeros(3)
        if fields["rate_valid"]:
            assert fields["rate_covariance_valid"]
            sigma = np.sqrt([fields[f"rate_covariance_{axis}{axis}"] for axis in "xyz"])
            error = (np.array([fields[f"rate_{axis}"] for axis in "xyz"]) - rate) / sigma
        told.append(
            Told(
                fields["mode"],
                bool(fields["valid"]),
                fields["reasons"],
                float(np.degrees(np.linalg.norm(rate))),
                error,
                np.degrees(sigma),
            )
        )
    return told


def modes_of(told: list[Told]) -> list[int]:
    return [mode for mode, _ in itertools.groupby(report.mode for report in told)]


def errors_of(told: list[Told]) -> Array:
    return np.array([report.error for report in told if report.error is not None])


def share_within_3_sigma(told: list[Told]) -> float:
    return float(np.mean((np.abs(errors_of(told)) < 3.0).all(axis=1)))


@pytest.mark.parametrize(
    ("unit", "segments"),
    [
        ("aps_rs", [ramps(5.0, 10.0, 2.0, AXIS)]),
        ("iris", [ramps(5.0, 6.0, 1.0, AXIS)]),
        ("aps_rs", SEVERAL_AXES),
        ("iris", SEVERAL_AXES),
    ],
    ids=["aps_rs 0 to 5 to 0 deg/s", "iris 0 to 5 to 0 deg/s", "aps_rs several axes", "iris several axes"],
)
def test_spun_up_and_down(unit: str, segments: list[dict[str, Any]], tmp_path: Path) -> None:
    told = beside_the_truth(*reports_of(unit, segments, tmp_path / "unit"))
    modes = modes_of(told)
    assert modes.index(MODE["TRACKING"]) < modes.index(MODE["RATE_ONLY"])
    assert modes.count(MODE["RATE_ONLY"]) == len(segments)
    assert modes[-1] == MODE["TRACKING"]
    assert told[-1].valid
    for report in told:
        assert report.valid == (report.reasons == 0)
    fast = [report for report in told if report.mode == MODE["RATE_ONLY"]]
    assert max(report.true_deg_s for report in fast) > 2.5
    without = [report for report in told if report.error is None]
    assert len(without) <= 0.1 * len(told)
    assert share_within_3_sigma(told) >= SHARE_WITHIN_3_SIGMA
    # honest, not simply large
    spread = errors_of(told).std(axis=0)
    assert spread.max() < 1.2
    assert spread.min() > 0.4
    assert np.median([report.sigma_deg_s.max() for report in fast if report.error is not None]) < 0.2


@pytest.mark.parametrize("unit", ["aps_rs", "iris"])
def test_steps_are_told_between_them(unit: str, tmp_path: Path) -> None:
    """Frames that see a step are of two rates; all others hold, and the unit comes back."""
    told = beside_the_truth(*reports_of(unit, steps(), tmp_path / "unit"))
    assert modes_of(told)[-1] == MODE["TRACKING"]
    assert MODE["RATE_ONLY"] in modes_of(told)
    steady = [
        now
        for a, b, now, c, d in zip(told, told[1:], told[2:], told[3:], told[4:], strict=False)
        if max(abs(x.true_deg_s - now.true_deg_s) for x in (a, b, c, d)) < 1e-6
    ]
    assert len(steady) > 30
    assert share_within_3_sigma(steady) >= SHARE_WITHIN_3_SIGMA
