"""Telemetry out of transmitted bytes: for campaigns and pictures that run a unit in virtual time."""

from __future__ import annotations

from dataclasses import dataclass, field

from .protocol.framing import FrameReceived, SlipDecoder
from .protocol.packets import MAX_TELEMETRY_BYTES, Malformed, Telemetry
from .protocol.registry import parse_telemetry


@dataclass
class TelemetryListener:
    """Collects what a unit sends; give ``transmitted`` to the emulator."""

    packets: list[tuple[int, Telemetry]] = field(default_factory=list)
    malformed: int = 0
    received_bytes: int = 0
    _decoder: SlipDecoder = field(default_factory=lambda: SlipDecoder(MAX_TELEMETRY_BYTES))

    def transmitted(self, data: bytes, t_ns: int) -> None:
        self.received_bytes += len(data)
        for event in self._decoder.receive(data, t_ns):
            if not isinstance(event, FrameReceived):
                self.malformed += 1
                continue
            parsed = parse_telemetry(event.data)
            if isinstance(parsed, Malformed):
                self.malformed += 1
            else:
                self.packets.append((t_ns, parsed))

    def named(self, name: str) -> list[Telemetry]:
        """The packets of one message, in order."""
        return [packet for _, packet in self.packets if packet.name == name]
