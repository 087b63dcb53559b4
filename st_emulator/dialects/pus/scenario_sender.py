"""The OBC that a scenario's telecommands stand for on a CAN bus."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from ...clock import NS_PER_MS
from ...protocol.can.frames import RecordDecoder, encode_record
from ...protocol.can.transfer import FLOW_CONTROL, frame_kind
from ...protocol.can.transport import IsoTpConnection
from ...protocol.framing import END, FrameReceived, SlipDecoder
from ...wire.can.port import CanPortSettings

# ASSUMED: a unit that listens answers a first frame at once; one in BOOT must not hold up the next
# telecommand.
PATIENCE_NS = 100 * NS_PER_MS
SCENARIO_SOURCE_ID = 0x5C  # the source of a scenario's own telecommands, apart from any OBC's


class CanSender:
    """On a CAN bus: each packet by ISO-TP, as the unit's flow control asks for it.

    Its frames are those of a node that is there for the telecommands alone: it does not answer the unit's
    telemetry, which is for the OBC.
    """

    def __init__(self, settings: CanPortSettings) -> None:
        self._records = RecordDecoder()
        self._packets: deque[bytes] = deque()
        other_end = settings.transport_of_the_other_end()
        self._connection = IsoTpConnection(replace(other_end, n_bs_ns=PATIENCE_NS))

    def send(self, message: bytes, now_ns: int) -> None:
        self._packets.append(message)

    def send_raw(self, octets: bytes, now_ns: int) -> None:
        """The packets in octets of a serial line; what is no frame there is none here."""
        decoder = SlipDecoder(len(octets) + 1)
        for event in decoder.receive(octets + bytes([END]), now_ns):
            if isinstance(event, FrameReceived):
                self._packets.append(event.data)

    def take(self, data: bytes, now_ns: int) -> None:
        for frame in self._records.receive(data):
            if frame_kind(frame.data) == FLOW_CONTROL:
                self._connection.receive(frame, now_ns)

    def poll(self, now_ns: int) -> list[bytes]:
        connection = self._connection
        connection.poll(now_ns)
        due: list[bytes] = []
        while True:
            if self._packets and not connection.sending:
                connection.send(self._packets.popleft(), now_ns)
            frame = connection.next_frame(now_ns)
            if frame is None:
                return due
            due.append(encode_record(frame))
            # ASSUMED: it has left at once; the bus gives it its turn and its time.
            connection.confirmed(frame, now_ns)

    def next_ns(self) -> int | None:
        return self._connection.next_deadline_ns()
