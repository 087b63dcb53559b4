"""The dialect ``sagitta`` in front of the device: boot loader and program, requests, subscription."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from ...clock import NS_PER_US
from ...device import reports
from ...device.commands import Acquire, GoStandby, RefusedError, Reset, SetTime
from ...device.star_tracker import StarTracker
from ...firmware_model.causes import ResetCause
from ...firmware_model.link_work import line_work, packet_work, round_work, telecommand_work
from ...firmware_model.modes import Mode
from ...firmware_model.work import Work
from ...protocol.pus.enumerations import MalformedReason
from ...protocol.sagitta.frames import (
    BadRequest,
    MessageType,
    Request,
    Status,
    body_of,
    parse_request,
    telemetry_body,
)
from ...protocol.sagitta.telemetry import ACTIONS, TELEMETRY, ActionId, TelemetryId
from ...wire.slip_port import SlipPort
from ..dialect import SerialWire
from .parameters import ParameterMemory
from .settings import SagittaSettings
from .solution import Solutions, Validation
from .subscription import FrameBudget, Subscription
from .telemetry import TelemetryData
from .unix_time import tai_ns_from_unix, unit_time_us
from .wire_frame import WireFrame

#: ASSUMED: room for a dozen of the longest frames; one that finds none is lost whole.
QUEUE_LIMIT_BYTES = 4096
LOOKING = (Mode.LOST_IN_SPACE, Mode.TRACKING, Mode.RATE_ONLY)
WORD = 32


class SagittaDialect:
    """One unit on its serial line (see :class:`~st_emulator.dialects.dialect.Dialect`).

    ``program``: whether the program runs, or the boot loader. It is the port's client.

    Args:
        device: the device.
        wire: the line.
        settings: quirks and rates.
    """

    def __init__(self, device: StarTracker, wire: SerialWire, settings: SagittaSettings) -> None:
        self.device = device
        self.settings = settings
        self.port = SlipPort(
            wire.clock,
            wire.baud,
            wire.transmit,
            self,
            pace_reception=wire.pace_reception,
            messages=wire.messages,
        )
        self.program = False
        self._boot_taken = False  # the reply to boot has to leave
        self._starting = False  # the program, not the boot loader
        self._received = 0
        self._sent = 0
        self._counter = 0
        self._sending, self._reception = Work(), Work()  # not yet in the work of a frame
        wire_frame, validation = WireFrame(settings.boresight), Validation()
        self.solutions = Solutions(
            wire_frame, validation, validated=settings.validation, held=settings.hold_quaternion
        )
        self._budget = FrameBudget(settings.most_frames_per_s)
        self._subscription = Subscription(device, settings, self._send_subscribed)
        self._telemetry = TelemetryData(device, self.solutions)
        self.parameters = ParameterMemory(device, wire_frame, validation, self._subscription.set)
        self._serve: dict[MessageType, Callable[[Request, int], None]] = {
            MessageType.SET_PARAMETER: self._set_parameter,
            MessageType.READ_PARAMETER: self._read_parameter,
            MessageType.REQUEST_TELEMETRY: self._request_telemetry,
            MessageType.ACTION: self._action,
        }
        self._run: dict[ActionId, Callable[[int, int], Status]] = {
            ActionId.BOOT: self._boot,
            ActionId.SET_TIME: self._set_time,
        }

    # -- Dialect

    def arrive(self, data: bytes) -> None:
        self.port.arrive(data)

    def drain_ns(self) -> int:
        return self.port.drain_ns(self.port.queued_bytes)

    def take_work(self) -> Work:
        sent, received = self._sending, self._reception
        self._sending, self._reception = Work(), Work()
        return round_work(sent, received)

    def where(self) -> str:
        return f"{self.port.where()}, sagitta address 0x{self.settings.address:02X}"

    @property
    def messages_received(self) -> int:
        return self._received

    @property
    def messages_sent(self) -> int:
        return self._sent

    def on(self, report: reports.Report) -> None:
        match report:
            case reports.Restarted(cause):
                self._starting = self._boot_taken and cause is ResetCause.COLD_RESET
                self._boot_taken = False
                self._restart()
            case reports.Booted():
                self._booted()
            case reports.GoingDown():
                self._subscription.reset()
            case reports.WentOff():
                self.port.restart()
            case reports.ModeChanged(transition):
                self._mode_changed(transition.next_mode)
            case reports.FrameStarted(frame_index):
                if self.program and self.device.mode not in LOOKING:
                    self._subscription.frame_told(frame_index)
            case reports.AttitudeReady(record):
                if self.program:
                    self.solutions.take(report, self.device.mode is Mode.TRACKING)
                    self._subscription.frame_told(record.index)
            case _:
                pass  # the language has no word for it

    def _restart(self) -> None:
        self.port.restart()
        self.program = False
        self._counter = 0
        self._sending, self._reception = Work(), Work()
        self._budget.reset()
        self._subscription.reset()
        self.solutions.reset()
        self.parameters.reset()

    def _booted(self) -> None:
        self.program = self._starting or not self.settings.boot_loader
        self.device.later(0, self._begin)

    def _begin(self) -> None:
        self.parameters.give_back()
        if self.program and self.settings.autonomous and self.device.mode is Mode.STANDBY:
            self.device.execute(Acquire())

    def _mode_changed(self, mode: Mode) -> None:
        if mode not in LOOKING:
            self.solutions.interrupted()
        elif not self.program:
            # By the device's own parameter autonomous_start. ASSUMED: the boot loader takes no images.
            self.device.later(0, self._rest)

    def _rest(self) -> None:
        if not self.program and self.device.mode in LOOKING:
            self.device.execute(GoStandby())

    # -- the port's client

    @property
    def listening(self) -> bool:
        return self.device.listening

    @property
    def silent(self) -> bool:
        return self.device.silent

    def bytes_received(self, count: int) -> None:
        self._reception += line_work(count)

    def packet_received(self, raw: bytes, last_bit_ns: int) -> None:
        self._received += 1
        self._reception += telecommand_work(len(raw))
        latency_ns = self.device.profile.timing.telecommand_latency_us * NS_PER_US
        self.device.later(latency_ns, partial(self._handle, raw, last_bit_ns))

    def packet_discarded(self, reason: MalformedReason, length: int) -> None:
        self._received += 1

    # -- requests

    def _handle(self, raw: bytes, received_ns: int) -> None:
        if not self.device.listening:
            return
        request = parse_request(raw, self.settings.address, hash_checked=self.settings.hash_checked)
        if isinstance(request, BadRequest):
            return
        boot = request.type is MessageType.ACTION and request.id == ActionId.BOOT
        if self.program or boot:
            self._serve[request.type](request, received_ns)
        elif self.settings.boot_loader_answers:
            self._refuse(request, Status.BOOT_LOADER)

    def _refuse(self, request: Request, status: Status) -> None:
        """Answer that nothing was done. A reply 81 without status cannot say so: there is none."""
        if request.type is MessageType.REQUEST_TELEMETRY:
            self._send_telemetry(MessageType.TELEMETRY, request.id, status, b"")
        elif request.type is not MessageType.READ_PARAMETER or self.settings.parameter_status:
            self._send(MessageType(request.type | 0x80), request.id, bytes([status]))

    def _set_parameter(self, request: Request, received_ns: int) -> None:
        status = self.parameters.set(request.id, request.arguments)
        self._send(MessageType.SET_PARAMETER_REPLY, request.id, bytes([status]))

    def _read_parameter(self, request: Request, received_ns: int) -> None:
        arguments = self.parameters.read(request.id)
        if arguments is None:
            self._refuse(request, Status.NOT_IMPLEMENTED)
        elif request.arguments:
            self._refuse(request, Status.BAD_ARGUMENTS)
        else:
            status = bytes([Status.OK]) if self.settings.parameter_status else b""
            self._send(MessageType.PARAMETER, request.id, status + arguments)

    def _request_telemetry(self, request: Request, received_ns: int) -> None:
        if request.id not in TELEMETRY:
            self._refuse(request, Status.NOT_IMPLEMENTED)
        elif request.arguments:
            self._refuse(request, Status.BAD_ARGUMENTS)
        else:
            self._send_data(MessageType.TELEMETRY, TelemetryId(request.id))

    def _action(self, request: Request, received_ns: int) -> None:
        definition = ACTIONS.get(request.id)
        if definition is None:
            self._refuse(request, Status.NOT_IMPLEMENTED)
            return
        values = definition.arguments.unpack(request.arguments)
        if values is None:
            self._refuse(request, Status.BAD_ARGUMENTS)
            return
        (argument,) = values.values()
        status = self._run[definition.id](argument, received_ns)
        self._send(MessageType.ACTION_REPLY, request.id, bytes([status]))
        if self._boot_taken:
            self.device.execute(Reset())  # once the reply has left

    def _boot(self, region: int, received_ns: int) -> Status:
        if self.program and self.device.mode is not Mode.FAULT:
            return Status.OK  # ASSUMED: it runs already; a second boot does no harm
        try:
            self.device.check(Reset())
        except RefusedError:
            return Status.NOT_NOW
        self._boot_taken = True
        return Status.OK

    def _set_time(self, unix_us: int, received_ns: int) -> Status:
        if self.settings.set_time_words == "high_first":
            unix_us = unix_us >> WORD | (unix_us & (1 << WORD) - 1) << WORD
        tai_ns = tai_ns_from_unix(unix_us)
        if tai_ns is None:
            return Status.BAD_ARGUMENTS
        command = SetTime(tai_ns, received_ns)
        try:
            self.device.check(command)
        except RefusedError:
            return Status.NOT_NOW
        self.device.execute(command)
        return Status.OK

    # -- out

    def _send_subscribed(self, id_: TelemetryId) -> None:
        if self._budget.allows(self.device.clock.now_ns):
            self._send_data(MessageType.ASYNCHRONOUS_TELEMETRY, id_)

    def _send_data(self, type_: MessageType, id_: TelemetryId) -> None:
        self._send_telemetry(type_, id_, Status.OK, self._telemetry.of(id_))

    def _send_telemetry(self, type_: MessageType, id_: int, status: Status, data: bytes) -> None:
        t_ns = self.device.clock.now_ns
        if id_ == TelemetryId.SOLUTION and self.settings.solution_time == "mid_exposure":
            t_ns = t_ns if self.solutions.mid_exposure_ns is None else self.solutions.mid_exposure_ns
        time_us = unit_time_us(self.device.time, t_ns)
        body = telemetry_body(type_, id_, status, self._counter, time_us, data, self.settings.address)
        self._counter = self._counter + 1 & 0xFFFFFFFF
        self._queue(body)

    def _send(self, type_: MessageType, id_: int, payload: bytes) -> None:
        self._queue(body_of(type_, id_, payload, self.settings.address))

    def _queue(self, body: bytes) -> None:
        """Nothing leaves in BOOT and OFF; what finds no room is lost whole."""
        if self.device.silent:
            return
        self._sending += packet_work(len(body))
        if self.port.queue(body, QUEUE_LIMIT_BYTES):
            self._sent += 1
            self._budget.spend(self.device.clock.now_ns)
