"""The same run gives the same bytes at the same times: whatever the steps, and again from its journal."""

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil_tests.vectors import reference_decoder as wire
from st_emulator.bench.emulator import Emulator
from st_emulator.bench.journal import JournalEntry, read_journal
from st_emulator.bench.scenario import parse_scenario
from st_emulator.commands.replaying import emulator_of, feed, first_difference
from st_emulator.device.store import FileStore
from st_emulator.errors import ConfigurationError
from st_emulator.units.profile import load_unit

MS = 1_000_000
ROJA1 = load_unit("roja1")

SCENARIO = """
schema = 1
name = "steps"
[trajectory]
kind = "constant_rate"
ra_deg = 83.0
dec_deg = -3.0
rate_deg_s = [0.0, 0.1, 0.2]
[sky]
false_spots = 3
[[telecommands]]
at_s = 0.75
name = "function"
fields = { function_id = "START_ACQUISITION", arguments = {} }
[[telecommands]]
at_s = 0.5
name = "set_time"
fields = { time = "2026-01-15T00:00:00Z" }
[[telecommands]]
at_s = 1.25
name = "hk_one_shot"
fields = { structure_ids = ["STATUS", "LINK", "TIMING"] }
[[telecommands]]
at_s = 1.25
raw_hex = "c0deadbeefc0"
"""


def run(steps: Callable[[Emulator], None], *, seed: int | None = None, text: str = SCENARIO) -> str:
    """The journal of a run."""
    journal = io.StringIO()
    emulator = Emulator(ROJA1, parse_scenario(text, "steps"), seed=seed, journal=journal)
    steps(emulator)
    emulator.close()
    return journal.getvalue()


END_NS = 2500 * MS


def in_steps(step_ns: int) -> Callable[[Emulator], None]:
    def steps(emulator: Emulator) -> None:
        while emulator.now_ns < END_NS:
            emulator.advance(min(emulator.now_ns + step_ns, END_NS))

    return steps


def event_by_event(emulator: Emulator) -> None:
    while (due_ns := emulator.next_event_ns()) is not None and due_ns <= END_NS:
        emulator.advance(due_ns)
    emulator.advance(END_NS)


@pytest.fixture(scope="module")
def at_once() -> str:
    return run(in_steps(END_NS))


@pytest.mark.parametrize("step_ns", [1 * MS, 7_654_321, 250 * MS, 104_729])
def test_steps_do_not_matter(at_once: str, step_ns: int) -> None:
    assert run(in_steps(step_ns)) == at_once
    assert at_once.count('"tx"') > 50


def test_event_by_event_is_the_same(at_once: str) -> None:
    assert run(event_by_event) == at_once


def test_another_seed_is_another_sky(at_once: str) -> None:
    other = run(in_steps(END_NS), seed=2)
    assert other != at_once
    assert run(in_steps(END_NS), seed=2) == other


def test_scenario_telecommands_arrive_in_order_of_time(at_once: str) -> None:
    received = [json.loads(line) for line in at_once.splitlines() if '"rx"' in line]
    assert [item["t_ns"] for item in received] == [500 * MS, 750 * MS, 1250 * MS, 1250 * MS]
    assert received[-1]["rx"] == "c0deadbeefc0"


def test_scenario_telecommands_are_counted_in_order_of_time(at_once: str) -> None:
    received = [bytes.fromhex(json.loads(line)["rx"]) for line in at_once.splitlines() if '"rx"' in line]
    frames = [frame for data in received for frame in wire.slip_frames(data) if len(frame) > 10]
    assert [wire.decode_packet(frame)["sequence_count"] for frame in frames] == [0, 1, 2]
    line = b"".join(bytes.fromhex(json.loads(text)["tx"]) for text in at_once.splitlines() if '"tx"' in text)
    told = [wire.decode_telemetry(frame) for frame in wire.slip_frames(line)]
    assert [packet["fields"]["event_id"] for packet in told if packet["service"] == 5].count(10) == 0


def replayed(text: str, tmp_path: Path) -> tuple[list[JournalEntry], list[JournalEntry], str]:
    """Transmitted groups of a journal and of its replay, and the replay's own journal."""
    path = tmp_path / "run.journal"
    path.write_text(text)
    journal = read_journal(path)
    groups: list[JournalEntry] = []
    again = io.StringIO()
    emulator = emulator_of(
        journal,
        str(path),
        transmit=lambda data, t_ns: groups.append(JournalEntry(t_ns, "tx", data)),
        journal=again,
    )
    feed(emulator, journal)
    emulator.close()
    recorded = [entry for entry in journal.entries if entry.direction == "tx"]
    return recorded, groups, again.getvalue()


def test_a_replay_is_the_same_run(at_once: str, tmp_path: Path) -> None:
    recorded, groups, again = replayed(at_once, tmp_path)
    assert first_difference(recorded, groups) is None
    assert again.splitlines()[1:] == at_once.splitlines()[1:]


def test_a_telecommand_at_the_instant_of_other_events_replays(tmp_path: Path) -> None:
    """At 1.0 s a frame starts and, with boot at once, housekeeping is due: a replay must keep the order."""
    instant = json.loads(json.dumps(ROJA1.model_dump(mode="json")))
    instant["timing"] |= {"boot_ms": 0, "telecommand_latency_us": 0}
    profile = type(ROJA1).model_validate(instant)
    text = SCENARIO.replace("0.75", "1.0").replace("1.25", "2.0").replace("0.5", "0.0", 1)
    journal = io.StringIO()
    emulator = Emulator(profile, parse_scenario(text, "instant"), journal=journal, baud=4_000_000)
    emulator.advance(END_NS)
    emulator.close()
    recorded, groups, _ = replayed(journal.getvalue(), tmp_path)
    assert first_difference(recorded, groups) is None
    assert len(recorded) > 10


def test_a_damaged_store_replays_with_its_event(tmp_path: Path) -> None:
    path = tmp_path / "store.json"
    path.write_text("damaged")
    journal = io.StringIO()
    emulator = Emulator(ROJA1, store=FileStore(path, "roja1"), journal=journal)
    emulator.advance(1600 * MS)
    emulator.close()
    recorded, groups, _ = replayed(journal.getvalue(), tmp_path)
    line = b"".join(entry.data for entry in recorded)
    assert [wire.decode_telemetry(frame)["fields"].get("event_id") for frame in wire.slip_frames(line)][
        :2
    ] == [1, 14]
    assert first_difference(recorded, groups) is None


FUNCTIONS = st.sampled_from([(1, b""), (2, b""), (3, b""), (5, b""), (7, b""), (9, b""), (4, b"\0")])
TELECOMMAND = st.one_of(
    FUNCTIONS.map(lambda item: (8, 1, bytes([item[0]]) + item[1])),
    st.sampled_from(
        [
            (17, 1, b""),
            (3, 27, b"\x01\x02"),
            (9, 1, b"\x00"),
            (9, 128, bytes(range(7))),
            (20, 3, b"\x01\x00\x13\x00"),
        ]
    ),
)


@settings(
    max_examples=8,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(
    arrivals=st.lists(
        st.tuples(
            st.integers(0, 400 * MS),
            st.one_of(
                st.binary(min_size=1, max_size=30),
                TELECOMMAND.map(
                    lambda tc: wire.slip_frame(
                        wire.telecommand_packet(tc[0], tc[1], tc[2], ROJA1.apid, 3, 1, 15)
                    )
                ),
            ),
        ),
        max_size=8,
    )
)
def test_whatever_a_live_obc_sent_replays(tmp_path: Path, arrivals: list[tuple[int, bytes]]) -> None:
    journal = io.StringIO()
    emulator = Emulator(ROJA1, journal=journal)
    emulator.advance(400 * MS)
    for gap_ns, data in arrivals:
        emulator.advance(emulator.now_ns + gap_ns)
        emulator.receive(data)
    emulator.advance(emulator.now_ns + 600 * MS)
    emulator.close()
    recorded, groups, again = replayed(journal.getvalue(), tmp_path)
    assert first_difference(recorded, groups) is None
    assert again == journal.getvalue()


def test_first_difference_names_the_place() -> None:
    one = [JournalEntry(1, "tx", b"a"), JournalEntry(2, "tx", b"b")]
    assert first_difference(one, one) is None
    assert "group 1" in str(first_difference(one, [one[0], JournalEntry(2, "tx", b"c")]))
    assert "group 1" in str(first_difference(one, [one[0], JournalEntry(3, "tx", b"b")]))
    assert first_difference(one, one[:1]) == "2 groups against 1"


def test_a_journal_with_a_damaged_first_line_is_named(at_once: str, tmp_path: Path) -> None:
    header: dict[str, Any] = json.loads(at_once.splitlines()[0])
    for key in ("unit", "scenario", "store", "seed", "baud"):
        path = tmp_path / "a.journal"
        path.write_text(json.dumps({name: value for name, value in header.items() if name != key}) + "\n")
        with pytest.raises(ConfigurationError, match=r"a\.journal"):
            emulator_of(read_journal(path), str(path))
