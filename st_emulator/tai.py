"""On-board time (TAI since 1958-01-01) and civil time (UTC)."""

from __future__ import annotations

import warnings
from datetime import UTC, datetime

import erfa

from .clock import NS_PER_S, NS_PER_US

EPOCH_1958 = datetime(1958, 1, 1, tzinfo=UTC)


def tai_minus_utc_s(moment: datetime) -> float:
    """Leap seconds at `moment` (IERS, as in ERFA's `dat`); before 1972 10 s, ASSUMED: of no use on board."""
    utc = moment.astimezone(UTC)
    if utc.year < 1972:
        return 10.0
    with warnings.catch_warnings():  # "dubious year": leap seconds of the future are not announced
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        return float(erfa.dat(utc.year, utc.month, utc.day, 0.0))


def tai_ns_from_utc(moment: datetime | str) -> int:
    """TAI nanoseconds since 1958-01-01 of `moment`, or of an ISO 8601 text.

    ValueError when it has no time zone, is earlier, or is no date.
    """
    if isinstance(moment, str):
        moment = datetime.fromisoformat(moment)
    if moment.tzinfo is None:
        raise ValueError(f"{moment.isoformat()}: a time zone is needed, such as {moment.isoformat()}Z")
    since = moment - EPOCH_1958
    elapsed_us = (since.days * 86_400 + since.seconds) * 1_000_000 + since.microseconds
    tai_ns = elapsed_us * NS_PER_US + round(tai_minus_utc_s(moment) * NS_PER_S)
    if tai_ns < 0:
        raise ValueError(f"{moment.isoformat()}: on-board time begins at 1958-01-01")
    return tai_ns
