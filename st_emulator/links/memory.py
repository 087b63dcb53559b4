"""Links without an operating system below them: a pair in memory, and none at all."""

import threading

from .link import ClosesOnExit, LinkError

MEMORY_CAPACITY_BYTES = 65536


class _Direction:
    """Bytes under way in one direction."""

    def __init__(self, capacity_bytes: int) -> None:
        self.capacity_bytes = capacity_bytes
        self.pending = bytearray()
        self.open = True
        self.lock = threading.Lock()


class MemoryLink(ClosesOnExit):
    """One end of a wire in memory; made in pairs by `memory_link_pair`."""

    def __init__(self, name: str, incoming: _Direction, outgoing: _Direction) -> None:
        self.name = name
        self.dropped_bytes = 0
        self._incoming = incoming
        self._outgoing = outgoing
        self._closed = False

    def fileno(self) -> int | None:
        """None: there is nothing to select() on."""
        return None

    def read(self) -> bytes:
        """Every byte that has arrived. LinkError when closed here, or there with nothing left to read."""
        self._require_open()
        with self._incoming.lock:
            data = bytes(self._incoming.pending)
            self._incoming.pending.clear()
            if not data and not self._incoming.open:
                raise LinkError(f"{self.name}: the other side has closed the link")
        return data

    def write(self, data: bytes) -> int:
        """Number of bytes taken: as many as there is room for, none once the other side has closed."""
        self._require_open()
        direction = self._outgoing
        with direction.lock:
            room = direction.capacity_bytes - len(direction.pending) if direction.open else 0
            taken = min(len(data), room)
            direction.pending += data[:taken]
        self.dropped_bytes += len(data) - taken
        return taken

    def close(self) -> None:
        """Close this end; the other can still read what was sent before."""
        self._closed = True
        for direction in (self._incoming, self._outgoing):
            with direction.lock:
                direction.open = False

    def _require_open(self) -> None:
        if self._closed:
            raise LinkError(f"{self.name}: the link is closed")


def memory_link_pair(
    capacity_bytes: int = MEMORY_CAPACITY_BYTES, names: tuple[str, str] = ("memory (unit)", "memory (obc)")
) -> tuple[MemoryLink, MemoryLink]:
    """Two ends of one wire; `capacity_bytes` may be under way in each direction."""
    to_first = _Direction(capacity_bytes)
    to_second = _Direction(capacity_bytes)
    return MemoryLink(names[0], to_first, to_second), MemoryLink(names[1], to_second, to_first)


class NullLink(ClosesOnExit):
    """No wire: nothing arrives, and what is sent is dropped and counted."""

    def __init__(self) -> None:
        self.name = "none"
        self.dropped_bytes = 0
        self._closed = False

    def fileno(self) -> int | None:
        """None: nothing will ever arrive."""
        return None

    def read(self) -> bytes:
        """b"" always. LinkError when closed."""
        self._require_open()
        return b""

    def write(self, data: bytes) -> int:
        """0 always. LinkError when closed."""
        self._require_open()
        self.dropped_bytes += len(data)
        return 0

    def close(self) -> None:
        """Nothing to release."""
        self._closed = True

    def _require_open(self) -> None:
        if self._closed:
            raise LinkError(f"{self.name}: the link is closed")
