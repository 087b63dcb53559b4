"""What is counted of a sky, against the firmware run by itself and against the emulator's own frames."""

from __future__ import annotations

import numpy as np
import pytest

from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import Scenario, ScenarioTelecommand, Sky
from st_emulator.budget.samples import Instant, Look, counts_of, look
from st_emulator.budget.scenes import frames_under, random_conditions
from st_emulator.budget.subject import Subject, subject_of
from st_emulator.budget.transmission import transmission_of
from st_emulator.firmware_model.modes import Mode
from st_emulator.firmware_model.reasons import Reason
from st_emulator.firmware_model.work import Work


def test_a_sky_is_its_frames_and_their_reports(roja1):
    conditions = random_conditions(1, 4)[0]
    sample = look(roja1, None, Look(conditions))
    frames = list(frames_under(roja1, conditions))
    report = transmission_of(Subject(roja1)).work
    for counts, inputs in zip(
        [sample.lost.counts, *(item.counts for item in sample.tracked)], frames, strict=True
    ):
        assert np.array_equal(counts, counts_of(inputs.process().work + report))
    assert [item.reasons for item in sample.tracked] == [0, 0]


def test_a_short_search_is_the_same_with_and_without_limit(roja1):
    lost = look(roja1, None, Look(random_conditions(1, 4)[0])).lost
    assert not lost.limited
    assert np.array_equal(lost.counts, lost.whole_counts)
    assert np.array_equal(lost.other_counts, lost.whole_counts)


def test_a_long_search_is_cut_by_the_budget_of_its_mode(roja1):
    """At 20 MHz roja1 has 5 million cycles pipelined and 2.7 million not: among false stars neither ends."""
    slow = subject_of(roja1, clock_hz=20_000_000)
    case = Look(random_conditions(3, 2, false_stars=100)[1], slow.changed)
    lost = look(roja1, None, case).lost
    assert lost.limited
    assert lost.reasons & Reason.WORK_LIMIT
    assert not lost.whole_reasons & Reason.WORK_LIMIT
    assert lost.other_counts.sum() < lost.counts.sum() < lost.whole_counts.sum()
    # by itself: the firmware with the configuration of each mode
    for pipelined, counts in ((1, lost.counts), (0, lost.other_counts)):
        changed = dict(slow.changed) | {"pipelined": pipelined}
        inputs = next(frames_under(roja1, case.place, parameters=changed))
        report = transmission_of(slow).work
        assert np.array_equal(counts, counts_of(inputs.process().work + report))


def test_before_the_search_and_the_search_are_steps_of_the_frame(roja1):
    place = random_conditions(1, 4, false_stars=10)[0]
    lost = look(roja1, None, Look(place)).lost
    records = []
    next(frames_under(roja1, place)).without_limit().process(records.append)
    names = [record.step for record in records]
    at = names.index("identify")
    assert names.index("detect") < at < names.index("attitude")
    before = sum((counts_of(record.work) for record in records[:at]), counts_of(Work({"frames": 1})))
    assert np.array_equal(lost.before_counts, before)
    assert np.array_equal(lost.search_counts, counts_of(records[at].work))
    assert np.all(lost.whole_counts >= lost.before_counts + lost.search_counts)


SCENARIO = Scenario(
    seed=11,
    sky=Sky(false_spots=7, sun=False, moon=False, earth=False),
    parameters={"aberration_correction": 0},  # the emulator's time is not set, so it corrects nothing
    telecommands=[ScenarioTelecommand(at_s=0.6, name="function", fields={"function_id": 2, "arguments": {}})],
)


@pytest.mark.parametrize("clock_hz", [400_000_000, 60_000_000])
def test_frames_of_a_scenario_are_the_emulators(roja1, clock_hz):
    """Frame 3 of a running unit, the first after the telecommand, and those tracked after it cost what the
    budget says, but for the telemetry, of which more than the frame's own report is built."""
    scenario = SCENARIO.model_copy(update={"parameters": {"aberration_correction": 0, "clock_hz": clock_hz}})
    records = []
    Emulator(roja1, scenario, on_completed=records.append).advance(2_000_000_000)
    own, *tracked = records[:3]
    assert (own.index, own.acquisition) == (3, Mode.LOST_IN_SPACE)
    assert {item.acquisition for item in tracked} == {Mode.TRACKING}
    subject = subject_of(roja1, parameters={"aberration_correction": 0, "clock_hz": clock_hz})
    sample = look(roja1, scenario, Look(Instant(3 * roja1.frame_period_ns, 0), subject.changed))
    report = transmission_of(subject).work
    assert np.array_equal(sample.lost.counts, counts_of(own.result.work + report))
    assert own.result.valid
    for item, frame in zip(sample.tracked, tracked, strict=True):
        assert np.array_equal(item.counts, counts_of(frame.result.work + report))


def test_the_report_is_as_long_as_on_the_wire(roja1):
    sent: list[bytes] = []

    def transmit(data: bytes, _: int) -> None:
        sent.append(data)

    Emulator(roja1, SCENARIO, transmit=transmit).advance(3_000_000_000)
    from st_emulator.protocol.framing import FrameReceived, SlipDecoder
    from st_emulator.protocol.pus.registry import parse_telemetry

    events = SlipDecoder(4096).receive(b"".join(sent), 0)
    packets = [event.data for event in events if isinstance(event, FrameReceived)]
    reports = [item for item in packets if getattr(parse_telemetry(item), "name", "") == "attitude_report"]
    found = transmission_of(Subject(roja1))
    assert reports
    assert {len(item) for item in reports} == {found.packet_bytes}
    # ten bits a byte at 115200 baud, two END and some escapes
    plain_ns = (found.packet_bytes + 2) * 10 * 10**9 / 115200
    assert plain_ns < found.serial_ns < 1.02 * plain_ns
    assert found.work == Work({"telemetry_bytes": found.packet_bytes, "crc_bytes": found.packet_bytes})


def test_a_unit_that_sends_no_report_builds_none(roja1):
    silent = Subject(roja1).with_parameters(attitude_report=0)
    found = transmission_of(silent)
    assert (found.packet_bytes, found.serial_ns) == (0, 0)
    assert found.work == Work()
    assert found.can_frames == 5
    # five frames of 8 bytes at 1 Mbit/s: 111 bits at least, with stuff bits 135 at most
    assert 5 * 108_000 <= found.can_ns <= 5 * 135_000
