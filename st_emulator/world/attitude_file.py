"""Attitudes from files: CSV of time and quaternion, and the CCSDS Attitude Ephemeris Message (see `aem`).

A CSV file begins with a line of column names, in any order:

- ``t_s`` (seconds since power-on) or ``utc`` (a date such as 2026-01-15T00:00:00.25Z);
- ``q_x, q_y, q_z, q_w``: passive, turns ICRS components into those of the body frame (or, where the reader is
  told so, the other way round), scalar part ``q_w``, of any length and sign;
- if wanted ``rate_x_rad_s, rate_y_rad_s, rate_z_rad_s`` (or ``_deg_s``): of the body relative to ICRS, body
  axes;
- if wanted ``x_km, y_km, z_km`` and ``vx_km_s, vy_km_s, vz_km_s``: geocentric place and velocity, ICRS axes;
- if wanted ``sun_x, sun_y, sun_z``: direction to the Sun, ICRS axes.

Empty lines and lines that begin with ``#`` are left out.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import quaternion
from .epochs import tai_ns_of
from .sampled import SampledTrajectory, TruthSample

Array = NDArray[np.float64]

DIRECTIONS = ("icrs_to_body", "body_to_icrs")
FEWEST, MOST = 2, 1_000_000

_VECTORS = {
    "rate_rad_s": ("rate_x_rad_s", "rate_y_rad_s", "rate_z_rad_s"),
    "rate_deg_s": ("rate_x_deg_s", "rate_y_deg_s", "rate_z_deg_s"),
    "position_km": ("x_km", "y_km", "z_km"),
    "velocity_km_s": ("vx_km_s", "vy_km_s", "vz_km_s"),
    "sun_direction": ("sun_x", "sun_y", "sun_z"),
}
_QUATERNION = ("q_x", "q_y", "q_z", "q_w")
_TIMES = ("t_s", "utc")
_COLUMNS = (*_TIMES, *_QUATERNION, *(name for names in _VECTORS.values() for name in names))


def mounted(samples: Sequence[TruthSample], q_body_to_sensor: ArrayLike) -> SampledTrajectory:
    """The trajectory of a sensor on a body whose attitudes and rates are sampled.

    Raises:
        ValueError: there are too few samples, or one does not follow the one before.
    """
    if not FEWEST <= len(samples) <= MOST:
        raise ValueError(f"{len(samples)} attitudes; allowed are {FEWEST} to {MOST:_}")
    mount = quaternion.canonical(q_body_to_sensor)
    trajectory = SampledTrajectory()
    for sample in samples:
        q = quaternion.multiply(mount, quaternion.canonical(sample.q_icrs_to_sensor))
        rate = None if sample.rate_rad_s is None else quaternion.rotate(mount, sample.rate_rad_s)
        trajectory.set_attitude(
            sample.t_ns,
            q,
            rate,
            position_km=sample.position_km,
            velocity_km_s=sample.velocity_km_s,
            sun_direction=sample.sun_direction,
        )
    return trajectory


def samples_of_csv(text: str, start_tai_ns: int, direction: str = "icrs_to_body") -> list[TruthSample]:
    """The samples of a CSV file; ``start_tai_ns``: the date of power-on, for a column ``utc``. The "sensor"
    of the samples is the file's body.

    Raises:
        ValueError: names the line and what is allowed.
    """
    rows = _rows(text)
    try:
        number, names = next(rows)
    except StopIteration:
        raise ValueError("an empty file; allowed is CSV that begins with a line of column names") from None
    names = [name.strip() for name in names]
    place = f"line {number}"
    for name in names:
        if name not in _COLUMNS:
            raise ValueError(f"{place}: column {name!r:.40}; allowed are {', '.join(_COLUMNS)}")
        if names.count(name) > 1:
            raise ValueError(f"{place}: column {name} twice")
    times = [name for name in _TIMES if name in names]
    if len(times) != 1:
        raise ValueError(f"{place}: allowed is one column of time, t_s or utc")
    vectors = [item for item, columns in _VECTORS.items() if any(column in names for column in columns)]
    for columns in (_QUATERNION, *(_VECTORS[item] for item in vectors)):
        missing = [column for column in columns if column not in names]
        if missing:
            raise ValueError(f"{place}: there is no column {missing[0]}; it goes with {', '.join(columns)}")
    if {"rate_rad_s", "rate_deg_s"} <= set(vectors):
        raise ValueError(f"{place}: rates in rad/s and in deg/s; allowed is one of them")
    found = []
    for number, row in rows:
        if len(row) != len(names):
            raise ValueError(f"line {number}: {len(row)} values; allowed are {len(names)}, one a column")
        values = dict(zip(names, row, strict=True))
        try:
            found.append(_sample(values, times[0], vectors, start_tai_ns, direction))
        except ValueError as error:
            raise ValueError(f"line {number}: {error}") from error
        if len(found) > MOST:
            raise ValueError(f"line {number}: more than {MOST:_} attitudes")
    return found


def _rows(text: str) -> Iterator[tuple[int, list[str]]]:
    for number, line in enumerate(text.splitlines(), start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, next(csv.reader([line.removeprefix("\ufeff")]))


def _sample(
    values: dict[str, str], time: str, vectors: Sequence[str], start_tai_ns: int, direction: str
) -> TruthSample:
    if time == "utc":
        t_ns = tai_ns_of(values["utc"], "UTC") - start_tai_ns
    else:
        t_s = _number("t_s", values["t_s"])
        if not abs(t_s) < 1e9:
            raise ValueError(f"t_s: found {t_s:g}; allowed are seconds since power-on")
        t_ns = round(t_s * 1e9)
    given = {item: [_number(name, values[name]) for name in _VECTORS[item]] for item in vectors}
    if "rate_deg_s" in given:
        given["rate_rad_s"] = [math.radians(value) for value in given.pop("rate_deg_s")]
    x, y, z, w = (_number(name, values[name]) for name in _QUATERNION)
    if direction == "body_to_icrs":
        x, y, z = -x, -y, -z
    return TruthSample.of({"t_ns": t_ns, "q_icrs_to_sensor": (x, y, z, w), **given})


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{name}: found {text!r:.40}; allowed is a number")
    return value
