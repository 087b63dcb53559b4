"""From the device's quaternion and time to the angles and weeks of the KST-9."""

from __future__ import annotations

import math

NS_PER_S = 1_000_000_000
WEEK_S = 604_800
GPS_EPOCH_TAI_NS = (8040 * 86_400 + 19) * NS_PER_S  # 1980-01-06 UTC, TAI since 1958-01-01: 19 leap seconds
LAST_WEEK = 9999


def gps_from_tai(tai_ns: int) -> tuple[int, float]:
    """GPS week and second of it."""
    week, rest_ns = divmod(tai_ns - GPS_EPOCH_TAI_NS, WEEK_S * NS_PER_S)
    return week, rest_ns / NS_PER_S


def tai_from_gps(week: int, second: float) -> int:
    return GPS_EPOCH_TAI_NS + week * WEEK_S * NS_PER_S + round(second * NS_PER_S)


def pointing(q_icrs_to_sensor: tuple[float, float, float, float]) -> tuple[float, float, float]:
    """(right ascension in hours, declination and roll in degrees) of (x, y, z, w).

    The rows of the rotation matrix are the sensor's axes in ICRS: the third one the boresight, the second one
    against the image's up. Roll is up's angle from north to east about the boresight.
    """
    x, y, z, w = q_icrs_to_sensor
    boresight = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
    up = (-2 * (x * y - w * z), -(1 - 2 * (x * x + z * z)), -2 * (y * z + w * x))
    ra = math.atan2(boresight[1], boresight[0])
    dec = math.atan2(boresight[2], math.hypot(boresight[0], boresight[1]))
    east = (-math.sin(ra), math.cos(ra), 0.0)
    north = (-math.sin(dec) * math.cos(ra), -math.sin(dec) * math.sin(ra), math.cos(dec))
    to_east, to_north = (math.fsum(a * b for a, b in zip(up, axis, strict=True)) for axis in (east, north))
    return math.degrees(ra) % 360 / 15, math.degrees(dec), math.degrees(math.atan2(to_east, to_north)) % 360
