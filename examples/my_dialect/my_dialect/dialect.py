"""My dialect in front of a device: commands out of octets, octets out of reports."""

from __future__ import annotations

from functools import partial
from typing import Any

from st_emulator.clock import NS_PER_MS, NS_PER_US, ScheduledEvent
from st_emulator.device import reports
from st_emulator.device.commands import (
    Acquire,
    Command,
    Failure,
    GoStandby,
    Refusal,
    RefusedError,
    Reset,
)
from st_emulator.device.star_tracker import StarTracker
from st_emulator.dialects.dialect import SerialWire
from st_emulator.firmware_model.link_work import line_work, packet_work, round_work, telecommand_work
from st_emulator.firmware_model.work import Work
from st_emulator.wire.serial_line import SerialLine

from .messages import BY_NUMBER, Bad, Decoder, Frame, encode
from .settings import MySettings

MOST_WAITING_BYTES = 1024  # telemetry beyond it is lost, as in a unit's transmit buffer

# What the device does for a command; the others are the dialect's own business.
DEVICE_COMMANDS: dict[str, Command] = {"find_attitude": Acquire(), "stop": GoStandby(), "restart": Reset()}

ACCEPTED, UNKNOWN_COMMAND, WRONG_LENGTH, REFUSED = 0, 1, 2, 9
REFUSALS = {Refusal.NOT_ALLOWED_IN_MODE: 3, Refusal.OUT_OF_RANGE: 4, Refusal.BUSY: 5}
FAILURES = {Failure.SUPERSEDED: 1, Failure.ABORTED: 2, Failure.SELF_TEST_FAILED: 3}


class Completion:
    """Tells the OBC how a command ends (see :class:`st_emulator.device.commands.Running`)."""

    def __init__(self, dialect: MyDialect, number: int) -> None:
        self._dialect = dialect
        self._number = number

    def started(self) -> None:
        pass

    def progressed(self, step: int) -> None:
        pass

    def completed(self) -> None:
        self._dialect.send("done", command=self._number, failure=0)

    def failed(self, failure: Failure, data: int = 0) -> None:
        self._dialect.send("done", command=self._number, failure=FAILURES[failure])


class MyDialect:
    """One unit on its serial line (see :class:`st_emulator.dialects.dialect.Dialect`)."""

    def __init__(self, device: StarTracker, wire: SerialWire, settings: MySettings) -> None:
        self._device = device
        self._settings = settings
        self._line = SerialLine(
            wire.clock,
            wire.baud,
            wire.transmit,
            self._received,
            delimiter=None,
            pace_reception=wire.pace_reception,
            messages=wire.messages,
        )
        self._decoder = Decoder()
        self._end_of_half: ScheduledEvent | None = None
        self._every = settings.attitude_every
        self._bad_frames = 0
        self._messages_received = 0
        self._messages_sent = 0
        self._received_work, self._sent_work = Work(), Work()

    # -- what the bench asks

    def arrive(self, data: bytes) -> None:
        self._line.arrive(data)

    def take_work(self) -> Work:
        work = round_work(self._sent_work, self._received_work)
        self._received_work, self._sent_work = Work(), Work()
        return work

    def drain_ns(self) -> int:
        return self._line.duration_ns(self._line.queued_bytes)

    def where(self) -> str:
        return f"{self._line.baud} baud, address {self._settings.address}"

    @property
    def messages_received(self) -> int:
        return self._messages_received

    @property
    def messages_sent(self) -> int:
        return self._messages_sent

    # -- what the device tells

    def on(self, report: reports.Report) -> None:
        match report:
            case reports.Restarted():
                self._forget()
                self._every = self._settings.attitude_every
            case reports.Booted(boot_count=count):
                self.send("started", boot_count=count & 0xFFFF)
            case reports.WentOff():
                self._forget()
            case reports.CountersCleared():
                self._bad_frames = 0
            case reports.AttitudeReady():
                self._attitude(report)

    def _forget(self) -> None:
        """A life of the unit is over: what is half received and what waits to be sent is lost."""
        self._line.flush()
        self._decoder.reset()
        self._end_of_half = None

    def _attitude(self, report: reports.AttitudeReady) -> None:
        record = report.record
        if not self._every or record.index % self._every:
            return
        x, y, z, w = report.q_icrs_to_sensor
        time_us = self._device.time.tai_ns(record.mid_exposure_ns) // NS_PER_US
        valid = int(not report.reasons)
        self.send("attitude", frame=record.index, time_us=time_us, valid=valid, x=x, y=y, z=z, w=w)

    # -- in

    def _received(self, data: bytes) -> None:
        if self._device.listening:  # else the octets are lost, as on the real line
            self._received_work += line_work(len(data))
            self._take(self._decoder.receive(data))

    def _take(self, found: list[Frame | Bad]) -> None:
        if self._end_of_half is not None:
            self._end_of_half.cancel()
        for item in found:
            if isinstance(item, Bad):
                self._messages_received += 1
                self._bad_frames = min(self._bad_frames + 1, 0xFFFF)
            elif item.address == self._settings.address:
                self._messages_received += 1
                self._received_work += telecommand_work(len(item.payload) + 5)
                latency_ns = self._device.profile.timing.telecommand_latency_us * NS_PER_US
                self._device.later(latency_ns, partial(self._handle, item))
        if self._decoder.half:
            gap_ns = self._settings.gap_ms * NS_PER_MS
            self._end_of_half = self._device.later(gap_ns, lambda: self._take(self._decoder.give_up()))

    def _handle(self, frame: Frame) -> None:
        if not self._device.listening:
            return
        layout = frame.layout
        if layout is None:
            known = frame.number in BY_NUMBER
            self.send("answer", command=frame.number, refusal=WRONG_LENGTH if known else UNKNOWN_COMMAND)
        elif layout.name == "get_status":
            self._send_status()
        elif layout.name == "report_every":
            self._every = frame.values()["frames"]
            self.send("answer", command=frame.number, refusal=ACCEPTED)
        elif layout.name in DEVICE_COMMANDS:
            self._tell_device(frame.number, DEVICE_COMMANDS[layout.name])
        else:  # a telemetry message, sent to the unit
            self.send("answer", command=frame.number, refusal=UNKNOWN_COMMAND)

    def _tell_device(self, number: int, command: Command) -> None:
        try:
            self._device.check(command)
        except RefusedError as error:
            self.send("answer", command=number, refusal=REFUSALS.get(error.refusal, REFUSED))
            return
        self.send("answer", command=number, refusal=ACCEPTED)
        self._device.execute(command, Completion(self, number))

    def _send_status(self) -> None:
        device = self._device
        self.send(
            "status",
            mode=int(device.mode),
            attitude_valid=int(device.attitude_valid),
            boot_count=device.parameters.boot_count & 0xFFFF,
            bad_frames=self._bad_frames,
        )

    # -- out

    def send(self, name: str, **values: Any) -> None:
        """Send telemetry; nothing leaves in BOOT and OFF."""
        frame = encode(name, self._settings.address, values)
        if self._device.silent or self._line.queued_bytes + len(frame) > MOST_WAITING_BYTES:
            return
        self._line.send(frame)
        self._messages_sent += 1
        self._sent_work += packet_work(len(frame))
