"""Cycles from work counts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from st_emulator.firmware_model.processor import (
    EVIDENCE,
    Coefficient,
    ProcessorProfile,
    ProcessorProfileError,
)
from st_emulator.firmware_model.work import COUNTS, STAGES, Work

OURS = "arm926ej_s_provisional"


def flat_profile(clock_hz: int = 1000, **special: float) -> ProcessorProfile:
    """One core cycle for each count but those named."""
    cost = {name: special.get(name, 1.0) for name in COUNTS}
    return ProcessorProfile(clock_hz, {n: Coefficient(c, 0.0, "assumed", "test") for n, c in cost.items()})


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
        number * (profile.coefficients[name].core_cycles + profile.coefficients[name].memory_cycles)
        for name, number in counts.items()
    )
    assert abs(report.total - exact) <= 0.5 * len(STAGES)


def test_duration_is_rounded_up() -> None:
    profile = flat_profile(clock_hz=400_000_000)
    assert profile.duration_ns(100_000_000) == 250_000_000  # a frame's budget at 4 Hz
    assert profile.duration_ns(1) == 3  # 2.5 ns
    assert profile.duration_ns(0) == 0
    assert profile.with_clock(200_000_000).duration_ns(1) == 5


def test_the_provisional_profile_reproduces_its_trial_figures() -> None:
    """The figures on the left were measured; the coefficients must give them back."""
    profile = ProcessorProfile.load(OURS)
    c = profile.coefficients
    assert profile.clock_hz == 400_000_000
    # threshold byte by byte: 9.0 core; 10.5 in all for one byte a pixel
    assert c["threshold_pixels"].core_cycles == 9.0
    assert c["threshold_pixels"].core_cycles + c["threshold_pixels"].memory_cycles / 2 == 10.5
    # centre of mass of a star of 9 px: 888 core, 1107 in all (cold pixels: 22.9 in all)
    assert c["centroid_stars"].core_cycles + 9 * c["centroid_pixels"].core_cycles == pytest.approx(888, abs=1)
    star = c["centroid_stars"]
    assert star.core_cycles + star.memory_cycles + 9 * 22.9 == pytest.approx(1107, abs=1)
    # Jacobi 375k, CRC 14.5 a byte, run 125 core and 140 to 153 in all
    assert c["qmethod_solves"].core_cycles + c["qmethod_solves"].memory_cycles == 375_000
    assert c["crc_bytes"].core_cycles + c["crc_bytes"].memory_cycles == 14.5
    assert c["runs"].core_cycles == 125
    assert 140 <= c["runs"].core_cycles + c["runs"].memory_cycles <= 153


def test_each_provisional_coefficient_carries_its_evidence() -> None:
    profile = ProcessorProfile.load(OURS)
    assert {c.evidence for c in profile.coefficients.values()} == set(EVIDENCE)
    assert all(len(c.source) > 10 for c in profile.coefficients.values())


def document() -> dict[str, Any]:
    counts = {
        n: {"core_cycles": 1, "memory_cycles": 0.5, "evidence": "assumed", "source": "test"} for n in COUNTS
    }
    return {"name": "mine", "clock_hz": 123, "counts": counts}


def test_a_users_own_profile_is_a_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(document()))
    profile = ProcessorProfile.load(str(path))
    assert (profile.name, profile.clock_hz) == ("mine", 123)
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
        (json.dumps(without(document(), "runs")), "without a coefficient: runs;"),
        (json.dumps(with_count(document(), "sprints", GOOD)), "unknown counts: sprints"),
        (json.dumps(with_count(document(), "runs", 3)), "counts.runs"),
        (json.dumps(with_count(document(), "runs", {**GOOD, "core_cycles": "many"})), "counts.runs"),
        (json.dumps(with_count(document(), "runs", {**GOOD, "core_cycles": -1})), "runs: cycles must be"),
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
    with pytest.raises(ProcessorProfileError, match="'cray': not one of arm926ej_s_provisional"):
        ProcessorProfile.load("cray")
