"""A unit with a rolling shutter: when its frames are exposed, read out and told, with rows that overlap."""

from __future__ import annotations

import io
import itertools
import json

import numpy as np
import pytest

from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import Scenario
from st_emulator.bench.world_of import camera_model
from st_emulator.device.imaging import FrameRecord, FrameSource
from st_emulator.errors import ConfigurationError
from st_emulator.firmware_model.causes import FrameDropCause
from st_emulator.firmware_model.image.frame import Frame
from st_emulator.units.profile import UnitProfile, load_unit, parse_unit, unit_text
from st_emulator.world.sampled import BeyondTruthError, SampledTrajectory
from st_emulator.world.trajectory import constant_rate

MS = 1_000_000
PERIOD_NS, EXPOSURE_NS, READOUT_NS = 200 * MS, 200 * MS, 200 * MS
LAST_ROW_NS = 1023 * READOUT_NS // 1024
RATE_DEG_S = (0.05, -0.02, 0.1)


def rolling(text: str | None = None, readout_ms: float = 200.0) -> UnitProfile:
    """The unit of the paper with its rolling shutter, rows 0.2 s / 1024 apart."""
    text = unit_text("aps_rs")[1] if text is None else text
    lines = [line for line in text.splitlines() if not line.startswith(("shutter", "readout_ms"))]
    at = lines.index("[detector]") + 1
    lines.insert(at, 'shutter = "rolling"')
    lines.insert(lines.index("[timing]") + 1, f"readout_ms = {readout_ms}")
    return parse_unit("\n".join(lines), "test")


def scenario(**parameters: float) -> Scenario:
    return Scenario.model_validate(
        {
            "trajectory": {
                "kind": "constant_rate",
                "ra_deg": 84.0,
                "dec_deg": 1.0,
                "roll_deg": 0.0,
                "rate_deg_s": list(RATE_DEG_S),
            },
            "parameters": {"autonomous_start": 1, **parameters},
        }
    )


def run(profile: UnitProfile, until_ms: float, **parameters: float) -> tuple[list[FrameRecord], list[dict]]:
    """The frames that were processed, and the truth of all that were exposed."""
    truth = io.StringIO()
    completed: list[FrameRecord] = []
    emulator = Emulator(profile, scenario(**parameters), seed=3, truth=truth, on_completed=completed.append)
    emulator.advance(round(until_ms * MS))
    emulator.close()
    return completed, [json.loads(line) for line in truth.getvalue().splitlines()]


class WithAGap:
    """A sensor that does not deliver one frame."""

    def __init__(self, source: FrameSource, missing: int) -> None:
        self._source, self._missing = source, missing

    def frame(self, frame_index: int, exposure_start_ns: int, exposure_ns: int) -> Frame | None:
        frame = self._source.frame(frame_index, exposure_start_ns, exposure_ns)
        return None if frame_index == self._missing else frame


def test_the_shutter_is_the_files() -> None:
    assert load_unit("roja1").detector.shutter == "global"
    assert camera_model(load_unit("roja1")).rolling_readout_ns == 0
    assert load_unit("roja1").row_time_s == 0.0
    profile = rolling()
    assert camera_model(profile).rolling_readout_ns == READOUT_NS
    assert profile.last_row_start_ns == LAST_ROW_NS == camera_model(profile).last_row_start_ns
    assert profile.row_time_s == pytest.approx(0.2 / 1024)
    text = unit_text("roja1")[1].replace("[detector]", '[detector]\nshutter = "sliding"')
    with pytest.raises(ConfigurationError, match=r"detector\.shutter.*one of 'global', 'rolling'"):
        parse_unit(text, "test")


def test_frames_without_a_gap_overlap_and_each_is_processed() -> None:
    completed, truth = run(rolling(), 6000)
    assert [record.index for record in completed] == list(range(completed[0].index, completed[-1].index + 1))
    assert len(completed) >= 20
    for record in completed:
        assert record.start_ns == record.index * PERIOD_NS
        assert record.mid_exposure_ns == record.start_ns + (EXPOSURE_NS + LAST_ROW_NS) // 2
        assert record.exposure_end_ns == record.start_ns + EXPOSURE_NS + LAST_ROW_NS
        assert record.readout_end_ns == record.start_ns + EXPOSURE_NS + READOUT_NS
        assert record.cycles is not None
        spent_ns = record.cycles.total * 1e9 / 400e6
        assert record.due_ns == pytest.approx(record.readout_end_ns + spent_ns, abs=100)
        assert record.dropped_before == 0
        assert record.result is not None
        assert record.result.state.t_ns in (0, record.mid_exposure_ns) or not record.result.valid
    by_index = {line["frame_index"]: line for line in truth}
    assert set(by_index) >= {record.index for record in completed}
    true = constant_rate(ra_deg=84.0, dec_deg=1.0, rate_deg_s=RATE_DEG_S)
    for record in completed:
        line = by_index[record.index]
        assert line["exposure_mid_ns"] == record.mid_exposure_ns
        assert line["exposure_end_ns"] == record.exposure_end_ns
        q = true.q_icrs_to_sensor(record.mid_exposure_ns)
        np.testing.assert_allclose(line["q_icrs_to_sensor"], q, atol=1e-12)


def test_each_frame_goes_on_from_the_one_before() -> None:
    """Two frames are in the sensor at a time; the state still passes through all of them in their order."""
    completed, _ = run(rolling(), 4000)
    valid = [record for record in completed if record.result is not None and record.result.valid]
    assert len(valid) >= 5
    tracked = [record for record in valid if record.acquisition == record.result.acquisition_after]
    assert tracked  # at a gentle rate it gets to tracking, which needs the attitude of the frame before


def test_a_processor_that_is_too_slow_drops_frames_of_an_overlapping_unit() -> None:
    completed, _ = run(rolling(), 6000, clock_hz=20_000_000)
    assert any(record.dropped_before > 0 for record in completed)
    ends = [record.due_ns for record in completed]
    assert all(
        a is not None and b is not None and b.readout_end_ns >= a
        for a, b in zip(ends, completed[1:], strict=False)
    )


def test_without_overlap_no_row_is_exposed_while_the_frame_before_is_worked_on() -> None:
    completed, truth = run(rolling(), 6000, pipelined=0)
    exposed = [line["exposure_start_ns"] for line in truth if line["frame_index"] >= completed[0].index]
    due = [record.due_ns for record in completed]
    assert len(completed) >= 5
    assert all(b - a >= 2 * PERIOD_NS for a, b in itertools.pairwise(exposed))
    assert all(start >= end for start, end in zip(exposed[1:], due, strict=False))
    assert all(record.dropped_before >= 1 for record in completed[1:])


def test_the_truth_is_asked_for_up_to_the_end_of_the_last_row() -> None:
    profile = rolling()
    true = constant_rate(ra_deg=84.0, dec_deg=1.0, rate_deg_s=RATE_DEG_S)
    outside = SampledTrajectory()
    outside.set_attitude(0, true.q_icrs_to_sensor(0), true.rate_sensor(0))
    completed: list[FrameRecord] = []
    emulator = Emulator(
        profile, scenario(), seed=3, truth=io.StringIO(), trajectory=outside, on_completed=completed.append
    )
    first = next(
        number
        for number in range(100)
        if number * PERIOD_NS >= (profile.timing.boot_ms + profile.timing.self_test_ms) * MS
    )
    end_ns = first * PERIOD_NS + EXPOSURE_NS + LAST_ROW_NS
    for t_ns in range(50 * MS, end_ns, 50 * MS):
        outside.set_attitude(t_ns, true.q_icrs_to_sensor(t_ns), true.rate_sensor(t_ns))
    emulator.advance(outside.last_ns or 0)  # nothing has asked for more
    with pytest.raises(BeyondTruthError):
        emulator.advance(end_ns)
    for t_ns in range(end_ns + 1, end_ns + 4 * PERIOD_NS, 50 * MS):
        outside.set_attitude(t_ns, true.q_icrs_to_sensor(t_ns), true.rate_sensor(t_ns))
    emulator.advance(end_ns + 2 * PERIOD_NS)
    inside, _ = run(profile, end_ns / MS + 400)
    assert completed
    for here, there in zip(completed, inside, strict=False):
        assert here.index == there.index
        assert here.result is not None
        assert there.result is not None
        np.testing.assert_allclose(here.result.q_icrs_to_sensor, there.result.q_icrs_to_sensor, atol=1e-7)


def test_the_firmware_is_told_the_row_time(monkeypatch: pytest.MonkeyPatch) -> None:
    from st_emulator.device import imaging

    told: list[tuple[int, float]] = []
    real = imaging.process_frame

    def listening(frame, context, *rest):  # type: ignore[no-untyped-def]
        told.append((context.t_mid_ns, context.row_time_s))
        return real(frame, context, *rest)

    monkeypatch.setattr(imaging, "process_frame", listening)
    completed, _ = run(rolling(), 2500)
    assert [t_ns for t_ns, _ in told][: len(completed)] == [record.mid_exposure_ns for record in completed]
    assert all(row_time_s == pytest.approx(0.2 / 1024) for _, row_time_s in told)


def test_drops_are_told_when_the_frame_would_have_been_read_out() -> None:
    """A sensor that delivers nothing for one frame: the one behind it, exposed meanwhile, is processed."""
    profile = rolling()
    emulator = Emulator(profile, scenario(), seed=3)
    emulator.device.imaging._source = WithAGap(emulator.device.imaging._source, 9)
    dropped: list[tuple[int, int, FrameDropCause | None]] = []
    done: list[FrameRecord] = []
    tell, complete = emulator.device.frame_dropped, emulator.device.frame_completed
    emulator.device.frame_dropped = lambda record: (
        dropped.append((record.index, emulator.now_ns, record.drop_cause)),
        tell(record),
    )
    emulator.device.frame_completed = lambda record: (done.append(record), complete(record))
    emulator.advance(4000 * MS)
    assert (9, 9 * PERIOD_NS + EXPOSURE_NS + READOUT_NS, FrameDropCause.NO_FRAME_FROM_SENSOR) in dropped
    indices = [record.index for record in done]
    assert 8 in indices
    assert 9 not in indices
    assert indices[indices.index(8) + 1] == 10
    assert next(record for record in done if record.index == 10).dropped_before == 1
