"""Regions from GeoJSON: the land of connected polygons in metres; one sentence for the rest."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from pyproj import Transformer

from radiant_core.errors import BadInput
from radiant_core.frames import enu_from_geodetic
from radiant_core.waypoints import region as geojson_region
from radiant_core.waypoints.region import load_region

ORIGIN = np.array([47.0, 8.0, 400.0])


def square(west: float, east: float, south: float = 0.0, north: float = 1.0) -> list[list[float]]:
    """A closed ring in thousandths of a degree from the origin."""
    corners = [(west, south), (east, south), (east, north), (west, north), (west, south)]
    return [[8.0 + x / 1000, 47.0 + y / 1000] for x, y in corners]


def written(path: Path, geometry: Any) -> Path:
    path.write_text(json.dumps({"type": "Feature", "properties": {}, "geometry": geometry}))
    return path


def polygon(*rings: Any) -> dict[str, Any]:
    return {"type": "Polygon", "coordinates": list(rings)}


def test_a_polygon_lies_where_its_corners_are(tmp_path: Path) -> None:
    ring = square(0, 2)
    for added in ([], [[4000.0]]):
        high = [[*at, *(added[0] if added else [])] for at in ring]
        corners = load_region(written(tmp_path / "a.json", polygon(high)), ORIGIN)
        expected = enu_from_geodetic([[lat, lon, 400.0] for lon, lat in ring[:4]], ORIGIN)[:, :2]
        assert shapely.Polygon(corners).symmetric_difference(shapely.Polygon(expected)).area < 1e-6, "altitudes say nothing of the land"


def test_a_triangle_is_land_and_holes_are_left_out(tmp_path: Path) -> None:
    ring = square(0, 2)
    triangle = [*ring[:3], ring[0]]
    area_m2 = shapely.Polygon(load_region(written(tmp_path / "a.json", polygon(triangle)), ORIGIN)).area
    whole_m2 = shapely.Polygon(load_region(written(tmp_path / "b.json", polygon(ring, square(0.5, 1, 0.2, 0.8))), ORIGIN)).area
    assert area_m2 == pytest.approx(whole_m2 / 2, rel=1e-4)  # meridians meet at the pole


def test_polygons_that_touch_are_one_land(tmp_path: Path) -> None:
    parts = {"type": "MultiPolygon", "coordinates": [[square(0, 1)], [square(1, 2)], [square(0.5, 1.5)]]}
    whole = shapely.Polygon(load_region(written(tmp_path / "a.json", polygon(square(0, 2))), ORIGIN))
    joined = shapely.Polygon(load_region(written(tmp_path / "b.json", parts), ORIGIN))
    # Of 17,000 m²: a parallel is no straight line.
    assert joined.symmetric_difference(whole).area < 0.2


@pytest.mark.parametrize(
    ("geometry", "told"),
    [
        ({"type": "MultiPolygon", "coordinates": [[square(0, 1)], [square(2, 3)]]}, "none or lie apart"),
        ({"type": "MultiPolygon", "coordinates": []}, "none or lie apart"),
        ({"type": "Point", "coordinates": [8.0, 47.0]}, "none or lie apart"),
        ({"type": "Polygon", "coordinates": "all"}, "a Polygon has no list of rings"),
        ({"type": "MultiPolygon", "coordinates": {"a": 1}}, "a MultiPolygon has no list of rings"),
        ({"type": "MultiPolygon", "coordinates": [[]]}, "a MultiPolygon has no list of rings"),
        (polygon(), "no list of rings"),
        (polygon(square(0, 1)[:3]), "at least four positions"),
        (polygon("ring"), "at least four positions"),
        (polygon([[8.0], *square(0, 1)]), "at least four positions"),
        (polygon([[8.0, 47.0, 1.0, 1.0], *square(0, 1)]), "at least four positions"),
        (polygon([(square(0, 1)[i]) for i in (0, 2, 1, 3, 0)]), "crosses itself"),
    ],
)
def test_what_is_no_region_is_told(tmp_path: Path, geometry: Any, told: str) -> None:
    with pytest.raises(BadInput, match=told):
        load_region(written(tmp_path / "a.json", geometry), ORIGIN)


def test_a_region_in_another_system_is_the_same_land(tmp_path: Path) -> None:
    ring = np.array(square(0, 1))
    moved = np.column_stack(Transformer.from_crs("EPSG:4326", "EPSG:32632", always_xy=True).transform(ring[:, 0], ring[:, 1])).tolist()
    in_utm = {"type": "Polygon", "coordinates": [moved], "crs": {"type": "name", "properties": {"name": "EPSG:32632"}}}
    (tmp_path / "b.json").write_text(json.dumps(in_utm))
    land = load_region(written(tmp_path / "a.json", polygon(square(0, 1))), ORIGIN)
    # A millimetre: our UTM and PROJ's differ by micrometres.
    np.testing.assert_allclose(load_region(tmp_path / "b.json", ORIGIN), land, atol=1e-3)


def test_what_is_no_such_file_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BadInput, match="there is no file"):
        load_region(tmp_path / "none.json", ORIGIN)
    (tmp_path / "latin.json").write_bytes('{"type": "Zürich"}'.encode("latin-1"))
    with pytest.raises(BadInput, match="no text in UTF-8"):
        load_region(tmp_path / "latin.json", ORIGIN)
    path = written(tmp_path / "a.json", polygon(square(0, 1)))
    for limit, passes in ((path.stat().st_size, True), (path.stat().st_size - 1, False)):
        monkeypatch.setattr(geojson_region, "MAX_REGION_BYTES", limit)
        if passes:
            assert load_region(path, ORIGIN).shape == (4, 2)
        else:
            with pytest.raises(BadInput, match="give the region's outline only"):
                load_region(path, ORIGIN)


def test_a_corner_that_is_no_number_is_told(tmp_path: Path) -> None:
    ring = square(0, 1)
    ring[1] = [8.0, "x"]  # type: ignore[list-item]
    with pytest.raises(BadInput, match=r"cannot use .*a\.json: ring "):
        load_region(written(tmp_path / "a.json", polygon(ring)), ORIGIN)
