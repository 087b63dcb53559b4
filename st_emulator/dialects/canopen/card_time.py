"""The card's clock: the device's on-board time (TAI) read and set as Unix time.

A device whose time was not set counts from zero at power-on: the card's clock then starts at 1970-01-01.
ASSUMED: as a computer without a battery clock does.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from ...clock import NS_PER_US
from ...device.star_tracker import StarTracker
from ...tai import EPOCH_1958, tai_minus_utc_s, tai_ns_from_utc

EPOCH_1970 = datetime(1970, 1, 1, tzinfo=UTC)
MICROSECOND = timedelta(microseconds=1)


def tai_ns_of_unix(unix_us: int) -> int:
    """On-board time of microseconds since 1970."""
    return tai_ns_from_utc(EPOCH_1970 + timedelta(microseconds=unix_us))


def unix_us_of_tai(tai_ns: int) -> int:
    """Microseconds since 1970 of an on-board time; negative before."""
    tai = EPOCH_1958 + timedelta(microseconds=tai_ns // NS_PER_US)
    utc = tai - timedelta(seconds=tai_minus_utc_s(tai))
    utc = tai - timedelta(seconds=tai_minus_utc_s(utc))
    return (utc - EPOCH_1970) // MICROSECOND


def unix_us_at(device: StarTracker, t_ns: int) -> int:
    """What the card's clock shows at a virtual time, microseconds since 1970."""
    tai_ns = device.time.tai_ns(t_ns)
    return unix_us_of_tai(tai_ns) if device.time.synchronised else tai_ns // NS_PER_US
