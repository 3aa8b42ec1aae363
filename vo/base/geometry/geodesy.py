"""Positions on the ellipsoid WGS 84, and in metres east, north and up of a point on it.

Source: IOGP guidance note 373-7-2, "Coordinate Conversions and Transformations including Formulas",
    4.1.1 (geographic and geocentric) and 4.1.2 (geocentric and topocentric).
"""

from __future__ import annotations

import numpy as np

from vo.base.types import Floats

_SEMI_MAJOR_M = 6_378_137.0
_FLATTENING = 1.0 / 298.257223563
_ECCENTRICITY2 = _FLATTENING * (2.0 - _FLATTENING)
_ITERATIONS = 6  # of the latitude: below 1e-12 rad up to 10,000 km above the ground


def ecef_from_geodetic(geodetic: Floats) -> Floats:
    """Earth-centred positions (N, 3) in metres.

    Args:
        geodetic: (N, 3) latitude and longitude in degrees, height above the ellipsoid in metres.
    """
    latitude, longitude = np.radians(geodetic[:, 0]), np.radians(geodetic[:, 1])
    height, sine = geodetic[:, 2], np.sin(latitude)
    normal = _SEMI_MAJOR_M / np.sqrt(1.0 - _ECCENTRICITY2 * sine**2)
    across = (normal + height) * np.cos(latitude)
    up = (normal * (1.0 - _ECCENTRICITY2) + height) * sine
    return np.column_stack([across * np.cos(longitude), across * np.sin(longitude), up])


def geodetic_from_ecef(ecef: Floats) -> Floats:
    """Latitude and longitude in degrees, height in metres (N, 3) of earth-centred positions."""
    x, y, z = ecef.T
    across = np.hypot(x, y)
    latitude = np.arctan2(z, across * (1.0 - _ECCENTRICITY2))
    for _ in range(_ITERATIONS):
        sine = np.sin(latitude)
        normal = _SEMI_MAJOR_M / np.sqrt(1.0 - _ECCENTRICITY2 * sine**2)
        latitude = np.arctan2(z + _ECCENTRICITY2 * normal * sine, across)
    sine, cosine = np.sin(latitude), np.cos(latitude)
    root = np.sqrt(1.0 - _ECCENTRICITY2 * sine**2)
    height = across * cosine + z * sine - _SEMI_MAJOR_M * root
    return np.column_stack([np.degrees(latitude), np.degrees(np.arctan2(y, x)), height])


def enu_from_geodetic(geodetic: Floats, origin: Floats) -> Floats:
    """Metres east, north and up (N, 3) of positions (N, 3), seen from an origin (3,)."""
    from_origin = ecef_from_geodetic(geodetic) - ecef_from_geodetic(origin[None])
    return np.asarray(from_origin @ _enu_from_ecef(origin).T)


def geodetic_from_enu(enu: Floats, origin: Floats) -> Floats:
    """The inverse of `enu_from_geodetic`."""
    return geodetic_from_ecef(enu @ _enu_from_ecef(origin) + ecef_from_geodetic(origin[None]))


def _enu_from_ecef(origin: Floats) -> Floats:
    latitude, longitude = np.radians(origin[:2])
    sl, cl, sp, cp = np.sin(longitude), np.cos(longitude), np.sin(latitude), np.cos(latitude)
    return np.array([[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])
