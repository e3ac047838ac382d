"""The next flight of a real run, its lists read by other programs' readers, against the surface that
the run's photographs are of."""

from __future__ import annotations

import json
import zipfile
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fastkml
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from pygeoif import Point
from pyproj import Transformer

from radiant_app.commands.plan.next_flight import NextFlightRequest, plan_next_flight
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.events import Warned
from radiant_core.export.geotiff import NO_DATA
from scenegen.raycast import Photographer
from tests.app.test_next_flight import Hearing
from truth import config_of

KNOWN = sample_scenes_folder() / "hamlet" / "known"
SAFE_M, LOWEST_M = 16.0, 18.0
Places = NDArray[np.float64]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Hearing]:
    out, display = tmp_path_factory.mktemp("next") / "next", Hearing()
    run = sample_scenes_folder() / "runs" / "tiny"
    request = NextFlightRequest(run=run, out=out, photographs=8, resolution=2.0, safe_m=SAFE_M, lowest_m=LOWEST_M)
    plan_next_flight(request, display)
    return out, display


def of_kml(path: Path) -> Places:
    document = fastkml.KML.from_string(path.read_text().split("\n", 1)[1]).features[0]
    assert isinstance(document, fastkml.Document)
    marks = [mark.geometry for mark in document.features if isinstance(mark, fastkml.Placemark)]
    return np.array([next(iter(mark.coords)) for mark in marks if isinstance(mark, Point)])


def of_wpml(path: Path) -> Places:
    with zipfile.ZipFile(path) as archive:
        root = ElementTree.fromstring(archive.read("wpmz/waylines.wpml"))
    assert root.findtext(".//{*}executeHeightMode") == "relativeToStartPoint"
    marks = list(root.iter("{http://www.opengis.net/kml/2.2}Placemark"))
    places = [mark.findtext("{*}Point/{*}coordinates", "").split(",") for mark in marks]
    return np.column_stack([np.array(places, float), np.array([mark.findtext("{*}executeHeight") for mark in marks], float)])


def of_qgroundcontrol(path: Path) -> Places:
    # MAV_CMD_NAV_WAYPOINT in MAV_FRAME_GLOBAL_RELATIVE_ALT: latitude, longitude, height above home.
    items = [item for item in json.loads(path.read_text())["mission"]["items"] if item["command"] == 16]
    assert {item["frame"] for item in items} == {3}
    return np.array([item["params"][4:] for item in items], float)[:, [1, 0, 2]]


READERS = {"kml": of_kml, "kmz": of_wpml, "plan": of_qgroundcontrol}


def proposal_of(out: Path) -> dict[str, Any]:
    return json.loads((out / "next.geojson").read_text())


@pytest.mark.parametrize("ending", READERS)
def test_other_readers_get_every_view_and_no_point_below_take_off(flown: tuple[Path, Hearing], ending: str) -> None:
    out, _ = flown
    (path,) = (out / "flight").glob(f"*.{ending}")
    places = READERS[ending](path)
    assert places[:, 2].min() >= LOWEST_M
    views = [feature for feature in proposal_of(out)["features"] if feature["geometry"]["type"] == "Point"]
    assert len(views) == 8
    at = 0
    for view in views:
        wanted = np.array([*view["geometry"]["coordinates"][:2], view["properties"]["height_above_take_off"]])
        at += int(np.flatnonzero((np.abs(places[at:] - wanted) <= (1e-8, 1e-8, 0.006)).all(axis=1))[0]) + 1


@pytest.mark.parametrize("ending", READERS)
def test_the_true_surface_is_as_far_as_asked_where_the_model_shows_it(flown: tuple[Path, Hearing], ending: str) -> None:
    out, display = flown
    (path,) = (out / "flight").glob(f"*.{ending}")
    proposal, record = proposal_of(out), json.loads((KNOWN / "frame.json").read_text())
    place = f"+lon_0={record['origin_lon_deg']} +lat_0={record['origin_lat_deg']} +h_0={record['origin_alt_m']}"
    steps = ("unitconvert +xy_in=deg +xy_out=rad", "cart +ellps=WGS84", f"topocentric +ellps=WGS84 {place}")
    to_truth = Transformer.from_pipeline("+proj=pipeline " + " ".join(f"+step +proj={step}" for step in steps))
    lon, lat, height = READERS[ending](path).T
    corners = np.column_stack(to_truth.transform(lon, lat, height + proposal["take_off"]))
    way = np.concatenate([start + np.linspace(0, 1, 40)[:, None] * (end - start) for start, end in pairwise(corners)])
    photographer = Photographer(config_of(KNOWN))
    closest = photographer.closest(way)
    far = np.linalg.norm(way - closest, axis=1)
    # Positions of GPS place the run, and are off by so much.
    is_near = far < SAFE_M - photographer.config.gps_error_m
    back = np.array(to_truth.transform(*closest[is_near].T, direction="INVERSE")).T
    assert not is_mapped(out / "known.tif", back).any()
    assert far.min() < SAFE_M + 4, "nothing is near enough to test the distance"
    views = [feature["properties"] for feature in proposal["features"] if feature["geometry"]["type"] == "Point"]
    told = [event.message for event in display.heard if isinstance(event, Warned) and "does not show" in event.message]
    assert len(told) == 1
    num_told, num_views = (int(word) for word in told[0].split(" views")[0].split(" of "))
    assert 0 < num_told <= sum(not view["over_known"] for view in views) and num_views == 8


def is_mapped(path: Path, lon_lat: Places) -> NDArray[np.bool_]:
    """Whether the map has a figure at places (P,2 or 3)."""
    with tifffile.TiffFile(path) as file:
        photographs, tags = file.asarray()[..., 0], file.geotiff_metadata or {}
    east, north = Transformer.from_crs(4326, int(tags["ProjectedCSTypeGeoKey"]), always_xy=True).transform(*lon_lat[:, :2].T)
    (cell, *_), (_, _, _, west, top, _) = tags["ModelPixelScale"], tags["ModelTiepoint"]
    rows, columns = np.floor((top - north) / cell).astype(int), np.floor((east - west) / cell).astype(int)
    inside = (rows >= 0) & (columns >= 0) & (rows < photographs.shape[0]) & (columns < photographs.shape[1])
    return inside & (photographs[np.where(inside, rows, 0), np.where(inside, columns, 0)] != NO_DATA)
