"""Faults of the telemetry, exercised: on the serial line, and on the CAN bus with its cyclic frames."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

from hil_tests.faults.exercise import MS, Exercise, Seen
from hil_tests.faults.exercises_line import IN_3_S
from hil_tests.unit.conftest import CanBench, Packet

AXES = "xyzw"
FRAME_S = 0.25


def reports(seen: Seen) -> list[Packet]:
    """The attitude reports of the fault's time: each comes, whole and valid."""
    found = seen.during("attitude_report")
    assert len(found) == IN_3_S
    assert not seen.broken
    assert all(one.fields["valid"] for one in found)
    return found


def quaternion(packet: Packet) -> tuple[float, ...]:
    return tuple(packet.fields[f"q_{axis}"] for axis in AXES)


def seconds(cuc: tuple[int, int]) -> float:
    return cuc[0] + cuc[1] / (1 << 24)


def measured_s(packet: Packet) -> float:
    return seconds(packet.fields["mid_exposure_time"])


def cyclic(seen: Seen, name: str) -> list[dict[str, Any]]:
    """Cyclic frames of a kind while the fault lasted; none on a serial line."""
    if not isinstance(seen.bench, CanBench):
        return []
    found = seen.bench.frames(name)
    return [fields for t_ns, fields in found if seen.start_ms * MS < t_ns <= seen.end_ms * MS]


def turn_deg(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    """The angle between two attitudes."""
    x, y, z, w = one
    a, b, c, d = (-other[0], -other[1], -other[2], other[3])
    vector = (
        w * a + d * x + y * c - z * b,
        w * b + d * y + z * a - x * c,
        w * c + d * z + x * b - y * a,
    )
    return math.degrees(2 * math.asin(min(1.0, math.sqrt(sum(part * part for part in vector)))))


def frozen_attitude(seen: Seen) -> str:
    found = reports(seen)
    goes_on = ("frame_index", "mid_exposure_time", "latency_us")
    contents = [{name: value for name, value in one.fields.items() if name not in goes_on} for one in found]
    assert all(content == contents[0] for content in contents)
    index = found[0].fields["frame_index"]
    assert [one.fields["frame_index"] for one in found] == list(range(index, index + IN_3_S))
    for one, next_one in pairwise(found):
        assert math.isclose(measured_s(next_one) - measured_s(one), FRAME_S, abs_tol=1e-6)
    others = seen.before("attitude_report")[-4:] + seen.after("attitude_report")
    assert len({quaternion(one) for one in others}) == len(others)  # a real one has noise
    for name in ("attitude_1", "attitude_2", "rates"):
        frames = [
            {key: value for key, value in one.items() if key != "counter"} for one in cyclic(seen, name)
        ]
        assert all(frame == frames[0] for frame in frames)
    return f"{IN_3_S} attitudes the same to the last bit, frame number and time go on"


def frozen_counter(seen: Seen) -> str:
    found = reports(seen)
    assert len({one.fields["frame_index"] for one in found}) == 1
    assert len({quaternion(one) for one in found}) == IN_3_S
    times = [measured_s(one) for one in found]
    assert math.isclose(times[-1] - times[0], (IN_3_S - 1) * FRAME_S, abs_tol=1e-5)
    index = found[0].fields["frame_index"]
    assert seen.after("attitude_report")[0].fields["frame_index"] == index + IN_3_S
    for name in ("attitude_1", "status", "mid_exposure_time"):
        assert {one["counter"] for one in cyclic(seen, name)} <= {index & 0xFF}
    return f"frame {index} {IN_3_S} times, each with a new attitude and time"


def ages_s(packets: list[Packet]) -> list[float]:
    """Packet time less the time of measurement, without what the unit itself calls its latency."""
    return [
        seconds(one.decoded["time"]) - measured_s(one) - one.fields["latency_us"] / 1e6 for one in packets
    ]


def time_stands(seen: Seen) -> str:
    found = reports(seen)
    assert len({one.fields["mid_exposure_time"] for one in found}) == 1
    assert len({quaternion(one) for one in found}) == IN_3_S
    ages = ages_s(found)
    assert math.isclose(ages[-1], (IN_3_S - 1) * FRAME_S, abs_tol=1e-5)
    frames = cyclic(seen, "mid_exposure_time")
    assert len({(one["seconds"], one["fraction"]) for one in frames}) <= 1
    assert all(
        abs(age) < 1e-5 for age in ages_s(seen.before("attitude_report") + seen.after("attitude_report"))
    )
    return f"one time {IN_3_S} times, at last {ages[-1]:.2f} s old; frame numbers and attitudes go on"


def time_lags(seen: Seen) -> str:
    ages = ages_s(reports(seen))
    assert all(math.isclose(age, 1.5, abs_tol=1e-5) for age in ages)
    for one, report in zip(cyclic(seen, "mid_exposure_time"), seen.during("attitude_report"), strict=False):
        assert one["seconds"] + one["fraction"] == measured_s(report)
    assert all(abs(age) < 1e-5 for age in ages_s(seen.after("attitude_report")))
    return f"each time of measurement {ages[0]:.3f} s too old, which latency_us does not say"


def jumping_time(seen: Seen) -> str:
    found = reports(seen)
    ages = ages_s(found)
    assert all(abs(age) <= 0.8 + 1e-5 for age in ages)
    assert len(set(ages)) == IN_3_S
    times = [measured_s(one) for one in found]
    backwards = sum(next_one < one for one, next_one in pairwise(times))
    assert backwards
    for one, report in zip(cyclic(seen, "mid_exposure_time"), found, strict=False):
        assert one["seconds"] + one["fraction"] == measured_s(report)
    assert all(abs(age) < 1e-5 for age in ages_s(seen.after("attitude_report")))
    return f"times off by {min(ages):+.2f} to {max(ages):+.2f} s, {backwards} times backwards"


def stuck_sequence_count(seen: Seen) -> str:
    found = seen.during()
    (count,) = {one.decoded["sequence_count"] for one in found}
    reports(seen)
    numbers = [one.decoded["message_count"] for one in seen.during("attitude_report")]
    assert numbers == list(range(numbers[0], numbers[0] + IN_3_S))
    assert count == seen.before()[-1].decoded["sequence_count"] + 1
    assert seen.after()[0].decoded["sequence_count"] == count + len(found)
    return f"{len(found)} packets with sequence count {count}, then a gap of {len(found) - 1}"


def not_a_number(seen: Seen) -> str:
    found = reports(seen)
    assert all(math.isnan(part) for one in found for part in quaternion(one))
    assert not any(math.isnan(part) for one in seen.after("attitude_report") for part in quaternion(one))
    for name in ("attitude_1", "attitude_2"):
        frames = cyclic(seen, name)
        assert len(frames) in (0, IN_3_S)
        assert all(abs(value) <= 1 for one in frames for key, value in one.items() if key != "counter")
    return f"{IN_3_S} valid reports whose quaternion is NaN, check sums right"


def one_component(seen: Seen) -> str:
    for one in reports(seen):
        assert [math.isnan(part) for part in quaternion(one)] == [False, True, False, False]
    return f"{IN_3_S} valid reports whose q_y is NaN"


def opposite_sign(seen: Seen) -> str:
    before, found, after = seen.before("attitude_report")[-1], reports(seen), seen.after("attitude_report")
    for one in found:
        assert all(
            math.isclose(part, -usual, abs_tol=1e-3)
            for part, usual in zip(quaternion(one), quaternion(before), strict=True)
        )
        assert turn_deg(quaternion(one), quaternion(before)) < 0.05
    assert quaternion(found[0])[3] < 0 < quaternion(after[0])[3]
    for one, report in zip(cyclic(seen, "attitude_2"), found, strict=False):
        assert math.isclose(one["q_w"], report.fields["q_w"], abs_tol=1e-8)
    turn_arcsec = 3600 * turn_deg(quaternion(found[0]), quaternion(before))
    return f"all four components change their sign, the attitude turns by {turn_arcsec:.0f} arcsec"


def wrong_attitude(seen: Seen) -> str:
    before, found, after = seen.before("attitude_report")[-1], reports(seen), seen.after("attitude_report")
    turns = [turn_deg(quaternion(one), quaternion(before)) for one in found]
    assert all(math.isclose(turn, 2.0, abs_tol=0.05) for turn in turns)
    assert turn_deg(quaternion(after[0]), quaternion(before)) < 0.05
    assert all(one.fields["residual_rms_arcsec"] < 60 for one in found)
    assert all(abs(one.fields[f"rate_{axis}"]) < 1e-3 for one in found for axis in "xyz")
    frames = zip(cyclic(seen, "attitude_1"), cyclic(seen, "attitude_2"), found, strict=False)
    for first, second, report in frames:
        told = (first["q_x"], first["q_y"], second["q_z"], second["q_w"])
        assert all(math.isclose(a, b, abs_tol=1e-8) for a, b in zip(told, quaternion(report), strict=True))
    return f"a valid attitude {min(turns):.3f} to {max(turns):.3f} deg off, rate and residuals as ever"


EXERCISES: tuple[Exercise, ...] = tuple(
    Exercise(fault, judged, name=name, on_can=on_can)
    for fault, judged, name in (
        ({"kind": "telemetry.frozen_attitude"}, frozen_attitude, ""),
        ({"kind": "telemetry.frozen_counter"}, frozen_counter, ""),
        ({"kind": "telemetry.stale_time"}, time_stands, ""),
        ({"kind": "telemetry.stale_time", "lag_s": 1.5}, time_lags, "by 1.5 s"),
        ({"kind": "telemetry.jumping_time", "most_s": 0.8}, jumping_time, ""),
        ({"kind": "telemetry.stuck_sequence_count"}, stuck_sequence_count, ""),
        ({"kind": "telemetry.not_a_number"}, not_a_number, ""),
        ({"kind": "telemetry.not_a_number", "component": "y"}, one_component, "of one component"),
        ({"kind": "telemetry.opposite_sign"}, opposite_sign, ""),
        ({"kind": "telemetry.wrong_attitude", "deg": 2.0, "axis": "y"}, wrong_attitude, ""),
    )
    for on_can in (False, True)
)
