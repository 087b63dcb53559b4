"""On-board time: TAI since 1958-01-01, kept as an offset to the virtual clock.

Until it is set it counts from zero at power-on and its status says that it is not synchronised.
"""

from __future__ import annotations

from ..protocol.enumerations import TimeStatus
from ..protocol.packets import CucTime


class OnboardTime:
    """The unit's clock. ``prepare`` latches a setting, ``apply`` brings it into force (at a frame's
    start).
    """

    def __init__(self) -> None:
        self._offset_ns = 0
        self._pending_offset_ns: int | None = None
        self.status = TimeStatus.FREE_RUNNING

    @property
    def synchronised(self) -> bool:
        return self.status == TimeStatus.SET

    def tai_ns(self, t_ns: int) -> int:
        """On-board time at a virtual time, nanoseconds since 1958-01-01 TAI."""
        return t_ns + self._offset_ns

    def cuc(self, t_ns: int) -> CucTime:
        return CucTime.from_ns(self.tai_ns(t_ns))

    def prepare(self, time: CucTime, at_ns: int) -> None:
        """``time`` is the on-board time at the virtual time ``at_ns``; it comes into force with
        :meth:`apply`.
        """
        self._pending_offset_ns = time.to_ns() - at_ns

    def apply(self, t_ns: int) -> tuple[CucTime, CucTime] | None:
        """Bring a prepared setting into force; returns (old, new) reading at ``t_ns``, or None if none
        waits.
        """
        if self._pending_offset_ns is None:
            return None
        old = self.cuc(t_ns)
        self._offset_ns, self._pending_offset_ns = self._pending_offset_ns, None
        self.status = TimeStatus.SET
        return old, self.cuc(t_ns)

    def discard_pending(self) -> None:
        self._pending_offset_ns = None
