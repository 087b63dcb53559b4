"""A run on a CAN bus is the same whatever the steps, and again from its journal."""

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rich.console import Console

from hil_tests.vectors import reference_can as can
from hil_tests.vectors import reference_decoder as wire
from st_emulator.bench.journal import read_journal
from st_emulator.bench.scenario import parse_scenario
from st_emulator.commands.demo import mode_changes
from st_emulator.commands.replaying import emulator_of, feed, frame_of, refusals_of, replay_journal
from st_emulator.protocol.pus.enumerations import Mode
from st_emulator.wire.can.wiring import CanWiring

from .conftest import MS, CanBench, make_can
from .test_determinism import SCENARIO

END_NS = 3000 * MS
WIRINGS = {"classic": {}, "fd": {"fd": True}, "hardware": {"hardware": True}, "node 77": {"node": 77}}


def in_steps(step_ns: int) -> Callable[[CanBench, int], None]:
    def go(bench: CanBench, until_ns: int) -> None:
        while bench.emulator.now_ns < until_ns:
            bench.advance(min(bench.emulator.now_ns + step_ns, until_ns))

    return go


def run(go: Callable[[CanBench, int], None], *, refuse: bool = True, **wiring: Any) -> str:
    """The journal of a run with scenario telecommands, an OBC's, SYNC, foreign frames, a full link."""
    journal = io.StringIO()
    scenario = parse_scenario(SCENARIO, "steps")
    bench = make_can(
        scenario=scenario, journal=journal, can=CanWiring(**wiring), can_section={"heartbeat_ms": 100}
    )
    go(bench, 900 * MS)
    bench.send("memory_dump", {"memory_id": 1, "start_address": 0, "length": 700})
    bench.put_frame("sync", b"\x01")
    for number in range(50):
        bench.put(can.record(0x100 + number, bytes(number % 9)))
    go(bench, 905 * MS)
    bench.refusing = refuse
    go(bench, 960 * MS)
    bench.refusing = False
    bench.put(can.record(0x60A, b"\x40"))
    bench.put(can.error_record(0x04, bytes([0, 0x20, 0, 0, 0, 0, 0, 0])))
    bench.put(b"\x01\x02\x03")
    go(bench, 2100 * MS)
    bench.peer.deaf = True
    go(bench, 2600 * MS)
    bench.peer.deaf = False
    bench.send("ping")
    go(bench, END_NS)
    bench.emulator.close()
    return journal.getvalue()


@pytest.fixture(scope="module", params=WIRINGS)
def at_once(request: Any) -> tuple[str, dict[str, Any]]:
    return run(in_steps(END_NS), **WIRINGS[request.param]), WIRINGS[request.param]


@pytest.mark.parametrize("step_ns", [1 * MS, 7_654_321, 130_000])
def test_steps_do_not_matter(at_once: tuple[str, dict[str, Any]], step_ns: int) -> None:
    text, wiring = at_once
    assert run(in_steps(step_ns), **wiring) == text
    assert text.count('"tx"') > 100
    assert text.count('"refused"') > 20
    assert scenario_frames(text) > 4


def scenario_frames(text: str) -> int:
    """First and single frames of telecommands whose source is the scenario."""
    return sum('"rx"' in line and "005c" in line for line in text.splitlines()) + text.count("deadbeef")


def read(text: str, tmp_path: Path) -> Path:
    path = tmp_path / "run.journal"
    path.write_text(text)
    return path


def test_a_replay_is_the_same_run(at_once: tuple[str, dict[str, Any]], tmp_path: Path) -> None:
    """Its journal has the same lines: what came, what went out, what the link did not take, their times."""
    text, wiring = at_once
    path = read(text, tmp_path)
    journal = read_journal(path)
    assert journal.header["can"] == {"bitrate": None, "fd": False, "node": None, "hardware": False} | wiring
    refusals = refusals_of(journal)
    again = io.StringIO()
    emulator = emulator_of(
        journal, str(path), journal=again, transmit=lambda data, t_ns: 0 if (t_ns, data) in refusals else None
    )
    feed(emulator, journal)
    emulator.close()
    assert again.getvalue().splitlines()[1:] == text.splitlines()[1:]


def test_st_emulator_replay(at_once: tuple[str, dict[str, Any]], tmp_path: Path) -> None:
    text, _ = at_once
    path = read(text, tmp_path)
    again, report = tmp_path / "again.journal", tmp_path / "report.json"
    console = Console(file=io.StringIO())
    assert replay_journal(path, str(report), again, console) == 0
    # The telecommands of the scenario stand in the journal as what came in.
    assert again.read_text().splitlines()[1:] == text.splitlines()[1:]
    figures = json.loads(report.read_text())
    assert "none" in json.dumps(figures)


@pytest.mark.parametrize("kind", ["tx", "rx", "refused"])
def test_a_line_that_is_missing_is_a_difference(
    at_once: tuple[str, dict[str, Any]], kind: str, tmp_path: Path
) -> None:
    text, _ = at_once
    lines = text.splitlines(keepends=True)
    of_kind = [number for number, line in enumerate(lines) if f'"{kind}"' in line]
    # Of those received the last is of the ping; the first of the scenario's came in BOOT.
    del lines[of_kind[-1 if kind == "rx" else 0]]
    path = read("".join(lines), tmp_path)
    assert replay_journal(path, None, None, Console(file=io.StringIO())) == 1


def test_pictures_and_modes_from_the_journal(tmp_path: Path) -> None:
    path = read(run(in_steps(END_NS)), tmp_path)
    journal = read_journal(path)
    changes = [mode for _, mode in mode_changes(journal)]
    assert changes == [Mode.BOOT, Mode.STANDBY, Mode.LOST_IN_SPACE, Mode.TRACKING]
    record = frame_of(journal, str(path), 8)
    assert record is not None
    assert record.result is not None
    assert record.result.valid


@settings(
    max_examples=10,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(
    arrivals=st.lists(
        st.tuples(
            st.integers(0, 300 * MS),
            st.one_of(
                st.binary(min_size=1, max_size=30),
                st.builds(
                    can.record, st.sampled_from([0x60A, 0x080, 0x100, 0x58A, 1]), st.binary(max_size=8)
                ),
                st.builds(can.error_record, st.sampled_from([0x40, 0x100, 0x204]), st.just(bytes(8))),
                st.sampled_from([(17, 1, b""), (6, 5, b"\x01\0\0\0\0\x02\0"), (8, 1, b"\x02")]),
            ),
            st.booleans(),
        ),
        max_size=10,
    )
)
def test_whatever_came_replays(tmp_path: Path, arrivals: list[tuple[int, Any, bool]]) -> None:
    journal = io.StringIO()
    bench = make_can(journal=journal)
    bench.run(400)
    for gap_ns, what, refuse in arrivals:
        bench.refusing = refuse
        bench.advance(bench.emulator.now_ns + gap_ns)
        if isinstance(what, bytes):
            bench.put(what)
        else:
            bench.put_packet(wire.telecommand_packet(*what, bench.apid, 3, 1, 15))
    bench.run(600)
    bench.emulator.close()
    text = journal.getvalue()
    path = read(text, tmp_path)
    again = tmp_path / "again.journal"
    assert replay_journal(path, None, again, Console(file=io.StringIO())) == 0
    assert again.read_text().splitlines()[1:] == text.splitlines()[1:]
