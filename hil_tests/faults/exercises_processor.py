"""Faults of the processor, exercised."""

from __future__ import annotations

from typing import Any

from hil_tests.faults.exercise import Exercise, Seen
from hil_tests.faults.exercises_sensor import FRAME_DROPPED, count, events, frames, tracked_before, valid
from hil_tests.unit.conftest import MS, Bench

OVERRUN = 0x10  # of the reasons
CAUSE_OVERRUN = 0  # of FRAME_DROPPED
WARM, WATCHDOG, FAULT = 1, 3, 4  # reset causes
TIMING, STATUS = 3, 1  # housekeeping
PERIOD_MS = 250


def look_at_timing(bench: Bench, seen: Seen) -> None:
    """Housekeeping before and at the end of the fault."""
    seen.figures["before"] = bench.housekeeping(TIMING)
    bench.run_to(seen.end_ms - 100)
    seen.figures["timing"] = bench.housekeeping(TIMING)
    seen.figures["status"] = bench.housekeeping(STATUS)


def within_the_budget(seen: Seen) -> str:
    found, before = frames(seen), tracked_before(seen)
    timing = seen.figures["timing"]
    assert valid(found) == len(found) == 12
    assert timing["clock_hz"] == 100_000_000
    assert timing["cycles_budget"] == seen.figures["before"]["cycles_budget"] // 4
    late, early = max(one["latency_us"] for one in found), max(one["latency_us"] for one in before)
    assert late > early + 40_000
    assert seen.figures["status"]["frames_late"] == 0
    latency = f"latency {late / 1000:.0f} ms (before {early / 1000:.0f} ms)"
    return f"valid in 12 of 12, {latency}, clock 100 MHz in TIMING"


def over_the_budget(seen: Seen) -> str:
    found = frames(seen)
    timing, status = seen.figures["timing"], seen.figures["status"]
    processed = [one for one in found if not one["reasons"] & FRAME_DROPPED]
    late = [one for one in processed if one["late"]]
    dropped = count(found, OVERRUN)
    assert late
    assert all(one["valid"] for one in late), "late, and right"
    assert dropped == count(found, FRAME_DROPPED) == len(found) - len(processed) > 0
    causes = [one["cause"] for one in events(seen, "FRAME_DROPPED")]
    assert set(causes) == {CAUSE_OVERRUN}
    overran = events(seen, "FRAME_OVERRAN")
    assert len(overran) >= len(late)
    assert timing["cycles_total"] > timing["cycles_budget"]
    assert timing["margin_us"] < 0
    assert status["frames_late"] >= 1
    assert status["frames_dropped"] == sum(
        1 for one in seen.before("attitude_report") + seen.during("attitude_report")
        if one.fields["reasons"] & FRAME_DROPPED and one.t_ns < seen.end_ms * MS - 100 * MS
    )  # fmt: skip
    share = timing["cycles_total"] / timing["cycles_budget"]
    return (
        f"{dropped} of 12 frames dropped with OVERRUN, {len(late)} late, cycles {share:.1f} times the budget"
    )


def caches_off(seen: Seen) -> str:
    text = over_the_budget(seen)
    timing = seen.figures["timing"]
    assert timing["cache_kib"] == 0
    assert seen.figures["before"]["cache_kib"] == 32
    assert timing["cycles_memory"] > 0.8 * timing["cycles_total"]
    return f"{text}, cache_kib 0 in TIMING"


def slow_stage(seen: Seen) -> str:
    text = over_the_budget(seen)
    timing, before = seen.figures["timing"], seen.figures["before"]
    ratio = {
        name: timing[f"cycles_{name}"] / before[f"cycles_{name}"]
        for name in ("threshold", "centroid", "attitude")
    }
    assert ratio["centroid"] > 60
    assert ratio["threshold"] < 3
    assert ratio["attitude"] < 3
    return f"{text}, of them {timing['cycles_centroid'] / timing['cycles_total']:.0%} in the slow stage"


def ping_in_vain(bench: Bench, seen: Seen) -> None:
    bench.run(300)
    seen.figures["ping"] = bench.send("ping")
    bench.run(1000)


def booted(seen: Seen, cause: int, after_ms: float) -> str:
    (boot,) = [
        one for one in seen.sent
        if one.decoded["service"] == 5 and one.fields["event_id"] == 1 and one.t_ns > seen.start_ms * MS
    ]  # fmt: skip
    assert boot.fields["data"] == {"boot_count": 2, "reset_cause": cause}
    boot_ms = seen.bench.emulator.profile.timing.boot_ms
    at_ms = boot.t_ns / MS - seen.start_ms
    assert after_ms + boot_ms < at_ms < after_ms + boot_ms + 20
    # what the line still held when it began is all that comes before
    silent = [
        one for one in seen.sent if seen.start_ms + 10 < one.t_ns / MS < seen.start_ms + after_ms + boot_ms
    ]
    assert silent == []
    return f"silence of {at_ms:.0f} ms, BOOT_COMPLETED with reset cause {cause} and boot count 2"


def stuck(seen: Seen) -> str:
    text = booted(seen, WATCHDOG, 1000)
    assert not seen.bench.stages(seen.figures["ping"])
    assert seen.bench.of("pong") == []
    return f"{text} (WATCHDOG); a telecommand meanwhile has no report"


def spurious(seen: Seen) -> str:
    return f"{booted(seen, FAULT, 0)} (FAULT)"


def warm(seen: Seen) -> str:
    return f"{booted(seen, WARM, 0)} (WARM_RESET)"


HANG: dict[str, Any] = {"lasts_ms": 0, "reboots": True, "meanwhile": ping_in_vain}

EXERCISES = (
    Exercise({"kind": "processor.slower_clock"}, within_the_budget, "4 times", meanwhile=look_at_timing),
    Exercise(
        {"kind": "processor.slower_clock", "factor": 20},
        over_the_budget,
        "20 times",
        meanwhile=look_at_timing,
    ),
    Exercise({"kind": "processor.cache_off"}, caches_off, meanwhile=look_at_timing),
    Exercise(
        {"kind": "processor.slow_stage", "stage": "centroid", "factor": 100},
        slow_stage,
        meanwhile=look_at_timing,
    ),
    Exercise({"kind": "processor.stuck"}, stuck, **HANG),
    Exercise({"kind": "processor.stuck"}, stuck, **HANG, on_can=True),
    Exercise({"kind": "processor.spurious_reset"}, spurious, lasts_ms=0, reboots=True),
    Exercise(
        {"kind": "processor.spurious_reset", "cause": "warm_reset"}, warm, "warm", lasts_ms=0, reboots=True
    ),
)  # fmt: skip
