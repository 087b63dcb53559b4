"""PUS in front of the device, over SLIP on a serial line or ISO-TP on a CAN bus."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, TypeVar

from ...clock import NS_PER_US
from ...device import reports
from ...device.star_tracker import StarTracker
from ...firmware_model.link_work import line_work, round_work, telecommand_work
from ...firmware_model.work import Work
from ...protocol.pus.enumerations import HousekeepingId, MalformedReason
from ...protocol.pus.packets import error_controlled_bytes
from ...wire.can.port import CanPort
from ...wire.port import PortClient, UnitPort
from ...wire.slip_port import SlipPort
from ..dialect import CanWire, SerialWire
from .cyclic import CyclicFrames
from .reception import RaiseEvent, Receiver
from .services import connection_test, events, functions, housekeeping, memory, parameters, time_management
from .services.attitude import attitude_fields
from .services.large_data import LargeData
from .serving import Served
from .structures import link_values, no_bus_values, status_values, timing_values
from .transmission import Transmitter

PortT = TypeVar("PortT", bound=UnitPort)

#: Every telecommand of the language: how it is served. A test holds it equal to the registry.
SERVED: Mapping[str, Served[Any]] = {
    **connection_test.SERVED,
    **housekeeping.SERVED,
    **events.SERVED,
    **memory.SERVED,
    **time_management.SERVED,
    **functions.SERVED,
    **parameters.SERVED,
}


class PusDialect:
    """One unit's PUS application on one port (see :class:`~st_emulator.dialects.dialect.Dialect`).

    It is the port's client: nothing that comes in is taken while the device does not listen.

    Args:
        device: the device.
        make_port: makes the port, which tells this dialect what comes in.
        make_cyclic: makes what a CAN port has beside packets; None on a serial line.
    """

    def __init__(
        self,
        device: StarTracker,
        make_port: Callable[[PortClient], PortT],
        make_cyclic: Callable[[StarTracker, PortT, RaiseEvent], CyclicFrames] | None = None,
    ) -> None:
        self.device = device
        port = make_port(self)
        self.port: UnitPort = port
        wire = device.profile.wire
        self.transmitter = Transmitter(device, self.port, wire.apid, wire.source_id)
        send = self.transmitter.send
        self.events = events.Events(send)
        raise_event = self.events.raise_event
        self.transmitter.on_lost = self.events.packets_lost
        self.receiver = Receiver(device, send, raise_event, wire.apid)
        self.cyclic = None if make_cyclic is None else make_cyclic(device, port, raise_event)
        self.image = LargeData(device, self.port, self.transmitter, raise_event)
        self.time = time_management.TimeManagement(device, send)
        self.housekeeping = housekeeping.Housekeeping(
            device,
            send,
            {
                HousekeepingId.STATUS: partial(status_values, device),
                HousekeepingId.LINK: partial(
                    link_values, self.receiver.counters, self.transmitter, self.port
                ),
                HousekeepingId.TIMING: partial(timing_values, device),
                HousekeepingId.CAN: no_bus_values if self.cyclic is None else self.cyclic.housekeeping,
            },
        )
        serve = self.receiver.serve
        serve(connection_test.ConnectionTest(), connection_test.SERVED)
        serve(self.housekeeping, housekeeping.SERVED)
        serve(self.events, events.SERVED)
        serve(memory.MemoryManagement(device, self.image), memory.SERVED)
        serve(self.time, time_management.SERVED)
        serve(functions.Functions(device, self.image), functions.SERVED)
        serve(parameters.ParameterManagement(device), parameters.SERVED)
        self._reception = Work()  # not yet in the work of a frame

    @staticmethod
    def on_serial(device: StarTracker, wire: SerialWire) -> PusDialect:
        """On a serial line."""

        def port(client: PortClient) -> SlipPort:
            return SlipPort(
                wire.clock,
                wire.baud,
                wire.transmit,
                client,
                pace_reception=wire.pace_reception,
                messages=wire.messages,
            )

        return PusDialect(device, port)

    @staticmethod
    def on_can(device: StarTracker, wire: CanWire) -> PusDialect:
        """On a CAN bus, with cyclic frames beside the packets."""
        settings = wire.wiring.port_settings(device.profile.can)

        def port(client: PortClient) -> CanPort:
            return CanPort(
                wire.clock, settings, wire.transmit, client, wire.disturbance, wire.messages, wire.recovers
            )

        return PusDialect(device, port, CyclicFrames)

    # -- Dialect

    def arrive(self, data: bytes) -> None:
        self.port.arrive(data)

    def drain_ns(self) -> int:
        return self.port.drain_ns(self.port.queued_bytes)

    def take_work(self) -> Work:
        received, self._reception = self._reception, Work()
        return round_work(self.transmitter.take_work(), received)

    def where(self) -> str:
        return f"{self.port.where()}, APID {self.device.profile.apid}"

    @property
    def messages_received(self) -> int:
        return self.receiver.counters.tc_received

    @property
    def messages_sent(self) -> int:
        return self.transmitter.packets

    def on(self, report: reports.Report) -> None:
        match report:
            case reports.Restarted():
                self._restart()
            case reports.Booted():
                self._booted(report)
            case reports.GoingDown():
                self.image.abort()
                self.housekeeping.reset()
                self.time.reset()
            case reports.WentOff():
                self.port.restart()  # what waits, cyclic frames too
            case reports.CountersCleared():
                self.receiver.counters.clear()
                self.transmitter.clear_counters()
                if self.cyclic is not None:
                    self.cyclic.clear_counters()
            case reports.FrameStarted(frame_index):
                self.time.frame_started(frame_index)
            case reports.AttitudeReady():
                self._report_attitude(report)
            case reports.ImageCaptured(image):
                self.image.image_captured(image)
            case _:
                self.events.report(report)

    def _restart(self) -> None:
        self.transmitter.reset()
        self.receiver.reset()
        self.events.reset()
        self.image.reset()
        self.housekeeping.reset()
        self.time.reset()
        if self.cyclic is not None:
            self.cyclic.reset()

    def _booted(self, report: reports.Booted) -> None:
        self.events.report(report)
        if self.cyclic is not None:
            self.cyclic.start()
        interval_ms = self.device.profile.wire.status_interval_ms
        if interval_ms:
            self.housekeeping.start(HousekeepingId.STATUS, interval_ms)

    def _report_attitude(self, report: reports.AttitudeReady) -> None:
        wanted = report.record.settings.report
        if not wanted and self.cyclic is None:
            return
        fields = attitude_fields(self.device, report)
        if self.cyclic is not None and not self.device.silent:
            self.cyclic.report_attitude(fields)
        if wanted:
            self.transmitter.send("attitude_report", fields)

    # -- the port's client

    @property
    def listening(self) -> bool:
        return self.device.listening

    @property
    def silent(self) -> bool:
        return self.device.silent

    def bytes_received(self, count: int) -> None:
        self.receiver.counters.rx_bytes += count
        self._reception += line_work(count)

    def packet_received(self, raw: bytes, last_bit_ns: int) -> None:
        self._reception += telecommand_work(error_controlled_bytes(raw))
        latency_ns = self.device.profile.timing.telecommand_latency_us * NS_PER_US
        self.device.later(latency_ns, partial(self._handle, raw, last_bit_ns))

    def packet_discarded(self, reason: MalformedReason, length: int) -> None:
        self.receiver.discarded(reason, length)

    def _handle(self, raw: bytes, received_ns: int) -> None:
        if self.device.listening:
            self.receiver.handle(raw, received_ns)
