"""A unit on a CAN bus in virtual time with an OBC that answers at once: what the model itself takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from st_emulator.bench.emulator import Emulator
from st_emulator.bench.scenario import Scenario
from st_emulator.protocol.can.bits import frame_duration_ns
from st_emulator.protocol.can.frames import CanFrame, RecordDecoder, encode_record
from st_emulator.protocol.can.transfer import CONSECUTIVE, frame_kind
from st_emulator.protocol.can.transport import IsoTpConnection, IsoTpSettings, PduReceived
from st_emulator.protocol.pus.packets import MAX_TELEMETRY_BYTES, Telemetry
from st_emulator.protocol.pus.registry import encode_telecommand, parse_telemetry
from st_emulator.units.profile import UnitProfile
from st_emulator.wire.can.wiring import CanWiring


@dataclass
class IdealObc:
    """``packets``: (virtual time of the last bit in ns, packet). ``consecutive``: (payload bytes, time on the
    wire in ns) of each consecutive frame of the unit.
    """

    profile: UnitProfile
    scenario: Scenario
    wiring: CanWiring = field(default_factory=CanWiring)
    packets: list[tuple[int, Telemetry]] = field(default_factory=list)
    consecutive: list[tuple[int, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        settings = self.wiring.port_settings(self.profile.can)
        self._bus = settings.bus
        self._telemetry = settings.identifiers.telemetry
        self._records = RecordDecoder()
        self._connection = IsoTpConnection(
            IsoTpSettings(
                transmit_identifier=settings.identifiers.telecommand,
                receive_identifier=self._telemetry,
                extended=settings.identifiers.extended,
                fd=settings.fd,
                frame_bytes=settings.frame_bytes,
                max_receive_bytes=MAX_TELEMETRY_BYTES,
            )
        )
        self._outbox: list[CanFrame] = []
        self._waiting: list[bytes] = []
        self._count = 0
        self.emulator = Emulator(self.profile, self.scenario, can=self.wiring, transmit=self._heard)

    @property
    def bitrate(self) -> int:
        """Of the bus, bit/s."""
        return self._bus.bitrate

    @property
    def now_ns(self) -> int:
        return self.emulator.now_ns

    def send(self, name: str, ack: int = 0b1111, **fields: object) -> None:
        """Put a telecommand on the bus now."""
        packet = encode_telecommand(
            name, fields, apid=self.profile.apid, sequence_count=self._count & 0x3FFF, source_id=0, ack=ack
        )
        self._count += 1
        self._waiting.append(packet)
        self._speak()

    def run_to(self, until_ns: int, done: Callable[[], bool] = lambda: False) -> bool:
        """Let time go on to ``until_ns``, or until ``done()`` (True)."""
        while True:
            self._speak()
            if done():
                return True
            due_ns = self.emulator.next_event_ns()
            if due_ns is None or due_ns > until_ns:
                self.emulator.advance(until_ns)
                return done()
            self.emulator.advance(due_ns)

    def _speak(self) -> None:
        now_ns = self.now_ns
        while True:
            if self._waiting and not self._connection.sending:
                self._connection.send(self._waiting.pop(0), now_ns)
            frame = self._connection.next_frame(now_ns)
            if frame is None:
                return
            self.emulator.receive(encode_record(frame))
            self._connection.confirmed(frame, now_ns)

    def _heard(self, data: bytes, t_ns: int) -> None:
        for frame in self._records.receive(data):
            if frame.identifier != self._telemetry:
                continue
            if frame_kind(frame.data) == CONSECUTIVE:
                wire_ns = frame_duration_ns(frame, self._bus.bitrate, self._bus.data_bitrate)
                self.consecutive.append((len(frame.data) - 1, wire_ns))
            for event in self._connection.receive(frame, t_ns):
                if isinstance(event, PduReceived):
                    parsed = parse_telemetry(event.data)
                    if isinstance(parsed, Telemetry):
                        self.packets.append((t_ns, parsed))
