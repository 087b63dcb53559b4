"""CANopen in front of the device, on a CAN bus."""

from __future__ import annotations

from functools import partial
from typing import Final

from ...clock import NS_PER_MS, NS_PER_S, NS_PER_US, ScheduledEvent
from ...device import reports
from ...device.star_tracker import StarTracker
from ...firmware_model.causes import FaultCause, FrameDropCause, StoreInvalidCause
from ...firmware_model.link_work import line_work, round_work, telecommand_work
from ...firmware_model.reasons import Reason
from ...firmware_model.work import Work
from ...protocol.can.bits import INTERMISSION_BITS, bits_duration_ns
from ...protocol.can.frames import CanFrame, RecordDecoder, encode_record
from ...protocol.can.vocabulary import CanState
from ...protocol.canopen.card import ATTITUDE_PDOS, CARD_OBJECTS, RECEIVE_PDOS, TRANSMIT_PDOS
from ...protocol.canopen.communication import communication_objects
from ...protocol.canopen.dictionary import Dictionary
from ...protocol.canopen.emergency import EmergencyCode
from ...protocol.canopen.node import CanopenNode, Kind, NodeFrame
from ...wire.can.bus import CanBus, CanBusSettings
from ..dialect import CanWire
from .card import Card
from .settings import CanopenSettings
from .transmission import Transmitter

HARDWARE_VERSION: Final = "0.0"
SOFTWARE_VERSION: Final = "0.0.0"
STORE_CAUSE: Final = 0x80
MOST_DRAIN_NS: Final = NS_PER_S  # ASSUMED: a bus that takes nothing does not hold a reset up for longer

EMERGENCY_OF_FAULT: Final = {
    FaultCause.SELF_TEST_FAILED: EmergencyCode.DEVICE_HARDWARE,
    FaultCause.SENSOR_LOST: EmergencyCode.DEVICE_HARDWARE,
    FaultCause.PROCESSOR_OVERLOADED: EmergencyCode.GENERIC,
    FaultCause.CATALOGUE_DAMAGED: EmergencyCode.DATA_SET,
    FaultCause.COMMANDED: EmergencyCode.GENERIC,
    FaultCause.PROGRAM_DAMAGED: EmergencyCode.INTERNAL_SOFTWARE,
}


def u32(number: int) -> bytes:
    """Details of an emergency message."""
    return (number & 0xFFFF_FFFF).to_bytes(4, "little")


class CanopenDialect:
    """One card on one bus (see :class:`~st_emulator.dialects.dialect.Dialect`)."""

    def __init__(self, device: StarTracker, wire: CanWire, settings: CanopenSettings) -> None:
        self.device = device
        self._clock = wire.clock
        unit, wiring = device.profile.can, wire.wiring
        number = settings.node if wiring.node is None else wiring.node
        bitrate = wiring.bitrate or unit.bitrate
        self.bus = CanBus(
            wire.clock,
            CanBusSettings(
                bitrate=bitrate,
                data_bitrate=max(unit.data_bitrate, bitrate),
                hardware=wiring.hardware,
                bus_off_restart_ms=unit.bus_off_restart_ms,
            ),
            lambda frame: wire.transmit(encode_record(frame)),
            self._received,
            on_state=self._bus_state_changed,
            disturbance=wire.disturbance,
            recovers=wire.recovers,
        )
        self.bus.listening = False
        self.transmitter = Transmitter(self.bus, self._left)
        self.dictionary = Dictionary(
            [
                *communication_objects(
                    number,
                    name=device.profile.unit.name,
                    hardware_version=HARDWARE_VERSION,
                    software_version=SOFTWARE_VERSION,
                    heartbeat_ms=settings.heartbeat_ms,
                    receive=[(pdo, pdo.base + settings.obc_node) for pdo in RECEIVE_PDOS],
                    transmit=[(pdo, pdo.base + number) for pdo in TRANSMIT_PDOS],
                    fixed_pdo_parameters=settings.fixed_pdo_parameters,
                ),
                *CARD_OBJECTS,
            ]
        )
        self.node = CanopenNode(
            number,
            self.dictionary,
            transmit_pdos=len(TRANSMIT_PDOS),
            receive_pdos=len(RECEIVE_PDOS),
            sdo_timeout_ns=settings.sdo_timeout_ms * NS_PER_MS,
            goes_operational=settings.goes_operational,
            reset_node=lambda: self.card.reset_node(),
        )
        self.card = Card(device, self.dictionary, settings, self._solved)
        self._decoder = RecordDecoder()
        self._timer: ScheduledEvent | None = None
        self._reception = Work()  # not yet in the work of a frame
        self._messages_received = 0
        self._reported_lost = 0
        self._give_up_ns: int | None = None  # when a device that goes down waits no longer for the bus
        self._intermission_ns = 0
        if not wiring.hardware:  # the modelled bus gives a frame to its receivers behind it
            self._intermission_ns = bits_duration_ns(INTERMISSION_BITS, bitrate)

    # -- Dialect

    def arrive(self, data: bytes) -> None:
        for frame in self._decoder.receive(data):
            self.bus.arrive(frame)
        if self._decoder.incomplete:  # a link brings whole records: what follows starts with one
            self._decoder.reset()

    def take_work(self) -> Work:
        received, self._reception = self._reception, Work()
        return round_work(self.transmitter.take_work(), received)

    def drain_ns(self) -> int:
        left_ns = self.transmitter.drain_ns()
        if self._give_up_ns is None:
            return left_ns
        return min(left_ns, max(self._give_up_ns - self._clock.now_ns, 0))

    def where(self) -> str:
        return f"{self.bus.settings.bitrate} bit/s, CANopen node {self.node.node} ({self.node.node:02X}h)"

    @property
    def messages_received(self) -> int:
        return self._messages_received

    @property
    def messages_sent(self) -> int:
        return self.transmitter.frames

    def on(self, report: reports.Report) -> None:
        match report:
            case reports.Restarted():
                self._gone()
                self.card.restart()
                self.dictionary.restore(0, 0xFFFF)
                self.node.emergencies.reset()
            case reports.Booted(store_fault=fault):
                self._booted(fault)
            case reports.GoingDown():
                self._give_up_ns = self._clock.now_ns + MOST_DRAIN_NS
                self.node.stop()
            case reports.WentOff():
                self._gone()
            case reports.ModeChanged():
                self.card.mode_changed()
            case reports.CountersCleared():
                self._messages_received = self._reported_lost = 0
                self.transmitter.clear_counters()
            case reports.AttitudeReady():
                self.card.attitude_ready(report)
                self._follow_frame(report)
            case reports.FrameOverran(record):
                self._raise(EmergencyCode.PROCESSOR_OVERRUN, u32(record.index))
            case reports.FrameDropped(record):
                if record.drop_cause is not FrameDropCause.NO_FRAME_FROM_SENSOR:
                    self._raise(EmergencyCode.PROCESSOR_OVERRUN, u32(record.index))
            case reports.SensorBlinded():
                self._raise(EmergencyCode.SENSOR_BLINDED)
            case reports.FaultEntered(cause):
                self._raise(EMERGENCY_OF_FAULT[cause], bytes((cause,)))
            case reports.ImageCaptured(image):
                self.card.capture.captured(image)
            case _:
                pass
        self._flush()

    # -- life

    def _gone(self) -> None:
        """Off the bus."""
        self.node.stop()
        self.transmitter.reset()
        self.bus.listening = False
        self.bus.reset()
        self._give_up_ns = None

    def _booted(self, fault: StoreInvalidCause | None) -> None:
        self.card.booted()
        self.bus.listening = True
        self.node.start(self._clock.now_ns)
        if fault not in (None, StoreInvalidCause.ABSENT):  # an empty memory is no fault
            assert fault is not None
            self._raise(EmergencyCode.DATA_SET, bytes((STORE_CAUSE | fault,)))

    # -- what the device tells

    def _solved(self) -> None:
        for number in ATTITUDE_PDOS:
            self.node.pdo_event(number, self._clock.now_ns)

    def _follow_frame(self, report: reports.AttitudeReady) -> None:
        """Errors that a frame shows to be over."""
        record = report.record
        if record.result is None:
            return
        if not report.reasons & Reason.BLINDED:
            self._clear(EmergencyCode.SENSOR_BLINDED)
        if not record.late_ns and not record.dropped_before:
            self._clear(EmergencyCode.PROCESSOR_OVERRUN)

    def _raise(self, code: EmergencyCode, details: bytes = b"") -> None:
        self.node.raise_error(code, self._clock.now_ns, details)

    def _clear(self, code: EmergencyCode) -> None:
        self.node.clear_error(code, self._clock.now_ns)

    # -- frames in

    def _received(self, frame: CanFrame) -> None:
        if not self.device.listening or frame.remote or frame.extended or frame.fd:
            return
        if not self.node.hears(frame.identifier):
            return
        self._messages_received += 1
        self._reception += line_work(len(frame.data))
        self._reception += telecommand_work(0)  # the controller has checked the CRC
        received_ns = max(self._clock.now_ns - self._intermission_ns, 0)
        latency_ns = self.device.profile.timing.telecommand_latency_us * NS_PER_US
        self.device.later(latency_ns, partial(self._handle, frame, received_ns))

    def _handle(self, frame: CanFrame, received_ns: int) -> None:
        if self.device.listening:
            self.node.receive(frame.identifier, frame.data, received_ns, self._clock.now_ns)
            self._flush()

    def _bus_state_changed(self, before: CanState, now: CanState) -> None:
        if now is CanState.ERROR_PASSIVE:
            self._raise(EmergencyCode.CAN_ERROR_PASSIVE)
        elif now is CanState.ERROR_ACTIVE:
            if before is CanState.BUS_OFF:
                self._raise(EmergencyCode.RECOVERED_FROM_BUS_OFF, u32(self.bus.counters.bus_off_count))
            self._clear(EmergencyCode.CAN_ERROR_PASSIVE)
        self._flush()

    # -- frames out

    def _flush(self) -> None:
        """What the node has to say goes out, and its next deadline is waited for."""
        for frame in self.node.take():
            self.transmitter.queue(frame)
        due_ns = self.node.next_deadline_ns()
        # A timer that is too early stays: the deadline of a transfer moves with each frame.
        if due_ns is None or (self._timer is not None and self._timer.at_ns <= due_ns):
            return
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._clock.at(max(due_ns, self._clock.now_ns), self._due)

    def _due(self) -> None:
        self._timer = None
        self.node.poll(self._clock.now_ns)
        self._flush()

    def _left(self, frame: NodeFrame) -> None:
        now_ns = self._clock.now_ns
        if frame.kind is Kind.SDO:
            self.node.sdo.touch(now_ns)
        if self.transmitter.lost > self._reported_lost:
            self._reported_lost = self.transmitter.lost
            self._raise(EmergencyCode.CAN_OVERRUN, u32(self._reported_lost))
            self._flush()
