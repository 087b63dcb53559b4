"""The unit's time on the wire: Unix microseconds from on-board TAI, and back."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from ...clock import NS_PER_US
from ...device.onboard_time import TURNOVER_NS, OnboardTime
from ...tai import EPOCH_1958, tai_minus_utc_s, tai_ns_from_utc

EPOCH_1970 = datetime(1970, 1, 1, tzinfo=UTC)
US_PER_S = 1_000_000
BETWEEN_EPOCHS_US = int((EPOCH_1970 - EPOCH_1958).total_seconds()) * US_PER_S


def tai_ns_from_unix(unix_us: int) -> int | None:
    """TAI nanoseconds since 1958-01-01 of a Unix time; None where the unit's clock cannot hold it."""
    if not 0 <= unix_us < TURNOVER_NS // NS_PER_US - BETWEEN_EPOCHS_US:
        return None
    tai_ns = tai_ns_from_utc(EPOCH_1970 + timedelta(microseconds=unix_us))
    return tai_ns if tai_ns < TURNOVER_NS else None


def unix_us_from_tai(tai_ns: int) -> int:
    """The Unix time of an on-board time, never less than 0; a leap second reads as the second after it."""
    tai = EPOCH_1958 + timedelta(microseconds=tai_ns // NS_PER_US)
    utc = tai - timedelta(seconds=tai_minus_utc_s(tai))
    leap_us = round(tai_minus_utc_s(utc) * US_PER_S)
    return max(0, tai_ns // NS_PER_US - leap_us - BETWEEN_EPOCHS_US)


def unit_time_us(time: OnboardTime, t_ns: int) -> int:
    """What the unit gives for its time at a virtual time: Unix microseconds, or those since the start while
    the time is not set.
    """
    tai_ns = time.tai_ns(t_ns)
    return unix_us_from_tai(tai_ns) if time.synchronised else tai_ns // NS_PER_US
