"""Dates as text, to the nanosecond."""

from __future__ import annotations

import re
import warnings

import erfa

from .time_scales import JD_1958

_EPOCH = re.compile(
    r"(\d{4})-(?:(\d{2})-(\d{2})|(\d{3}))[T ](\d{2}):(\d{2}):(\d{2})(?:\.(\d{1,12}))?(Z?)", re.ASCII
)
#: What a time scale's reading lacks to TAI, ns; UTC has leap seconds instead.
TAI_MINUS_NS = {"TAI": 0, "TT": -32_184_000_000, "GPS": 19_000_000_000}
SCALES = ("UTC", *TAI_MINUS_NS)


def tai_ns_of(text: str, scale: str) -> int:
    """TAI nanoseconds since 1958-01-01 of a date as ISO 8601 text (calendar date or day of the year) in a
    time scale of SCALES. A Z at the end is allowed with UTC alone.

    Raises:
        ValueError: no such date or scale.
    """
    found = _EPOCH.fullmatch(text.strip())
    if scale not in SCALES:
        raise ValueError(f"time scale {scale}; allowed are {', '.join(SCALES)}")
    if found is None or (found[9] and scale != "UTC"):
        raise ValueError(
            f"{text!r:.40} is no date in {scale}; allowed are dates such as 2026-01-15T00:00:00.25"
        )
    year, month, day, day_of_year = (None if part is None else int(part) for part in found.groups()[:4])
    hour, minute, second = (int(part) for part in found.groups()[4:7])
    assert year is not None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)  # leap seconds of the future are not announced
        try:
            if day_of_year is not None:
                if not 1 <= day_of_year <= 366:
                    raise ValueError("day of the year")
                first = erfa.dtf2d("UTC" if scale == "UTC" else "TAI", year, 1, 1, 0, 0, 0.0)
                year, month, day, _ = erfa.jd2cal(first[0] + day_of_year - 1, first[1])
            parts = (int(year), int(month or 1), int(day or 1), hour, minute, float(second))
            jd = erfa.utctai(*erfa.dtf2d("UTC", *parts)) if scale == "UTC" else erfa.dtf2d("TAI", *parts)
        except (erfa.ErfaError, ValueError) as error:
            raise ValueError(f"{text!r:.40} is no date: {str(error)[:60]}") from error
    whole_s = round(((float(jd[0]) - JD_1958) + float(jd[1])) * 86400.0)
    fraction_ns = int(((found[8] or "") + "0" * 9)[:9])
    return whole_s * 1_000_000_000 + fraction_ns + TAI_MINUS_NS.get(scale, 0)
