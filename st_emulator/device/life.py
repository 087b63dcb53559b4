"""The life of a device: power, boot, reset, hanging, going down; and the one place that sets its mode.

Everything that changes the mode goes through :meth:`Life._follow`, by the one table in
``firmware_model.modes``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Final

from ..clock import ScheduledEvent, VirtualClock
from ..firmware_model.causes import FaultCause, ResetCause
from ..firmware_model.modes import Mode, ModeEvent, transition
from . import reports
from .speaker import MUTE, Speaker

SILENT: Final = (Mode.BOOT, Mode.OFF)


class Life(ABC):
    """What lives: it has power or not, boots, and has a mode.

    A subclass says in ``_power_came``, ``_power_went``, ``_begin``, ``_booted``, ``_come_to_rest`` and
    ``_fall_still`` what it does then.

    ``powered_since_ns``: when power came last; the frame grid runs from there.

    Args:
        clock: the virtual clock; power comes on with :meth:`power_on`.
        boot_ns: how long a boot takes.
    """

    def __init__(self, clock: VirtualClock, boot_ns: int) -> None:
        self.clock = clock
        self.mode = Mode.OFF
        self.powered = False
        self.powered_since_ns = 0
        self.reset_cause = ResetCause.POWER_ON
        self._boot_ns = boot_ns
        self._speaker: Speaker = MUTE
        self._started_ns = 0
        self._life = 0  # counts starts; an action scheduled in an earlier life is void
        self._going_down = False
        self._hangs = False
        self._fault_in_boot: FaultCause | None = None

    def speak_through(self, speaker: Speaker) -> None:
        """Report to ``speaker`` from now on; before power comes on."""
        self._speaker = speaker

    def _tell(self, report: reports.Report) -> None:
        self._speaker.on(report)

    # -- what a subclass does

    @abstractmethod
    def _power_came(self) -> None:
        """Power is there: in BOOT already, nothing is told yet."""

    @abstractmethod
    def _power_went(self) -> None:
        """Power has gone: nothing of it runs any more."""

    @abstractmethod
    def _begin(self, cause: ResetCause) -> None:
        """A boot begins; the start was told. What the life before has left is void."""

    @abstractmethod
    def _booted(self, fault: FaultCause | None) -> None:
        """The boot is over; ``fault``: what was found meanwhile."""

    @abstractmethod
    def _come_to_rest(self) -> None:
        """It goes down: what runs is given up, so that every command that was taken has its end."""

    @abstractmethod
    def _fall_still(self) -> None:
        """It hangs: nothing runs, nothing is told."""

    # -- power and life

    def power_on(self) -> None:
        """Power comes on at the present time; the frame grid runs from here. Nothing where it is on."""
        if self.powered:
            return
        self.powered = True
        self.powered_since_ns = self.clock.now_ns
        self._boot(ModeEvent.POWER_ON, ResetCause.POWER_ON, self._power_came)

    def power_off(self) -> None:
        """Power goes, whatever runs: what waits is lost, nothing is told. Nothing where it is off."""
        if not self.powered:
            return
        self.powered = False
        self._power_went()
        self._off(ModeEvent.POWER_OFF)

    def restart(self, cause: ResetCause) -> None:
        """Start anew at once, as the watchdog does: what waits to be sent is lost. Nothing without power."""
        if self.mode != Mode.OFF:
            self._boot(ModeEvent.COMMAND_RESET, cause)

    def hang(self, watchdog_ns: int) -> None:
        """The processor hangs: nothing is sent, taken or processed until the watchdog resets it, so much
        later. The sensor's frame grid goes on. Nothing where it is off, or hangs already.
        """
        if self.mode == Mode.OFF or self._hangs:
            return
        self._life += 1
        self._hangs = True
        self._fall_still()
        self._tell(reports.WentOff())
        self.later(watchdog_ns, partial(self.restart, ResetCause.WATCHDOG))

    def later(self, delay_ns: int, action: Callable[[], None]) -> ScheduledEvent:
        """Schedule an action that a reset makes void."""
        life = self._life
        return self.clock.after(delay_ns, lambda: action() if self._life == life else None)

    def _boot(self, event: ModeEvent, cause: ResetCause, begin: Callable[[], None] = lambda: None) -> None:
        self._life += 1
        self._going_down = self._hangs = False
        self._fault_in_boot = None
        self._follow(event)
        begin()
        self.reset_cause = cause
        self._tell(reports.Restarted(cause))
        self._started_ns = self.clock.now_ns
        life = self._life
        self._begin(cause)
        if self._life != life:
            return  # power went while the start was being counted
        self.later(self._boot_ns, self._boot_done)

    def _boot_done(self) -> None:
        self._follow(ModeEvent.BOOT_DONE)
        self._booted(self._fault_in_boot)

    def _off(self, event: ModeEvent) -> None:
        """Nothing is sent or processed until power is cycled."""
        self._life += 1
        self._hangs = False
        self._follow(event)
        self._tell(reports.WentOff())

    def _go_down(self, last: Callable[[], None]) -> None:
        """Come to rest and do ``last`` (a reset, a shutdown) when the line is idle: no more frames and
        commands."""
        self._going_down = True
        self._come_to_rest()
        self.later(0, partial(self._when_idle, last))  # behind what is sent at this instant

    def _when_idle(self, action: Callable[[], None]) -> None:
        waiting_ns = self._speaker.drain_ns()
        if waiting_ns:
            self.later(waiting_ns, partial(self._when_idle, action))
        else:
            action()

    # -- modes

    def _follow(self, event: ModeEvent) -> None:
        """Change the mode as the table says, and tell; an event that the table does not know in this mode
        changes nothing.
        """
        row = transition(self.mode, event)
        if row is not None and row.next_mode != self.mode:
            self.mode = row.next_mode
            self._tell(reports.ModeChanged(row))

    @property
    def listening(self) -> bool:
        """Whether commands are taken: not in BOOT and OFF, nor on the way there, nor while it hangs."""
        return not self.silent and not self._going_down

    @property
    def silent(self) -> bool:
        """Whether nothing is sent: in BOOT and OFF, and while it hangs."""
        return self._hangs or self.mode in SILENT
