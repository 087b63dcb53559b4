"""Dates against astropy's time scales."""

from __future__ import annotations

import datetime

import pytest
from astropy.time import Time
from hypothesis import given
from hypothesis import strategies as st

from st_emulator.tai import tai_ns_from_utc
from st_emulator.world import time_scales


@given(st.datetimes(datetime.datetime(1975, 1, 1), datetime.datetime(2025, 12, 31)))
def test_tai_since_1958_against_astropy(date: datetime.datetime) -> None:
    found = tai_ns_from_utc(date.replace(tzinfo=datetime.UTC))
    expected = (Time(date, scale="utc").tai - Time("1958-01-01", scale="tai")).to_value("s")
    assert abs(found * 1e-9 - expected) < 2e-6


def test_scales_of_one_date_against_astropy() -> None:
    tai_ns = tai_ns_from_utc("2024-07-04T06:30:00+02:00")
    date = Time("2024-07-04T04:30:00", scale="utc")
    assert abs(sum(time_scales.tai_jd(tai_ns)) - date.tai.jd) < 1e-9
    assert abs(sum(time_scales.tt_jd(tai_ns)) - date.tt.jd) < 1e-9
    assert abs(sum(time_scales.ut1_jd(tai_ns)) - date.utc.jd) < 1e-9
    assert abs(time_scales.julian_year(tai_ns) - date.tt.jyear) < 1e-9


def test_default_start_of_the_renderer_is_2026() -> None:
    assert tai_ns_from_utc("2026-01-01T00:00:00Z") == 2_145_916_837_000_000_000


def test_a_time_without_its_zone_is_refused() -> None:
    for moment in (datetime.datetime(2026, 1, 1), "2026-01-01T00:00:00"):
        with pytest.raises(ValueError, match="a time zone is needed"):
            tai_ns_from_utc(moment)


def test_no_date_is_no_date() -> None:
    with pytest.raises(ValueError, match="Invalid isoformat"):
        tai_ns_from_utc("first of March")
