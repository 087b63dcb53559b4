"""What comes out of the guest, passed on."""

from __future__ import annotations

import contextlib
import os
import threading

CHUNK_BYTES = 65536


class Relay:
    """Copies what the guest writes to ``guest_fd`` to a descriptor of ours, in a thread.

    The guest ends its output with a token, which is not passed on: behind a reader who is slow bytes may wait
    in the guest's kernel when its command has long ended, and nothing else tells that all have come.
    ``ended``: the token or the end has come and all before it is written. ``broken``: nobody reads our
    output; the rest is discarded. A byte 0 goes to ``wake_fd`` when either becomes true.
    """

    def __init__(self, target_fd: int, token: bytes, wake_fd: int) -> None:
        self._read_fd, self.guest_fd = os.pipe()
        self._target_fd = target_fd
        self._token = token
        self._wake_fd = wake_fd
        self.ended = False
        self.broken = False
        self._thread = threading.Thread(target=self._copy, daemon=True)

    def start(self) -> None:
        """Begin; ``guest_fd`` has been given to the guest and is closed here."""
        os.close(self.guest_fd)
        self._thread.start()

    def join(self, timeout_s: float) -> None:
        """Wait for the end."""
        self._thread.join(timeout_s)

    def _copy(self) -> None:
        held = b""
        while chunk := os.read(self._read_fd, CHUNK_BYTES):
            held += chunk
            before, token, _ = held.partition(self._token)
            if token:
                held = before
                break
            kept = _overlap(held, self._token)
            self._write(held[: len(held) - kept])
            held = held[len(held) - kept :]
        self._write(held)
        self.ended = True
        self._wake()

    def _write(self, data: bytes) -> None:
        while data and not self.broken:
            try:
                data = data[os.write(self._target_fd, data) :]
            except OSError:
                self.broken = True
                self._wake()

    def _wake(self) -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(self._wake_fd, b"\0")


def _overlap(data: bytes, token: bytes) -> int:
    """How many last bytes of ``data`` may be the first of ``token``."""
    for length in range(min(len(data), len(token) - 1), 0, -1):
        if data.endswith(token[:length]):
            return length
    return 0
