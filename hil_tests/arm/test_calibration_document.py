"""The document of a calibration: what the processor reads of it, its bytes, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from st_emulator.errors import ConfigurationError
from st_emulator.firmware_model.processor import ProcessorProfile
from st_emulator.firmware_model.work import COUNTS, STAGES, Work
from tools.calibration.compiler import Build
from tools.calibration.document import (
    ASSUMED,
    SampleSet,
    document_of,
    predictor,
    read_document,
    rounded,
    text_of,
)
from tools.calibration.fit import fit
from tools.calibration.frames import LOST_IN_SPACE, TRACKING
from tools.calibration.samples import CACHES_KIB, TARGETS, Sample, fills_target
from tools.calibration.validation import by_stage, stage_errors, within_limits

BUILD = Build(Path("kernels.elf"), "gcc 12.2.0 (Debian 12.2.0-14)", ("-O2",), {"kernels.elf": "ab" * 32})
CALIBRATED = [name for name in COUNTS if name not in ASSUMED]
FILLS_PER_CYCLE = {32: 0.001, 16: 0.0015, 8: 0.0025, 4: 0.005}


def true_cycles(name: str) -> float:
    """A figure of its own for each count, 5 to 5000 cycles."""
    return 5.0 * 10 ** (3 * CALIBRATED.index(name) / len(CALIBRATED))


def sample_of(sequence, frame, kind, stage, counts, factor=1.0):
    core = factor * sum(number * true_cycles(name) for name, number in counts.items())
    values = {"core_cycles": core, "instructions": 0.8 * core, "accesses": 1.1 * core}
    values |= {fills_target(kib): core * share for kib, share in FILLS_PER_CYCLE.items()}
    return Sample(
        sequence,
        frame,
        kind,
        "detect",
        stage,
        tuple(sorted(counts.items())),
        tuple(round(values[target]) for target in TARGETS),
        (("alu", round(0.5 * core)), ("ldr", round(0.3 * core))),
    )


def sample_set(seed, sequences, noise=0.0):
    rng = np.random.default_rng(seed)
    samples = []
    for sequence in range(sequences):
        for frame, kind in enumerate((LOST_IN_SPACE, TRACKING)):
            for stage in STAGES:
                names = [name for name in CALIBRATED if COUNTS[name].stage == stage]
                counts = {name: int(rng.integers(1000, 100_000)) for name in names}
                samples.append(
                    sample_of(sequence, frame, kind, stage, counts, 1.0 + noise * float(rng.normal()))
                )
    return SampleSet(tuple(samples))


@pytest.fixture(scope="module")
def document():
    fitted, held_out = sample_set(1, 40), sample_set(2, 10)
    return document_of(BUILD, fit(fitted.samples, resamples=20), fitted, held_out)


def test_the_processor_loads_it_and_counts_the_same_cycles(document, tmp_path):
    path = tmp_path / "arm926ej_s.json"
    path.write_text(text_of(document), encoding="utf-8")
    profile = ProcessorProfile.load(path)
    assert profile.name == "arm926ej_s"
    assert profile.clock_hz == 400_000_000
    assert profile.table.caches_kib == (32, 16, 8, 4, 0)
    assert set(profile.coefficients) == set(COUNTS)
    predict = predictor(document)
    counts = {name: 1000 + 7 * place for place, name in enumerate(CALIBRATED)}
    work = Work(counts)
    everything = sample_of(0, 0, TRACKING, "threshold", counts)
    for kib in CACHES_KIB:
        expected = predict(everything)["core_cycles"] + 48 * predict(everything)[fills_target(kib)]
        assert profile.with_cache(kib).cycles(work).total == pytest.approx(expected, abs=len(STAGES))
    without = predict(everything)["core_cycles"] + 30 * predict(everything)["accesses"]  # 75 ns at 400 MHz
    assert profile.with_cache(0).cycles(work).total == pytest.approx(without, abs=len(STAGES))
    # the figures are those that the samples were made with
    cycles = sum(number * true_cycles(name) for name, number in counts.items())
    assert profile.cycles(work).total == pytest.approx(cycles * (1 + 48 * FILLS_PER_CYCLE[32]), rel=1e-3)


def test_bounds_widen_by_the_fits_own_sigma(document, tmp_path):
    noisy = sample_set(3, 40, noise=0.08)
    wide = document_of(BUILD, fit(noisy.samples, resamples=40), noisy, sample_set(4, 5))
    work = Work({"runs": 100_000})
    spreads = []
    for number, item in enumerate((document, wide)):
        path = tmp_path / f"{number}.json"
        path.write_text(text_of(item), encoding="utf-8")
        profile = ProcessorProfile.load(path)
        low, high = profile.bounds(work)
        assert low.total < profile.cycles(work).total < high.total
        spreads.append((high.total - low.total) / profile.cycles(work).total)
        assert item["counts"]["runs"]["core_sigma"] >= 0
    assert wide["counts"]["runs"]["core_sigma"] > 10 * document["counts"]["runs"]["core_sigma"]
    assert spreads[1] > spreads[0]


def test_every_count_is_calibrated_but_those_with_a_reason(document):
    assumed = [name for name, item in document["counts"].items() if item["evidence"] == "assumed"]
    assert assumed == sorted(ASSUMED) == ["frames"]
    assert "interrupts" in document["counts"]["frames"]["source"]
    assert document["counts"]["runs"]["source"] == "detect: 80 frames"


def test_a_count_that_no_sample_has_is_named():
    fitted = sample_set(1, 12)
    without = SampleSet(
        tuple(
            sample_of(s.sequence, s.frame, s.kind, s.stage, {k: v for k, v in s.counts if k != "crc_bytes"})
            for s in fitted.samples
        )
    )
    with pytest.raises(ConfigurationError, match=r"no frame of the calibration has: crc_bytes;"):
        document_of(BUILD, fit(without.samples, resamples=5), without, sample_set(2, 2))


def test_the_same_samples_give_the_same_bytes(document):
    fitted, held_out = sample_set(1, 40), sample_set(2, 10)
    again = document_of(BUILD, fit(fitted.samples, resamples=20), fitted, held_out)
    assert text_of(again) == text_of(document)
    text = text_of(document)
    assert json.loads(text) == document
    keys = list(json.loads(text)["counts"])
    assert keys == sorted(keys)


def test_another_machines_rounding_does_not_show(document):
    """Samples and coefficients off by a few units in the last place give the same bytes."""
    fitted, held_out = sample_set(1, 40), sample_set(2, 10)
    found = fit(fitted.samples, resamples=20)
    moved = {
        name: {
            target: type(item)(item.value * (1 + 4e-15), item.sigma * (1 - 4e-15))
            for target, item in targets.items()
        }
        for name, targets in found.coefficients.items()
    }
    other = type(found)(moved, found.frames, found.collinear)
    assert text_of(document_of(BUILD, other, fitted, held_out)) == text_of(document)


@pytest.mark.parametrize(
    ("value", "figures", "expected"),
    [
        (0.0, 5, 0.0),
        (123.456789, 5, 123.46),
        (0.00123456789, 5, 0.0012346),
        (98765432.1, 5, 98765000.0),
        (0.0777, 2, 0.078),
        (float("nan"), 5, 0.0),
    ],
)
def test_rounding(value, figures, expected):
    assert rounded(value, figures) == expected


def test_errors_are_those_of_the_rounded_figures(document):
    fitted = sample_set(1, 40)
    errors = by_stage(stage_errors(fitted.samples, predictor(document)))
    assert {stage: item.as_dict() for stage, item in errors.items()} == document["residuals"]
    assert set(document["residuals"]) == set(STAGES)
    assert document["frames"] == {"fitted": 80, "held_out": 20}
    assert document["frame_held_out"]["tracking"]["frames"] == 10
    assert within_limits(document)


def test_what_is_off_shows_in_the_errors():
    fitted = sample_set(1, 20)
    held_out = sample_set(2, 6)
    off = [s for s in held_out.samples if s.stage != "centroid"]
    off += [
        sample_of(s.sequence, s.frame, s.kind, s.stage, dict(s.counts), 0.8)
        for s in held_out.samples
        if s.stage == "centroid"
    ]
    document = document_of(BUILD, fit(fitted.samples, resamples=5), fitted, SampleSet(tuple(off)))
    assert document["held_out"]["centroid"]["worst"] == pytest.approx(0.25, abs=0.001)
    assert document["held_out"]["centroid"]["bias"] == pytest.approx(0.25, abs=0.001)
    assert document["held_out"]["threshold"]["worst"] < 0.001
    assert not within_limits(document)
    assert "25.0% of the simulated program" in document["accuracy"]


def test_a_stage_under_a_tenth_of_a_millisecond_is_taken_relative_to_that():
    """100 runs are 4 us: half of them too little is 2 us of 100 us; a thousand times as many are judged by
    themselves.
    """
    cycles = 1 + 48 * FILLS_PER_CYCLE[32]
    for runs, expected in ((100, 100 * true_cycles("runs") * cycles / 2 / 40_000), (100_000, 0.5)):
        sample = sample_of(0, 0, TRACKING, "clustering", {"runs": runs})
        predicted = dict(zip(TARGETS, sample.values, strict=True))
        half = {target: value / 2 for target, value in predicted.items()}
        (error,) = stage_errors([sample], lambda _, half=half: half)
        assert error.error == pytest.approx(-expected, rel=3e-2)  # of whole cycles and fills
        assert by_stage([error])["clustering"].short == (runs == 100)


def test_class_counts_are_those_of_the_fit(document):
    fitted = sample_set(1, 40)
    assert document["class_counts"] == {
        name: sum(dict(s.classes)[name] for s in fitted.samples) for name in ("alu", "ldr")
    }


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "line 1"),
        ("[]", "binaries, compiler, flags, counts missing"),
        ('{"counts": {}, "compiler": "x", "flags": []}', "binaries missing"),
    ],
)
def test_files_that_are_no_document(tmp_path, text, says):
    path = tmp_path / "x.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError, match=says):
        read_document(path)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ConfigurationError, match="cannot be read: No such file"):
        read_document(tmp_path / "none.json")
