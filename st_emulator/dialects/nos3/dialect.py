"""The generic star tracker in front of the device: it speaks when it is asked."""

from __future__ import annotations

from functools import partial
from typing import Final

from ...clock import NS_PER_US
from ...device import reports
from ...device.commands import Acquire, Quaternion, RefusedError
from ...device.star_tracker import StarTracker
from ...firmware_model.link_work import line_work, round_work, telecommand_work
from ...firmware_model.modes import Mode
from ...firmware_model.work import Work
from ...protocol.nos3.command_parser import CommandEvent, CommandReceived
from ...protocol.nos3.messages import LAYOUTS, CommandDefinition, Message
from ...protocol.nos3.quantisation import quantised
from ...wire.serial_line import SerialLine
from ..dialect import SerialWire
from .answering import Answering
from .reception import CallbackReception, Reception, StreamReception
from .settings import Nos3Settings

#: Bits of the status in the housekeeping of layout ``readme``.
#: ASSUMED: the README says only that 0 is healthy and that each bit is an error.
STATUS_FAULT: Final = 1
STATUS_STORE_INVALID: Final = 2

DETERMINING: Final = (Mode.LOST_IN_SPACE, Mode.TRACKING, Mode.RATE_ONLY)
"""The modes in which frames are looked at, so that an attitude can be valid."""


class Nos3Dialect:
    """One unit on a serial line (see :class:`~st_emulator.dialects.dialect.Dialect`)."""

    def __init__(self, device: StarTracker, wire: SerialWire, settings: Nos3Settings) -> None:
        self.device = device
        self.settings = settings
        self.layout = LAYOUTS[settings.layout]
        self.line = SerialLine(
            wire.clock,
            wire.baud,
            wire.transmit,
            self._received,
            delimiter=None,
            pace_reception=wire.pace_reception,
            messages=wire.messages,
        )
        self.reception: Reception = (
            CallbackReception() if settings.reception == "callback" else StreamReception()
        )
        self.answering = Answering(self.line, device.later, self._answer, settings.reply_delay_us * NS_PER_US)
        self._commands_received = 0
        self._count = 0  # the command counter of the housekeeping
        self._configuration = 0
        self._status = 0
        self._octets_in = self._commands_in = self._octets_out = 0  # up to what work has been taken
        self._octets_received = 0

    # -- Dialect

    def arrive(self, data: bytes) -> None:
        self.reception.announce(len(data))
        self.line.arrive(data)

    def drain_ns(self) -> int:
        return self.answering.drain_ns()

    def take_work(self) -> Work:
        """ASSUMED: an octet received or sent costs as much as one of PUS; no check sum is computed."""
        received = line_work(self._octets_received - self._octets_in)
        for _ in range(self._commands_received - self._commands_in):
            received += telecommand_work(0)
        sent = Work({"telemetry_bytes": self.answering.octets - self._octets_out})
        self._octets_in, self._commands_in = self._octets_received, self._commands_received
        self._octets_out = self.answering.octets
        return round_work(sent, received)

    def where(self) -> str:
        return f"{self.line.baud} baud, layout {self.layout.name}"

    @property
    def messages_received(self) -> int:
        return self._commands_received

    @property
    def messages_sent(self) -> int:
        return self.answering.messages

    def on(self, report: reports.Report) -> None:
        match report:
            case reports.Restarted():
                self._configuration = self._status = 0
                self.reception.reset()
                self.answering.reset()
            case reports.Booted(store_fault=fault):
                if fault is not None:
                    self._status |= STATUS_STORE_INVALID
                if self.settings.autonomous:
                    self._acquire()
            case reports.CountersCleared():
                self._count = 0
            case reports.FaultEntered():
                self._status |= STATUS_FAULT
            case reports.GoingDown():
                self.answering.forget_waiting()
            case reports.WentOff():
                self.reception.reset()
                self.answering.reset()
            case _:
                pass  # it speaks when it is asked

    def _acquire(self) -> None:
        try:
            self.device.check(Acquire())
        except RefusedError:
            return  # it is in FAULT already
        self.device.execute(Acquire())

    # -- in

    def _received(self, data: bytes) -> None:
        listening = self.device.listening and self.settings.enabled
        if listening:
            self._octets_received += len(data)
        for event in self.reception.receive(data, listening):
            self._take(event)

    def _take(self, event: CommandEvent) -> None:
        self._commands_received += 1
        if isinstance(event, CommandReceived):
            latency_ns = self.device.profile.timing.telecommand_latency_us * NS_PER_US
            self.device.later(latency_ns, partial(self._handle, event))

    def _handle(self, command: CommandReceived) -> None:
        if self.device.listening:
            self.answering.take(command)

    # -- out

    def _answer(self, command: CommandReceived) -> tuple[bytes, ...]:
        """Count a well-formed command and say what it is answered with."""
        definition = self._known(command.command)
        self._add_to_count()
        if definition is None:
            if self.settings.echo == "accepted":
                return ()
            answer: tuple[bytes, ...] = (command.raw,)
        else:
            if definition.name == "config":
                self._configuration = command.payload
            reply = definition.reply
            answer = (command.raw,) if reply is None else (command.raw, self._reply(reply))
        if self.settings.counter == "twice":
            self._add_to_count()  # behind the reply, as the simulator does
        return answer

    def _known(self, number: int) -> CommandDefinition | None:
        definition = self.layout.by_number(number)
        unknown = self.layout.name == "code" and self.settings.config_command == "unknown"
        if definition is not None and definition.name == "config" and unknown:
            return None
        return definition

    def _add_to_count(self) -> None:
        self._count = (self._count + 1) & 0xFFFFFFFF

    def _reply(self, message: Message) -> bytes:
        x, y, z, w = self._quaternion()
        values = {
            "count": self._count,
            "configuration": self._configuration,
            "status": self._status,
            "q0": quantised(x),
            "q1": quantised(y),
            "q2": quantised(z),
            "q3": quantised(w),
            "valid": int(self.device.attitude_valid and self.device.mode in DETERMINING),
        }
        return message.encode({field.name: values[field.name] for field in message.variables})

    def _quaternion(self) -> Quaternion:
        x, y, z, w = self.device.last_quaternion
        if self.settings.quaternion == "tracker_to_inertial":
            return -x, -y, -z, w
        return x, y, z, w
