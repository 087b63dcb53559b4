"""A unit in real time behind a pseudo-terminal, and a driver that waits 50 ms as the real one does."""

from __future__ import annotations

import os
import subprocess
import sys
import termios
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil_tests.dialects.nos3 import client
from hil_tests.dialects.nos3.bench import unit
from st_emulator.commands.warm_up import warm_up
from st_emulator.units.profile import unit_text

STARTS_WITHIN_S = 60
ATTITUDE_WITHIN_S = 20
DRIVER_WAITS_S = 0.05


def test_the_warm_up_works_whatever_the_unit_speaks():
    warm_up(unit())


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[int]:
    """The OBC's end of a running unit's line."""
    _, text = unit_text("roja1")
    ours = tmp_path / "nos3_unit.toml"
    ours.write_text(text.replace("[wire]\n", '[wire]\ndialect = "nos3"\n') + "\n[dialects.nos3]\n")
    path = tmp_path / "line"
    command = [sys.executable, "-m", "st_emulator", "run", str(ours), "--link", f"pty:{path}"]
    with subprocess.Popen(
        [*command, "--seconds", "60"],
        env=os.environ | {"XDG_STATE_HOME": str(tmp_path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        try:
            end = time.monotonic() + STARTS_WITHIN_S
            while not path.exists():
                assert process.poll() is None, process.stdout and process.stdout.read()
                assert time.monotonic() < end
                time.sleep(0.05)
            end_of_line = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            tty.setraw(end_of_line)
            yield end_of_line
            os.close(end_of_line)
        finally:
            process.terminate()
            process.wait(timeout=20)


def read(line: int, count: int, within_s: float) -> bytes:
    """As the driver reads: ticks of 1 ms until all octets are there or time is over."""
    octets = b""
    end = time.monotonic() + within_s
    while len(octets) < count and time.monotonic() < end:
        try:
            octets += os.read(line, count - len(octets))
        except BlockingIOError:
            time.sleep(0.001)
    return octets


def ask(line: int, name: str) -> dict[str, int] | None:
    """One exchange; None when the driver would call it an error."""
    termios.tcflush(line, termios.TCIOFLUSH)
    command = client.command(name)
    os.write(line, command)
    if read(line, 9, DRIVER_WAITS_S) != command:
        return None
    size = client.reply_size(name)
    reply = read(line, size, DRIVER_WAITS_S)
    return client.decode(name, reply) if len(reply) == size else None


def test_a_driver_gets_the_attitude_in_its_time(terminal):
    end = time.monotonic() + ATTITUDE_WITHIN_S
    in_time = late = 0
    data = None
    while time.monotonic() < end and not (data and data["valid"] and in_time >= 20):
        data = ask(terminal, "data")
        in_time += data is not None
        late += data is None and in_time > 0  # from the end of the boot on
        time.sleep(0.02)
    assert data is not None
    assert data["valid"] == 1
    assert in_time > late  # this computer may do something else at times
    assert abs(sum(q * q for q in client.quaternion(data)) - 1) < 2e-4
