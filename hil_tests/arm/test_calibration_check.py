"""`tools/calibrate_cycles --check`: what it says of changed kernels, other compilers and none at all."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from hil_tests.arm.conftest import require_compiler
from st_emulator.firmware_model.work import COUNTS
from tools.calibration import __main__ as command
from tools.calibration import check as checking
from tools.calibration.compiler import KERNELS, PINNED_COMPILER, Build, Compiler, build, find_compiler
from tools.calibration.document import SampleSet, text_of
from tools.calibration.frames import LOST_IN_SPACE
from tools.calibration.samples import TARGETS, Sample

PINNED = Compiler("gcc", PINNED_COMPILER, True, {})
OTHER = Compiler("gcc", "gcc 14.1.0 (somebody's)", False, {})
OURS = Build(
    Path("kernels.elf"),
    PINNED_COMPILER,
    ("-O2",),
    {"kernels.elf": "aa", "clustering.o": "bb", "libm.a": "cc"},
)
FILLS = {"32": 0.1, "16": 0.1, "8": 0.2, "4": 0.3}


def document_with(**changes):
    entry = {
        "core_cycles": 100.0,
        "core_sigma": 1.0,
        "line_fills": FILLS,
        "line_fills_sigma": FILLS,
        "accesses": 120.0,
        "instructions": 80.0,
        "evidence": "calibrated",
        "source": "detect",
    }
    counts = {name: dict(entry) for name in COUNTS}
    counts["frames"] |= {"evidence": "assumed", "source": "interrupts"}
    document = {
        "name": "arm926ej_s",
        "clock_hz": 400_000_000,
        "compiler": OURS.compiler,
        "flags": list(OURS.flags),
        "binaries": dict(OURS.sha256),
        "counts": counts,
    }
    return document | changes


def held_out(factor=1.0):
    """One frame of 1000 runs whose simulation is ``factor`` times what the document predicts."""
    predicted = {"core_cycles": 1e5, "instructions": 8e4, "accesses": 1.2e5}
    predicted |= {f"line_fills_{kib}": 1000 * share for kib, share in FILLS.items()}
    values = tuple(round(predicted[target] * factor) for target in TARGETS)
    sample = Sample(0, 0, LOST_IN_SPACE, "detect", "clustering", (("runs", 1000),), values)
    return SampleSet((sample,))


def checked(document=None, compiler=PINNED, made=OURS, factor=1.0):
    return checking.check(document or document_with(), compiler, lambda: made, lambda build: held_out(factor))


def test_what_is_as_committed_holds():
    found = checked()
    assert found.holds
    assert found.figures["worst_stage"] < 1e-3
    assert found.figures["binaries"] == 3
    assert found.notes == ("assumed: frames: interrupts",)


@pytest.mark.parametrize(
    ("hashes", "says"),
    [
        ({"kernels.elf": "dd"}, "binaries changed since the calibration: kernels.elf"),
        (
            {"clustering.o": "ee", "kernels.elf": "dd"},
            "changed since the calibration: clustering.o, kernels.elf",
        ),
        ({"voting.o": "ff"}, "binaries new since the calibration: voting.o"),
    ],
)
def test_changed_binaries_are_named(hashes, says):
    found = checked(made=replace(OURS, sha256=OURS.sha256 | hashes))
    assert not found.holds
    assert any(says in failure for failure in found.failures)
    assert any("run tools/calibrate_cycles" in failure for failure in found.failures)


def test_a_binary_that_is_gone_and_other_flags_are_named():
    hashes = {name: value for name, value in OURS.sha256.items() if name != "clustering.o"}
    found = checked(made=replace(OURS, sha256=hashes, flags=("-O3",)))
    assert "binaries gone since the calibration: clustering.o" in found.failures
    assert "flags changed since the calibration: -O3" in found.failures


def test_figures_that_do_not_predict_the_simulation():
    for factor, stage, frame in (
        (1.04, False, False),
        (1.08, False, True),
        (1.15, True, True),
        (0.8, True, True),
    ):
        failures = checked(factor=factor).failures
        assert any("clustering: predicted 10" in item for item in failures) == stage, factor
        assert any("frame: predicted 10" in item for item in failures) == frame, factor


def test_another_compiler_is_told_and_held_to_a_tolerance():
    made = replace(OURS, compiler=OTHER.version, sha256={"kernels.elf": "zz"})
    found = checked(compiler=OTHER, made=made, factor=1.2)
    assert found.holds
    assert any(OTHER.version in note and PINNED_COMPILER in note for note in found.notes)
    assert not checked(compiler=OTHER, made=made, factor=1.5).holds


def test_counts_that_came_or_went_are_named():
    document = document_with()
    document["counts"] = {name: item for name, item in document["counts"].items() if name != "runs"}
    document["counts"]["runs_of_old"] = document["counts"]["clusters"]
    found = checked(document)
    assert "counts without figures: runs; run tools/calibrate_cycles" in found.failures
    assert any("runs_of_old" in failure for failure in found.failures)


def test_without_a_compiler_nothing_is_said():
    assert checked(compiler=None) is None


@pytest.fixture
def committed(tmp_path, monkeypatch):
    """The command with a committed file of its own and no compiler unless a test gives it one."""
    path = tmp_path / "arm926ej_s.json"
    path.write_text(text_of(document_with()), encoding="utf-8")
    monkeypatch.setattr(command, "COMMITTED", path)
    monkeypatch.setattr(command, "find_compiler", lambda: None)
    monkeypatch.setattr(command, "require_compiler", lambda *_: "cross compiler missing; not root")
    return path


def status_of(**options):
    with pytest.raises(SystemExit) as end:
        command.main(**options)
    return end.value.code


def test_a_missing_compiler_is_no_failure_unless_required(committed, capsys):
    assert status_of(check=True) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "committed figures cannot be checked; they serve as they are" in said
    assert status_of(check=True, require=True) == 3
    assert "cross compiler missing; not root" in capsys.readouterr().err


def test_calibration_without_a_compiler_ends_with_3(committed, capsys):
    before = committed.read_text(encoding="utf-8")
    assert status_of(quick=True) == 3
    assert "cross compiler missing" in capsys.readouterr().err
    assert committed.read_text(encoding="utf-8") == before


def with_compiler(monkeypatch, factor=1.0, made=OURS):
    monkeypatch.setattr(command, "find_compiler", lambda: PINNED)
    monkeypatch.setattr(command, "shared_build", lambda: made)
    monkeypatch.setattr(command, "simulate_set", lambda *_: held_out(factor))


def test_the_command_says_what_holds(committed, monkeypatch, capsys, tmp_path):
    with_compiler(monkeypatch)
    report = tmp_path / "check.json"
    assert status_of(check=True, require=False, json_path=report) == 0
    assert "The committed figures hold." in capsys.readouterr().err
    assert json.loads(report.read_text(encoding="utf-8"))["holds"] is True


def test_the_command_says_what_does_not_hold(committed, monkeypatch, capsys):
    with_compiler(monkeypatch, made=replace(OURS, sha256=OURS.sha256 | {"clustering.o": "00"}))
    assert status_of(check=True) == 1
    said = capsys.readouterr().err
    assert "binaries changed since the calibration: clustering.o" in said
    assert "do not hold" in said


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"require": True}, "--require is for --check"),
        ({"quick": True, "frames": 5}, "--quick and --frames"),
        ({"json_path": Path("no/such/folder/x.json")}, "--json no/such/folder/x.json: cannot be written"),
        ({"plot_path": Path("plot.txt")}, "--plot plot.txt"),
    ],
)
def test_bad_input_ends_with_2(committed, capsys, options, says):
    assert status_of(**options) == 2
    assert says in capsys.readouterr().err


def test_a_committed_file_that_is_none_ends_with_2(committed, capsys):
    committed.write_text("[]", encoding="utf-8")
    assert status_of(check=True) == 2
    assert "no figures of tools/calibrate_cycles" in capsys.readouterr().err


def test_a_changed_kernel_changes_its_hash_and_the_programs(tmp_path):
    """Two real builds of the runtime and one kernel, one constant apart."""
    require_compiler()
    sources = tmp_path / "sources"
    shutil.copytree(KERNELS / "runtime", sources / "runtime")
    (sources / "kernel.c").write_text("int st_kernel(int a) { return 3 * a; }\n", encoding="utf-8")
    (sources / "other.c").write_text("int st_other(int a) { return a - 1; }\n", encoding="utf-8")
    before = build(tmp_path / "before", sources=sources)
    (sources / "kernel.c").write_text("int st_kernel(int a) { return 5 * a; }\n", encoding="utf-8")
    after = build(tmp_path / "after", sources=sources)
    compiler = find_compiler()
    document = document_with(
        compiler=compiler.version, flags=list(before.flags), binaries=dict(before.sha256)
    )
    assert checking.check_hashes(document, before, compiler).holds
    found = checking.check_hashes(document, after, compiler)
    assert found.failures[0] == "binaries changed since the calibration: kernel.o, kernels.elf"
