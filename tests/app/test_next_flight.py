"""The next flight of a made-up run: its map, its reasons, and lists that other programs read."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import tifffile
from rich.console import Console

from radiant_app.commands.plan.next_flight import NextFlightRequest, limit_of, plan_next_flight
from radiant_app.commands.plan.tables import next_flight_lines
from radiant_app.events import Decided, Event, Warned
from radiant_app.report.known_section import BEGIN, END, add_known_section
from radiant_app.report.progress import ProgressDisplay
from radiant_core.errors import BadInput
from radiant_core.export.geotiff import NO_DATA
from radiant_core.next_flight.layers import BANDS, HOLE
from radiant_core.waypoints.reader import read_waypoints
from radiant_viewer.layers.known_layer import NAME as KNOWN_LAYER
from radiant_viewer.layers.palette import VERMILLION
from radiant_viewer.runs.run_layers import hidden_at_first, run_layers
from radiant_viewer.runs.run_view import load_run_view
from radiant_viewer.window.subject import load_subject
from tests.viewer.made_up_run import made_up_town, save_run

SAFE_M = 6.0


class Hearing(ProgressDisplay):
    """A display that shows nothing and remembers what it was told."""

    def __init__(self) -> None:
        super().__init__(Console(quiet=True))
        self.heard: list[Event] = []

    def __call__(self, event: Event) -> None:
        self.heard.append(event)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("next") / "run"
    save_run(folder, made_up_town())
    return folder


@pytest.fixture(scope="module")
def flown(run: Path) -> tuple[Path, dict[str, Any], list[Event]]:
    display = Hearing()
    out = run.parent / "next"
    request = NextFlightRequest(run=run, out=out, photographs=6, resolution=3.0, safe_m=SAFE_M, highest_m=80.0)
    return out, plan_next_flight(request, display), display.heard


def test_the_map_has_its_bands_and_place(flown: tuple[Path, dict[str, Any], list[Event]]) -> None:
    out, figures, heard = flown
    with tifffile.TiffFile(out / "known.tif") as file:
        bands = file.asarray()
        tags = file.geotiff_metadata or {}
    assert bands.shape[2] == len(BANDS)
    assert int(tags["ProjectedCSTypeGeoKey"]) == int(figures["crs"].split(":")[1].split()[0])
    views = bands[..., 0][bands[..., 0] != -9999]
    assert views.max() >= 2
    # No photograph is at hand: no error is predicted, and that is said.
    assert (bands[..., 4] == -9999).all()
    assert "predicted_error" in figures
    assert any(isinstance(event, Warned) and "not predicted" in event.message for event in heard)
    # Level ground: no way over the unknown is low for what might stand there.
    assert not any(isinstance(event, Warned) and "does not show" in event.message for event in heard)
    lines = next_flight_lines(figures, Path("RUN"))
    (flight,) = figures["flight"]
    assert f"edge-1-1: 6 views, {flight['flight_s'] / 60:.1f} min, 1 battery" in lines
    assert lines[-1] == "next: fly, then radiant join RUN --photographs NEW --out OUT"
    shapes = json.loads((out / "known.geojson").read_text())
    assert shapes["type"] == "FeatureCollection"
    assert (out / "known.png").stat().st_size > 10_000


def test_each_view_has_a_reason_and_keeps_its_distance(flown: tuple[Path, dict[str, Any], list[Event]]) -> None:
    out, figures, _ = flown
    record = json.loads((out / "next.geojson").read_text())
    points = [feature for feature in record["features"] if feature["geometry"]["type"] == "Point"]
    assert len(points) == figures["views"] == 6
    for point in points:
        assert point["properties"]["reason"].startswith("gain ")
        height = point["properties"]["height_above_take_off"]
        # The ground of the town is level to a metre.
        assert SAFE_M <= height <= 80.0
        assert -90 <= point["properties"]["pitch"] < 0


def test_lists_are_read_back_alike(flown: tuple[Path, dict[str, Any], list[Event]]) -> None:
    out, _, _ = flown
    record = json.loads((out / "next.geojson").read_text())
    points = [feature for feature in record["features"] if feature["geometry"]["type"] == "Point"]
    lon_lat = np.array([point["geometry"]["coordinates"][:2] for point in points])
    (csv,) = (out / "flight").glob("*.csv")
    waypoints = read_waypoints(csv).waypoints
    rows = [row for row, name in enumerate(waypoints.names) if "-pass-" not in name]
    assert waypoints.lat_lon_alt[rows][:, 1::-1] == pytest.approx(lon_lat, abs=1e-8)
    assert waypoints.height_kinds == ("takeoff",)
    items = json.loads(csv.with_suffix(".plan").read_text())["mission"]["items"]
    places = [item["params"][4:6] for item in items if item["command"] == 16]
    assert np.array(places) == pytest.approx(waypoints.lat_lon_alt[:, :2], abs=1e-8)
    with zipfile.ZipFile(csv.with_suffix(".kmz")) as archive:
        root = ElementTree.fromstring(archive.read("wpmz/waylines.wpml"))
    texts = [element.text for element in root.iter() if element.tag.endswith("coordinates")]
    assert len(texts) == len(waypoints)
    root = ElementTree.fromstring(csv.with_suffix(".kml").read_text())
    assert sum(element.tag.endswith("Placemark") for element in root.iter()) == len(waypoints)


def test_a_map_inside_its_run_is_a_hidden_layer_and_a_section_of_the_report(run: Path) -> None:
    assert KNOWN_LAYER not in {layer.name for layer in run_layers(load_run_view(run))}
    report = run / "report.html"
    report.write_text(f"<p>before</p>{BEGIN}{END}<p>after</p>")
    figures = plan_next_flight(NextFlightRequest(run=run, out=run / "known", resolution=4.0), Hearing())
    subject = load_subject(run)
    layer = next(layer for layer in subject.layers if layer.name == KNOWN_LAYER)
    assert KNOWN_LAYER in hidden_at_first(subject.layers)
    assert layer.picture is not None
    with tifffile.TiffFile(run / "known" / "known.tif") as file:
        bands = file.asarray()
    image = layer.picture.image
    holes = (bands[..., 6] == HOLE) & (bands[..., 8] <= 0)
    assert (image[holes] == (*VERMILLION, 255)).all()
    assert (image[..., 3] == 0).sum() == (bands[..., 6] == NO_DATA).sum()
    # North is up, and the corners are those of the cells.
    assert np.ptp(layer.picture.corners[:, 0]) == pytest.approx(4.0 * image.shape[1], rel=0.01)
    assert layer.picture.corners[0, 1] > layer.picture.corners[3, 1]
    page = report.read_text()
    assert page.startswith("<p>before</p>")
    assert page.endswith("<p>after</p>")
    assert page.count("What is known of the surface") == 1
    assert f"{figures['hole_walls']:,.0f}" in page
    assert "only down" in page
    assert add_known_section(report, run / "known" / "known.png", figures)
    assert report.read_text() == page
    (run / "known" / "known_map.tif").write_bytes(b"none")
    subject = load_subject(run)
    assert "cannot be read" in subject.summary
    assert KNOWN_LAYER not in {layer.name for layer in subject.layers}


# A photograph takes north 3 s and 0.06 s to send, south 6 s, beside 12.5 s for any number.
MACHINES = """
[[edge]]
id = "north"
position_m = [0.0, 40.0]
aggregate_s = { constant = 2.0 }
[[edge.device]]
id = "north-1"
init_s = {}
train_s = { constant = 10.5, linear = 3.0 }
model_mb = { linear = 0.25 }

[[edge]]
id = "south"
position_m = [0.0, -40.0]
aggregate_s = { constant = 2.0 }
[[edge.device]]
id = "south-1"
init_s = {}
train_s = { constant = 10.5, linear = 6.0 }
model_mb = { linear = 0.25 }
"""


def proposed(run: Path, name: str, photographs: int, deadline_s: float | None) -> tuple[dict[str, Any], dict[str, bytes], list[str]]:
    """Figures, every file of the flight, and decisions on the deadline."""
    out, display = run.parent / name, Hearing()
    system = run.parent / "machines.toml"
    system.write_text(MACHINES)
    request = NextFlightRequest(
        run=run, out=out, photographs=photographs, system=system, deadline_s=deadline_s, resolution=4.0, safe_m=SAFE_M
    )  # fmt: skip
    figures = plan_next_flight(request, display)
    files = {path.name: path.read_bytes() for path in (out / "next.geojson", *(out / "flight").iterdir()) if path.suffix != ".kmz"}
    said = [event.decision.choice for event in display.heard if isinstance(event, Decided) and event.decision.topic == "deadline"]
    return figures, files, said


def test_a_deadline_leaves_out_the_views_of_least_gain(run: Path) -> None:
    figures, files, said = proposed(run, "free", 6, None)
    assert not said and all("training_s" not in row for row in figures["flight"])
    loose_figures, loose, said = proposed(run, "loose", 6, 24.8)
    # Four photographs take north 24.7 s, two take south 24.6 s.
    assert [row["views"] for row in loose_figures["flight"]] == [4, 2]
    assert loose == files and not said
    tight_figures, tight, said = proposed(run, "tight", 6, 22.0)
    assert said == ["2 of 6 views, those of least gain, are left out"]
    assert tight == proposed(run, "fewer", 4, None)[1], "the best four, dealt as if four were asked for"
    assert sum(row["views"] for row in tight_figures["flight"]) == tight_figures["views"] == 4
    # Join and way to the cloud beside, at 50 and 100 Mbit/s.
    assert all(row["training_s"] + 2.0 + 0.02 * row["views"] <= 22.0 for row in tight_figures["flight"])


def test_a_deadline_that_no_photograph_meets_is_refused(run: Path) -> None:
    out, system = run.parent / "none", run.parent / "machines.toml"
    system.write_text(MACHINES)
    for request, said in (
        (
            NextFlightRequest(run=run, out=out, photographs=2, system=system, deadline_s=12.0, resolution=4.0),
            r"edge 'north', the fastest, 15\.6",
        ),
        (NextFlightRequest(run=run, out=out, photographs=2, system=system, deadline_s=0.0), "more than 0"),
        (NextFlightRequest(run=run, out=out, photographs=2, deadline_s=60.0), "--system"),
        (NextFlightRequest(run=run, out=out, system=system, deadline_s=60.0), "only the map was asked for"),
    ):
        with pytest.raises(BadInput, match=said):
            plan_next_flight(request, Hearing())
        assert not out.exists()


def test_an_edge_far_from_the_scene_is_told_once(run: Path) -> None:
    system, display = run.parent / "far.toml", Hearing()
    system.write_text(MACHINES.replace("position_m = [0.0, 40.0]", "lat_lon_deg = [-30.0, 150.0]"))
    figures = plan_next_flight(NextFlightRequest(run=run, out=run.parent / "far", photographs=4, system=system, resolution=4.0), display)
    told = [event.message for event in display.heard if isinstance(event, Warned) and " km from the photographs" in event.message]
    assert len(told) == 1 and told[0].startswith("Edge 'north' stands ") and figures["views"] == 4


def test_an_edge_that_is_a_curve_alone_flies_nothing(run: Path) -> None:
    system = run.parent / "curve.toml"
    system.write_text(MACHINES + '[[edge]]\nid = "curve"\nposition_m = [0.0, 0.0]\ntime_s = { linear = 1.0 }\n')
    out = run.parent / "curve"
    with pytest.raises(BadInput, match="edge 'curve' has no devices that fly"):
        plan_next_flight(NextFlightRequest(run=run, out=out, photographs=4, system=system, resolution=4.0), Hearing())


def test_the_map_alone_has_no_flight_and_bad_requests_leave_nothing(run: Path) -> None:
    out = run.parent / "map"
    figures = plan_next_flight(NextFlightRequest(run=run, out=out, resolution=4.0), Hearing())
    assert "views" not in figures
    assert sorted(path.name for path in out.iterdir()) == ["known.geojson", "known.png", "known.tif", "known_map.tif"]
    lines = next_flight_lines(figures, run)
    assert f"surface of the model: {figures['surface']:,.1f} m²" in lines and "side of a cell: 4.00 m" in lines
    assert lines[-1] == f"next: radiant plan --next {run} --photographs 13 --out OUT"
    nothing = run.parent / "nothing"
    for request, said in (
        (NextFlightRequest(run=run, out=nothing, photographs=0), "expected 1 or more"),
        (NextFlightRequest(run=run, out=nothing, photographs=501), "at most 500"),
        (NextFlightRequest(run=run, out=nothing, formats=("gpx",)), "gpx"),
        (NextFlightRequest(run=run, out=nothing, resolution=float("nan")), "resolution"),
        (NextFlightRequest(run=run, out=nothing, resolution=4.0, photographs=2, highest_m=6.0), "raise the upper limit|none of"),
    ):
        with pytest.raises(BadInput, match=said):
            plan_next_flight(request, Hearing())
        assert not nothing.exists()


def test_what_ended_the_choice_is_named_only_if_it_was_asked_for() -> None:
    def limit(photographs: int | None, batteries: int | None, count: int, num_adding: int) -> str:
        return limit_of(NextFlightRequest(run=Path(), out=Path(), photographs=photographs, batteries=batteries), count, num_adding)

    assert limit(9, None, 9, 9) == limit(9, 2, 9, 9) == "photographs"
    assert limit(9, 2, 5, 9) == limit(None, 2, 5, 9) == "batteries"
    # Fewer views than allowed add anything.
    assert limit(9, None, 5, 5) == limit(9, 2, 5, 5) == limit(None, 2, 5, 5) == ""
