"""On-board time: TAI since 1958-01-01, kept as an offset to the virtual clock.

Until it is set it counts from zero at power-on or the last cold reset, and says that it is not set. It has 4
octets of seconds and turns over behind them, as the counter of a unit does.
"""

from __future__ import annotations

from ..clock import NS_PER_S

TURNOVER_NS = (1 << 32) * NS_PER_S
PARTS_PER_BILLION = 1_000_000_000


class OnboardTime:
    """The unit's clock. ``prepare`` latches a setting, ``apply`` brings it into force (at a frame's start).

    ``synchronised``: whether it was set since it began to count.
    """

    def __init__(self) -> None:
        self._drift_ppb = 0
        self._latched_ns = 0
        self.restart(0)

    def restart(self, t_ns: int) -> None:
        """Count from zero at the virtual time ``t_ns``, as after power-on."""
        self._offset_ns = -t_ns
        self._drift_since_ns = t_ns
        self._pending_offset_ns: int | None = None
        self.synchronised = False

    def _drifted_ns(self, t_ns: int) -> int:
        """What the reading gained by its drift since the offset was fixed. Times before it (of a frame that
        was exposed then) have none.
        """
        return max(0, t_ns - self._drift_since_ns) * self._drift_ppb // PARTS_PER_BILLION

    def tai_ns(self, t_ns: int) -> int:
        """On-board time at a virtual time, nanoseconds since 1958-01-01 TAI."""
        return (t_ns + self._offset_ns + self._drifted_ns(t_ns)) % TURNOVER_NS

    def drift(self, change_ppb: int, t_ns: int) -> None:
        """From ``t_ns`` on it runs so much faster than before; what it has gained stays."""
        self._offset_ns += self._drifted_ns(t_ns)
        self._drift_since_ns = t_ns
        self._drift_ppb += change_ppb

    def jump(self, change_ns: int) -> None:
        """Another reading at once; a setting that waits is not touched."""
        self._offset_ns += change_ns

    @property
    def waiting(self) -> bool:
        """Whether a prepared setting waits to come into force."""
        return self._pending_offset_ns is not None

    def prepare(self, tai_ns: int, at_ns: int) -> None:
        """``tai_ns`` is the on-board time at the virtual time ``at_ns``; it comes into force with
        :meth:`apply`.
        """
        self._pending_offset_ns = tai_ns - at_ns
        self._latched_ns = at_ns

    def apply(self, t_ns: int) -> tuple[int, int] | None:
        """Bring a prepared setting into force; returns the readings at ``t_ns`` before and after, or None if
        none waits.
        """
        if self._pending_offset_ns is None:
            return None
        old = self.tai_ns(t_ns)
        self._offset_ns, self._pending_offset_ns = self._pending_offset_ns, None
        self._drift_since_ns = self._latched_ns  # a clock that drifts does so from the latched instant on
        self.synchronised = True
        return old, self.tai_ns(t_ns)

    def discard_pending(self) -> None:
        """A prepared setting never comes into force."""
        self._pending_offset_ns = None
