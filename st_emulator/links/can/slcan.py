"""slcan: a CAN adapter at a serial port, with the text protocol of Lawicel's CAN232."""

from __future__ import annotations

import errno
import fcntl
import os
import select
import stat
import threading

import can
from can.interfaces.slcan import slcanBus

from ...protocol.errors import LocalProtocolError
from ..link import LinkError
from .records import frame_to_send, message_of, one_line, record_of

BITRATES = (10_000, 20_000, 50_000, 83_300, 100_000, 125_000, 250_000, 500_000, 750_000, 1_000_000)
OPENING_S = 2.0  # python-can's own: adapters that reset when their port is opened need it
READ_CHUNK_BYTES = 65536


class _LawicelBus(slcanBus):
    """python-can's codec and opening of such an adapter over a port that never waits.

    Its own reading takes two system calls a byte and its own writing waits until all has left. In `pending`
    is what the driver has not taken yet of a line begun: nothing may come in between.
    """

    def __init__(self, device: str, bitrate: int, opening_s: float) -> None:
        self.pending = bytearray()
        self._pending_lock = threading.Lock()
        super().__init__(device, bitrate=bitrate, timeout=0, sleep_after_open=opening_s)

    def _write(self, string: str) -> None:
        with self._pending_lock:
            self.pending += string.encode() + self.LINE_TERMINATOR
        self.push()

    def push(self) -> bool:
        """Write what is pending; whether all of it could be. OSError when the device has gone."""
        with self._pending_lock:
            while self.pending:
                try:
                    del self.pending[: os.write(self.fileno(), self.pending)]
                except BlockingIOError:
                    return False
        return True

    def fetch(self) -> None:
        """Take in all that has arrived. OSError when the device has gone."""
        # Such a port reads b"" both when nothing is there and after a hang-up; poll() tells which.
        poll = select.poll()
        poll.register(self.fileno(), select.POLLIN)
        while events := poll.poll(0):
            chunk = b""
            if events[0][1] & select.POLLIN:
                chunk = os.read(self.fileno(), READ_CHUNK_BYTES)
            if not chunk:
                raise OSError(errno.ENODEV, "the adapter was removed")
            self._buffer += chunk

    def holds_line(self) -> bool:
        """Whether `recv` has a whole line to look at: a frame, or an answer, which gives no message."""
        return self._OK in self._buffer or self._ERROR in self._buffer

    def _read(self, timeout: float | None) -> str | None:
        ends = [end for end in map(self._buffer.find, (self._OK, self._ERROR)) if end >= 0]
        if not ends:
            return None
        line = self._buffer[: min(ends) + 1]
        del self._buffer[: len(line)]
        return line.decode("ascii", "replace")


class SlcanPort:
    hardware = True
    receive_overruns = 0

    def __init__(self, name: str, device: str, bitrate: int, opening_s: float) -> None:
        self._name = name
        self._gone: str | None = None
        self.unreadable_frames = 0
        if bitrate not in BITRATES:
            allowed = ", ".join(map(str, BITRATES))
            raise LinkError(f"{name}: slcan has no such bit rate; allowed are {allowed} bit/s")
        # python-can would take what follows an @ for the rate of the serial port.
        path = os.path.realpath(os.path.expanduser(device))
        self._lock_fd = _lock_device(name, path)
        try:
            if "@" in path:
                raise LinkError(f"{name}: python-can takes no path with an @; make a symbolic link to it")
            self._bus = _LawicelBus(path, bitrate, opening_s)
        except (OSError, can.CanError) as error:
            reason = one_line(error)
            if "Inappropriate ioctl" in reason:
                reason = "this device is no serial port"
            raise LinkError(f"{name}: the adapter cannot be opened: {reason}") from error
        finally:
            if not hasattr(self, "_bus"):
                os.close(self._lock_fd)

    def fileno(self) -> int | None:
        return self._bus.fileno()

    def read(self) -> bytes:
        if self._gone is not None:
            raise LinkError(self._gone)
        received = bytearray()
        try:
            self._bus.push()
            self._bus.fetch()
        except OSError as error:
            gone = self._set_gone(error)
            if not self._bus.holds_line():
                raise gone from error
        while self._bus.holds_line():
            received += self._next_record()
        return bytes(received)

    def _next_record(self) -> bytes:
        """b"" for a line that is no frame."""
        try:
            message = self._bus.recv(timeout=0)
            if message is None:  # an answer of the adapter
                return b""
            if message.is_remote_frame or message.dlc == len(message.data):
                return record_of(message)
        except (ValueError, IndexError, LocalProtocolError):  # python-can does not check the text
            pass
        self.unreadable_frames += 1
        return b""

    def send(self, record: bytes) -> bool:
        if self._gone is not None:
            raise LinkError(self._gone)
        frame = frame_to_send(record, fd=False)
        if frame is None:
            return False
        try:
            if not self._bus.push():
                return False
            self._bus.send(message_of(frame))
        except (OSError, can.CanError) as error:
            raise self._set_gone(error) from error
        return True

    def close(self) -> None:
        try:
            self._bus.shutdown()
        except (OSError, can.CanError):  # removed
            self._bus.serialPortOrig.close()
        os.close(self._lock_fd)

    def _set_gone(self, error: Exception) -> LinkError:
        self._gone = f"{self._name}: the adapter was removed, or the other side has closed the link"
        return LinkError(self._gone)


def _lock_device(name: str, path: str) -> int:
    """A descriptor with the lock that keeps others out (flock, as pyserial's `exclusive`)."""
    try:
        if not stat.S_ISCHR(os.stat(path).st_mode):
            raise LinkError(f"{name}: no serial port; name the adapter's, such as can:slcan//dev/ttyACM0")
        fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        raise LinkError(
            f"{name}: no such device; name the adapter's serial port, such as can:slcan//dev/ttyACM0"
        ) from None
    except PermissionError:
        raise LinkError(
            f"{name}: permission denied; add the user to the group of the device (on Debian: dialout)"
        ) from None
    except OSError as error:
        raise LinkError(f"{name}: {error.strerror}") from error
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(fd)
        raise LinkError(f"{name}: the adapter is busy: another program has its port open") from None
    return fd
