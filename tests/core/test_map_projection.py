"""UTM is the one map that keeps angles, is straight on its middle meridian and true to scale there:
each law is checked on its own."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from radiant_core.errors import BadInput
from radiant_core.frames import WGS84_FLATTENING, WGS84_SEMI_MAJOR_M
from radiant_core.map_projection import geodetic_from_utm, utm_epsg, utm_from_geodetic

E2 = WGS84_FLATTENING * (2 - WGS84_FLATTENING)


def meridian_radius_m(lat: float) -> float:
    return WGS84_SEMI_MAJOR_M * (1 - E2) / (1 - E2 * np.sin(lat) ** 2) ** 1.5


@pytest.mark.parametrize("lat_deg", [0.0, 12.0, 47.37, 83.0])
def test_the_middle_meridian_is_straight_and_0_9996_times_its_length(lat_deg: float) -> None:
    east, north = utm_from_geodetic([[lat_deg, 9.0]], 32632)[0]
    arc_m, _ = quad(meridian_radius_m, 0, np.radians(lat_deg), epsabs=1e-9, epsrel=1e-13)
    assert east == pytest.approx(500e3, abs=1e-6)
    assert north == pytest.approx(0.9996 * arc_m, abs=1e-6)
    south = utm_from_geodetic([[-lat_deg, 9.0]], 32732)[0]
    assert south == pytest.approx([500e3, 10e6 - north], abs=1e-6)


@given(lat=st.floats(-80, 84), off=st.floats(-4, 4))
def test_angles_are_kept_and_the_inverse_comes_back(lat: float, off: float) -> None:
    epsg = 32632 if lat >= 0 else 32732
    place = np.array([[lat, 9 + off]])
    back = geodetic_from_utm(utm_from_geodetic(place, epsg), epsg)
    assert back == pytest.approx(place, abs=1e-11)
    step = 1e-5
    moved = utm_from_geodetic(place + np.array([[step, 0], [-step, 0], [0, step], [0, -step]]), epsg)
    radians = np.radians(2 * step)
    lat_rad = np.radians(lat)
    parallel_m = WGS84_SEMI_MAJOR_M * np.cos(lat_rad) / np.sqrt(1 - E2 * np.sin(lat_rad) ** 2)
    northward = (moved[0] - moved[1]) / (meridian_radius_m(lat_rad) * radians)
    eastward = (moved[2] - moved[3]) / (parallel_m * radians)
    # 1e-7: differences over 1 m of numbers known to 1e-9 m, over a parallel that is short near the
    # pole.
    assert eastward == pytest.approx([northward[1], -northward[0]], abs=2e-7)


def test_zones_and_their_limits() -> None:
    assert utm_epsg(47.37, 8.54) == 32632
    assert utm_epsg(-33.9, 151.2) == 32756
    assert utm_epsg(0.0, 180.0) == 32660
    for lat, lon in ((85.0, 0.0), (-81.0, 0.0), (0.0, 181.0), (np.nan, 0.0)):
        with pytest.raises(BadInput, match="UTM"):
            utm_epsg(lat, lon)
    with pytest.raises(BadInput, match="EPSG:4326"):
        utm_from_geodetic([[47.0, 8.0]], 4326)
    with pytest.raises(BadInput, match="own zone"):
        utm_from_geodetic([[47.0, 60.0]], 32632)
