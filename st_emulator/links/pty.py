"""The unit's end of a pseudo-terminal, with a link path that stays the same from run to run.

The kernel gives each pseudo-terminal a number (/dev/pts/7), so a symbolic link at a path of the user's choice
points to it. A lock file beside the link (PATH.lock, held with flock, which the kernel releases when the
process dies) tells a link that is in use from one left by a killed emulator.
"""

import contextlib
import errno
import fcntl
import os
import stat
import struct
import termios
import time
import tty
from collections.abc import Callable
from pathlib import Path

from .link import ClosesOnExit, LinkError

STALE_AFTER_NS = 10_000_000_000
"""Bytes that nobody has begun to read for this long are flushed: a late reader must not get old telemetry."""
INPUT_QUEUE_BYTES = 4095
"""Linux n_tty holds so many unread bytes; what lies behind them is not counted by FIONREAD."""
SETTLING_NS = 10_000_000
"""What is written takes a moment to reach the reader's queue; until then its length says nothing."""
READ_CHUNK_BYTES = 65536
PTS_FOLDER = "/dev/pts/"


class PtyLink(ClosesOnExit):
    """A new pseudo-terminal in raw mode; an OBC opens `path`. Raises LinkError when `path` cannot be used.

    The slave side stays open here too, so that an OBC may come, go and come again. Bytes unread for
    `STALE_AFTER_NS` (or more than `INPUT_QUEUE_BYTES` for as long) are flushed at the next `read` or `write`
    and count as dropped.
    """

    def __init__(self, path: str | Path, monotonic_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.path = Path(path).expanduser().absolute()
        self.name = f"pty:{self.path}"
        self.dropped_bytes = 0
        self._monotonic_ns = monotonic_ns
        self._closed = False
        self._lock_fd = _claim(self.path, self.name)
        try:
            self._master_fd, self._slave_fd = os.openpty()
        except OSError as error:
            _release(self.path, self._lock_fd)
            raise LinkError(f"{self.name}: no pseudo-terminal to be had: {error.strerror}") from error
        self.device = os.ttyname(self._slave_fd)
        try:
            tty.setraw(self._slave_fd)
            os.set_blocking(self._master_fd, False)
            _point(self.path, self.device)
        except OSError as error:
            os.close(self._master_fd)
            os.close(self._slave_fd)
            _release(self.path, self._lock_fd)
            raise LinkError(f"{self.name}: the link cannot be made: {error.strerror}") from error
        self._unread_bytes = 0
        self._unread_since_ns = 0
        self._written_ns = 0

    def fileno(self) -> int | None:
        """The master side's descriptor."""
        self._require_open()
        return self._master_fd

    def read(self) -> bytes:
        """Every byte that an OBC has written, b"" when none."""
        self._require_open()
        self._flush_if_stale()
        received = bytearray()
        while True:
            try:
                chunk = os.read(self._master_fd, READ_CHUNK_BYTES)
            except BlockingIOError:
                return bytes(received)
            except OSError as error:
                raise LinkError(f"{self.name}: reading failed: {error.strerror}") from error
            if not chunk:
                return bytes(received)
            received += chunk

    def write(self, data: bytes) -> int:
        """Number of bytes taken by the kernel; the others are dropped and counted."""
        self._require_open()
        self._flush_if_stale()
        taken = 0
        while taken < len(data):
            try:
                taken += os.write(self._master_fd, data[taken:])
            except BlockingIOError:
                break
            except OSError as error:
                raise LinkError(f"{self.name}: writing failed: {error.strerror}") from error
        if taken:
            self._written_ns = self._monotonic_ns()
            if not self._unread_bytes:
                self._unread_since_ns = self._written_ns
            self._unread_bytes += taken
        self.dropped_bytes += len(data) - taken
        return taken

    def close(self) -> None:
        """Remove the link path, then close the pseudo-terminal."""
        if self._closed:
            return
        self._closed = True
        with contextlib.suppress(OSError):
            if os.readlink(self.path) == self.device:
                self.path.unlink()
        os.close(self._master_fd)
        os.close(self._slave_fd)
        _release(self.path, self._lock_fd)

    def _flush_if_stale(self) -> None:
        if not self._unread_bytes:
            return
        now_ns = self._monotonic_ns()
        if now_ns - self._written_ns < SETTLING_NS:
            return
        (waiting,) = struct.unpack("i", fcntl.ioctl(self._slave_fd, termios.FIONREAD, b"\0\0\0\0"))
        if waiting < min(self._unread_bytes, INPUT_QUEUE_BYTES):
            # Somebody reads. (At the queue's limit reading does not show, as what is read is refilled from
            # behind; a reader who stays that far behind for so long counts as absent.)
            self._unread_bytes = waiting
            self._unread_since_ns = now_ns
        elif now_ns - self._unread_since_ns >= STALE_AFTER_NS:
            termios.tcflush(self._slave_fd, termios.TCIFLUSH)
            self.dropped_bytes += self._unread_bytes
            self._unread_bytes = 0

    def _require_open(self) -> None:
        if self._closed:
            raise LinkError(f"{self.name}: the link is closed")


def runtime_folder() -> Path:
    """The user's own folder for link paths: $XDG_RUNTIME_DIR/st-emulator, else /tmp/st-emulator-UID.

    Made with mode 0700 when missing. LinkError when it belongs to somebody else.
    """
    base = os.environ.get("XDG_RUNTIME_DIR")
    if base and os.path.isdir(base):
        folder = Path(base) / "st-emulator"
    else:
        folder = Path(f"/tmp/st-emulator-{os.getuid()}")
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        status = os.lstat(folder)
    except OSError as error:
        raise LinkError(f"pty: cannot make {folder}: {error.strerror}; name a path: pty:PATH") from error
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid():
        raise LinkError(f"pty: {folder} is not a folder of this user; name a path: pty:PATH")
    return folder


def default_path(name: str) -> Path:
    """Link path of the unit called `name` in the user's runtime folder."""
    return runtime_folder() / name


def live_paths() -> list[Path]:
    """Link paths in the user's runtime folder that a running emulator holds."""
    return [
        path
        for path in sorted(runtime_folder().iterdir())
        if path.is_symlink() and is_terminal(path) and _is_locked(path)
    ]


def only_live_path(name: str) -> Path:
    """The link path called `name` if live, else the only live one. LinkError for none or a choice."""
    live = live_paths()
    named = [path for path in live if path.name == name]
    if len(named or live) == 1:
        return (named or live)[0]
    if not live:
        raise LinkError(f"pty: no emulator runs with a link in {runtime_folder()}; name its path: pty:PATH")
    raise LinkError(f"pty: several emulators run; name one: {', '.join(f'pty:{path}' for path in live)}")


def is_terminal(path: str | Path) -> bool:
    """Whether `path` leads to a character device."""
    try:
        return stat.S_ISCHR(os.stat(Path(path).expanduser()).st_mode)
    except OSError:
        return False


def _lock_path(path: Path) -> Path:
    return path.with_name(path.name + ".lock")


def _is_locked(path: Path) -> bool:
    try:
        fd = os.open(_lock_path(path), os.O_RDWR | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(fd)
    return False


def _claim(path: Path, name: str) -> int:
    """Lock `path` and see that it is free or a link left behind; returns the lock's descriptor."""
    fd = _lock(path, name)
    try:
        status = os.lstat(path)
    except FileNotFoundError:
        return fd
    except OSError as error:
        _release(path, fd)
        raise LinkError(f"{name}: {error.strerror}") from error
    if stat.S_ISLNK(status.st_mode) and os.readlink(path).startswith(PTS_FOLDER):
        return fd
    _release(path, fd)
    raise LinkError(f"{name}: the path exists and is no link to a pseudo-terminal; name another path")


def _lock(path: Path, name: str) -> int:
    lock_path = _lock_path(path)
    while True:
        try:
            fd = os.open(lock_path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        except OSError as error:
            missing = error.errno == errno.ENOENT
            what = f"the folder {path.parent} does not exist" if missing else str(error.strerror)
            raise LinkError(f"{name}: {what}; name a path in a folder that you may write to") from error
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(fd)
            raise LinkError(f"{name}: a running emulator has this link; stop it or name another") from None
        # The holder before us removes its lock file when it closes: ours must still be the one there.
        with contextlib.suppress(OSError):
            if os.path.samestat(os.fstat(fd), os.stat(lock_path)):
                return fd
        os.close(fd)


def _release(path: Path, lock_fd: int) -> None:
    with contextlib.suppress(OSError):
        _lock_path(path).unlink()
    os.close(lock_fd)


def _point(path: Path, device: str) -> None:
    """Make `path` a link to `device` in one step, in place of a link left behind."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    with contextlib.suppress(FileNotFoundError):
        temporary.unlink()
    temporary.symlink_to(device)
    os.replace(temporary, path)
