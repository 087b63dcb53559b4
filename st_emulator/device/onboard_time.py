"""On-board time: TAI since 1958-01-01, kept as an offset to the virtual clock.

Until it is set it counts from zero at power-on or the last cold reset, and says that it is not set. It has 4
octets of seconds and turns over behind them, as the counter of a unit does.
"""

from __future__ import annotations

from ..clock import NS_PER_S

TURNOVER_NS = (1 << 32) * NS_PER_S


class OnboardTime:
    """The unit's clock. ``prepare`` latches a setting, ``apply`` brings it into force (at a frame's start).

    ``synchronised``: whether it was set since it began to count.
    """

    def __init__(self) -> None:
        self.restart(0)

    def restart(self, t_ns: int) -> None:
        """Count from zero at the virtual time ``t_ns``, as after power-on."""
        self._offset_ns = -t_ns
        self._pending_offset_ns: int | None = None
        self.synchronised = False

    def tai_ns(self, t_ns: int) -> int:
        """On-board time at a virtual time, nanoseconds since 1958-01-01 TAI."""
        return (t_ns + self._offset_ns) % TURNOVER_NS

    def prepare(self, tai_ns: int, at_ns: int) -> None:
        """``tai_ns`` is the on-board time at the virtual time ``at_ns``; it comes into force with
        :meth:`apply`.
        """
        self._pending_offset_ns = tai_ns - at_ns

    def apply(self, t_ns: int) -> tuple[int, int] | None:
        """Bring a prepared setting into force; returns the readings at ``t_ns`` before and after, or None if
        none waits.
        """
        if self._pending_offset_ns is None:
            return None
        old = self.tai_ns(t_ns)
        self._offset_ns, self._pending_offset_ns = self._pending_offset_ns, None
        self.synchronised = True
        return old, self.tai_ns(t_ns)

    def discard_pending(self) -> None:
        """A prepared setting never comes into force."""
        self._pending_offset_ns = None
