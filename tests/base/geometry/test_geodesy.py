"""WGS 84: published figures, and the way back."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.geodesy import (
    ecef_from_geodetic,
    enu_from_geodetic,
    geodetic_from_ecef,
    geodetic_from_enu,
)

# IOGP guidance note 373-7-2, examples of 4.1.1 and 4.1.2.
_GEODETIC = np.array([[53 + 48 / 60 + 33.820 / 3600, 2 + 7 / 60 + 46.380 / 3600, 73.0]])
_ECEF = np.array([[3_771_793.968, 140_253.342, 5_124_304.349]])
_ORIGIN = np.array([55.0, 5.0, 200.0])
_ENU = np.array([[-189_013.869, -128_642.040, -4_220.171]])


def test_published_figures() -> None:
    np.testing.assert_allclose(ecef_from_geodetic(_GEODETIC), _ECEF, atol=6e-4)
    np.testing.assert_allclose(enu_from_geodetic(_GEODETIC, _ORIGIN), _ENU, atol=6e-4)


def test_there_and_back() -> None:
    rng = np.random.default_rng(1)
    low, high = (-90.0, -180.0, -500.0), (90.0, 180.0, 20_000.0)
    geodetic = np.vstack([rng.uniform(low, high, (100, 3)), [(90.0, 0.0, 10.0), (-90.0, 0.0, 0.0)]])
    ecef = ecef_from_geodetic(geodetic)
    np.testing.assert_allclose(ecef_from_geodetic(geodetic_from_ecef(ecef)), ecef, atol=2e-8)
    enu = enu_from_geodetic(geodetic, _ORIGIN)
    back = geodetic_from_enu(enu, _ORIGIN)
    np.testing.assert_allclose(ecef_from_geodetic(back), ecef, atol=2e-8)


def test_axes_are_east_north_up() -> None:
    near = _ORIGIN + np.array([[1e-5, 0.0, 0.0], [0.0, 1e-5, 0.0], [0.0, 0.0, 1.0]])
    enu = enu_from_geodetic(near, _ORIGIN)
    np.testing.assert_allclose(
        enu[:, [1, 0, 2]] / np.diagonal(enu[:, [1, 0, 2]])[:, None], np.eye(3), atol=1e-5
    )
    assert (np.diagonal(enu[:, [1, 0, 2]]) > 0.6).all()
