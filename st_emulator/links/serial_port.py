"""A serial port, 8N1; also the OBC's end of a pseudo-terminal, which is a serial port to whoever opens it."""

import contextlib
import fcntl
import os
import select
import stat
import termios

import serial

from .link import ClosesOnExit, LinkError

READ_CHUNK_BYTES = 65536


class SerialLink(ClosesOnExit):
    """An exclusively opened serial port. Raises LinkError when it is missing, busy or no serial port.

    Exclusive among programs that lock the port (flock, as pyserial's `exclusive` does); real ports also get
    TIOCEXCL, which keeps out later openings of unprivileged programs that do not lock. Bytes that waited in
    the port before it was opened are discarded.
    """

    def __init__(self, device: str | os.PathLike[str], baud: int) -> None:
        self.device = os.path.expanduser(os.fspath(device))
        self.baud = baud
        self.name = f"serial:{self.device}@{baud}"
        self.dropped_bytes = 0
        self._require_character_device()
        try:
            # 8N1 and no flow control are pyserial's defaults; stated because the link depends on them.
            self._port = serial.Serial(
                self.device,
                baud,
                bytesize=serial.EIGHTBITS,
                parity=serial.PARITY_NONE,
                stopbits=serial.STOPBITS_ONE,
                timeout=0,
                write_timeout=0,
                xonxoff=False,
                rtscts=False,
                dsrdtr=False,
                exclusive=True,
            )
        except (OSError, ValueError, termios.error) as error:  # SerialException is an OSError
            raise LinkError(f"{self.name}: {_reason(error)}") from error
        self._fd: int = self._port.fileno()
        # A pseudo-terminal that the emulator keeps open would stay exclusive after its OBC was killed.
        self._tiocexcl = not os.path.realpath(self.device).startswith("/dev/pts/")
        if self._tiocexcl:
            fcntl.ioctl(self._fd, termios.TIOCEXCL)
        self._poll = select.poll()
        self._poll.register(self._fd, select.POLLIN)
        self._closed = False

    def fileno(self) -> int | None:
        """The port's descriptor."""
        self._require_open()
        return self._fd

    def read(self) -> bytes:
        """Every byte that has arrived. LinkError when the device has gone or the other side has closed."""
        self._require_open()
        received = bytearray()
        # Such a port reads b"" both when nothing is there and after a hang-up; poll() tells which.
        while events := self._poll.poll(0):
            state = events[0][1]
            if state & select.POLLIN:
                try:
                    chunk = os.read(self._fd, READ_CHUNK_BYTES)
                except BlockingIOError:
                    break
                except OSError:
                    chunk = b""
                if chunk:
                    received += chunk
                    continue
            if received:
                break
            if state & (select.POLLHUP | select.POLLERR | select.POLLNVAL):
                raise LinkError(f"{self.name}: the other side has closed the link, or the device was removed")
            break
        return bytes(received)

    def write(self, data: bytes) -> int:
        """Number of bytes taken by the driver; the others are dropped and counted."""
        self._require_open()
        taken = 0
        while taken < len(data):
            try:
                taken += os.write(self._fd, data[taken:])
            except BlockingIOError:
                break
            except OSError as error:
                raise LinkError(f"{self.name}: writing failed: {error.strerror}") from error
        self.dropped_bytes += len(data) - taken
        return taken

    def close(self) -> None:
        """Give the port free."""
        if self._closed:
            return
        self._closed = True
        if self._tiocexcl:
            with contextlib.suppress(OSError):  # the device may have been removed
                fcntl.ioctl(self._fd, termios.TIOCNXCL)
        self._port.close()

    def _require_open(self) -> None:
        if self._closed:
            raise LinkError(f"{self.name}: the link is closed")

    def _require_character_device(self) -> None:
        try:
            mode = os.stat(self.device).st_mode
        except FileNotFoundError:
            raise LinkError(f"{self.name}: no such device; name a serial port or a pty's path") from None
        except OSError as error:
            raise LinkError(f"{self.name}: {error.strerror}") from error
        if not stat.S_ISCHR(mode):
            raise LinkError(f"{self.name}: no device; name a serial port or a pty's path")


def _reason(error: Exception) -> str:
    text = str(error)
    if "exclusively lock" in text or "busy" in text.lower():
        return "the port is busy: another program has it open"
    if "Permission denied" in text:
        return "permission denied; add the user to the group of the device (on Debian: dialout)"
    if "Inappropriate ioctl" in text:
        return "this device is no serial port"
    return " ".join(text.split())
