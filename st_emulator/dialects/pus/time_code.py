"""The device's on-board time as CUC (CCSDS 301.0-B-4 clause 3.2)."""

from __future__ import annotations

from ...device.star_tracker import StarTracker
from ...protocol.pus.enumerations import TimeStatus
from ...protocol.pus.packets import CucTime


def cuc_at(device: StarTracker, t_ns: int) -> CucTime:
    """On-board time at a virtual time."""
    return CucTime.from_ns(device.time.tai_ns(t_ns))


def time_status(device: StarTracker) -> TimeStatus:
    """Whether the on-board time was set."""
    return TimeStatus.SET if device.time.synchronised else TimeStatus.FREE_RUNNING
