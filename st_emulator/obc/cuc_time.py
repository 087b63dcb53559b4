"""On-board time in CUC as an OBC's user reads it."""

from __future__ import annotations

from datetime import datetime, timedelta

from ..clock import NS_PER_US
from ..protocol.pus.packets import CucTime
from ..tai import EPOCH_1958, tai_minus_utc_s


def utc_from_cuc(time: CucTime) -> datetime:
    """The UTC moment of an on-board time, to the microsecond; a leap second reads as the second after it."""
    tai = EPOCH_1958 + timedelta(microseconds=time.to_ns() // NS_PER_US)
    utc = tai - timedelta(seconds=tai_minus_utc_s(tai))
    return tai - timedelta(seconds=tai_minus_utc_s(utc))


def seconds(time: CucTime) -> float:
    """TAI seconds since 1958-01-01 as a float (good to 0.5 us)."""
    return time.coarse + time.fine / (1 << 24)
