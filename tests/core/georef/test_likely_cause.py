"""Why a list lies off GPS: each mistake made on purpose, by PROJ where it is one of a projection, is named."""

from __future__ import annotations

import re

import numpy as np
import pytest
from pyproj import Transformer

from radiant_core.errors import BadInput
from radiant_core.georef.crs import parse_crs
from radiant_core.georef.likely_cause import likely_cause, place_difference

TOWN = np.array([[47.370, 8.540, 475.0], [47.372, 8.543, 480.0], [47.371, 8.545, 470.0]])
GPS = np.array([47.3711, 8.5427, 530.0])
"""The middle of photographs, 55 m above and 25 m beside the middle of the points."""


def read_as(places: np.ndarray, written: str, read: str) -> np.ndarray:
    """Places (N,3) whose numbers in the system `written` are taken for numbers in `read`; by PROJ."""
    lat, lon, alt = places.T
    plane = Transformer.from_crs("EPSG:4979", written, always_xy=True).transform(lon, lat, alt)
    lon, lat, alt = Transformer.from_crs(read, "EPSG:4979", always_xy=True).transform(*plane)
    return np.column_stack([lat, lon, alt])


@pytest.mark.parametrize(
    ("listed", "system", "said"),
    [
        (TOWN[:, [1, 0, 2]], "EPSG:4326", "latitude and longitude are exchanged"),
        (TOWN * [-1, 1, 1], "EPSG:4326", "sign of the latitude"),
        (TOWN * [1, -1, 1], "EPSG:4326", "sign of the longitude"),
        (TOWN * [-1, -1, 1], None, "signs of latitude and longitude"),
        (read_as(TOWN, "EPSG:32632", "EPSG:32732"), "EPSG:32732", r"hemisphere of the zone is wrong \(GPS is in UTM zone 32N"),
        (read_as(TOWN, "EPSG:32632", "EPSG:32732"), None, "hemisphere of the zone is wrong"),
        (read_as(TOWN, "EPSG:32632", "EPSG:32631"), "EPSG:32631", "one zone of 6° too far west .GPS is in UTM zone 32N, EPSG:32632"),
        (read_as(TOWN, "EPSG:32632", "EPSG:32635"), None, "3 zones of 6° too far east"),
        (read_as(TOWN, "EPSG:32632", "EPSG:32733"), "EPSG:32733", "hemisphere of the zone is wrong, and the zone is one zone"),
        (TOWN + np.array([0, 3, 0]), None, "one zone of 3° too far east"),
        (TOWN * [1, 1, 1 / 0.3048], "EPSG:4326", "heights are in feet, taken for metres"),
        (TOWN * [1, 1, 0.3048], None, "heights are in metres, taken for feet"),
        (read_as(TOWN, "EPSG:23032", "EPSG:32632"), "EPSG:32632", "another datum"),
        (TOWN, "EPSG:32632", None),
        (TOWN + np.array([1.0, 2.0, 0]), "EPSG:4326", None),
    ],
)
def test_each_mistake_is_named(listed: np.ndarray, system: str | None, said: str | None) -> None:
    cause = likely_cause(listed, GPS, None if system is None else parse_crs(system))
    assert cause is None if said is None else cause is not None and re.search(said, cause), cause


def test_the_southern_hemisphere_read_as_the_northern_one() -> None:
    perth = np.array([[-31.95, 115.86, 20.0]])
    assert "UTM zone 50S" in str(likely_cause(read_as(perth, "EPSG:32750", "EPSG:32650"), perth, parse_crs("EPSG:32650")))


NAD83_UTM = "+proj=utm +zone=18 +datum=NAD83 +units=m +type=crs"
"""Without an area of use: what a list of EPSG:26918 in feet names is refused when it is read."""


@pytest.mark.parametrize(
    ("code", "factor", "said"),
    [
        ("EPSG:2263", 0.3048, "east and north are in metres, taken for "),
        (NAD83_UTM, 1 / 0.3048, "east and north are in feet, taken for metres"),
        (NAD83_UTM, 3937 / 1200, "east and north are in (US survey )?feet, taken for metres"),
        (NAD83_UTM, None, "east and north are exchanged"),
    ],
)
def test_units_and_axes_of_the_plane_are_tried(code: str, factor: float | None, said: str) -> None:
    place = np.array([[40.70, -74.0, 10.0]])
    lat, lon, alt = place.T
    to_plane = Transformer.from_crs("EPSG:4979", code, always_xy=True)
    east, north, up = to_plane.transform(lon, lat, alt)
    wrong = (north, east, up) if factor is None else (east * factor, north * factor, up)
    lon, lat, alt = to_plane.transform(*wrong, direction="INVERSE")
    cause = likely_cause(np.column_stack([lat, lon, alt]), place[0], parse_crs(code))
    assert cause is not None and re.search(said, cause), cause


def test_distances_are_medians_and_cross_the_180th_meridian() -> None:
    # One minute of latitude is a nautical mile, 1,852 m, within 0.6 % on an ellipsoid.
    found = place_difference([[0, 179.9999, 5.0]] * 3, [1 / 60, -179.9999, 2.0])
    assert found.horizontal_m == pytest.approx(1852, rel=6e-3) and found.vertical_m == 3.0
    assert found.cause is None


def test_expected_places_may_be_one_for_each() -> None:
    assert place_difference(TOWN, TOWN).horizontal_m == 0.0
    with pytest.raises(BadInput, match="no listed places"):
        likely_cause(np.zeros((0, 3)), GPS)
    with pytest.raises(BadInput):
        likely_cause(TOWN, TOWN[:2])
    with pytest.raises(BadInput):
        likely_cause([[np.nan, 0, 0]], GPS)
