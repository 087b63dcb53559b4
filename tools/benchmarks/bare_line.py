"""The same ping without an emulator: what this machine, as busy as it is, adds to any answer over a pty.

Run as a process of its own it is the other end: it answers whatever comes after a fixed delay and does
nothing else.
"""

from __future__ import annotations

import os
import pty
import random
import select
import subprocess
import sys
import time
import tty
from typing import Any

from spread import of_delays

from st_emulator.drivers.realtime import ahead_of_others

DELAY_NS = 4_000_000
PAUSE_S = (0.02, 0.1)
PACKET = bytes(24)


def floor(pings: int) -> dict[str, Any]:
    """Round trips above the delay of a process that only waits and answers, at the emulator's priority."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    command = [sys.executable, __file__, str(master)]
    chance = random.Random(1)
    excess_ms = []
    try:
        with subprocess.Popen(command, pass_fds=(master,), stdin=subprocess.DEVNULL) as process:
            os.close(master)
            _answer(slave)  # the child is up
            with ahead_of_others():
                for _ in range(pings):
                    time.sleep(chance.uniform(*PAUSE_S))
                    begun_ns = time.monotonic_ns()
                    _answer(slave)
                    excess_ms.append((time.monotonic_ns() - begun_ns - DELAY_NS) * 1e-6)
            process.terminate()
    finally:
        os.close(slave)
    return of_delays(excess_ms)


def _answer(slave: int) -> None:
    os.write(slave, PACKET)
    left = len(PACKET)
    while left:
        select.select([slave], [], [])
        left -= len(os.read(slave, left))


def _serve(master: int) -> None:
    with ahead_of_others():
        while True:
            select.select([master], [], [])
            due_ns = time.monotonic_ns() + DELAY_NS
            data = os.read(master, 4096)
            while (left_ns := due_ns - time.monotonic_ns()) > 0:
                select.select([], [], [], left_ns * 1e-9)
            os.write(master, data)


if __name__ == "__main__":
    _serve(int(sys.argv[1]))
