"""The reader's thread on real links. Nothing here depends on how fast the machine is."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from st_emulator.links import Link, LinkError, memory_link_pair
from st_emulator.links.pty import PtyLink
from st_emulator.obc import Obc, TelemetryTimeout

PATIENCE_S = 30.0


@contextmanager
def running(wire: Any, link: Link) -> Iterator[Any]:
    """A fake unit that answers pings in a thread of its own."""
    unit = wire.FakeUnit(link)
    unit.answer((17, 1), lambda request: unit.send(17, 2))
    stop = threading.Event()

    def run() -> None:
        while not stop.is_set():
            unit.step(unit.now_ns + 1_000_000)
            stop.wait(0.001)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield unit
    finally:
        stop.set()
        thread.join()


@pytest.mark.parametrize("apid", [None, 0x123])
def test_over_a_pseudo_terminal(wire: Any, tmp_path: Path, apid: int | None) -> None:
    with PtyLink(tmp_path / "unit") as link, running(wire, link) as unit:
        with Obc.connect(f"pty:{tmp_path / 'unit'}", apid=apid, record=tmp_path / "recording") as obc:
            unit.attitude(frame=32)
            for _ in range(20):
                assert obc.ping(PATIENCE_S) > 0
            unit.attitude(frame=33)
            # The thread may have read it before this line: from the start on, then.
            obc.wait_for(
                "attitude_report", lambda report: report.fields["frame_index"] == 33, PATIENCE_S, since=0
            )
            counters = obc.counters
        assert (counters.telecommands_sent, counters.telecommands_verified) == (20, 20)
        assert (counters.crc_errors, counters.malformed, counters.sequence_gaps) == (0, 0, 0)
        with Obc.connect(str(tmp_path / "unit"), apid=0x123) as obc:
            obc.ping(PATIENCE_S)


def test_over_memory(wire: Any) -> None:
    unit_link, obc_link = memory_link_pair()
    with running(wire, unit_link), Obc(obc_link, apid=wire.APID) as obc:
        assert obc.ping(PATIENCE_S) > 0


def test_a_link_that_goes_away_ends_every_wait(wire: Any) -> None:
    unit_link, obc_link = memory_link_pair()
    with Obc(obc_link) as obc:
        threading.Timer(0.05, unit_link.close).start()
        with pytest.raises(LinkError, match="other side has closed"):
            obc.wait(PATIENCE_S)
        with pytest.raises(LinkError, match="other side has closed"):
            obc.next("attitude_report", PATIENCE_S)


def test_what_the_thread_cannot_do_reaches_the_caller(wire: Any) -> None:
    unit_link, obc_link = memory_link_pair()
    with Obc(obc_link) as obc:

        def full(*ignored: object) -> None:
            raise OSError(28, "No space left on device")

        obc.unit.take = full  # type: ignore[method-assign]
        unit_link.write(wire.slip(wire.telemetry_packet(17, 2)))
        with pytest.raises(OSError, match="No space left"):
            obc.wait(PATIENCE_S)


def test_an_apid_that_is_not_given_is_learned_before_the_first_telecommand(wire: Any) -> None:
    unit_link, obc_link = memory_link_pair()
    with running(wire, unit_link) as unit, Obc(obc_link) as obc:
        unit.attitude(after_ms=50)
        obc.ping(PATIENCE_S)
        assert [request.apid for request in unit.requests] == [wire.APID]
        assert obc.destination_apid == wire.APID


def test_silence_ends_at_the_time_limit() -> None:
    _, obc_link = memory_link_pair()
    with Obc(obc_link) as obc, pytest.raises(TelemetryTimeout):
        obc.next("attitude_report", 0.01)


def test_closing_twice_and_missing_links(tmp_path: Path) -> None:
    _, obc_link = memory_link_pair()
    obc = Obc(obc_link)
    obc.close()
    obc.close()
    with pytest.raises(LinkError, match="no pseudo-terminal there"):
        Obc.connect(f"pty:{tmp_path / 'unit'}")


def test_a_recording_that_cannot_be_leaves_the_port_free(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with PtyLink(tmp_path / "unit"):
        with pytest.raises(Exception, match="cannot record there"):
            Obc.connect(f"pty:{tmp_path / 'unit'}", record=tmp_path / "file")
        Obc.connect(f"pty:{tmp_path / 'unit'}").close()
