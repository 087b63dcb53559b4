"""Cycles from work counts."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from st_emulator.firmware_model.processor import (
    EVIDENCE,
    Coefficient,
    CycleTable,
    MemoryTiming,
    ProcessorProfile,
    ProcessorProfileError,
)
from st_emulator.firmware_model.work import COUNTS, STAGES, Work

OURS = "arm926ej_s"


def flat_profile(clock_hz: int = 1000, **special: float) -> ProcessorProfile:
    """One core cycle for each count but those named."""
    cost = {name: special.get(name, 1.0) for name in COUNTS}
    coefficients = {n: Coefficient(c, {32: 0.0}, "assumed", "test") for n, c in cost.items()}
    return ProcessorProfile(CycleTable("flat", clock_hz, coefficients))


def test_cycles_are_counts_times_coefficients_by_stage() -> None:
    profile = flat_profile(runs=10.5, crc_bytes=2.0)
    report = profile.cycles(Work({"runs": 3, "clusters": 4, "crc_bytes": 7}))
    assert list(report.by_stage) == list(STAGES)
    assert {s: c for s, c in report.by_stage.items() if c} == {
        "clustering": 36,
        "telemetry": 14,
    }  # 35.5 -> 36
    assert report.total == 50
    assert profile.cycles(Work()).total == 0


@given(st.dictionaries(st.sampled_from(sorted(COUNTS)), st.integers(0, 10**7)))
def test_the_total_is_the_sum_of_the_stages(counts: dict[str, int]) -> None:
    profile = ProcessorProfile.load(OURS)
    report = profile.cycles(Work(counts))
    assert report.total == sum(report.by_stage.values())
    exact = sum(
        number * (profile.coefficients[name].core_cycles + 48 * profile.coefficients[name].line_fills[32])
        for name, number in counts.items()
    )
    assert abs(report.total - exact) <= 0.5 * len(STAGES)


def test_duration_is_rounded_up() -> None:
    profile = flat_profile(clock_hz=400_000_000)
    assert profile.duration_ns(100_000_000) == 250_000_000  # a frame's budget at 4 Hz
    assert profile.duration_ns(1) == 3  # 2.5 ns
    assert profile.duration_ns(0) == 0
    assert profile.with_clock(200_000_000).duration_ns(1) == 5


def table(**changes: Any) -> CycleTable:
    """Every count free but two: runs, with figures of every kind, and crc_bytes, which is assumed."""
    free = Coefficient(0.0, {32: 0.0, 16: 0.0}, "calibrated", "test", accesses=0.0)
    coefficients = dict.fromkeys(COUNTS, free) | {
        "runs": Coefficient(100.0, {32: 0.5, 16: 2.0}, "calibrated", "test", 3.0, {32: 0.04}, 40.0),
        "crc_bytes": Coefficient(10.0, {32: 0.0, 16: 0.0}, "assumed", "test", 5.0, accesses=4.0),
    }
    memory = MemoryTiming(
        {"low": 60.0, "nominal": 120.0, "high": 180.0}, {"low": 50.0, "nominal": 100.0, "high": 200.0}
    )
    return CycleTable("mine", 400_000_000, coefficients, memory, 0.1, **changes)


WORK = Work({"runs": 1000, "crc_bytes": 100})


def test_the_memory_keeps_its_time_when_the_clock_changes() -> None:
    profile = ProcessorProfile(table())
    # 1000 runs: 100,000 core cycles and 500 fills of 120 ns, 60,000 ns
    assert profile.cycles(WORK).total == 101_000 + 500 * 48
    slow = profile.with_clock(100_000_000)
    assert slow.cycles(WORK).total == 101_000 + 500 * 12
    assert slow.duration_ns(slow.cycles(WORK).total) == 1_010_000 + 60_000
    parts = profile.parts(WORK)
    assert parts["runs"] == pytest.approx((100_000.0, 24_000.0))
    assert parts["crc_bytes"] == (1000.0, 0.0)


@pytest.mark.parametrize(("line_fill", "cycles"), [("low", 24), ("nominal", 48), ("high", 72)])
def test_line_fills_take_what_the_memory_takes(line_fill: str, cycles: int) -> None:
    profile = ProcessorProfile(table()).with_line_fill(line_fill)
    assert profile.line_fill_cycles == pytest.approx(cycles)
    assert profile.cycles(WORK).by_stage["clustering"] == 100_000 + 500 * cycles


def test_smaller_caches_miss_more_and_none_pays_each_access() -> None:
    profile = ProcessorProfile(table())
    assert profile.cache_kib == 32
    assert table().caches_kib == (32, 16, 0)
    assert profile.with_cache(16).cycles(WORK).by_stage["clustering"] == 100_000 + 2000 * 48
    # 100 ns an access, 40 cycles
    assert profile.with_cache(0).cycles(WORK).by_stage["clustering"] == 100_000 + 1000 * 40 * 40
    with pytest.raises(ProcessorProfileError, match="mine: cache_kib 8: none of 32, 16, 0"):
        profile.with_cache(8)
    with pytest.raises(ProcessorProfileError, match="line_fill 'fast': none of low, nominal, high"):
        profile.with_line_fill("fast")


def test_bounds_hold_the_model_the_memory_and_two_sigma_of_the_fit() -> None:
    low, high = ProcessorProfile(table()).bounds(WORK)
    # runs: sigma of core 3, of fills 0.04 of 48 cycles, each 1000 times
    spread = 2 * 1000 * math.hypot(3.0, 0.04 * 48)
    assert low.by_stage["clustering"] == round(90_000 + 500 * 24 - spread)
    assert high.by_stage["clustering"] == round(110_000 + 500 * 72 + spread)
    assert high.by_stage["telemetry"] == 1100 + 2 * 500
    assert low.total == sum(low.by_stage.values())
    low, high = ProcessorProfile(table()).bounds(Work({"crc_bytes": 1}))
    assert (low.total, high.total) == (0, 21)  # 9 - 10 is none; 11 + 10


@given(st.dictionaries(st.sampled_from(sorted(COUNTS)), st.integers(0, 10**7)))
def test_cycles_lie_between_their_bounds(counts: dict[str, int]) -> None:
    profile = ProcessorProfile.load(OURS)
    low, high = profile.bounds(Work(counts))
    report = profile.cycles(Work(counts))
    for stage in STAGES:
        assert low.by_stage[stage] <= report.by_stage[stage] <= high.by_stage[stage]


def test_the_uncertainty_is_a_sentence_to_print() -> None:
    text = ProcessorProfile(table()).uncertainty
    assert "+-10%" in text
    assert "24/48/72 cycles" in text
    assert "factor of 2" in text


def test_each_of_our_coefficients_carries_its_evidence() -> None:
    coefficients = ProcessorProfile.load(OURS).coefficients
    assert {c.evidence for c in coefficients.values()} <= set(EVIDENCE)
    assert all(len(c.source) > 10 for c in coefficients.values())


def document() -> dict[str, Any]:
    counts = {
        n: {"core_cycles": 1, "memory_cycles": 0.5, "evidence": "assumed", "source": "test"} for n in COUNTS
    }
    return {"name": "mine", "clock_hz": 123, "counts": counts}


def test_a_users_own_profile_is_a_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(document()))
    profile = ProcessorProfile.load(str(path))
    assert (profile.name, profile.clock_hz, profile.cache_kib) == ("mine", 123, 32)
    assert profile.cycles(Work({"runs": 4})).total == 6


def without(doc: dict[str, Any], key: str) -> dict[str, Any]:
    del doc["counts"][key]
    return doc


def with_count(doc: dict[str, Any], key: str, entry: Any) -> dict[str, Any]:
    doc["counts"][key] = entry
    return doc


GOOD = {"core_cycles": 1, "memory_cycles": 0, "evidence": "trial", "source": "x"}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{", "line 1"),
        ("[]", "'counts'"),
        (json.dumps({"counts": {}}), "'clock_hz'"),
        (json.dumps({"counts": {}, "clock_hz": True}), "'clock_hz'"),
        (json.dumps({**document(), "clock_hz": 0}), "clock_hz"),
        (json.dumps({**document(), "memory": {"line_fill_ns": {"low": 1}}}), "memory needs line_fill_ns"),
        (
            json.dumps(
                {
                    **document(),
                    "memory": {
                        "line_fill_ns": {"low": 9, "nominal": 2, "high": 3},
                        "access_ns": {"low": 1, "nominal": 2, "high": 3},
                    },
                }
            ),
            "ascending",
        ),
        (json.dumps({**document(), "model_uncertainty": {"core": 3}}), "model_uncertainty.core"),
        (json.dumps(without(document(), "runs")), "without a coefficient: runs;"),
        (json.dumps(with_count(document(), "sprints", GOOD)), "unknown counts: sprints"),
        (json.dumps(with_count(document(), "runs", 3)), "counts.runs"),
        (json.dumps(with_count(document(), "runs", {**GOOD, "core_cycles": "many"})), "counts.runs"),
        (
            json.dumps(with_count(document(), "runs", {**GOOD, "core_cycles": -1})),
            "runs: every figure must be",
        ),
        (json.dumps(with_count(document(), "runs", {**GOOD, "evidence": "hope"})), "'hope'"),
    ],
)
def test_bad_profiles_are_refused_by_file_and_key(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "bad.json"
    path.write_text(text)
    with pytest.raises(ProcessorProfileError) as caught:
        ProcessorProfile.load(path)
    assert "bad.json" in str(caught.value)
    assert expected in str(caught.value)


def test_missing_profiles_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ProcessorProfileError, match=r"no-such\.json: cannot be read"):
        ProcessorProfile.load(tmp_path / "no-such.json")
    with pytest.raises(ProcessorProfileError, match="'cray': not one of arm926ej_s"):
        ProcessorProfile.load("cray")
