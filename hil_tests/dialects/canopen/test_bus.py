"""The bus: errors, a link that takes nothing, arbitration, frames that mean nothing; the same run twice."""

from __future__ import annotations

import io
import random

import pytest

from hil_tests.dialects.canopen import client
from hil_tests.dialects.canopen.bench import MS, Bench, make
from hil_tests.dialects.canopen.client import STATES
from st_emulator.bench.journal import read_journal
from st_emulator.commands.replaying import emulator_of, feed, first_difference
from st_emulator.wire.can.bus import BusError
from st_emulator.wire.can.wiring import CanWiring


def test_frames_that_are_not_for_the_card():
    bench = make().boot()
    for identifier in (0x62D, 0x600, 0x5AC, 0x182, 0x80 + 0x2C, 0x7FF, 0x100):
        bench.put(identifier, bytes.fromhex("4000400000000000"))
    bench.put(0x62C, b"", remote=True)
    bench.put(0x62C, bytes.fromhex("4000400000000000"), extended=True)
    received = bench.emulator.dialect.messages_received
    bench.run(50)
    assert bench.sent == []
    assert bench.emulator.dialect.messages_received == received == 0


@pytest.mark.parametrize("cut", [1, 4, 7, 8, 12, 15])
def test_records_that_are_cut_lose_nothing_behind_them(cut):
    bench = make().boot()
    whole = client.record(0x62C, bytes.fromhex("4000400000000000"))
    bench.emulator.receive(whole[:cut])
    bench.run(5)
    assert bench.state == STATES["STANDBY"]


def test_records_joined_and_with_garbage_between():
    bench = make().boot()
    good = client.record(0x62C, bytes.fromhex("4017100000000000"))
    bad = bytes.fromhex("0000062c09000000") + bytes(9)  # no frame has 9 octets
    bench.emulator.receive(bad + good + bad + good + bad)
    bench.run(5)
    assert len(bench.of(0x5AC)) == 2


def test_a_bus_full_of_errors():
    ends_ns = [2_000 * MS]

    def errors(frame, own, now_ns):
        return BusError.ACK if own and 500 * MS < now_ns < ends_ns[0] else None

    bench = make(disturbance=errors, heartbeat_ms=100)
    bench.run(1900)
    assert bench.emulator.dialect.bus.state.name == "ERROR_PASSIVE"  # missing acknowledgements do no more
    assert bench.heartbeats[-1][0] < 510 * MS
    bench.run(1000)
    # The newest heartbeat is out, the old ones are not; 8120h, its end and the lost frames are told.
    beats = [t_ns for t_ns, _ in bench.heartbeats if t_ns > 1_900 * MS]
    assert 9 <= len(beats) <= 12
    codes = {message[:2].hex() for message in bench.emergencies}
    assert {"2081", "1081", "0000"} <= codes
    assert bench.sdo.number(0x1001) == 0


def test_off_the_bus_and_back():
    count = [0]

    def errors(frame, own, now_ns):
        if own and now_ns > 500 * MS and count[0] < 32:
            count[0] += 1
            return BusError.BIT
        return None

    bench = make(disturbance=errors, heartbeat_ms=50)
    bench.run(3000)
    assert bench.emulator.dialect.bus.counters.bus_off_count == 1
    recovered = [message for message in bench.emergencies if message[:2] == b"\x40\x81"]
    assert recovered == [bytes.fromhex("4081 11 01000000 00")]
    assert bench.state == STATES["STANDBY"]


def test_a_link_that_takes_nothing_for_a_while():
    bench = make(heartbeat_ms=20).boot()
    bench.ask_for("STAR_TRACK")
    bench.run(600)
    bench.refusing = True
    bench.run(2000)
    bench.forget()
    bench.refusing = False
    bench.run(20)
    # One of each is left: the newest, besides one that the controller had already.
    assert len(bench.of(0x3AC)) <= 2
    assert len(bench.heartbeats) <= 3
    assert bench.state == STATES["STAR_TRACK"]
    # 8110h: frames were lost.
    assert any(message[:2] == b"\x10\x81" for message in bench.emergencies)


def test_frames_of_others_go_first_by_their_identifiers():
    bench = make().boot()
    bench.ask_for("STAR_TRACK")
    bench.run(1000)
    # A flood of high priority from another node, 80 frames of 111 us or more, when an attitude is due.
    begun_ns = bench.attitudes[-1].t_ns + bench.emulator.profile.frame_period_ns - 4 * MS
    bench.forget()
    bench.emulator.advance(begun_ns)
    assert bench.attitudes == []
    for _ in range(80):
        bench.put(0x010, bytes(8))
    bench.run(15)
    (one,) = bench.attitudes
    assert one.t_ns > begun_ns + 80 * 111_000


def test_bit_rate():
    slow = make(can=CanWiring(bitrate=125_000)).boot()
    slow.put(0x62C, bytes.fromhex("4000400000000000"))
    begun = slow.emulator.now_ns
    slow.run(10)
    ((t_ns, _),) = slow.of(0x5AC)
    assert 2 * 111 * 8_000 <= t_ns - begun - 500_000 <= 2 * 135 * 8_000
    assert slow.emulator.dialect.where() == "125000 bit/s, CANopen node 44 (2Ch)"


def busy_session(bench: Bench, seed: int = 1) -> None:
    """A bit of everything, with garbage between."""
    chance = random.Random(seed)
    bench.boot()
    bench.set_time()
    bench.ask_for("STAR_TRACK")
    bench.run(1200)
    for _ in range(50):
        bench.put(chance.randrange(0x800), chance.randbytes(chance.randrange(9)))
        bench.run(chance.random() * 5)
    bench.sdo.read_by_blocks(0x4001, 5)
    bench.ask_for("CAPTURE")
    bench.run(700)
    bench.sdo.write(0x3003, 1, b"\x01")
    bench.run(1000)


def test_two_runs_and_a_replay_give_the_same_octets(tmp_path):
    runs = []
    for number in range(2):
        path = tmp_path / f"{number}.jsonl"
        with path.open("w") as file:
            bench = make(journal=file, seed=5)
            busy_session(bench)
            bench.emulator.close()
        runs.append(path.read_bytes())
    assert runs[0] == runs[1]
    assert len(runs[0]) > 100_000
    journal = read_journal(path)
    again = io.StringIO()
    emulator = emulator_of(journal, str(path), journal=again)
    feed(emulator, journal)
    emulator.close()
    copy = tmp_path / "again.jsonl"
    copy.write_text(again.getvalue())
    sent, again_sent = (
        [one for one in found.entries if one.direction == "tx"] for found in (journal, read_journal(copy))
    )
    assert first_difference(sent, again_sent) is None
    assert len(sent) > 1000


def test_work_of_the_link_counts_into_frames():
    bench = make().boot()
    dialect = bench.emulator.dialect
    dialect.take_work()
    bench.sdo.number(0x4000)
    counts = dialect.take_work().counts
    assert counts["telecommands"] == 1
    assert counts["telecommand_bytes"] == 8
    assert counts["telemetry_bytes"] == 8
    assert counts["sending_rounds"] == counts["receiving_rounds"] == 1
    assert dialect.messages_received == 1
    assert dialect.messages_sent == 2  # the boot-up message and the answer
