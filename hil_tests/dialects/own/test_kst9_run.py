"""`st-emulator run ./kst9_unit.toml` in a process of its own, and an OBC on its pseudo-terminal."""

from __future__ import annotations

import os
import select
import signal
import time
import tty
from pathlib import Path

import pytest

from hil_tests.architecture.source_tree import ROOT
from hil_tests.cli.live import LiveUnit
from hil_tests.dialects.own.client import Client, sentence

PROJECT = Path(__file__).with_name("kst9_project")
PATIENCE_S = 30.0


def listen(port: int, client: Client, kind: str, count: int = 1) -> None:
    """Until the unit has said so many sentences of a kind."""
    deadline = time.monotonic() + PATIENCE_S
    while len(client.of(kind)) < count:
        assert time.monotonic() < deadline, client.said
        if select.select([port], [], [], 0.1)[0]:
            client.take(os.read(port, 4096))


def test_over_a_pseudo_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    path = tmp_path / "unit"
    with LiveUnit("./kst9_unit.toml", "--link", f"pty:{path}", cwd=PROJECT) as unit:
        unit.await_running()
        assert any("57600 baud, unit B" in line for line in unit.said)
        port = os.open(path, os.O_RDWR | os.O_NOCTTY)
        try:
            tty.setraw(port)
            client = Client()
            listen(port, client, "LDR")
            os.write(port, sentence("RUN"))
            listen(port, client, "RDY")
            os.write(port, sentence("PSH", 2)[:5])
            os.write(port, sentence("PSH", 2)[5:] + b"$KSBVER*00\r\n")
            listen(port, client, "NAK")
            assert client.of("NAK") == [["CS"]]
            assert client.of("ACK") == [["RUN"], ["PSH"]]
            listen(port, client, "ATT", 8)
        finally:
            os.close(port)
        state, ra, *_ = client.of("ATT")[-1][2:]
        assert state == "T"
        assert abs(float(ra) - 83.0 / 15) < 0.001  # where a unit without a scenario looks
        assert unit.stop(signal.SIGTERM) == 0
    assert any("3 telecommands" in line for line in unit.said)
