"""Stellar aberration: where the stars seem to be for an observer who moves with the Earth and round it.

The velocity of the Earth comes from a Keplerian orbit of the Earth-Moon barycentre (elements of Standish,
"Keplerian elements for approximate positions of the major planets", JPL, valid 1800 to 2050). Left out are
the motion of the Sun about the barycentre of the solar system and that of the Earth about the one with the
Moon, 0.013 km/s each, so that the directions are right to about 0.03 arcsec.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

SPEED_OF_LIGHT_KM_S = 299_792.458
_MEAN_SPEED_KM_S = 29.784692  # mean motion of the barycentre times its semi-major axis
_OBLIQUITY_RAD = math.radians(23.4392911)  # J2000
# 2000-01-01 12:00 TT in TAI seconds since 1958-01-01 (the CCSDS epoch): 15340.5 days less TT - TAI = 32.184 s
_J2000_TAI_S = 15_340.5 * 86_400.0 - 32.184
_CENTURY_S = 36_525.0 * 86_400.0


def earth_velocity_km_s(tai_ns: int) -> FloatArray:
    """Velocity of the Earth in ICRS, km/s, float64[3], at tai_ns (TAI, ns since 1958-01-01).

    Right to 0.04 km/s from 1990 to 2050, which is 0.03 arcsec of aberration.
    """
    centuries = (tai_ns * 1e-9 - _J2000_TAI_S) / _CENTURY_S
    longitude = math.radians((100.46457166 + 35_999.37244981 * centuries) % 360.0)
    perihelion = math.radians(102.93768193 + 0.32327364 * centuries)
    eccentricity = 0.01671123 - 0.00004392 * centuries
    anomaly = longitude - perihelion
    true_longitude = (
        longitude
        + 2.0 * eccentricity * math.sin(anomaly)
        + 1.25 * eccentricity * eccentricity * math.sin(2.0 * anomaly)
    )
    speed = _MEAN_SPEED_KM_S / math.sqrt(1.0 - eccentricity * eccentricity)
    along = -speed * (math.sin(true_longitude) + eccentricity * math.sin(perihelion))
    across = speed * (math.cos(true_longitude) + eccentricity * math.cos(perihelion))
    return np.array([along, across * math.cos(_OBLIQUITY_RAD), across * math.sin(_OBLIQUITY_RAD)])


def apparent_directions(unit_vectors: FloatArray, velocity_km_s: FloatArray) -> FloatArray:
    """Directions[n, 3] as an observer of this velocity (about the barycentre) sees them, relativistic."""
    apparent = np.empty_like(np.ascontiguousarray(unit_vectors, np.float64))
    rows = np.arange(len(apparent), dtype=np.int32)
    beta = np.ascontiguousarray(velocity_km_s, np.float64) / SPEED_OF_LIGHT_KM_S
    apparent_kernel(np.ascontiguousarray(unit_vectors, np.float64), rows, beta, apparent)
    return apparent


@numba.njit(nogil=True)
def apparent_kernel(
    unit_vectors: FloatArray, rows: npt.NDArray[np.int32], beta: FloatArray, apparent: FloatArray
) -> None:
    """Write the apparent directions of the given rows to apparent[len(rows), 3]; beta[3]: velocity / c."""
    square = beta[0] * beta[0] + beta[1] * beta[1] + beta[2] * beta[2]
    inverse_gamma = math.sqrt(1.0 - square)
    for place in range(len(rows)):
        row = rows[place]
        x = unit_vectors[row, 0]
        y = unit_vectors[row, 1]
        z = unit_vectors[row, 2]
        if square > 0.0:
            along = x * beta[0] + y * beta[1] + z * beta[2]
            share = 1.0 + along / (1.0 + inverse_gamma)
            x = inverse_gamma * x + share * beta[0]
            y = inverse_gamma * y + share * beta[1]
            z = inverse_gamma * z + share * beta[2]
            norm = math.sqrt(x * x + y * y + z * z)
            x /= norm
            y /= norm
            z /= norm
        apparent[place, 0] = x
        apparent[place, 1] = y
        apparent[place, 2] = z
