"""The KST-9's language in front of a device."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from st_emulator.clock import NS_PER_MS, ScheduledEvent
from st_emulator.device import reports
from st_emulator.device.commands import (
    NOBODY,
    Acquire,
    Command,
    Failure,
    GoStandby,
    Refusal,
    RefusedError,
    Reset,
    RunSelfTest,
    SetParameters,
    SetTime,
)
from st_emulator.device.star_tracker import StarTracker
from st_emulator.dialects.dialect import SerialWire
from st_emulator.firmware_model.link_work import line_work, packet_work, round_work, telecommand_work
from st_emulator.firmware_model.modes import Mode
from st_emulator.firmware_model.work import Work
from st_emulator.wire.serial_line import SerialLine

from .angles import LAST_WEEK, WEEK_S, gps_from_tai, pointing, tai_from_gps
from .messages import COMMANDS, Bad, Decoder, Sentence, encode
from .settings import Kst9Settings

MOST_WAITING_BYTES = 2048  # ASSUMED: the document names no buffer
THINKING_NS = 1 * NS_PER_MS
LOADER_PERIOD_NS = 250 * NS_PER_MS
START_NS = 80 * NS_PER_MS
PUSH_DS = 10
NS_PER_DS = 100 * NS_PER_MS
LOADER_KNOWS = ("RUN", "VER")
STATES = {
    Mode.STANDBY: "I",
    Mode.LOST_IN_SPACE: "S",
    Mode.TRACKING: "T",
    Mode.SELF_TEST: "X",
    Mode.FAULT: "F",
}
REFUSALS = {Refusal.NOT_ALLOWED_IN_MODE: "ST", Refusal.OUT_OF_RANGE: "RG"}
ENDS = {Failure.SUPERSEDED: "SU", Failure.ABORTED: "AB"}


class Course:
    """Tells the OBC how a command goes (see :class:`st_emulator.device.commands.Running`)."""

    def __init__(self, kind: str, say: Callable[..., None]) -> None:
        self._kind = kind
        self._say = say

    def started(self) -> None:
        pass

    def progressed(self, step: int) -> None:
        self._say("PRG", self._kind, step)

    def completed(self) -> None:
        self._say("DNE", self._kind, "OK")

    def failed(self, failure: Failure, data: int = 0) -> None:
        self._say("DNE", self._kind, ENDS.get(failure, f"{data:02X}"))


class Kst9:
    """One unit on its serial line (see :class:`st_emulator.dialects.dialect.Dialect`)."""

    def __init__(self, device: StarTracker, wire: SerialWire, settings: Kst9Settings) -> None:
        self._device = device
        self._settings = settings
        self._line = SerialLine(
            wire.clock,
            wire.baud,
            wire.transmit,
            self._received,
            delimiter=ord("\n"),
            pace_reception=wire.pace_reception,
        )
        self._decoder = Decoder()
        self._in_loader = False
        self._starting = False
        self._pushed: ScheduledEvent | None = None
        self._last: reports.AttitudeReady | None = None
        self._bad = self._messages_received = self._messages_sent = 0
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
        return f"{self._line.baud} baud, unit {self._settings.letter}"

    @property
    def messages_received(self) -> int:
        return self._messages_received

    @property
    def messages_sent(self) -> int:
        return self._messages_sent

    # -- what the device tells

    def on(self, report: reports.Report) -> None:
        match report:
            case reports.Restarted() | reports.WentOff():
                self._line.flush()
                self._decoder.reset()
                self._in_loader = self._starting = False
                self._last = None
            case reports.Booted():
                if self._settings.loader:
                    self._in_loader = True
                    self._device.later(self._settings.loader_ms * NS_PER_MS, self._load)
                    self._announce_loader(0)
                else:
                    self._device.later(0, self._application)  # behind what the device does at its boot's end
            case reports.CountersCleared():
                self._bad = 0
            case reports.AttitudeReady():
                self._last = report

    # -- the loader

    def _announce_loader(self, number: int) -> None:
        if self._in_loader:
            self._say("LDR", number)
            self._device.later(LOADER_PERIOD_NS, partial(self._announce_loader, number + 1))

    def _load(self) -> None:
        """On RUN, or when nobody said it."""
        if self._in_loader:
            self._in_loader = False
            self._starting = True
            self._device.later(START_NS, self._application)

    def _application(self) -> None:
        self._starting = False
        self._say("RDY", self._device.parameters.boot_count)
        self._push(PUSH_DS)
        search = Acquire()
        try:
            self._device.check(search)
        except RefusedError:
            return  # a fault came first
        self._device.execute(search, NOBODY)

    # -- in

    def _received(self, data: bytes) -> None:
        if not self._device.listening or self._starting:
            return
        self._received_work += line_work(len(data))
        for item in self._decoder.receive(data):
            if isinstance(item, Sentence) and item.unit != self._settings.letter:
                continue
            self._messages_received += 1
            self._received_work += telecommand_work(len(data))
            self._device.later(THINKING_NS, partial(self._handle, item, self._device.clock.now_ns))

    def _handle(self, item: Sentence | Bad, received_ns: int) -> None:
        if not self._device.listening or self._starting:
            return
        if isinstance(item, Bad):
            self._bad += 1
            self._say("NAK", item.code)
        elif item.kind not in COMMANDS:
            self._say("NAK", "UK", item.kind)
        elif self._in_loader and item.kind not in LOADER_KNOWS:
            self._say("NAK", "LD", item.kind)
        elif len(item.fields) != len(COMMANDS[item.kind]):
            self._say("NAK", "FD", item.kind)
        else:
            self._obey(item.kind, item.fields, received_ns)

    def _obey(self, kind: str, fields: Sequence[str], received_ns: int) -> None:
        match kind:
            case "VER":
                self._say("VER", "KST9", "1.2")
            case "RUN" if self._in_loader:
                self._say("ACK", "RUN")
                self._load()
            case "RUN":
                self._say("NAK", "ST", kind)
            case "POL":
                self._poll(fields[0])
            case _:
                try:
                    numbers = [float(text) for text in fields]
                except ValueError:
                    self._say("NAK", "FD", kind)
                    return
                self._obey_numbers(kind, numbers, received_ns)

    def _obey_numbers(self, kind: str, numbers: Sequence[float], received_ns: int) -> None:
        match kind, numbers:
            case "PSH", [ds]:
                if ds not in range(601):
                    self._say("NAK", "RG", kind)
                    return
                self._say("ACK", kind)
                self._push(int(ds))
            case "TIM", [week, second]:
                if week not in range(LAST_WEEK + 1) or not 0 <= second < WEEK_S:
                    self._say("NAK", "RG", kind)
                    return
                tai_ns = tai_from_gps(int(week), second)
                self._tell_device(kind, SetTime(tai_ns, received_ns), Course(kind, self._say))
            case "EXP", [ms]:
                if not 0 <= ms <= 1e6:
                    self._say("NAK", "RG", kind)
                    return
                self._tell_device(kind, SetParameters({"exposure_us": round(ms * 1000)}))
            case "SRH", []:
                self._tell_device(kind, Acquire(), Course(kind, self._say))
            case "TST", []:
                self._tell_device(kind, RunSelfTest(), Course(kind, self._say))
            case "IDL", []:
                self._tell_device(kind, GoStandby())
            case "RST", []:
                self._tell_device(kind, Reset())

    def _tell_device(self, kind: str, command: Command, course: Course | None = None) -> None:
        try:
            self._device.check(command)
        except RefusedError as error:
            self._say("NAK", REFUSALS[error.refusal], kind)
            return
        self._say("ACK", kind)
        self._device.execute(command, course or NOBODY)

    # -- out

    def _push(self, ds: int) -> None:
        """Attitudes at a pace of their own from now on; the pace before is over."""
        if self._pushed is not None:
            self._pushed.cancel()
            self._pushed = None
        if ds:
            self._pushed = self._device.later(ds * NS_PER_DS, partial(self._pushing, ds))

    def _pushing(self, ds: int) -> None:
        self._attitude()
        self._push(ds)

    def _poll(self, what: str) -> None:
        if what == "ATT":
            self._attitude()
        elif what == "STA":
            device = self._device
            state, tenths = self._state(), device.temperature_cdeg // 10
            self._say("STA", state, tenths, device.uptime_ms // 1000, self._bad)
        else:
            self._say("NAK", "RG", "POL")

    def _state(self) -> str:
        return STATES.get(self._device.mode, "L")

    def _attitude(self) -> None:
        last, device = self._last, self._device
        if last is None:
            self._say("ATT", "", "", self._state(), "", "", "", "")
            return
        week, second = "", ""
        if device.time.synchronised:
            number, since = gps_from_tai(device.time.tai_ns(last.record.mid_exposure_ns))
            week, second = f"{number}", f"{since:.3f}"
        angles = ["", "", ""]
        if device.attitude_valid and device.mode in (Mode.LOST_IN_SPACE, Mode.TRACKING):
            ra_h, dec_deg, roll_deg = pointing(last.q_icrs_to_sensor)
            angles = [f"{ra_h:.7f}", f"{dec_deg:+.6f}", f"{roll_deg:.6f}"]
        result = last.record.result
        stars = 0 if result is None else result.stars_identified
        self._say("ATT", week, second, self._state(), *angles, stars)

    def _say(self, kind: str, *fields: object) -> None:
        """Send a sentence; nothing leaves in BOOT and OFF."""
        sentence = encode(self._settings.letter, kind, fields)
        if self._device.silent or self._line.queued_bytes + len(sentence) > MOST_WAITING_BYTES:
            return
        self._line.send(sentence)
        self._messages_sent += 1
        self._sent_work += packet_work(len(sentence))
