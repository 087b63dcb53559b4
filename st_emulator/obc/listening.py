"""Telemetry out of transmitted bytes: for campaigns and pictures that run a unit in virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from ..protocol.can.cyclic import CanIdentifiers
from ..protocol.can.frames import RecordDecoder
from ..protocol.can.transfer import NEVER_NS
from ..protocol.can.transport import IsoTpConnection, IsoTpSettings, PduReceived, ReceptionFailed
from ..protocol.framing import FrameReceived, SlipDecoder
from ..protocol.pus.packets import MAX_TELEMETRY_BYTES, Malformed, Telemetry
from ..protocol.pus.registry import parse_telemetry


class _CanPackets:
    """The telemetry packets in the records of a unit's CAN frames, heard without taking part."""

    def __init__(self, identifiers: CanIdentifiers, fd: bool) -> None:
        self._records = RecordDecoder()
        self._connection = IsoTpConnection(
            IsoTpSettings(
                transmit_identifier=identifiers.telecommand,
                receive_identifier=identifiers.telemetry,
                extended=identifiers.extended,
                fd=fd,
                frame_bytes=64 if fd else 8,
                max_receive_bytes=MAX_TELEMETRY_BYTES,
                n_cr_ns=NEVER_NS // 2,  # the real receiver may pause the transfer with its flow control
            )
        )

    def receive(self, data: bytes, t_ns: int) -> Iterator[bytes | None]:
        for frame in self._records.receive(data):
            for event in self._connection.receive(frame, t_ns):
                if isinstance(event, PduReceived):
                    yield event.data
                elif isinstance(event, ReceptionFailed):
                    yield None
            # The real receiver gives the flow control; the one of this listener counts as given.
            while (answer := self._connection.next_frame(t_ns)) is not None:
                self._connection.confirmed(answer, t_ns)


class _LinePackets:
    """The frames in the octets of a serial line."""

    def __init__(self) -> None:
        self._decoder = SlipDecoder(MAX_TELEMETRY_BYTES)

    def receive(self, data: bytes, t_ns: int) -> Iterator[bytes | None]:
        for event in self._decoder.receive(data, t_ns):
            yield event.data if isinstance(event, FrameReceived) else None


@dataclass
class TelemetryListener:
    """Collects what a unit sends; give ``transmitted`` to the emulator.

    ``can``: the identifiers of a unit on a CAN bus, whose records come then; ``fd``: it uses CAN FD.
    """

    packets: list[tuple[int, Telemetry]] = field(default_factory=list)
    malformed: int = 0
    received_bytes: int = 0
    can: CanIdentifiers | None = None
    fd: bool = False

    def __post_init__(self) -> None:
        self._framing = _LinePackets() if self.can is None else _CanPackets(self.can, self.fd)

    def transmitted(self, data: bytes, t_ns: int) -> None:
        self.received_bytes += len(data)
        for raw in self._framing.receive(data, t_ns):
            parsed = None if raw is None else parse_telemetry(raw)
            if parsed is None or isinstance(parsed, Malformed):
                self.malformed += 1
            else:
                self.packets.append((t_ns, parsed))

    def named(self, name: str) -> list[Telemetry]:
        """The packets of one message, in order."""
        return [packet for _, packet in self.packets if packet.name == name]
