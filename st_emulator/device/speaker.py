"""Who speaks for the device: what it needs of a dialect."""

from __future__ import annotations

from typing import Final, Protocol

from ..firmware_model.work import Work
from .reports import Report


class Speaker(Protocol):
    """Who speaks for the device: a dialect on its wire."""

    def on(self, report: Report) -> None:
        """The device tells what happened, now. It may be asked and telemetry may be sent here; a command
        waits behind what the device is in the middle of: ``device.later(0, ...)``."""

    def take_work(self) -> Work:
        """The processor's work for messages received and sent since the last call, counted by
        :mod:`st_emulator.firmware_model.link_work`."""

    def drain_ns(self) -> int:
        """Time until what waits to be sent has left at the wire's full rate; 0 when nothing waits. The device
        goes down when it is 0."""


class _Mute:
    """A device that nobody speaks for."""

    def on(self, report: Report) -> None:
        pass

    def take_work(self) -> Work:
        return Work()

    def drain_ns(self) -> int:
        return 0


MUTE: Final[Speaker] = _Mute()
