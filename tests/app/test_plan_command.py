"""`radiant plan` before capture: waypoints or photographs with GPS in, a plan with everything beside it out, or nothing at all."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rich.console import Console

from radiant_app.commands.plan.content import ContentRequest
from radiant_app.commands.plan.flight import DroneText, FlightRequest, HeightOptions, flight_request
from radiant_app.commands.plan.plan import PlanRequest, plan
from radiant_app.commands.plan.tables import method_table
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.steps import training_part
from radiant_app.files.system_file import load_system
from radiant_app.report.progress import ProgressDisplay
from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask
from radiant_core.frames import geodetic_from_enu
from radiant_core.io.records import load_plan, load_plan_waypoints, load_scene
from radiant_core.plan.baselines import compare
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.waypoints.reader import exif_waypoints, read_waypoints
from tests.core.sfm.test_gps_of_photographs import hamlet_with, without_altitude
from tests.forked import run_module

HAMLET = sample_scenes_folder() / "hamlet" / "images"
SYSTEM = """
[[edge]]
id = "north"
lat_lon_deg = [47.3705, 8.54]
[[edge.device]]
id = "n1"
[[edge.device]]
id = "n2"
max_cameras = 0
[[edge]]
id = "south"
lat_lon_deg = [47.3695, 8.54]
[[edge.device]]
id = "s1"
"""


def make_plan(
    source: Path, out: Path, system: Path | None = None, method: Any = "exact", content: ContentRequest | None = None
) -> dict[str, Any]:
    display = ProgressDisplay(Console(file=io.StringIO()))
    content = content or ContentRequest()
    return plan(PlanRequest(source=source, out=out, system=system, method=method, seed=0, content=content), display)


def grid_csv(folder: Path, columns: int, rows: int, ground_m: float = 20.0) -> Path:
    east, north = np.meshgrid(np.linspace(-250, 250, columns), np.linspace(-125, 125, rows))
    positions = np.column_stack([east.ravel(), north.ravel(), np.full(columns * rows, 60.0)])
    lines = [f"wp{index},{lat},{lon},{alt}" for index, (lat, lon, alt) in enumerate(geodetic_from_enu(positions, (47.37, 8.54, ground_m)))]
    path = folder / "flight.csv"
    path.write_text("\n".join(["name,latitude,longitude,altitude", *lines]))
    return path


def test_1600_waypoints_become_a_plan_with_lists_and_regions(tmp_path: Path) -> None:
    source = grid_csv(tmp_path, 40, 40)
    (tmp_path / "system.toml").write_text(SYSTEM)
    result = make_plan(source, tmp_path / "plan.json", tmp_path / "system.toml")
    assert result["planned"] == 1600
    assert result["status"] == "optimal"
    assert result["warnings"].startswith("Devices without anything to capture: n2 (") and result["warnings"].endswith(").")
    waypoints = load_plan_waypoints(tmp_path / "plan.json")
    assert waypoints is not None
    assert waypoints.names == read_waypoints(source).waypoints.names
    cloud, edges = load_plan(tmp_path / "plan.json")
    assert cloud.counts.sum() == 1600
    # Sites lie where the file says, 55.6 m north and south of the middle (a second of latitude is
    # 30.9 m).
    np.testing.assert_allclose(cloud.sites[:, 1], [55.6, -55.6], atol=0.1)
    listed = [
        name
        for plan_of_edge in edges
        for device in plan_of_edge.device_ids
        if len(plan_of_edge.cameras_of(device))
        for name in read_waypoints(tmp_path / "plan_waypoints" / f"{device}.csv").waypoints.names
    ]
    assert sorted(listed) == sorted(waypoints.names)
    assert (tmp_path / "plan_waypoints" / "n2.csv").read_text() == "latitude,longitude,altitude(m),name\n"
    assert len(json.loads((tmp_path / "plan_regions.geojson").read_text())["features"]) == 2 + 2 + 1600
    picture = cv2.imread(str(tmp_path / "plan.png"))
    assert picture is not None and picture.shape == (900, 1280, 3)
    assert (picture != 255).any(axis=2).mean() > 0.2
    assert {path.name for path in tmp_path.iterdir()} == {
        "flight.csv", "system.toml", "plan.json", "plan.png", "plan_gantt.png", "plan_system.toml", "plan_waypoints", "plan_regions.geojson"
    }  # fmt: skip
    record = json.loads((tmp_path / "plan.json").read_text())
    del record["waypoints"]["heights_from"]
    (tmp_path / "earlier.json").write_text(json.dumps(record))
    with pytest.raises(BadInput, match=r"earlier\.json: it has no heights_from"):
        load_plan_waypoints(tmp_path / "earlier.json")


@pytest.mark.parametrize(("link_mbit_per_s", "chosen"), [(20, "models are joined"), (1000, "4 devices train together")])
def test_a_plan_says_whether_its_run_trains_together_with_both_times(tmp_path: Path, link_mbit_per_s: int, chosen: str) -> None:
    link = f"uplink_mbit_per_s = {link_mbit_per_s}.0"
    edges = [f'[[edge]]\nid = "e{edge}"\n{link}\n' for edge in (1, 2)]
    devices = [f'[[edge.device]]\nid = "d{edge}{number}"\nrelative_speed = 0.5\n{link}\n' for edge in (1, 2) for number in (1, 2)]
    (tmp_path / "system.toml").write_text("".join([edges[0], *devices[:2], edges[1], *devices[2:]]))
    result = make_plan(grid_csv(tmp_path, 10, 6), tmp_path / "plan.json", tmp_path / "system.toml")
    (whole,) = [line for line in result["training"] if line.startswith("all edges: ")]
    assert whole.startswith(f"all edges: {chosen}") and " s together, " in whole and " s joined)" in whole


def test_photographs_that_are_to_be_flown_again_are_all_in_the_lists(tmp_path: Path) -> None:
    flight = FlightRequest(formats=("kml",), height_m=60.0)
    request = PlanRequest(source=HAMLET, out=tmp_path / "plan.json", system=None, method="exact", seed=0, flight=flight)
    result = plan(request, ProgressDisplay(Console(file=io.StringIO())))
    lists = (tmp_path / "plan_waypoints").glob("*.csv")
    names = sorted(path.name for path in HAMLET.iterdir())
    listed = sorted(line.rsplit(",", 1)[1] for path in lists for line in path.read_text().splitlines()[1:])
    assert result["planned"] == len(names) and listed == names
    assert "held out" not in result["warnings"]


def test_photographs_are_planned_by_their_gps_without_every_8th(tmp_path: Path) -> None:
    for path in HAMLET.iterdir():
        shutil.copy(path, tmp_path)
    names = sorted(path.name for path in tmp_path.iterdir())
    image = cv2.imread(str(tmp_path / names[1]))
    assert image is not None
    cv2.imwrite(str(tmp_path / names[1]), image)  # loses its EXIF
    (tmp_path / "out").mkdir()
    result = make_plan(tmp_path, tmp_path / "out" / "plan.json")
    held_out = held_out_mask(names)
    waypoints = load_plan_waypoints(tmp_path / "out" / "plan.json")
    assert waypoints is not None
    assert list(waypoints.names) == [name for name, held in zip(names, held_out, strict=True) if not held and name != names[1]]
    assert f"without GPS in EXIF or XMP are not planned: {names[1]}" in result["warnings"]
    assert f"{held_out.sum()} of {len(names)} photographs" in result["warnings"]
    found = exif_waypoints(tmp_path).waypoints
    index = found.names.index(waypoints.names[0])
    np.testing.assert_array_equal(waypoints.lat_lon_alt[0], found.lat_lon_alt[index])
    # GPS counts from the sea: nothing in the lists is flown as height above take-off until somebody
    # says where the ground is.
    assert "give the ground's altitude with --ground" in result["warnings"] and "are heights above the sea" in result["forecast"]
    assert headers_of(tmp_path / "out" / "plan_waypoints") == {"latitude,longitude,altitude_absolute(m),name"}
    assert waypoints.absolute and waypoints.ground_m is None
    ground_m = float(waypoints.lat_lon_alt[:, 2].min()) - 50
    known = make_plan(tmp_path, tmp_path / "out" / "known.json", content=ContentRequest(ground_m=ground_m))
    assert "--ground" not in known["warnings"] + known["forecast"]
    assert headers_of(tmp_path / "out" / "known_waypoints") == {"latitude,longitude,altitude(m),name,altitude_absolute(m)"}
    lists = [read_waypoints(path).waypoints for path in (tmp_path / "out" / "known_waypoints").iterdir()]
    assert min(own.lat_lon_alt[:, 2].min() for own in lists) == pytest.approx(50, abs=1e-3)


def test_a_plan_without_altitudes_says_no_height_to_fly_at(tmp_path: Path) -> None:
    flat = hamlet_with(HAMLET.parent, tmp_path / "flat", without_altitude)
    result = make_plan(flat, tmp_path / "p.json")
    lists = sorted((tmp_path / "p_waypoints").iterdir())
    assert {path.read_text().splitlines()[0] for path in lists} == {"latitude,longitude,name"}
    assert "hold no height to fly at" in result["warnings"] and result["forecast"] == "not made, for no position has an altitude."
    assert "sea" not in result["warnings"] + result["forecast"]
    features = json.loads((tmp_path / "p_regions.geojson").read_text())["features"]
    assert {len(feature["geometry"]["coordinates"]) for feature in features if feature["geometry"]["type"] == "Point"} == {2}
    kept = load_plan_waypoints(tmp_path / "p.json")
    assert kept is not None and kept.heights_m is None and not kept.altitude_known
    back = [read_waypoints(path) for path in lists if path.read_text().count("\n") > 1]
    assert all(found.waypoints.heights_m is None and "hold no height" in found.warnings[0] for found in back)
    with pytest.raises(BadInput, match="leave --ground out"):
        make_plan(flat, tmp_path / "q.json", content=ContentRequest(ground_m=400))
    assert not (tmp_path / "q.json").exists()


def headers_of(folder: Path) -> set[str]:
    return {path.read_text().splitlines()[0] for path in folder.glob("*.csv")}


def test_what_cannot_be_planned_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    source, one, empty = grid_csv(tmp_path, 4, 3), tmp_path / "one", tmp_path / "empty"
    one.mkdir()
    empty.mkdir()
    shutil.copy(sorted(HAMLET.iterdir())[0], one)
    (tmp_path / "full.toml").write_text(SYSTEM.replace('id = "n1"', 'id = "n1"\nmax_cameras = 1').replace('"s1"', '"s1"\nmax_cameras = 1'))
    (tmp_path / "twice.csv").write_text("lat,lon\n47,8\nnan,8\n")
    (tmp_path / "taken_regions.geojson").write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    out = tmp_path / "plan.json"
    cases: list[tuple[Path, Path, Path | None, str]] = [
        (tmp_path / "none.csv", out, None, "does not exist"),
        (tmp_path / "twice.csv", out, None, "1 of 2 waypoints with a position that is not finite, 'wp-2'"),
        (source, tmp_path / "plan.txt", None, r"ends in \.json"),
        (source, tmp_path / "taken.json", None, r"taken_regions\.geojson exists"),
        (source, source / "nowhere" / "plan.json", None, "expected a folder to write"),
        (source, out, tmp_path / "full.toml", "can hold 2 of 12 cameras"),
        (one, out, None, "held out for scoring"),
        (empty, out, None, "no photographs"),
    ]
    for origin, target, system, told in cases:
        with pytest.raises(BadInput, match=told):
            make_plan(origin, target, system)
        assert sorted(tmp_path.rglob("*")) == before, told


def test_a_disk_that_fails_in_the_middle_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = grid_csv(tmp_path, 4, 3)

    def refuse(*_: object, **__: object) -> None:
        raise BadInput("cannot write: no space left.")

    monkeypatch.setattr("radiant_app.commands.plan.plan.save_plan", refuse)  # the last of the files
    with pytest.raises(BadInput, match="no space"):
        make_plan(source, tmp_path / "plan.json")
    assert list(tmp_path.iterdir()) == [source]


def test_the_command_line_prints_json_and_refuses_with_code_2(tmp_path: Path) -> None:
    source = grid_csv(tmp_path, 1, 1)

    def radiant(*arguments: object) -> subprocess.CompletedProcess[str]:
        return run_module("radiant_app", "plan", *arguments)

    good = radiant(source, "--out", tmp_path / "plan.json", "--json")
    assert good.returncode == 0, good.stderr
    assert json.loads(good.stdout)["counts"] == "edge-1 1, edge-2 0"
    refused = radiant(tmp_path / "plan.png", "--out", tmp_path / "other.json")
    assert refused.returncode == 2
    assert len(refused.stderr.strip().splitlines()) == 1
    assert "must end in .csv" in refused.stderr


def test_compare_measures_every_method_on_the_same_positions(tmp_path: Path) -> None:
    source = grid_csv(tmp_path, 15, 10)
    request = PlanRequest(source=source, out=tmp_path / "plan.json", system=None, method="exact", seed=0, compare=True)
    result = plan(request, ProgressDisplay(Console(file=io.StringIO())))
    over = {row["method"]: row["makespan_over_bound"] for row in result["methods"]}
    assert over["exact"] == 1.0
    assert len(over) == 5 and result["methods_left_out"].startswith("content: ")
    table = method_table(result["methods"]).splitlines()
    assert len(table) == 6
    assert table[1].split()[0] == "exact"


def test_compare_knows_the_content_of_a_scene(tmp_path: Path) -> None:
    run = sample_scenes_folder() / "runs" / "tiny"
    request = PlanRequest(source=run, out=tmp_path / "plan.json", system=None, method="exact", seed=0, compare=True)
    result = plan(request, ProgressDisplay(Console(file=io.StringIO())))
    rows = {row["method"]: row for row in result["methods"]}
    assert len(rows) == 6 and "methods_left_out" not in result
    scene = training_part(load_scene(run / "sfm" / "scene.safetensors"))
    seen = np.bincount(scene.observations[:, 1], minlength=len(scene.cameras))
    assert seen.max() > 1.5 * np.median(seen[seen > 0]) or seen.min() < 0.5 * np.median(seen), "some photographs show less than others"
    system = place_edges(load_system(tmp_path / "plan_system.toml"), scene.cameras.centers[:, :2], None, 0)
    wanted = {row.method: row for row in compare(scene.cameras.centers[:, :2], system, content=seen)}["content"]
    assert rows["content"]["makespan_s"] == wanted.makespan_s
    assert rows["content"]["squared_distance_m2"] == pytest.approx(wanted.squared_distance_m2)
    alike = {row.method: row for row in compare(scene.cameras.centers[:, :2], system, content=np.ones(len(seen)))}["content"]
    assert rows["content"]["squared_distance_m2"] != alike.squared_distance_m2, "halves of equal content are not halves of cameras"


CLAMPED = (
    '<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark><name>path</name><LineString>{mode}<coordinates>'
    "8.54,47.37,{alt} 8.5404,47.37,{alt} 8.5404,47.3702,{alt} 8.54,47.3702,{alt} 8.54,47.3704,{alt} 8.5404,47.3704,{alt}"
    "</coordinates></LineString></Placemark></Document></kml>"
)
LISTS, PLAIN = ("kmz", "plan", "kml"), HeightOptions()


def flown(folder: Path, mode: str, alt: float, heights: HeightOptions = PLAIN, formats: str | None = "kmz,plan,kml") -> dict[str, Any]:
    """A plan of a path of Google Earth, with flight lists."""
    (folder / "path.kml").write_text(CLAMPED.format(mode=mode and f"<altitudeMode>{mode}</altitudeMode>", alt=alt))
    request = flight_request(None, formats, heights, DroneText(8.0, "20m", 4000, 73.7))
    out = folder / "out" / "plan.json"
    display = ProgressDisplay(Console(file=io.StringIO()))
    return plan(PlanRequest(source=folder / "path.kml", out=out, system=None, method="exact", seed=0, flight=request), display)


@pytest.mark.parametrize(("mode", "alt"), [("", 0.0), ("", 455.5), ("clampToGround", 0.0), ("clampToGround", 455.5)])
def test_a_path_that_is_clamped_to_the_ground_has_no_height_to_fly_at(tmp_path: Path, mode: str, alt: float) -> None:
    with pytest.raises(
        BadInput, match="6 of 6 waypoints have no height to fly at, 'path-1' first: give --height with metres above take-off"
    ):
        flown(tmp_path, mode, alt)
    assert not (tmp_path / "out").exists()
    result = flown(tmp_path, mode, alt, formats=None)
    assert "6 of 6 waypoints are clamped to the ground" in result["warnings"] and result["heights"] == "not known"
    assert headers_of(tmp_path / "out" / "plan_waypoints") == {"latitude,longitude,name"}
    shutil.rmtree(tmp_path / "out")
    result = flown(tmp_path, mode, alt, HeightOptions(height_m=80.0))
    assert result["heights"] == "80 m above take-off" and "hold no height" not in result["warnings"]
    lists = tmp_path / "out" / "plan_waypoints"
    assert headers_of(lists) == {"latitude,longitude,altitude(m),name"} and {path.suffix[1:] for path in lists.iterdir()} == {*LISTS, "csv"}


@pytest.mark.parametrize(
    ("mode", "alt", "heights", "told"),
    [
        (
            "relativeToGround",
            455.5,
            HeightOptions(heights="takeoff"),
            "6 of 6 heights are more than 120 m above take-off.*--max-height 456",
        ),
        ("relativeToGround", -3.0, HeightOptions(heights="takeoff"), "6 of 6 heights are not above take-off.*--min-height -3"),
        ("relativeToGround", 80.0, HeightOptions(), "give --heights takeoff where the ground is level"),
        ("absolute", 455.5, HeightOptions(), "give --geoid with the metres"),
    ],
)
def test_lists_that_nobody_may_fly_are_written_when_asked_for(
    tmp_path: Path, mode: str, alt: float, heights: HeightOptions, told: str
) -> None:
    with pytest.raises(BadInput, match=told):
        flown(tmp_path, mode, alt, heights)
    assert not (tmp_path / "out").exists()
    asked = heights._replace(highest_m=456.0, lowest_m=-3.0, geoid_m=47.0, heights="takeoff" if mode == "relativeToGround" else None)
    assert flown(tmp_path, mode, alt, asked)["flight_heights"].startswith("heights are above")


def test_tables_hold_no_height_that_nobody_asked_for(tmp_path: Path) -> None:
    result = flown(tmp_path, "relativeToGround", 455.5, formats=None)
    assert "The lists hold no heights above take-off: 6 of 6 heights are more than 120 m" in result["warnings"]
    assert headers_of(tmp_path / "out" / "plan_waypoints") == {"latitude,longitude,name"}
    kept = load_plan_waypoints(tmp_path / "out" / "plan.json")
    assert kept is not None and kept.heights_m is not None and kept.heights_m.max() == 455.5, "the plan keeps what the file said"


def test_a_height_in_place_of_others_is_said_and_none_beside_the_ground(tmp_path: Path) -> None:
    result = flown(tmp_path, "absolute", 455.5, formats="plan,kml")
    assert result["flight_heights"] == "heights are above sea level" and "the lists are not held to 120 m above it" in result["warnings"]
    shutil.rmtree(tmp_path / "out")
    result = flown(tmp_path, "absolute", 455.5, HeightOptions(height_m=60.0))
    assert (
        "All waypoints fly 60 m above take-off, as --height says, in place of what they have: 455.5 m above sea level."
        in result["warnings"]
    )
    request = flight_request(None, None, HeightOptions(height_m=60.0), DroneText(8.0, "20m", 4000, 73.7))
    with pytest.raises(BadInput, match="give one of them"):
        plan(
            PlanRequest(
                source=tmp_path / "path.kml", out=tmp_path / "other" / "p.json", system=None, method="exact", seed=0, flight=request,
                content=ContentRequest(ground_m=400.0),
            ),
            ProgressDisplay(Console(file=io.StringIO())),
        )  # fmt: skip
