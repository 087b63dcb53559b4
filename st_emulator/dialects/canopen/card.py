"""The card: its states and their transitions on the device's modes, its time, its attitude."""

from __future__ import annotations

from collections.abc import Callable

from ...clock import NS_PER_MS
from ...device.commands import (
    Acquire,
    Command,
    GoStandby,
    RefusedError,
    Reset,
    RestoreParameters,
    SetTime,
    Shutdown,
)
from ...device.reports import AttitudeReady
from ...device.star_tracker import StarTracker
from ...firmware_model.causes import FaultCause, ResetCause
from ...firmware_model.modes import Mode
from ...protocol.canopen import card
from ...protocol.canopen.card import TRANSITIONS, CardState, SystemReset
from ...protocol.canopen.data_types import Value
from ...protocol.canopen.dictionary import Dictionary
from ...protocol.canopen.sdo import AbortCode
from ...protocol.canopen.time_codes import scet_of, unix_us_of_scet, unix_us_of_utc, utc_of
from .attitude import card_quaternion
from .capture import Capture
from .card_time import tai_ns_of_unix, unix_us_at
from .settings import CanopenSettings

US_PER_S = 1_000_000
US_PER_MS = 1_000
MS_PER_DAY = 86_400_000
MS_PER_S = 1000
U32 = 0xFFFF_FFFF

#: The card's state by the device's mode, where the mode alone says it.
STATE_OF_MODE = {
    Mode.OFF: CardState.OFF,
    Mode.BOOT: CardState.BOOT,
    Mode.SELF_TEST: CardState.STANDBY,
    Mode.STANDBY: CardState.STANDBY,
    Mode.LOST_IN_SPACE: CardState.STAR_TRACK,
    Mode.TRACKING: CardState.STAR_TRACK,
    Mode.RATE_ONLY: CardState.STAR_TRACK,  # images are taken and not solved, and the card has no rate
    Mode.FAULT: CardState.ERROR,
}

#: What a write of 3003h:1 does to the device.
RESETS: dict[SystemReset, tuple[Command, ...]] = {
    SystemReset.NO_STOP: (),
    SystemReset.SOFT: (Reset(ResetCause.WARM_RESET),),
    SystemReset.HARD: (Reset(ResetCause.COLD_RESET),),
    SystemReset.FACTORY: (RestoreParameters(), Reset(ResetCause.COLD_RESET)),
    SystemReset.POWER_OFF: (Shutdown(),),
}


class Card:
    """What the objects 2010h to 4003h mean.

    Args:
        device: the device.
        dictionary: the objects.
        settings: of the dialect.
        solved: called when the objects of TPDO 3 to 5 hold a new solved image.
    """

    def __init__(
        self,
        device: StarTracker,
        dictionary: Dictionary,
        settings: CanopenSettings,
        solved: Callable[[], None],
    ) -> None:
        self._device = device
        self._dictionary = dictionary
        self._settings = settings
        self._solved = solved
        self.capture = Capture(device, dictionary)
        self._low_power = False
        self._booting = False
        self._restarted_ns = 0
        self._next_image_ns = 0
        read, written = dictionary.on_read, dictionary.on_write
        read(card.STATUS, 0, lambda: self.state)
        written(card.STATUS, 0, self._ask_for)
        read(card.SCET, 0, lambda: scet_of(self._unix_us()))
        written(card.SCET, 0, self._set_scet)
        read(card.UTC, 0, lambda: utc_of(self._unix_us()))
        written(card.UTC, 0, self._set_utc)
        read(card.SYSTEM, card.UNIX_TIME, lambda: self._unix_us() // US_PER_S & U32)
        read(card.SYSTEM, card.UPTIME, lambda: device.uptime_ms // MS_PER_S & U32)
        read(card.SYSTEM, card.POWER_CYCLES, lambda: min(device.parameters.boot_count, 0xFFFF))
        written(card.SYSTEM, card.SYSTEM_RESET, self._reset)

    # -- life

    def restart(self) -> None:
        """A boot begins."""
        self.capture.reset()
        self._low_power = False
        self._booting = True
        self._restarted_ns = self._device.clock.now_ns
        self._next_image_ns = 0

    def booted(self) -> None:
        """The device is there; the card may stay in BOOT for longer."""
        until_ns = self._restarted_ns + self._settings.boot_ms * NS_PER_MS
        left_ns = until_ns - self._device.clock.now_ns
        if left_ns > 0:
            self._device.later(left_ns, self._boot_over)
        else:
            self._boot_over()

    def _boot_over(self) -> None:
        self._booting = False

    def mode_changed(self) -> None:
        """What was asked for beside the device's modes ends where the device leaves STANDBY."""
        if self._device.mode is not Mode.STANDBY:
            self._low_power = False
            self.capture.stop()

    # -- states

    @property
    def state(self) -> CardState:
        """Object 4000h."""
        state = STATE_OF_MODE[self._device.mode]
        if state is CardState.ERROR or state is CardState.OFF:
            return state
        if self._booting:
            return CardState.BOOT
        if state is CardState.STANDBY and self.capture.active:
            return CardState.CAPTURE
        return CardState.LOW_POWER if state is CardState.STANDBY and self._low_power else state

    def _ask_for(self, value: Value, at_ns: int) -> AbortCode | None:
        """A write of 4000h."""
        state = self.state
        if value == state:
            return None
        allowed = next((wanted for wanted in TRANSITIONS[state] if wanted == value), None)
        if allowed is not None and self._go(allowed):
            return None
        if self._settings.ignores_bad_states:
            return None
        known = value in set(CardState)
        return AbortCode.DEVICE_STATE if known else AbortCode.VALUE

    def _go(self, state: CardState) -> bool:
        """Change the state; False: the device does not."""
        self.capture.stop()
        self._low_power = False
        match state:
            case CardState.STAR_TRACK:
                self._next_image_ns = 0
                return self._execute(Acquire())
            case CardState.ERROR:
                self._device.enter_fault(FaultCause.COMMANDED)
            case CardState.OFF:
                return self._execute(Shutdown())
            case _:
                if self._device.mode is not Mode.STANDBY and not self._execute(GoStandby()):
                    return False
                self._low_power = state is CardState.LOW_POWER
                if state is CardState.CAPTURE:
                    self.capture.begin()
        return True

    def _execute(self, *commands: Command) -> bool:
        """Give the device commands, all or none; False: it does not take them now."""
        try:
            for command in commands:
                self._device.check(command)
        except RefusedError:
            return False
        for command in commands:
            self._device.execute(command)
        return True

    def _reset(self, value: Value, at_ns: int) -> AbortCode | None:
        """A write of 3003h:1, the range of which was checked."""
        taken = self._execute(*RESETS[SystemReset(int(value))])
        return None if taken else AbortCode.DEVICE_STATE

    def reset_node(self) -> None:
        """Network management asks for a reset of the node: as 3003h:1 hard."""
        self._execute(*RESETS[SystemReset.HARD])

    # -- time

    def _unix_us(self) -> int:
        return unix_us_at(self._device, self._device.clock.now_ns)

    def _set_scet(self, value: Value, at_ns: int) -> AbortCode | None:
        return self._set_time(unix_us_of_scet(int(value)), at_ns)

    def _set_utc(self, value: Value, at_ns: int) -> AbortCode | None:
        return self._set_time(unix_us_of_utc(int(value)), at_ns)

    def _set_time(self, unix_us: int | None, at_ns: int) -> AbortCode | None:
        """The card's time was ``unix_us`` when the last bit of the frame came in."""
        if unix_us is None:
            return AbortCode.VALUE
        taken = self._execute(SetTime(tai_ns_of_unix(unix_us), at_ns))
        return None if taken else AbortCode.DEVICE_STATE

    # -- attitude

    def attitude_ready(self, report: AttitudeReady) -> None:
        """A frame's result counts, or it was dropped."""
        record = report.record
        if record.result is None or report.reasons:
            if not self._settings.attitude_known_stays:
                self._dictionary[card.ORIENTATION, card.ATTITUDE_KNOWN] = 0
            return
        if self.state is not CardState.STAR_TRACK or record.start_ns < self._next_image_ns:
            return
        delay_ms = self._dictionary.number(card.CAPTURE, card.DELAY)
        # ASSUMED: the delay runs from exposure to exposure, for the device exposes while it computes.
        self._next_image_ns = record.start_ns + delay_ms * NS_PER_MS
        i, j, k, real = card_quaternion(report.q_icrs_to_sensor, self._settings)
        unix_us = unix_us_at(self._device, record.mid_exposure_ns)
        since_midnight = unix_us // US_PER_MS % MS_PER_DAY
        if self._settings.whole_seconds_since_midnight:
            since_midnight = unix_us // US_PER_S & U32
        values: dict[int, Value] = {
            card.ATTITUDE_I: i,
            card.ATTITUDE_J: j,
            card.ATTITUDE_K: k,
            card.ATTITUDE_REAL: real,
            card.TIME_SINCE_MIDNIGHT: since_midnight,
            card.ATTITUDE_KNOWN: 1,
        }
        for sub, value in values.items():
            self._dictionary[card.ORIENTATION, sub] = value
        if record.pixels is not None:
            self.capture.keep(record.pixels, record.mid_exposure_ns)
        self._solved()
        if not delay_ms:  # once only; behind what else this report brings
            self._device.later(0, self._track_once_over)

    def _track_once_over(self) -> None:
        if self.state is CardState.STAR_TRACK:
            self._execute(GoStandby())
