"""Packets in SLIP frames on the serial line."""

from __future__ import annotations

from collections.abc import Callable

from ..clock import VirtualClock
from ..protocol.framing import END, FrameReceived, SlipDecoder, slip_encode
from ..protocol.pus.packets import MAX_TELECOMMAND_BYTES
from .port import PortClient
from .seam import PLAIN, MessageSeam
from .serial_line import SerialLine

PART_BYTES = 1024  # ASSUMED: a part is on the line for 90 ms at 115200 baud; reports slip in between


class SlipPort:
    """The unit's serial port (see :class:`~st_emulator.wire.port.UnitPort`).

    Args:
        clock: the virtual clock.
        baud: line rate, bits per second.
        transmit: called with each group of bytes when its last bit has left.
        client: the unit.
        pace_reception: False behind a real port, whose bytes have already taken their time.
        messages: the seam of whole messages, outside their frames.
    """

    part_bytes = PART_BYTES

    def __init__(
        self,
        clock: VirtualClock,
        baud: int,
        transmit: Callable[[bytes], object],
        client: PortClient,
        *,
        pace_reception: bool = True,
        messages: MessageSeam = PLAIN,
    ) -> None:
        self._clock = clock
        self._messages = messages
        self._client = client
        self.line = SerialLine(
            clock, baud, transmit, self._received, delimiter=END, pace_reception=pace_reception
        )
        self._decoder = SlipDecoder(MAX_TELECOMMAND_BYTES)

    @property
    def queued_bytes(self) -> int:
        return self.line.queued_bytes

    def queue(self, packet: bytes, limit_bytes: int) -> int:
        frame = slip_encode(packet)
        if self.line.queued_bytes + len(frame) > limit_bytes:
            return 0
        self._messages.to_obc(packet, self._put)
        return len(frame)

    def _put(self, packet: bytes) -> None:
        self.line.send(slip_encode(packet))

    def drain_ns(self, count: int) -> int:
        return self.line.duration_ns(count)

    def restart(self) -> None:
        self.line.flush()
        self._decoder.reset()

    def where(self) -> str:
        return f"{self.line.baud} baud"

    def arrive(self, data: bytes) -> None:
        self.line.arrive(data)

    def _received(self, data: bytes) -> None:
        client = self._client
        if not client.listening:
            return  # as on the real line, the bytes are lost
        client.bytes_received(len(data))
        for event in self._decoder.receive(data, self._clock.now_ns):
            if isinstance(event, FrameReceived):
                self._messages.to_unit(event.data, self._take)
            else:
                client.packet_discarded(event.reason.malformed_reason, event.length)

    def _take(self, packet: bytes) -> None:
        if self._client.listening:
            self._client.packet_received(packet, self._clock.now_ns)
