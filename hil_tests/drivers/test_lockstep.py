"""A unit stepped from Python: time and truth are the test's."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import pytest

from hil_tests.unit.tumbling import COVARIANCE, RATE_RAD_S, tumble
from hil_tests.vectors import reference_decoder as wire
from hil_tests.vectors.reference_can import Peer
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.journal import read_journal
from st_emulator.bench.scenario import Scenario, parse_scenario
from st_emulator.clock import NS_PER_S, VirtualClock
from st_emulator.commands.replaying import emulator_of, feed
from st_emulator.drivers.lockstep import Lockstep, LockstepError, PausedError
from st_emulator.errors import ConfigurationError
from st_emulator.faults.catalogue import FAULTS
from st_emulator.links import memory_link_pair
from st_emulator.links.can.bus import CanLink
from st_emulator.units.profile import load_unit
from st_emulator.wire.can.wiring import CanWiring
from st_emulator.world import trajectory
from st_emulator.world.sampled import BeyondTruthError, SampledTrajectory

MS = 1_000_000
ROJA1 = load_unit("roja1")
TRUE = trajectory.constant_rate(ra_deg=83, dec_deg=-3, roll_deg=10, rate_deg_s=[0.05, 0.1, 0.2])
AUTONOMOUS = Scenario(parameters={"autonomous_start": 1})
SAME_SKY = parse_scenario(
    """
    [parameters]
    autonomous_start = 1
    [trajectory]
    kind = "constant_rate"
    ra_deg = 83
    dec_deg = -3
    roll_deg = 10
    rate_deg_s = [0.05, 0.1, 0.2]
    """,
    "same sky",
)


PING = wire.slip_frame(
    wire.encode_telecommand("ping", {}, apid=ROJA1.apid, sequence_count=0, source_id=1, ack=15)
)


def give(unit: Lockstep, t_ns: int) -> None:
    unit.set_attitude(t_ns, TRUE.q_icrs_to_sensor(t_ns), TRUE.rate_sensor(t_ns))


def stepped(unit: Lockstep, step_ns: int, end_ns: int) -> list[tuple[int, bytes]]:
    """The truth is given as far as each step, never further."""
    give(unit, 0)
    while unit.now_ns < end_ns:
        until_ns = min(unit.now_ns + step_ns, end_ns)
        give(unit, until_ns)
        unit.step_to(until_ns)
    return unit.take_groups()


class NoFuture:
    """A trajectory that knows nothing beyond the present of a clock."""

    clock: VirtualClock

    def _require(self, t_ns: Any) -> None:
        latest = int(np.max(t_ns))
        assert latest <= self.clock.now_ns, f"asked for {latest} ns at {self.clock.now_ns} ns"

    def q_icrs_to_sensor(self, t_ns: Any) -> Any:
        self._require(t_ns)
        return TRUE.q_icrs_to_sensor(t_ns)

    def rate_sensor(self, t_ns: Any) -> Any:
        self._require(t_ns)
        return TRUE.rate_sensor(t_ns)

    def position_km(self, t_ns: Any) -> None:
        self._require(t_ns)

    def velocity_km_s(self, t_ns: Any) -> None:
        self._require(t_ns)


@pytest.mark.parametrize("unit", ["roja1", "zy3", "science_cam"])
def test_nothing_inside_asks_for_a_future(unit):
    outside, truth = NoFuture(), io.StringIO()
    eager = []

    def submit(compute: Any) -> Any:  # a worker would begin at once
        eager.append(compute())
        raise AssertionError("begun before the exposure was over")

    emulator = Emulator(load_unit(unit), AUTONOMOUS, truth=truth, trajectory=outside, submit=submit)
    outside.clock = emulator.clock
    for command in ("CAPTURE_IMAGE", "START_ACQUISITION"):
        packet = wire.encode_telecommand(
            "function",
            {"function_id": {"CAPTURE_IMAGE": 5, "START_ACQUISITION": 2}[command], "arguments": b""},
            apid=emulator.profile.apid, sequence_count=0, source_id=emulator.profile.wire.source_id, ack=15,
        )  # fmt: skip
        emulator.advance(emulator.now_ns + 1500 * MS)
        emulator.receive(wire.slip_frame(packet))
    emulator.advance(5 * NS_PER_S)
    emulator.close()
    assert emulator.device.frame_counters.frames_processed > 5
    assert not eager


@pytest.mark.parametrize("kind", sorted(name for name in FAULTS if name.startswith("sensor.")))
def test_no_fault_of_the_sensor_asks_for_a_future(kind):
    outside = NoFuture()
    emulator = Emulator(ROJA1, AUTONOMOUS, trajectory=outside)
    outside.clock = emulator.clock
    emulator.advance(1500 * MS)
    emulator.faults.inject({"kind": kind})
    emulator.advance(3500 * MS)
    assert emulator.device.last_frame_index == 14


def test_the_scenarios_truth_file_is_as_before_but_written_when_the_exposure_is_over():
    truth = io.StringIO()
    emulator = Emulator(ROJA1, SAME_SKY, truth=truth)
    emulator.advance(1000 * MS + 1)
    started = emulator.device.last_frame_index
    lines = [json.loads(line) for line in truth.getvalue().splitlines()]
    assert started == 4
    assert lines[-1]["frame_index"] == 3
    assert all(line["exposure_end_ns"] <= emulator.now_ns for line in lines)
    emulator.close()
    lines = [json.loads(line) for line in truth.getvalue().splitlines()]
    assert [line["frame_index"] for line in lines] == list(range(lines[0]["frame_index"], 5))


def test_sampled_truth_gives_the_bytes_of_the_same_motion_as_a_scenario():
    sent: list[tuple[int, bytes]] = []
    emulator = Emulator(ROJA1, SAME_SKY, transmit=lambda data, t_ns: sent.append((t_ns, data)))
    emulator.advance(4 * NS_PER_S)
    assert emulator.device.frame_counters.frames_valid > 8
    outside = Lockstep.of(ROJA1, AUTONOMOUS)
    assert stepped(outside, 250 * MS, 4 * NS_PER_S) == sent


def test_the_same_steps_give_the_same_bytes_and_other_steps_too():
    runs = [
        stepped(Lockstep.of(ROJA1, AUTONOMOUS), step_ns, 3 * NS_PER_S)
        for step_ns in (100 * MS, 100 * MS, 250 * MS, 1000 * MS)
    ]
    assert runs[0]
    assert runs[0] == runs[1]
    # where the samples lie does not matter for a constant rate but for the last bits of the truth
    assert [t_ns for t_ns, _ in runs[0]] == [t_ns for t_ns, _ in runs[2]] == [t_ns for t_ns, _ in runs[3]]


def test_a_step_beyond_the_truth_stands_at_the_end_of_the_exposure_and_goes_on():
    unit, other = Lockstep.of(ROJA1, AUTONOMOUS), Lockstep.of(ROJA1, AUTONOMOUS)
    give(unit, 0)
    give(unit, 600 * MS)
    with pytest.raises(BeyondTruthError, match=r"samples reach from 0 s to 0\.6 s"):
        unit.step_to(NS_PER_S)
    stopped_ns = unit.now_ns
    assert 600 * MS < stopped_ns < NS_PER_S
    with pytest.raises(BeyondTruthError):
        unit.step_to(NS_PER_S)
    assert unit.now_ns == stopped_ns
    assert unit.truth().q_icrs_to_sensor is None
    give(unit, 2 * NS_PER_S)
    unit.step_to(2 * NS_PER_S)
    give(other, 0)
    give(other, 600 * MS)
    give(other, 2 * NS_PER_S)
    other.step_to(2 * NS_PER_S)
    groups = unit.take_groups()
    assert groups
    assert groups == other.take_groups()


def test_a_unit_that_does_not_look_needs_no_truth():
    unit = Lockstep.of(ROJA1)
    unit.step_to(20 * NS_PER_S)
    assert unit.truth().mode == "STANDBY"
    assert unit.truth().q_icrs_to_sensor is None


@pytest.mark.parametrize("step_ms", [70, 333])
def test_a_recorded_run_is_replayed_from_its_journal_alone(step_ms, tmp_path):
    journal, truth = io.StringIO(), io.StringIO()
    unit = Lockstep.of(ROJA1, AUTONOMOUS, journal=journal, truth=truth)
    give(unit, 0)
    for number in range(25):
        give(unit, unit.now_ns + 2 * step_ms * MS + number)
        unit.step_to(unit.now_ns + step_ms * MS)
        if number in (3, 10):
            with pytest.raises(BeyondTruthError):
                unit.step_to(unit.now_ns + 2000 * MS)
        if number == 10:
            unit.receive(PING)
    unit.emulator.close()
    path = tmp_path / "journal.jsonl"
    path.write_text(journal.getvalue())
    read = read_journal(path)
    assert any('"truth"' in line for line in journal.getvalue().splitlines()[1:])
    again, truth_again = io.StringIO(), io.StringIO()
    emulator = emulator_of(read, str(path), journal=again, truth=truth_again)
    feed(emulator, read)
    emulator.close()
    # but for the first line: what the scenario put into the memory is in the memory already
    assert again.getvalue().splitlines()[1:] == journal.getvalue().splitlines()[1:]
    assert truth_again.getvalue() == truth.getvalue()


def test_a_truth_that_gives_no_samples_cannot_be_replayed_and_says_so(tmp_path):
    journal = io.StringIO()
    Emulator(ROJA1, trajectory=TRUE, journal=journal).close()
    path = tmp_path / "journal.jsonl"
    path.write_text(journal.getvalue())
    with pytest.raises(ConfigurationError, match=r"line 1: the truth of this run .* gave no samples"):
        emulator_of(read_journal(path), str(path))


def test_a_damaged_sample_in_a_journal_is_told(tmp_path):
    journal = io.StringIO()
    Lockstep.of(ROJA1, journal=journal).emulator.close()
    path = tmp_path / "journal.jsonl"
    for content in ('{"t_ns": 1}', "5", "[]"):
        path.write_text(journal.getvalue() + f'{{"t_ns": 0, "truth": {content}}}\n')
        read = read_journal(path)
        with pytest.raises(ConfigurationError, match="journal: truth"):
            feed(emulator_of(read, str(path)), read)


def test_frames_run_until_and_pause():
    unit = Lockstep.of(ROJA1, AUTONOMOUS)
    for n in range(21):
        give(unit, n * 500 * MS)
    unit.step_frame(3)
    assert unit.now_ns == 500 * MS  # the first period begins with the power
    assert unit.run_until(lambda u: u.truth().valid, 9 * NS_PER_S)
    state = unit.truth()
    assert state.mode == "TRACKING"
    assert state.last_frame is not None
    assert unit.now_ns == state.last_frame.exposure_mid_ns + state.last_frame.latency_ns
    with pytest.raises(LockstepError, match="cannot step to 5 ns"):
        unit.step_to(5)
    assert not unit.run_until(lambda u: False, unit.now_ns + 700 * MS)
    unit.pause("lunch")
    before = unit.now_ns
    for step in (lambda: unit.step_to(9 * NS_PER_S), unit.step_frame, lambda: unit.run_until(bool, 10)):
        with pytest.raises(PausedError, match="lunch"):
            step()
    assert unit.now_ns == before
    unit.resume()
    unit.step_frame()
    assert unit.now_ns > before


def test_the_true_state_is_that_of_the_samples():
    unit = Lockstep.of(ROJA1, AUTONOMOUS)
    stepped(unit, 250 * MS, 5 * NS_PER_S)
    state = unit.truth()
    assert state.q_icrs_to_sensor == pytest.approx(TRUE.q_icrs_to_sensor(5 * NS_PER_S), abs=1e-12)
    assert state.rate_rad_s == pytest.approx(np.radians([0.05, 0.1, 0.2]), abs=1e-12)
    frame = state.last_frame
    assert frame is not None
    assert frame.q_true_icrs_to_sensor == pytest.approx(
        TRUE.q_icrs_to_sensor(frame.exposure_mid_ns), abs=1e-12
    )
    assert frame.error_arcsec is not None
    # without the date no aberration is corrected: 20.5 arcsec and the unit's noise
    assert np.linalg.norm(frame.error_arcsec[:2]) < 40
    assert frame.rate_rad_s == pytest.approx(state.rate_rad_s, abs=1e-3)
    counters = unit.counters()
    assert counters["frames_processed"] == unit.emulator.device.frame_counters.frames_processed > 10
    assert counters["bytes_sent"] > 0
    json.dumps(state.as_dict(), allow_nan=False)


def test_the_rate_of_the_last_frame_and_its_accuracy(monkeypatch):
    tumble(monkeypatch)
    unit = Lockstep.of(ROJA1, AUTONOMOUS)
    stepped(unit, 250 * MS, 3 * NS_PER_S)
    frame = unit.truth().last_frame
    assert frame is not None
    assert unit.truth().mode == "RATE_ONLY"
    assert not frame.valid
    assert frame.rate_rad_s == tuple(RATE_RAD_S)
    assert frame.rate_covariance_rad2_s2 == tuple(COVARIANCE.ravel())
    json.dumps(unit.truth().as_dict(), allow_nan=False)


def test_the_obcs_bytes_on_a_link_are_taken_when_a_step_begins():
    unit_end, obc_end = memory_link_pair()
    journal = io.StringIO()
    unit = Lockstep.of(ROJA1, link=unit_end, journal=journal)
    unit.step_to(700 * MS)
    obc_end.write(PING)
    unit.step_to(800 * MS)
    entries = [json.loads(line) for line in journal.getvalue().splitlines()[1:]]
    assert [(e["t_ns"], e["rx"]) for e in entries if "rx" in e] == [(700 * MS, PING.hex())]
    sent = unit.take()
    assert sent
    assert obc_end.read() == sent


def test_what_nobody_takes_is_lost_and_counted(monkeypatch):
    monkeypatch.setattr("st_emulator.drivers.lockstep.SENT_KEPT_BYTES", 300)
    unit = Lockstep.of(ROJA1)
    unit.step_to(30 * NS_PER_S)
    counters = unit.counters()
    taken = len(unit.take())
    assert taken <= 300
    assert counters["bytes_lost"] == counters["bytes_sent"] - taken > 0


def test_day_long_truth_keeps_no_more_than_seconds_of_it():
    unit = Lockstep.of(ROJA1)
    for n in range(2000):
        unit.set_attitude(n * 250 * MS, [0, 0, 0, 1], [0, 0, 0])
        unit.step_to(n * 250 * MS)
    sampled = unit.emulator.trajectory
    assert isinstance(sampled, SampledTrajectory)
    assert len(sampled.samples) < 50


def test_set_attitude_without_outside_truth_is_refused():
    with pytest.raises(LockstepError, match="not given from outside"):
        Lockstep.of(ROJA1, trajectory=None).set_attitude(0, [0, 0, 0, 1])


def test_faults_put_in_live_are_in_the_journal_with_the_truth(tmp_path):
    journal = io.StringIO()
    unit = Lockstep.of(ROJA1, AUTONOMOUS, journal=journal)
    give(unit, 0)
    for number in range(1, 21):
        give(unit, number * 200 * MS)
        unit.step_to(number * 200 * MS)
        if number == 8:
            fault = unit.inject({"kind": "telemetry.frozen_attitude"})
            assert [one["number"] for one in unit.active_faults()] == [fault]
        if number == 15:
            unit.clear(fault)
            assert unit.active_faults() == []
    unit.emulator.close()
    path = tmp_path / "journal.jsonl"
    path.write_text(journal.getvalue())
    read, again = read_journal(path), io.StringIO()
    assert {"truth", "inject", "clear"} <= {one.what for one in read.inputs if not hasattr(one, "data")}
    emulator = emulator_of(read, str(path), journal=again)
    feed(emulator, read)
    emulator.close()
    assert again.getvalue().splitlines()[1:] == journal.getvalue().splitlines()[1:]


def test_a_can_bus_beside_it_in_lockstep():
    """An OBC at the far end of a bus of python-can: its frames are taken when a step begins, and the same
    steps give the same frames at the same times.
    """
    runs = []
    for number in range(2):
        channel = f"lockstep-{number}"
        ends = [CanLink("virtual", channel, 1_000_000) for _ in range(2)]
        unit_end, obc_end = ends
        with unit_end, obc_end:
            unit = Lockstep.of(ROJA1, link=unit_end, can=CanWiring(), trajectory=None)
            peer = Peer(0x60A, 0x58A)
            taken: list[tuple[int, bytes]] = []
            for step in range(1, 301):
                if step == 100:
                    peer.send(wire.encode_telecommand("ping", {}, apid=ROJA1.apid, sequence_count=0, ack=15))
                while peer.outbox:
                    obc_end.write(peer.outbox.popleft())
                unit.step_to(step * 5 * MS)
                peer.take(obc_end.read(), unit.now_ns)
                taken += unit.take_groups()
            unit.emulator.close()
        names = [wire.decode_telemetry(packet)["name"] for _, packet in peer.packets]
        assert "pong" in names
        assert peer.broken == 0
        runs.append(taken)
    assert runs[0] == runs[1]
