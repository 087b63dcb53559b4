"""A unit in a process of its own, as a user starts it."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Self

PATIENCE_S = 120.0  # a loaded machine, and kernels that may have to be compiled first


class LiveUnit:
    """`st-emulator run ...` with its link; killed at the end of the block if it still runs.

    `said` holds its standard error by lines, `wait()` gives its exit status.
    """

    def __init__(self, *arguments: str | Path, cwd: Path | None = None) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "st_emulator", "run", *map(str, arguments)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=cwd,
        )
        self.said: list[str] = []
        self._running = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.said.append(line.rstrip("\n"))
            if line.startswith("running "):
                self._running.set()
        self._running.set()

    def await_running(self) -> None:
        """Return when power has come on."""
        assert self._running.wait(PATIENCE_S), self.said
        assert self.process.poll() is None, self.said

    def await_lines(self, path: Path, count: int) -> None:
        """Return when a file that the unit writes holds so many lines."""
        deadline = time.monotonic() + PATIENCE_S
        while not path.exists() or path.read_bytes().count(b"\n") < count:
            assert time.monotonic() < deadline, self.said
            assert self.process.poll() is None, self.said
            time.sleep(0.05)

    def stop(self, signal: int) -> int:
        """Send a signal; the exit status."""
        self.process.send_signal(signal)
        return self.wait()

    def wait(self) -> int:
        """The exit status, when it has ended."""
        status = self.process.wait(PATIENCE_S)
        self._reader.join(PATIENCE_S)
        return status

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self._reader.join(PATIENCE_S)
        for stream in (self.process.stdout, self.process.stderr):
            if stream is not None:
                stream.close()
