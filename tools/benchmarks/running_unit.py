"""A unit that runs in real time in a process of its own, seen through its pseudo-terminal."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from st_emulator.clock import NS_PER_S
from st_emulator.links import Link, open_link
from st_emulator.protocol.framing import FrameReceived, SlipDecoder
from st_emulator.protocol.pus.packets import MAX_TELEMETRY_BYTES, Telemetry
from st_emulator.protocol.pus.registry import parse_telemetry

START_TIMEOUT_S = 300.0
LINK_POLL_S = 0.002

SCENARIO = """schema = 1
name = "bench"
start_utc = "2026-01-15T00:00:00Z"

[trajectory]
kind = "inertial"
ra_deg = 84.0
dec_deg = -1.5
roll_deg = 20.0

[parameters]
autonomous_start = 1
"""


@dataclass(frozen=True)
class Arrival:
    """A telemetry packet and the time, monotonic ns, at which its last byte was read."""

    time_ns: int
    telemetry: Telemetry


class RunningUnit:
    """``st-emulator run`` on a pseudo-terminal, acquiring by itself, and the OBC's end of the line."""

    def __init__(self, unit: str, folder: Path, environment: dict[str, str] | None = None) -> None:
        self.journal = folder / "journal.jsonl"
        self.malformed = 0
        path = folder / "unit"
        scenario = folder / "scenario.toml"
        scenario.write_text(SCENARIO, encoding="utf-8")
        command = [
            *(sys.executable, "-m", "st_emulator", "run", unit, "--quiet", "--link", f"pty:{path}"),
            *("--scenario", str(scenario), "--journal", str(self.journal)),
        ]
        self.started_ns = time.monotonic_ns()
        self._process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, env={**os.environ, **(environment or {})}
        )
        try:
            self._link = self._await_link(path)
        except BaseException:
            self.stop()
            raise
        self._decoder = SlipDecoder(MAX_TELEMETRY_BYTES)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exception_type: type[BaseException] | None,
        exception: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._link.close()
        self.stop()

    def stop(self) -> None:
        """End the process as Ctrl-C does, so that the journal is whole."""
        if self._process.poll() is None:
            self._process.terminate()
        try:
            self._process.wait(20)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def first_byte_ns(self) -> int:
        """Time from the start of the process to its first telemetry byte."""
        if not select.select([self._link.fileno()], [], [], START_TIMEOUT_S)[0]:
            raise SystemExit("the unit sent nothing")
        return time.monotonic_ns() - self.started_ns

    def send(self, data: bytes) -> int:
        """Put bytes on the line; the time, monotonic ns, at which they went."""
        now_ns = time.monotonic_ns()
        self._link.write(data)
        return now_ns

    def receive(self, until_ns: int) -> list[Arrival]:
        """What the next bytes complete; an empty list when none come until ``until_ns`` (monotonic)."""
        wait_s = max(0.0, (until_ns - time.monotonic_ns()) / NS_PER_S)
        if not select.select([self._link.fileno()], [], [], wait_s)[0]:
            if self._process.poll() is not None:
                raise SystemExit(f"the emulator ended with status {self._process.returncode}")
            return []
        data = self._link.read()
        now_ns = time.monotonic_ns()
        arrivals = []
        for event in self._decoder.receive(data, now_ns):
            parsed = parse_telemetry(event.data) if isinstance(event, FrameReceived) else None
            if isinstance(parsed, Telemetry):
                arrivals.append(Arrival(now_ns, parsed))
            else:
                self.malformed += 1
        return arrivals

    def memory_mb(self) -> dict[str, float]:
        """Most memory so far and memory now that the process held in RAM, MB (10^6 bytes)."""
        lines = Path(f"/proc/{self._process.pid}/status").read_text(encoding="utf-8").splitlines()
        kib = {line.split()[0]: int(line.split()[1]) for line in lines if line.startswith(("VmHWM", "VmRSS"))}
        return {"peak": kib["VmHWM:"] * 1024 / 1e6, "at_end": kib["VmRSS:"] * 1024 / 1e6}

    def _await_link(self, path: Path) -> Link:
        while not path.exists():
            if self._process.poll() is not None:
                raise SystemExit(f"the emulator ended with status {self._process.returncode}")
            time.sleep(LINK_POLL_S)
        return open_link(f"pty:{path}", role="obc")
