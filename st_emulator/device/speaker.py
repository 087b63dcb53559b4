"""Who speaks for the device: what it needs of a dialect."""

from __future__ import annotations

from typing import Final, Protocol

from ..firmware_model.work import Work
from .reports import Listener, Report


class Speaker(Listener, Protocol):
    """Who speaks for the device: a dialect on its wire."""

    def take_work(self) -> Work:
        """The processor's work for messages since the last call."""

    def drain_ns(self) -> int:
        """Time until what waits to be sent has left; 0 when nothing waits."""


class _Mute:
    """A device that nobody speaks for."""

    def on(self, report: Report) -> None:
        pass

    def take_work(self) -> Work:
        return Work()

    def drain_ns(self) -> int:
        return 0


MUTE: Final[Speaker] = _Mute()
