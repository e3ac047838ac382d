"""What a run's regions are cut by: measured on generated scenes, forced both ways, and what a plan
of looks means to those who use it."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from benchmarks.methods.cells import BenchScene, Layout, ModelCache, bench_settings, deal_cell
from benchmarks.options import BenchOptions
from radiant_app.commands.plan.plan import PlanRequest, plan
from radiant_app.config.run_config import PlanOptions, RunConfig
from radiant_app.files.run_folder import Manifest, recorded_config
from radiant_app.files.system_file import even_system
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.cutting import LEAST_RISE, looks_pay
from radiant_app.run.pooled import PooledPhotographs
from radiant_app.run.progress import Progress
from radiant_app.run.scoring import regions_alone
from radiant_app.run.source import Plan
from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask
from radiant_core.frames import Frame, Sim3, geodetic_from_enu
from radiant_core.io.colmap.model import read_model
from radiant_core.io.records import load_plan, save_plan, save_scene
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.looks import camera_looks
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.constraints import PlanConstraints
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import num_cameras_outside, plan_regions
from radiant_core.scene import SfmScene
from radiant_core.sfm.world_frame.world import cameras_of, move_scene
from scenegen.config import SceneConfig
from scenegen.flight import plan_flight
from scenegen.known_model import write_known_model
from scenegen.raycast import Photographer

TOWN = Path(__file__).resolve().parents[2] / "sample_scenes" / "town" / "known"


def known_scene(folder: Path) -> SfmScene:
    """The cameras and points that a generator wrote."""
    model = read_model(folder)
    frame = Frame(kind="metric", origin_lat_lon_alt=np.array([47.0, 8.0, 400.0]))
    unmoved = Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))
    return move_scene(model, cameras_of(model), unmoved, frame)


def generated(folder: Path, flight: str) -> SfmScene:
    """A small street or orbit, without photographs."""
    config = SceneConfig(flight=flight, num_cameras=32, num_known_points=1500, width_px=160, height_px=120)
    write_known_model(folder, Photographer(config), plan_flight(config))
    return known_scene(folder)


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> SfmScene:
    """32 cameras along a street."""
    return generated(tmp_path_factory.mktemp("street"), "street")


def planned(scene: SfmScene, out: Path, **options: Any) -> tuple[PooledPhotographs, Plan, dict[str, Any]]:
    """The plan of a run of these photographs on two edges with two devices each; its decision."""
    out.mkdir(exist_ok=True)
    config = RunConfig(source=out, out=out, plan=PlanOptions(**options))
    photographs = PooledPhotographs(config=config, scene=scene, images=out)
    manifest = Manifest(folder=out, config={})
    made = photographs.make_plan(
        even_system(2, 2), Progress(manifest=manifest, listener=lambda event: None, clock=lambda: 0.0, started_s=0.0)
    )
    (decision,) = (each for each in manifest.decisions if each["topic"] == "what regions are cut by")
    return photographs, made, decision


def training_of(scene: SfmScene) -> SfmScene:
    return scene.restricted_to(np.flatnonzero(~held_out_mask(scene.cameras.names)))


def require_cut_by(made: Plan, places: np.ndarray) -> None:
    """The plan is, bit for bit, what the planner makes of these places."""
    system = place_edges(even_system(2, 2), places, None, 0)
    cloud = plan_regions(places, system)
    assert isinstance(cloud, CloudPlan)
    expected, found = asdict(cloud), asdict(made.cloud)
    for name in ("sites", "weights", "edge_of_camera"):
        np.testing.assert_array_equal(found[name], expected[name])
    for own, other in zip(made.cloud.borders, cloud.borders, strict=True):
        np.testing.assert_array_equal(own, other)
    for own, other in zip(made.edges, split_edges(places, cloud, system), strict=True):
        np.testing.assert_array_equal(own.camera_indices, other.camera_indices)
        np.testing.assert_array_equal(own.device_of_camera, other.device_of_camera)
        assert all(np.array_equal(*strips) for strips in zip(own.strips, other.strips, strict=True))


def test_a_street_is_cut_where_its_cameras_look(street: SfmScene, tmp_path: Path) -> None:
    photographs, made, decision = planned(street, tmp_path / "run")
    looks = camera_looks(training_of(street))
    assert made.cloud.looks is not None and made.cloud.cut_by == "looks"
    np.testing.assert_array_equal(made.cloud.looks, looks)
    require_cut_by(made, looks)
    assert made.cloud.certified and made.cloud.status == "optimal"
    assert num_cameras_outside(looks, made.cloud.sites, made.cloud.weights, made.cloud.edge_of_camera) == 0
    assert decision["choice"].endswith("where cameras look") and not decision["forced"] and not decision["changes_nothing"]
    assert decision["figure"] >= LEAST_RISE and "where they stand and" in decision["reason"]
    # Cameras stand where they stood, whatever the plan was cut by.
    np.testing.assert_array_equal(photographs.positions, training_of(street).cameras.centers[:, :2])
    cloud, _ = load_plan(tmp_path / "run" / "plan.json")
    np.testing.assert_array_equal(cloud.looks, looks)


def test_the_town_keeps_its_plan_bit_for_bit(tmp_path: Path) -> None:
    scene = known_scene(TOWN)
    _, made, decision = planned(scene, tmp_path / "run")
    assert made.cloud.looks is None and made.cloud.cut_by == "positions"
    require_cut_by(made, training_of(scene).cameras.centers[:, :2])
    assert decision["choice"].endswith("where cameras stand") and decision["changes_nothing"]
    assert 0 <= decision["figure"] < LEAST_RISE


def test_an_orbit_is_cut_where_its_cameras_stand(tmp_path: Path) -> None:
    _, made, decision = planned(generated(tmp_path, "orbit"), tmp_path / "run")
    assert made.cloud.looks is None and 0 < decision["figure"] < LEAST_RISE


@pytest.mark.parametrize(
    ("stand", "look", "pays"),
    [
        (0.01, 0.38, True),  # lewis
        (0.10, 0.32, True),  # street
        (0.02, 0.07, False),  # orbit
        (0.57, 0.58, False),  # town
        (0.67, 0.70, False),  # caliterra
        (0.39, 0.52, False),  # brighton: not measured, 18 photographs from straight above
        (0.0, LEAST_RISE, True),
        (-0.5, -0.45, False),
        (None, 0.9, False),
        (0.0, None, False),
        (float("nan"), 0.9, False),
        (0.0, float("nan"), False),
    ],
)
def test_only_what_is_like_the_scenes_that_gain_is_cut_where_cameras_look(stand: float | None, look: float | None, pays: bool) -> None:
    assert looks_pay(stand, look) is pays


def test_it_is_forced_both_ways(street: SfmScene, tmp_path: Path) -> None:
    _, made, decision = planned(street, tmp_path / "a", cut_by="positions")
    require_cut_by(made, training_of(street).cameras.centers[:, :2])
    assert made.cloud.looks is None and decision["forced"] and decision["figure"] >= LEAST_RISE
    town = known_scene(TOWN)
    _, made, decision = planned(town, tmp_path / "b", cut_by="looks")
    require_cut_by(made, camera_looks(training_of(town)))
    assert decision["forced"] and decision["figure"] < LEAST_RISE
    # A raster of where they look, for a cloud that is to know no more.
    _, made, _ = planned(street, tmp_path / "c", cut_by="looks", raster_cell_m=2.0)
    assert made.cloud.looks is not None and made.cloud.counts.sum() == len(made.cloud.looks)


def test_other_methods_and_scenes_without_points_are_cut_where_cameras_stand(street: SfmScene, tmp_path: Path) -> None:
    _, made, decision = planned(street, tmp_path / "a", method="even")
    assert made.cloud.looks is None and decision["figure"] is None and "method even" in decision["reason"]
    _, made, _ = planned(street, tmp_path / "b", method="paper", cut_by="looks")
    assert made.cloud.looks is not None
    blind = replace(street, observations=np.zeros((0, 2), np.int64))
    _, made, decision = planned(blind, tmp_path / "c")
    assert made.cloud.looks is None and decision["changes_nothing"] and "no sparse points" in decision["reason"]
    with pytest.raises(BadInput, match="no sparse points say where cameras look"):
        planned(blind, tmp_path / "d", cut_by="looks")


def test_the_setting_is_part_of_a_run_and_refused_where_it_means_nothing(tmp_path: Path) -> None:
    config = RunConfig(source=tmp_path, out=tmp_path / "run")
    assert recorded_config(config) != recorded_config(replace(config, plan=PlanOptions(cut_by="looks")))
    with pytest.raises(BadInput, match="each device places its own"):
        replace(config, frames="gps", plan=PlanOptions(cut_by="looks"))
    assert replace(config, frames="gps", plan=PlanOptions(cut_by="positions"))
    with pytest.raises(BadInput, match="--cut-by looks cuts another"):
        PlanOptions(cut_by="looks", file=tmp_path / "plan.json")
    with pytest.raises(BadInput, match="leave out --cut-by"):
        BenchOptions(scene=tmp_path, out=tmp_path, layout="run", cut_by="looks").check("methods")


def test_the_command_plan_cuts_a_scene_as_a_run_does(street: SfmScene, tmp_path: Path) -> None:
    (tmp_path / "scene").mkdir()
    save_scene(tmp_path / "scene" / "scene.safetensors", street)
    _, made, _ = planned(street, tmp_path / "run")

    def write(source: Path, **more: Any) -> tuple[dict[str, Any], CloudPlan]:
        out = tmp_path / f"plan{len(list(tmp_path.glob('plan*.json')))}.json"
        result = plan(
            PlanRequest(source=source, out=out, system=None, method="exact", seed=0, **more), ProgressDisplay(Console(quiet=True))
        )
        return result, load_plan(out)[0]

    result, cloud = write(tmp_path / "scene", compare=True)
    assert result["cut"].startswith("regions and strips are cut where cameras look")
    np.testing.assert_array_equal(cloud.edge_of_camera, made.cloud.edge_of_camera)
    np.testing.assert_array_equal(cloud.looks, made.cloud.looks)
    _, cloud = write(tmp_path / "scene", cut_by="positions")
    assert cloud.looks is None
    waypoints = tmp_path / "flight.csv"
    waypoints.write_text("name,latitude,longitude,altitude\na,47,8,60\nb,47.001,8,60\nc,47,8.001,60\n")
    result, cloud = write(waypoints)
    assert "cut" not in result and cloud.looks is None
    with pytest.raises(BadInput, match="positions alone do not say"):
        write(waypoints, cut_by="looks")


def test_cells_of_the_benchmark_are_cut_as_a_run_is(street: SfmScene, tmp_path: Path) -> None:
    training = training_of(street)
    scene = BenchScene(name="street", training=training, held_out=training, images=tmp_path, masks=None, long_side_px=96)
    cache, settings = ModelCache(folder=tmp_path), bench_settings(96, 10)
    cell = deal_cell(scene, cache, settings, Layout(num_edges=2, num_devices=2))
    np.testing.assert_array_equal(cell.recipe.cloud_plan.looks, camera_looks(training))
    for other in (cell.even, cell.planned("voronoi")):
        np.testing.assert_array_equal(other.cloud_plan.looks, camera_looks(training))
    assert (
        num_cameras_outside(
            camera_looks(training), cell.planned("voronoi").cloud_plan.sites, np.zeros(2), cell.planned("voronoi").cloud_plan.edge_of_camera
        )
        == 0
    )
    forced = deal_cell(replace(scene, cut_by="positions"), cache, settings, Layout(num_edges=2, num_devices=2))
    assert forced.recipe.cloud_plan.looks is None


def test_a_plan_around_constraints_is_cut_as_the_plan_that_they_refer_to(tmp_path: Path) -> None:
    positions = np.random.default_rng(0).uniform(-100, 100, (24, 3))
    places = geodetic_from_enu(positions, (47.0, 8.0, 400.0))
    flight = tmp_path / "flight.csv"
    rows = [f"w{index},{lat:.9f},{lon:.9f},60" for index, (lat, lon, _) in enumerate(places)]
    flight.write_text("\n".join(["name,latitude,longitude,altitude", *rows]))
    looks = np.ascontiguousarray(positions[::-1, :2])
    system = place_edges(even_system(2, 2), looks, None, 0)
    start = plan_regions(looks, system)
    assert isinstance(start, CloudPlan)
    pinned = int(np.flatnonzero(start.edge_of_camera == 0)[0])
    expected = plan_regions(looks, system, constraints=PlanConstraints(pinned={pinned: start.edge_ids[1]}), start=start)
    assert isinstance(expected, CloudPlan)
    save_plan(tmp_path / "start.json", replace(start, looks=looks), ())
    given = tmp_path / "given.toml"
    given.write_text(f'plan = "start.json"\n[pinned]\n{start.edge_ids[1]} = ["w{pinned}"]\n')
    request = PlanRequest(source=flight, out=tmp_path / "plan.json", system=None, method="exact", seed=0, constraints=given)
    assert "as the plan that it goes on from" in plan(request, ProgressDisplay(Console(quiet=True)))["cut"]
    found, _ = load_plan(tmp_path / "plan.json")
    np.testing.assert_array_equal(found.edge_of_camera, expected.edge_of_camera)
    np.testing.assert_array_equal(found.looks, looks)
    with pytest.raises(BadInput, match="is cut by looks: leave it out"):
        plan(replace(request, out=tmp_path / "other.json", cut_by="positions"), ProgressDisplay(Console(quiet=True)))


def test_machines_that_score_receive_regions_and_nothing_of_where_others_look(tmp_path: Path) -> None:
    places = np.random.default_rng(0).uniform(0, 50, (24, 2))
    system = even_system(2, 2)
    made = plan_regions(places, place_edges(system, places, None, 0))
    assert isinstance(made, CloudPlan)
    save_plan(tmp_path / "plan.json", regions_alone(replace(made, looks=places)), ())
    sent, _ = load_plan(tmp_path / "plan.json")
    assert sent.looks is None and not len(sent.edge_of_camera)
    np.testing.assert_array_equal(sent.sites, made.sites)
