"""The power supply: power is there as long as no fault keeps it away."""

from __future__ import annotations

from typing import Protocol


class Powered(Protocol):
    """What is supplied (see :class:`~st_emulator.device.star_tracker.StarTracker`)."""

    def power_on(self) -> None: ...

    def power_off(self) -> None: ...


class Supply:
    """Switches a unit. Several may keep power away at a time; it comes when the last lets go."""

    def __init__(self, unit: Powered) -> None:
        self._unit = unit
        self._keep_away: list[object] = []
        self._begun = False

    def begin(self) -> None:
        """The run begins: power comes, unless somebody keeps it away."""
        self._begun = True
        if not self._keep_away:
            self._unit.power_on()

    def cut(self, who: object) -> None:
        """``who`` keeps power away from now on."""
        if who not in self._keep_away:
            self._keep_away.append(who)
            self._unit.power_off()

    def restore(self, who: object) -> None:
        """``who`` lets go. Nothing where it did not keep power away."""
        if who in self._keep_away:
            self._keep_away.remove(who)
            if self._begun and not self._keep_away:
                self._unit.power_on()
