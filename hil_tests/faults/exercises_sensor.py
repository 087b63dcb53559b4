"""Faults of the sensor, exercised."""

from __future__ import annotations

import math
from typing import Any

from hil_tests.faults.exercise import Exercise, Seen
from hil_tests.unit.conftest import MODE, Bench
from hil_tests.vectors.received import EVENT

# bits of the reasons in an attitude report, from the interface document
TOO_FEW_STARS, NO_MATCH, BLINDED, RATE_TOO_HIGH, FRAME_DROPPED = 0x1, 0x2, 0x4, 0x8, 0x40
RESIDUAL_TOO_LARGE, NO_FRAME = 0x100, 0x800
SENSOR_LOST, NO_FRAME_FROM_SENSOR = 2, 2
TURNING: dict[str, Any] = {
    "trajectory": {
        "kind": "constant_rate",
        "ra_deg": 100,
        "dec_deg": 20,
        "roll_deg": 0,
        "rate_deg_s": (0.15, 0.1, 0.0),
    }
}


def frames(seen: Seen) -> list[dict[str, Any]]:
    """Attitude reports of the frames that were exposed while the fault lasted: whoever reads the frame
    numbers knows them."""
    first, end = math.ceil(seen.start_ms / 250), math.ceil(seen.end_ms / 250)
    return [
        one.fields
        for one in seen.sent
        if one.name == "attitude_report" and first <= one.fields["frame_index"] < end
    ]


def tracked_before(seen: Seen) -> list[dict[str, Any]]:
    return [
        one.fields for one in seen.before("attitude_report")
        if one.fields["mode"] == MODE["TRACKING"] and one.fields["frame_index"] < seen.start_ms / 250
    ]  # fmt: skip


def events(seen: Seen, name: str) -> list[dict[str, Any]]:
    return [
        one.fields["data"]
        for one in seen.sent
        if one.decoded["service"] == 5
        and one.fields["event_id"] == EVENT[name]
        and one.t_ns > seen.start_ms * 1e6
    ]


def span(reports: list[dict[str, Any]], name: str) -> tuple[float, float]:
    return min(one[name] for one in reports), max(one[name] for one in reports)


def mean(reports: list[dict[str, Any]], name: str) -> float:
    return float(sum(one[name] for one in reports) / len(reports))


def count(reports: list[dict[str, Any]], reason: int) -> int:
    return sum(1 for one in reports if one["reasons"] & reason)


def valid(reports: list[dict[str, Any]]) -> int:
    return sum(one["valid"] for one in reports)


def acquire(bench: Bench, seen: Seen) -> None:
    """The OBC has the unit search the sky under the fault."""
    bench.run(20)
    bench.function("START_ACQUISITION", ack=0)


def searched(seen: Seen) -> list[dict[str, Any]]:
    return [one for one in frames(seen) if one["mode"] == MODE["LOST_IN_SPACE"]]


# -- light


def false_stars_searched(seen: Seen) -> str:
    found = searched(seen)
    least, most = span(found, "spots_detected")
    assert least >= 100
    assert len(found) >= 10
    assert count(found, NO_MATCH) == len(found)
    assert valid(found) == 0
    return f"{least} to {most} spots detected, NO_MATCH in {len(found)} of {len(found)} frames of the search"


def false_stars_tracked(seen: Seen) -> str:
    found, before = frames(seen), tracked_before(seen)
    assert valid(found) == len(found) == 12
    _, most = span(found, "spots_detected")
    assert most > span(before, "spots_detected")[1]
    assert span(found, "stars_identified")[0] >= 20
    usual = mean(before, "spots_detected")
    return f"valid in 12 of 12, up to {most} spots detected in the windows (before {usual:.0f})"


def stray_light(seen: Seen) -> str:
    found, before = frames(seen), tracked_before(seen)
    assert valid(found) == 12
    level, noise = mean(found, "background_dn"), mean(found, "noise_dn")
    assert 100 < level - mean(before, "background_dn") < 200  # 150 DN in the middle, and 24 windows anywhere
    assert noise > 2 * mean(before, "noise_dn")
    assert mean(found, "covariance_xx") > 1.2 * mean(before, "covariance_xx")
    usual = mean(before, "noise_dn")
    return f"background {level:.0f} DN, noise {noise:.1f} DN (before {usual:.1f}), valid in 12 of 12"


def stray_light_searched(seen: Seen) -> str:
    found = searched(seen)
    processed = [one for one in found if not one["reasons"] & FRAME_DROPPED]
    assert count(processed, NO_MATCH) == len(processed) >= 4
    _, most = span(processed, "spots_detected")
    assert most >= 500, "the slope over the unit's moving average is taken for stars"
    assert events(seen, "FRAME_OVERRAN")
    return (
        f"{most} spots detected on the slope, NO_MATCH in {len(processed)} of {len(processed)} searched "
        f"frames, {count(found, FRAME_DROPPED)} frames dropped"
    )


def blinded(seen: Seen) -> str:
    found = frames(seen)
    assert count(found, BLINDED) == len(found) == 12
    assert valid(found) == 0
    assert len(events(seen, "SENSOR_BLINDED")) == 1, "once in a row of blinded frames"
    assert len(events(seen, "TRACKING_LOST")) == 1
    assert found[-1]["mode"] == MODE["LOST_IN_SPACE"]
    level = mean(found, "background_dn")
    assert level > 400
    return f"background {level:.0f} DN, BLINDED in 12 of 12, event SENSOR_BLINDED once, TRACKING_LOST"


def coming_nearer(seen: Seen) -> str:
    found = frames(seen)
    levels = [one["background_dn"] for one in found]
    windows = [one["background_dn"] for one in found if one["mode"] == MODE["TRACKING"]]
    assert windows == sorted(windows), "it grows all the time"
    first = next(number for number, one in enumerate(found) if one["reasons"] & BLINDED)
    assert 0 < first < 12
    assert all(one["reasons"] & BLINDED for one in found[first:])
    assert valid(found) == first
    assert len(events(seen, "SENSOR_BLINDED")) == 1
    rise = f"background from {levels[0]:.0f} to {levels[-1]:.0f} DN"
    return f"{rise}, valid in the first {first} of 12, then BLINDED"


def bright_object(seen: Seen) -> str:
    found = frames(seen)
    assert valid(found) == len(found) == 12
    least, most = span(found, "stars_identified")
    assert least < most, "it passes a window"
    assert least >= 20
    return f"valid in 12 of 12, {least:.0f} to {most:.0f} stars identified"


def protons_searched(seen: Seen) -> str:
    found, before = frames(seen), tracked_before(seen)
    lost = [one for one in found if one["mode"] == MODE["LOST_IN_SPACE"]]
    most = span(lost, "spots_detected")[1]
    assert most > 60
    assert found[-1]["valid"]
    assert found[-1]["mode"] == MODE["TRACKING"]
    least = span([one for one in found if one["valid"]], "stars_identified")[0]
    assert least < span(before, "stars_identified")[0]
    return f"{most} spots detected in the search, which succeeds; {least} to 24 stars identified in tracking"


# -- pixels


def fewer_stars(seen: Seen) -> str:
    found, before = frames(seen), tracked_before(seen)
    assert valid(found) == len(found) == 12
    stars, stars_before = mean(found, "stars_identified"), mean(before, "stars_identified")
    residual, residual_before = mean(found, "residual_rms_arcsec"), mean(before, "residual_rms_arcsec")
    assert stars < stars_before - 1
    assert residual > residual_before
    return (
        f"valid in 12 of 12, {stars:.0f} stars identified (before {stars_before:.0f}), residual "
        f"{residual:.1f} arcsec (before {residual_before:.1f})"
    )


def hot_pixels(seen: Seen) -> str:
    found, before = frames(seen), tracked_before(seen)
    cycles, cycles_before = mean(found, "cycles"), mean(before, "cycles")
    assert cycles > 1.1 * cycles_before
    return f"{fewer_stars(seen)}, {cycles / 1e6:.1f} million cycles (before {cycles_before / 1e6:.1f})"


def gain_falls(seen: Seen) -> str:
    found = frames(seen)
    stars = [one["stars_identified"] for one in found]
    assert stars[0] >= 22
    assert stars[-1] <= 6
    assert found[-1]["noise_dn"] < 0.5 * found[0]["noise_dn"]
    return (
        f"stars identified fall from {stars[0]} to {stars[-1]}, noise from {found[0]['noise_dn']:.1f} to "
        + (f"{found[-1]['noise_dn']:.1f} DN")
    )


def gain_grows(seen: Seen) -> str:
    found = frames(seen)
    first = next(number for number, one in enumerate(found) if one["reasons"] & BLINDED)
    assert valid(found) == first > 4
    assert len(events(seen, "SENSOR_BLINDED")) == 1
    return (
        f"valid in the first {first} of 12, background to {found[-1]['background_dn']:.0f} DN, then BLINDED"
    )


# -- frames


def no_frames(seen: Seen) -> str:
    found = frames(seen)
    assert len(found) == 4
    assert all(one["reasons"] == FRAME_DROPPED | NO_FRAME for one in found)
    dropped = events(seen, "FRAME_DROPPED")
    assert [one["cause"] for one in dropped] == [NO_FRAME_FROM_SENSOR] * 4
    following = next(one.fields for one in seen.after("attitude_report") if one.fields["valid"])
    assert following["frames_dropped_before"] == 4
    assert not events(seen, "TRACKING_LOST")
    return "FRAME_DROPPED and NO_FRAME in 4 of 4, 4 events FRAME_DROPPED, tracking is kept"


def reset_afterwards(bench: Bench, seen: Seen) -> None:
    bench.run_to(seen.end_ms)
    bench.function("RESET", {"kind": 1}, ack=0)


def sensor_lost(seen: Seen) -> str:
    found = frames(seen)
    assert len(found) == 7, "the eighth in a row ends it"
    assert all(one["reasons"] == FRAME_DROPPED | NO_FRAME for one in found)
    (entered,) = events(seen, "FAULT_ENTERED")
    assert entered["cause"] == SENSOR_LOST
    assert events(seen, "MODE_CHANGED")[0]["to_mode"] == MODE["FAULT"]
    return "NO_FRAME in 7 frames, then FAULT_ENTERED with SENSOR_LOST, mode FAULT; the OBC resets the unit"


def torn_still(seen: Seen) -> str:
    found = frames(seen)
    assert valid(found) == len(found) == 12
    return "valid in 12 of 12: a unit that does not turn shows nothing"


def torn_turning(seen: Seen) -> str:
    found = frames(seen)
    by_reason = [count(found, one) for one in (RATE_TOO_HIGH, RESIDUAL_TOO_LARGE, TOO_FEW_STARS)]
    assert sum(by_reason) >= 2
    off = [one for one in found if one["valid"] and not _rate_fits(one)]
    assert off, "a valid one whose rate tells that it is not from its own frame"
    return (
        f"not valid in {len(found) - valid(found)} of 12 (RATE_TOO_HIGH, RESIDUAL_TOO_LARGE); {len(off)} "
        "valid ones are those of the frame before: their rate is off by more than a tenth"
    )


def _rate_fits(report: dict[str, Any]) -> bool:
    """Whether a valid report's rate is the one that the OBC knows from its gyroscopes: 0.18 deg/s."""
    rate = math.degrees(math.hypot(report["rate_x"], report["rate_y"]))
    return not report["rate_valid"] or abs(rate / math.hypot(0.15, 0.1) - 1) < 0.1


EXERCISES = (
    Exercise(
        {"kind": "sensor.false_stars", "number": 100}, false_stars_searched, "searching", meanwhile=acquire
    ),
    Exercise(
        {"kind": "sensor.false_stars", "number": 100, "places": "fixed"}, false_stars_tracked, "tracking"
    ),
    Exercise({"kind": "sensor.hot_pixels"}, hot_pixels),
    Exercise({"kind": "sensor.dead_rows", "number": 60}, fewer_stars),
    Exercise({"kind": "sensor.dead_columns", "number": 90}, fewer_stars),
    Exercise({"kind": "sensor.no_frames"}, no_frames, "1 s", lasts_ms=1000),
    Exercise({"kind": "sensor.no_frames"}, sensor_lost, "3 s", meanwhile=reset_afterwards, reboots=True),
    Exercise({"kind": "sensor.torn_frame"}, torn_still, "still"),
    Exercise({"kind": "sensor.torn_frame"}, torn_turning, "turning", scenario=TURNING),
    Exercise({"kind": "sensor.stray_light"}, stray_light, "tracking"),
    Exercise({"kind": "sensor.stray_light"}, stray_light_searched, "searching", meanwhile=acquire),
    Exercise({"kind": "sensor.blinding", "body": "sun"}, blinded, "by the Sun"),
    Exercise({"kind": "sensor.blinding", "body": "sun"}, blinded, "by the Sun", on_can=True),
    Exercise({"kind": "sensor.blinding", "body": "moon"}, blinded, "by the Moon"),
    Exercise({"kind": "sensor.blinding", "body": "earth"}, blinded, "by the Earth"),
    Exercise(
        {"kind": "sensor.blinding", "angle_deg": 33, "approach_deg_s": 2}, coming_nearer, "that comes nearer"
    ),
    Exercise({"kind": "sensor.bright_object"}, bright_object),
    Exercise({"kind": "sensor.dust", "number": 150, "depth": 0.95}, fewer_stars),
    Exercise({"kind": "sensor.defocus"}, fewer_stars),
    Exercise({"kind": "sensor.gain_drift", "factor_per_s": 0.3}, gain_falls, "falling"),
    Exercise({"kind": "sensor.gain_drift", "factor_per_s": 8}, gain_grows, "growing"),
    Exercise(
        {"kind": "sensor.proton_streaks", "rate_per_cm2_s": 5000}, protons_searched, meanwhile=acquire
    ),
)  # fmt: skip
