"""A process that cleans up after another, also when that one is killed."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import time
from pathlib import Path
from types import TracebackType
from typing import NoReturn, Self

ENDING_S = 10.0  # a killed guest has gone long before


class Keeper:
    """Waits beside this process for its end, or the end of the block, and then does what it was told.

    It has a session of its own and no standard streams, so that neither Ctrl-C nor whoever waits for our
    output to end takes notice of it.
    """

    def __enter__(self) -> Self:
        read_fd, self._write_fd = os.pipe()
        self._pid = os.fork()
        if self._pid == 0:
            os.close(self._write_fd)
            _keep(read_fd)
        os.close(read_fd)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._write_fd)
        os.waitpid(self._pid, 0)

    def end(self, pid: int) -> None:
        """A process to be killed with its process group."""
        self._tell("end", str(pid))

    def remove(self, folder: Path) -> None:
        """A folder to be removed with all in it."""
        self._tell("remove", str(folder))

    def remove_if_empty(self, folder: str) -> None:
        """A folder to be removed if nothing was put there."""
        self._tell("rmdir", folder)

    def _tell(self, what: str, about: str) -> None:
        os.write(self._write_fd, os.fsencode(f"{what} {about}") + b"\0")


def _keep(read_fd: int) -> NoReturn:
    try:
        os.setsid()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE):
            signal.signal(number, signal.SIG_IGN)
        null_fd = os.open(os.devnull, os.O_RDWR)
        for fd in (0, 1, 2):
            os.dup2(null_fd, fd)
        os.chdir("/")
        told = b""
        while data := os.read(read_fd, 4096):
            told += data
        for order in told.split(b"\0")[:-1]:
            what, _, about = os.fsdecode(order).partition(" ")
            if what == "end":
                _end(int(about))
        for order in told.split(b"\0")[:-1]:
            what, _, about = os.fsdecode(order).partition(" ")
            if what == "remove":
                shutil.rmtree(about, ignore_errors=True)
            elif what == "rmdir":
                with contextlib.suppress(OSError):
                    os.rmdir(about)
    finally:
        os._exit(0)


def _end(pid: int) -> None:
    for kill in (os.killpg, os.kill):
        with contextlib.suppress(ProcessLookupError):
            kill(pid, signal.SIGKILL)
    deadline = time.monotonic() + ENDING_S
    while _runs(pid) and time.monotonic() < deadline:
        time.sleep(0.01)


def _runs(pid: int) -> bool:
    """Whether there is such a process that is not merely waiting for its parent to look."""
    try:
        status = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return status.rpartition(")")[2].split()[0] not in "ZX"
