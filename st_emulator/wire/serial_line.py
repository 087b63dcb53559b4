"""The serial line in virtual time: ten bits a byte at the line's baud rate, both ways.

A pseudo-terminal carries bytes at once whatever its baud rate, so the emulator gives them the time that they
take on a wire. Bytes to send go out in groups of what a UART's FIFO (or a millisecond of the line) holds.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from ..clock import NS_PER_S, VirtualClock
from .seam import PLAIN, MessageSeam

BITS_PER_BYTE = 10  # 8N1: start, eight data, stop
FIFO_BYTES = 16  # the FIFO of a 16550 UART


class SerialLine:
    """Paces bytes in both directions.

    Args:
        clock: the virtual clock.
        baud: line rate, bits per second.
        transmit: called with each group of bytes when its last bit has left.
        receive: called with received bytes when their last bit has arrived; the group ends at each
            ``delimiter``, so that a packet is handled when its own last byte is in, whatever follows it.
        delimiter: the byte that ends a frame; None: there is none, and each byte is a group of its own.
        pace_reception: False for a real port, whose bytes have already taken their time.
        messages: the seam of whole messages: what one :meth:`send` puts on the line, and what one
            :meth:`arrive` brings. A port that frames messages has the seam in front of its frames instead.
    """

    def __init__(
        self,
        clock: VirtualClock,
        baud: int,
        transmit: Callable[[bytes], object],
        receive: Callable[[bytes], None],
        *,
        delimiter: int | None,
        pace_reception: bool = True,
        messages: MessageSeam = PLAIN,
    ) -> None:
        self._clock = clock
        self._messages = messages
        self.baud = baud
        self._transmit = transmit
        self._receive = receive
        self._pace_reception = pace_reception
        self._delimiter = None if delimiter is None else bytes([delimiter])
        self._group = max(FIFO_BYTES, baud // BITS_PER_BYTE // 1000)
        self._tx = bytearray()
        self._tx_busy = False
        self._in_flight = 0
        self._tx_started_ns = 0
        self._tx_sent_since = 0
        self._rx_started_ns = 0
        self._rx_since = 0

    def duration_ns(self, count: int) -> int:
        """Time that ``count`` bytes take on the line."""
        return count * BITS_PER_BYTE * NS_PER_S // self.baud

    @property
    def queued_bytes(self) -> int:
        """Bytes that wait for the line, those on it included."""
        return len(self._tx)

    def send(self, data: bytes) -> None:
        """Queue bytes behind those already waiting."""
        self._messages.to_obc(data, self._put)

    def _put(self, data: bytes) -> None:
        self._tx += data
        if not self._tx_busy and self._tx:
            self._tx_started_ns, self._tx_sent_since = self._clock.now_ns, 0
            self._next_group()

    def _next_group(self) -> None:
        self._tx_busy = True
        count = self._in_flight = min(self._group, len(self._tx))
        due_ns = self._tx_started_ns + self.duration_ns(self._tx_sent_since + count)  # no rounding adds up

        def complete() -> None:
            data = bytes(self._tx[:count])
            del self._tx[:count]
            self._tx_sent_since += count
            self._tx_busy = False
            self._transmit(data)
            if self._tx and not self._tx_busy:
                self._next_group()

        self._clock.at(due_ns, complete)

    def flush(self) -> int:
        """Forget what waits (a reset of the unit); the group on the wire is completed. Returns the bytes
        lost.
        """
        keep = self._in_flight if self._tx_busy else 0
        lost = len(self._tx) - keep
        del self._tx[keep:]
        return lost

    def arrive(self, data: bytes) -> None:
        """Bytes were put on the line at the present time."""
        self._messages.to_unit(data, self._arrived)

    def _arrived(self, data: bytes) -> None:
        if not self._pace_reception:
            self._receive(data)
            return
        if self._clock.now_ns >= self._rx_started_ns + self.duration_ns(self._rx_since):
            self._rx_started_ns, self._rx_since = self._clock.now_ns, 0
        offset = 0
        while offset < len(data):
            end = offset if self._delimiter is None else data.find(self._delimiter, offset)
            end = len(data) if end < 0 else end + 1
            piece = data[offset:end]
            due_ns = self._rx_started_ns + self.duration_ns(self._rx_since + end)
            self._clock.at(due_ns, partial(self._receive, piece))
            offset = end
        self._rx_since += len(data)
