"""One sequence of frames through all kernels: every step, each time the same, as the figures predict."""

from __future__ import annotations

from pathlib import Path

import pytest

from st_emulator.firmware_model.frame_trace import STEPS
from tools.calibration.compiler import find_compiler
from tools.calibration.document import COMMITTED, SampleSet, predictor, read_document
from tools.calibration.frames import HELD_OUT, IDENTIFY, LOST_IN_SPACE, TRACKING, SkySequence
from tools.calibration.registry import families, own_records, steps_by_name
from tools.calibration.simulation import Case, OwnSequence, simulate
from tools.calibration.validation import FRAME_LIMIT, STAGE_LIMIT, frame_errors, stage_errors

SKY = SkySequence(HELD_OUT, 12, "roja1", "pyramid", (0.0, 0.1, 0.0))


@pytest.fixture(scope="module")
def simulated(arm_program: Path):
    return simulate(str(arm_program), Case(0, SKY))


def test_each_step_of_a_frame_has_kernels():
    assert set(STEPS) <= set(steps_by_name())
    assert own_records()  # telemetry, which no frame's trace has
    assert "step" not in families()


def test_every_step_is_run_and_gives_what_python_gives(simulated):
    assert simulated.failure == ""
    made = {step.name for family in own_records() for step in families()[family].STEPS}
    assert {sample.step for sample in simulated.samples} == set(STEPS) - made
    assert {sample.kind for sample in simulated.samples} == {LOST_IN_SPACE, TRACKING, IDENTIFY}


def test_a_case_depends_on_no_other(simulated, arm_program: Path):
    again = simulate(str(arm_program), Case(0, SKY))
    assert again == simulated


def test_each_record_that_a_family_makes_itself_is_run(arm_program: Path):
    for number, family in enumerate(own_records()):
        found = simulate(str(arm_program), Case(number, own=OwnSequence(HELD_OUT, 99, family, 3)))
        assert found.failure == ""
        made = own_records()[family](HELD_OUT * 1000 + 99, 3)
        assert {sample.frame for sample in found.samples} == set(range(len(made)))


def test_the_committed_figures_predict_it(simulated):
    document = read_document(COMMITTED)
    compiler = find_compiler()
    if compiler is not None and compiler.version != document["compiler"]:
        pytest.skip(f"the figures are those of {document['compiler']}, here is {compiler.version}")
    predict = predictor(document)
    samples = SampleSet(simulated.samples)
    stages = stage_errors(samples.samples, predict)
    assert {item.stage for item in stages} >= {"threshold", "clustering", "centroid", "identification"}
    for item in stages:
        assert abs(item.error) <= STAGE_LIMIT, item
    frames = frame_errors(samples.samples, predict)
    assert len(frames) == 3
    for item in frames:
        assert abs(item.error) <= FRAME_LIMIT, item
