"""A plan of `radiant plan` is opened, changed and saved so that `radiant plan`, `radiant run --plan` and the window take it again."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from radiant_app.commands.inspect.window import plan_file_of, plan_setting, run_setting, save_picture
from radiant_app.commands.plan.content import ContentRequest
from radiant_app.commands.plan.plan import PlanRequest, plan
from radiant_app.files.constraints_file import dump_constraints, load_constraints
from radiant_app.files.system_file import load_system
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.stages import require_plan
from radiant_core.errors import BadInput
from radiant_core.io.records import load_plan, load_plan_waypoints, load_scene, save_plan, save_scene
from radiant_core.plan.borders.footprints import Optics
from radiant_core.plan.regions.constraints import PlanConstraints
from radiant_core.plan.waypoints import Waypoints
from radiant_core.waypoints.reader import read_waypoints
from radiant_viewer.editing.model.edited_plan import border_weight_m2
from radiant_viewer.editing.model.plan_edits import FixWeight, LockRegion, PinCameras
from radiant_viewer.editing.solver.plan_editor import PlanEditor
from radiant_viewer.editing.store.plan_files import load_other_plan, plan_subject, save_edited_plan
from radiant_viewer.runs.plan_view import estimate_ground_m, load_plan_view
from radiant_viewer.window.subject import run_subject
from tests.app.test_plan_command import grid_csv, make_plan
from tests.viewer.made_up_run import made_up_town, save_run

SYSTEM = "".join(
    f'[[edge]]\nid = "{edge}"\nlat_lon_deg = [{lat}, {lon}]\n' + "".join(f'[[edge.device]]\nid = "{edge}-{n}"\n' for n in (1, 2))
    for edge, lat, lon in (("north", 47.3708, 8.541), ("south", 47.3692, 8.54), ("east", 47.37, 8.5425))
)


@pytest.fixture
def planned(tmp_path: Path) -> Path:
    (tmp_path / "machines.toml").write_text(SYSTEM)
    make_plan(grid_csv(tmp_path, 20, 15, 430.0), tmp_path / "plan.json", tmp_path / "machines.toml")
    return tmp_path


def test_an_edited_plan_is_what_plan_and_run_read(planned: Path) -> None:
    assert plan_file_of(planned) == plan_file_of(planned / "plan.json") == planned / "plan.json"
    run, setting = load_plan_view(planned / "plan.json"), plan_setting(planned / "plan.json")
    assert setting.system is not None and [edge.id for edge in setting.system.edges] == ["north", "south", "east"]
    before = load_plan_waypoints(planned / "plan.json")
    assert before is not None
    np.testing.assert_allclose(run.scene.cameras.centers[:, :2], before.positions_m[:, :2], atol=1e-9)
    # Altitudes of 490 m, images 18 m apart: heights above the sea, and 80 % of overlap from 50 m
    # above the ground.
    assert (abs(run.scene.cameras.centers[:, 2] - 50) < 15).all()
    forward = run.scene.cameras.cam_from_world[:, 2, :3]
    np.testing.assert_allclose(forward, np.tile([0, 0, -1.0], (300, 1)), atol=1e-9)  # straight down
    editor = PlanEditor(plan_subject(run), setting.system, (run.cloud_plan, run.edge_plans), setting.edits_path)
    editor.apply(LockRegion(edge="east"))
    editor.apply(PinCameras(cameras=editor.subject.names[:4], edge="south"))
    editor.apply(FixWeight(edge="north", weight_m2=border_weight_m2(editor.state.cloud, "north", "south", 30.0)))
    written = save_edited_plan(planned / "mine.json", editor.subject, editor.state, setting)
    beside = {f"mine{ending}" for ending in (".json", "_system.toml", "_start.json", "_constraints.toml", "_waypoints", "_regions.geojson")}
    assert {path.name for path in written} == beside
    # The run's own check, and the plan bit for bit.
    require_plan(planned / "mine.json", load_system(planned / "mine_system.toml"))
    cloud, edges = load_plan(planned / "mine.json")
    np.testing.assert_array_equal(cloud.edge_of_camera, editor.state.cloud.edge_of_camera)
    np.testing.assert_array_equal(cloud.weights, editor.state.cloud.weights)
    after = load_plan_waypoints(planned / "mine.json")
    assert after is not None and after.names == before.names
    # `radiant plan` with the saved constraints comes to the same plan.
    request = PlanRequest(
        source=planned / "flight.csv",
        out=planned / "again.json",
        system=planned / "mine_system.toml",
        method="exact",
        seed=0,
        constraints=planned / "mine_constraints.toml",
    )
    plan(request, ProgressDisplay(Console(file=io.StringIO())))
    again, edges_again = load_plan(planned / "again.json")
    np.testing.assert_array_equal(again.edge_of_camera, cloud.edge_of_camera)
    np.testing.assert_array_equal(edges_again[0].device_of_camera, edges[0].device_of_camera)
    # And to the same lists for the devices; one of a device that an earlier plan of this name had
    # is gone.
    (planned / "mine_waypoints" / "gone.csv").touch()
    save_edited_plan(planned / "mine.json", editor.subject, editor.state, setting)
    lists = {path.name: path.read_bytes() for path in (planned / "mine_waypoints").iterdir()}
    assert lists == {path.name: path.read_bytes() for path in (planned / "again_waypoints").iterdir()} and len(lists) == 6
    assert (planned / "mine_regions.geojson").read_bytes() == (planned / "again_regions.geojson").read_bytes()
    # Loaded into the window of the first plan it is the same again, whatever order its waypoints
    # come in.
    editor.undo()
    adopted = load_other_plan(planned / "mine.json", editor.subject)
    np.testing.assert_array_equal(adopted.cloud.edge_of_camera, cloud.edge_of_camera)
    turned = replace(editor.subject, names=editor.subject.names[::-1], positions=editor.subject.positions[::-1])
    mirrored = load_other_plan(planned / "mine.json", turned)
    np.testing.assert_array_equal(mirrored.cloud.edge_of_camera, cloud.edge_of_camera[::-1])
    np.testing.assert_array_equal(np.sort(len(turned.names) - 1 - mirrored.edges[1].camera_indices), edges[1].camera_indices)
    editor.apply(adopted)
    with pytest.raises(BadInput, match=r"ends in \.json"):
        save_edited_plan(planned / "mine.txt", editor.subject, editor.state, setting)
    other = replace(editor.subject, names=("strange", *editor.subject.names[1:]))
    with pytest.raises(BadInput, match="other cameras, 'wp0'"):
        load_other_plan(planned / "mine.json", other)
    message = save_picture(planned, "regions", planned / "map.png")
    image = cv2.imread(str(planned / "map.png"))
    assert "written" in message and image is not None and (image != 255).any(axis=2).mean() > 0.2
    with pytest.raises(BadInput, match="nothing was trained"):
        save_picture(planned, "splats", planned / "splats.png")


def test_a_run_on_the_globe_gives_a_plan_that_another_run_can_take(tmp_path: Path) -> None:
    town = made_up_town()
    save_run(tmp_path / "run", town)
    assert plan_file_of(tmp_path / "run") is None
    setting = run_setting(tmp_path / "run")
    assert setting.system is None and "name one by --system" in setting.reason
    save_plan(tmp_path / "plan.json", town.cloud_plan, town.edge_plans)
    run = load_plan_view(tmp_path / "plan.json", town.scene)
    subject = plan_subject(run)
    system = load_system(_write_system(tmp_path / "town.toml"))
    editor = PlanEditor(subject, system, (town.cloud_plan, town.edge_plans))
    written = save_edited_plan(tmp_path / "out.json", subject, editor.state, plan_setting(tmp_path / "plan.json", tmp_path / "town.toml"))
    assert len(written) == 4
    waypoints = load_plan_waypoints(tmp_path / "out.json")
    assert waypoints is not None
    # The file counts from the waypoints' own middle, as plans before capture do: regions lie around
    # the same cameras.
    cloud, _ = load_plan(tmp_path / "out.json")
    shift = subject.positions[:, :2].mean(axis=0)
    np.testing.assert_allclose(cloud.sites, town.cloud_plan.sites - shift, atol=1e-3)
    np.testing.assert_allclose(waypoints.positions_m[:, :2], subject.positions[:, :2] - shift, atol=1e-3)
    back = load_other_plan(tmp_path / "out.json", subject)
    np.testing.assert_allclose(back.cloud.sites, town.cloud_plan.sites, atol=1e-6)


def test_lists_of_a_run_hold_heights_above_its_ground_and_absolute_altitudes_beside_them(tmp_path: Path) -> None:
    town = made_up_town()
    # As structure from motion leaves it: 60 m over ground at 0 to 1 m, 474 m above the sea.
    seen = np.column_stack([np.arange(9000), np.zeros(9000, np.int64)])
    frame = replace(town.scene.frame, origin_lat_lon_alt=np.array([47.37, 8.54, 414.0]))
    town = replace(town, scene=replace(town.scene, observations=seen, frame=frame))
    save_plan(tmp_path / "plan.json", town.cloud_plan, town.edge_plans)
    subject = plan_subject(load_plan_view(tmp_path / "plan.json", town.scene))
    setting = plan_setting(tmp_path / "plan.json", _write_system(tmp_path / "town.toml"))
    editor = PlanEditor(subject, setting.system, (town.cloud_plan, town.edge_plans))  # type: ignore[arg-type]
    save_edited_plan(tmp_path / "out.json", subject, editor.state, setting)
    lists = [path for path in sorted((tmp_path / "out_waypoints").iterdir()) if path.read_text().count("\n") > 1]
    for path in lists:
        rows = list(csv.DictReader(path.read_text().splitlines()))
        assert list(rows[0]) == ["latitude", "longitude", "altitude(m)", "name", "altitude_absolute(m)"]
        for row in rows:
            # The lowest tenth of the points lies at 0.1 m; the ground curves away by a millimetre.
            assert float(row["altitude(m)"]) == pytest.approx(59.9, abs=0.05)
            assert float(row["altitude_absolute(m)"]) == pytest.approx(474, abs=0.05)
        back = read_waypoints(path).waypoints
        assert back.names == tuple(row["name"] for row in rows) and not back.absolute
    assert sum(len(read_waypoints(path).waypoints) for path in lists) == len(subject.names)
    kept = load_plan_waypoints(tmp_path / "out.json")
    assert kept is not None and kept.absolute and kept.ground_m == pytest.approx(414.1, abs=0.05), "for replan, and for the window"
    # A run in the field shows Gaussians, which float anywhere: nothing tells its ground.
    unseen = replace(town.scene, observations=np.zeros((0, 2), np.int64))
    save_edited_plan(tmp_path / "field.json", plan_subject(load_plan_view(tmp_path / "plan.json", unseen)), editor.state, setting)
    header = (tmp_path / "field_waypoints" / lists[0].name).read_text().split("\n")[0].strip()
    assert header == "latitude,longitude,altitude_absolute(m),name"


def test_lists_of_a_run_without_altitudes_hold_heights_above_its_ground_alone(tmp_path: Path) -> None:
    town = made_up_town()
    seen = np.column_stack([np.arange(9000), np.zeros(9000, np.int64)])
    frame = replace(town.scene.frame, origin_lat_lon_alt=np.array([47.37, 8.54, 0.0]), altitude_known=False)
    scene = replace(town.scene, observations=seen, frame=frame)
    save_scene(tmp_path / "scene.safetensors", scene)
    scene = load_scene(tmp_path / "scene.safetensors")
    assert not scene.frame.altitude_known
    save_plan(tmp_path / "plan.json", town.cloud_plan, town.edge_plans)
    setting = plan_setting(tmp_path / "plan.json", _write_system(tmp_path / "town.toml"))
    for name, points_seen, header in (
        ("out", seen, "latitude,longitude,altitude(m),name"),
        ("field", np.zeros((0, 2), np.int64), "latitude,longitude,name"),
    ):
        subject = plan_subject(load_plan_view(tmp_path / "plan.json", replace(scene, observations=points_seen)))
        editor = PlanEditor(subject, setting.system, (town.cloud_plan, town.edge_plans))  # type: ignore[arg-type]
        save_edited_plan(tmp_path / f"{name}.json", subject, editor.state, setting)
        lists = sorted((tmp_path / f"{name}_waypoints").iterdir())
        assert {path.read_text().splitlines()[0] for path in lists} == {header}
        rows = [row for path in lists for row in csv.DictReader(path.read_text().splitlines())]
        # The lowest tenth of the points lies at 0.1 m, the cameras 60 m above 0.
        assert all(float(row["altitude(m)"]) == pytest.approx(59.9, abs=0.05) for row in rows if name == "out")
        kept = load_plan_waypoints(tmp_path / f"{name}.json")
        assert kept is not None and not kept.absolute and kept.altitude_known == (name == "out"), "its ground is what they count from"


def test_what_cannot_be_opened_is_one_sentence(tmp_path: Path, planned: Path) -> None:
    assert plan_file_of(tmp_path / "none") is None
    (planned / "plan.json").rename(planned / "one.json")
    (planned / "two.json").write_bytes((planned / "one.json").read_bytes())
    with pytest.raises(BadInput, match=r"holds 2 plans, one\.json and two\.json"):
        plan_file_of(planned)
    town = made_up_town()
    save_plan(tmp_path / "scene_plan.json", town.cloud_plan, town.edge_plans)
    with pytest.raises(BadInput, match="name the scene's folder by --scene"):
        load_plan_view(tmp_path / "scene_plan.json")
    empty = replace(town.cloud_plan, edge_of_camera=np.zeros(0, np.int64))
    nobody = tuple(replace(edge, camera_indices=np.zeros(0, np.int64), device_of_camera=np.zeros(0, np.int64)) for edge in town.edge_plans)
    save_plan(tmp_path / "empty.json", empty, nobody)
    bare = town.scene.restricted_to(np.zeros(0, np.int64))
    with pytest.raises(BadInput, match="the plan has no cameras"):
        plan_subject(load_plan_view(tmp_path / "empty.json", bare))
    with pytest.raises(BadInput, match="cannot be read"):
        plan_setting(tmp_path / "empty.json", tmp_path / "none.toml")


def test_cameras_of_a_plan_stand_over_its_ground(planned: Path) -> None:
    request = PlanRequest(
        source=planned / "flight.csv",
        out=planned / "given.json",
        system=planned / "machines.toml",
        method="exact",
        seed=0,
        content=ContentRequest(ground_m=460.0),
    )
    plan(request, ProgressDisplay(Console(file=io.StringIO())))
    run, setting = load_plan_view(planned / "given.json"), plan_setting(planned / "given.json")
    # The grid flies at 490 m and curves down with the globe by some millimetres.
    np.testing.assert_allclose(run.scene.cameras.centers[:, 2], 30, atol=0.1)
    editor = PlanEditor(plan_subject(run), setting.system, (run.cloud_plan, run.edge_plans))  # type: ignore[arg-type]
    save_edited_plan(planned / "again.json", editor.subject, editor.state, setting)
    np.testing.assert_array_equal(load_plan_view(planned / "again.json").scene.cameras.centers, run.scene.cameras.centers)
    assert not [layer.name for layer in run_subject(run).layers if "Gaussians" in layer.name or "points" in layer.name]
    high = Waypoints(names=("a", "b"), lat_lon_alt=[[47.37, 8.54, 100.0], [47.3704, 8.54, 100.0]])
    assert estimate_ground_m(high, Optics()) == 0, "images 44 m apart overlap by 70 % from 100 m"


def test_a_run_with_a_broken_system_opens_and_one_without_manifest_says_so(tmp_path: Path) -> None:
    run = tmp_path / "run"
    save_run(run, made_up_town())
    (run / "system.toml").write_text("[[edge]\n")
    setting = run_setting(run)
    assert setting.system is None and setting.reason.startswith("The plan cannot be changed: ") and "system.toml" in setting.reason
    with pytest.raises(BadInput, match=r"system\.toml"):
        run_setting(run, run / "system.toml")
    (run / "manifest.json").unlink()
    with pytest.raises(BadInput, match=r"lost its manifest\.json.*plan\.json --scene"):
        plan_file_of(run)


def test_constraints_are_written_as_they_are_read(tmp_path: Path) -> None:
    names = ('a"b.jpg', "ü/2.jpg", "c.jpg")
    given = PlanConstraints(fixed_weights_m2={"e 1": -1234.5678901234567, "e2": 1e-300}, locked=("e3",), pinned={0: "e2", 2: "e3", 1: "e2"})
    town = made_up_town()
    save_plan(tmp_path / "start.json", town.cloud_plan, town.edge_plans)
    (tmp_path / "c.toml").write_text(dump_constraints(given, names, "start.json"), encoding="utf-8")
    found = load_constraints(tmp_path / "c.toml", names)
    assert found.constraints == given
    assert found.start is not None and found.start.edge_ids == town.cloud_plan.edge_ids


def _write_system(path: Path) -> Path:
    lines = [
        f'[[edge]]\nid = "{edge}"\n' + "".join(f'[[edge.device]]\nid = "{edge}-{n}"\n' for n in (1, 2))
        for edge in ("north", "harbour", "quarry")
    ]
    path.write_text("".join(lines))
    return path
