"""Dates of the simulated world.

Virtual time is integer nanoseconds since power-on; the date of virtual time zero is ``start_tai_ns``, TAI
nanoseconds since 1958-01-01T00:00:00 TAI, the epoch of the CCSDS unsegmented time code (CCSDS 301.0-B-4,
3.2.1). Everything here is exact to well under a millisecond, except UT1, which stands in as UTC.
"""

from __future__ import annotations

import warnings

import erfa
import numpy as np
from numpy.typing import NDArray

NS_PER_DAY = 86_400_000_000_000
JD_1958 = 2436204.5
TT_MINUS_TAI_DAYS = 32.184 / 86400.0
AU_KM = 149597870.7
AU_PER_DAY_IN_KM_S = AU_KM / 86400.0


def tai_jd(tai_ns: int) -> tuple[float, float]:
    """TAI as a two-part Julian date: (whole half-day, fraction)."""
    days, rest_ns = divmod(int(tai_ns), NS_PER_DAY)
    return JD_1958 + days, rest_ns / NS_PER_DAY


def tt_jd(tai_ns: int) -> tuple[float, float]:
    """TT as a two-part Julian date. TDB differs by under 2 ms (57 m of the Earth's path): it is taken as
    TT."""
    day, fraction = tai_jd(tai_ns)
    return day, fraction + TT_MINUS_TAI_DAYS


def ut1_jd(tai_ns: int) -> tuple[float, float]:
    """UT1 as a two-part Julian date.

    ASSUMED: UT1 = UTC (they differ by under 0.9 s, 13.5 arcsec of the Earth's rotation): a site's absolute
    pointing is no figure of a star tracker, its rate is.
    """
    day, fraction = tai_jd(tai_ns)
    with warnings.catch_warnings():  # "dubious year": leap seconds of the future are not announced
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        first, second = erfa.taiutc(day, fraction)
    return float(first), float(second)


def julian_year(tai_ns: int) -> float:
    """Julian epoch (TT), e.g. 2026.0."""
    return float(erfa.epj(*tt_jd(tai_ns)))


def earth_position_velocity(
    tai_ns: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The Earth's centre in ICRS: heliocentric position (km), barycentric position (km) and velocity (km/s).

    SOFA/ERFA ``epv00``: within 13 km and 5 mm/s of JPL's DE405 from 1900 to 2100.
    """
    heliocentric, barycentric = erfa.epv00(*tt_jd(tai_ns))
    return (
        np.array(heliocentric["p"]) * AU_KM,
        np.array(barycentric["p"]) * AU_KM,
        np.array(barycentric["v"]) * AU_PER_DAY_IN_KM_S,
    )
