"""The hierarchy in one process, under the local executor and on Ray: the same scene bit for bit, by four unlike recipes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.config.run_config import RunConfig
from radiant_app.executors.local import LocalExecutor
from radiant_app.executors.protocol import Executor, NodeTask
from radiant_app.executors.ray_cluster import RayExecutor
from radiant_app.files.system_file import even_system
from radiant_app.run.dealing import Dealer
from radiant_app.run.pooled import PooledPhotographs
from radiant_app.run.refining import plan_rounds
from radiant_app.workers.nodes import CUT_SCENE
from radiant_app.workers.sources import sfm_record
from radiant_core.aggregate.config import AggregateConfig, Join, Refine, aggregate_preset, with_joins
from radiant_core.aggregate.tree import Tree, tree_of_plan
from radiant_core.evaluate.split import held_out_mask
from radiant_core.frames import Frame
from radiant_core.hierarchy.choosing import CUT, JOINED, REFINED
from radiant_core.hierarchy.in_process import keep_best, run_in_process
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.io.colmap.model import read_model
from radiant_core.io.colmap.text import write_model
from radiant_core.io.photos.masks import mask_name
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.io.records import load_splats, save_cameras, save_plan
from radiant_core.io.run_store import read_json, write_json
from radiant_core.light.held_out import held_out_psnr_db
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import System
from radiant_core.render.rendered_view import render_views
from radiant_core.scene import SfmScene
from radiant_core.sfm.reconstruct import scene_from_colmap
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.photographs import load_training_views
from tests.core.scenes import cameras_above, ground_splats
from tests.forked_workers import forked_workers

SIDE_PX = 80
DRAFT = replace(train_preset("draft"), num_steps=24, long_side_px=SIDE_PX, max_num_splats=700)
PAPER = replace(train_preset("paper"), num_steps=24, long_side_px=SIDE_PX, max_num_splats=700)


@dataclass(frozen=True, kw_only=True)
class World:
    """A planned scene with its photographs, before any node has run."""

    photographs: PooledPhotographs
    recipe: Recipe

    @property
    def tree(self) -> Tree:
        return tree_of_plan(self.recipe.cloud_plan, self.recipe.edge_plans)

    def dealer(self, run: Path) -> Dealer:
        """Deals this world into a folder of its own."""
        (run / "sfm").mkdir(parents=True)
        masks = self.photographs.config.out / "sfm" / "masks"
        write_json(run / "sfm" / "result.json", {"masks": str(masks)} if masks.is_dir() else {})
        photographs = replace(self.photographs, config=replace(self.photographs.config, out=run))
        return Dealer(run=run, recipe=self.recipe, photographs=photographs)


class Oracle:
    """A world folded in this process, and what its nodes reported."""

    def __init__(self, world: World) -> None:
        training = world.photographs.training
        masks = world.photographs.config.out / "sfm" / "masks"
        views = load_training_views(world.photographs.images, training.cameras.scaled(SIDE_PX), masks)
        self.recorders: dict[str, Recorder] = {}
        self.run = run_in_process(world.recipe, training, views, self._recorder)

    def _recorder(self, stage: str) -> Recorder:
        return self.recorders.setdefault(stage, Recorder(stage=stage))


def planned(photographs: PooledPhotographs, system: System, train: TrainConfig, aggregate: AggregateConfig) -> Recipe:
    """The recipe of a system whose edges are placed among the cameras, with exact uploads."""
    positions = photographs.training.cameras.centers[:, :2]
    system = place_edges(system, positions, None, 0)
    cloud_plan = plan_regions(positions, system)
    assert isinstance(cloud_plan, CloudPlan)
    edge_plans = split_edges(positions, cloud_plan, system)
    return Recipe(system=system, cloud_plan=cloud_plan, edge_plans=edge_plans, train=train, aggregate=aggregate, backend="native")


def unequal(system: System) -> System:
    """The same system where the first device of every edge holds two photographs at most."""
    edges = [replace(edge, devices=(replace(edge.devices[0], max_cameras=2), *edge.devices[1:])) for edge in system.edges]
    return replace(system, edges=tuple(edges))


def hamlet_of_two_tiers(folder: Path) -> World:
    """Two edges with two unequal devices each; they and the cloud retrain. Twelve photographs with known cameras, uploads in 16 bits."""
    hamlet = sample_scenes_folder() / "hamlet"
    result = scene_from_colmap(hamlet / "known", hamlet / "images", folder / "sfm", lambda progress: None)
    photographs = PooledPhotographs(
        config=RunConfig(source=hamlet / "images", out=folder), scene=result.scene, images=result.undistorted_folder
    )
    recipe = planned(
        photographs,
        unequal(even_system(2, 2)),
        DRAFT,
        AggregateConfig(cloud=Join(epochs=1), edge=Join(epochs=2), refine=Refine(epochs=2, rounds=2)),
    )
    return World(photographs=photographs, recipe=replace(recipe, upload="float16"))


def ground_of_a_lone_edge(folder: Path) -> World:
    """One edge, which retrains its two devices' models; exact uploads."""
    return ground(folder, unequal(even_system(1, 2)), AggregateConfig(edge=Join(epochs=1), refine=Refine(epochs=2, rounds=3)))


def ground_crop_merged(folder: Path) -> World:
    """Two edges of one device each, whose models the cloud crops; exact uploads."""
    return ground(folder, even_system(2, 1), AggregateConfig(cloud=Join(method="crop_merge"), refine=Refine(epochs=2, rounds=1)))


def ground_that_only_fades(folder: Path) -> World:
    """Two edges of one device each, whose models the cloud leaves to the devices; exact uploads."""
    return ground(folder, even_system(2, 1), AggregateConfig(cloud=Join(epochs=0), refine=Refine(epochs=2, rounds=2)))


def ground(folder: Path, system: System, aggregate: AggregateConfig) -> World:
    """Nine rendered photographs of a made-up ground."""
    truth, cameras = ground_splats(), cameras_above([(x, y) for x in (-2, 0, 2) for y in (-1, 0, 1)], size_wh=(96, 72))
    (folder / "photos").mkdir()
    for view in render_views(truth, cameras):
        cv2.imwrite(str(folder / "photos" / view.name), view.image_bytes[..., ::-1])
    scene = SfmScene(
        cameras=cameras,
        points=truth.means.astype(float),
        colors=np.full((len(truth), 3), 128, np.uint8),
        observations=np.indices((len(truth), len(cameras))).reshape(2, -1).T,
        frame=Frame(kind="metric", origin_lat_lon_alt=np.zeros(3), residual_m=0.0),
    )
    photographs = PooledPhotographs(config=RunConfig(source=folder / "photos", out=folder), scene=scene, images=folder / "photos")
    return World(photographs=photographs, recipe=planned(photographs, system, DRAFT, aggregate))


def town_of_the_paper(folder: Path) -> World:
    """The paper's preset: two edges and a cloud that retrain. Eight photographs, one with a mask, uploads in 16 bits."""
    town = sample_scenes_folder() / "town"
    model = read_model(town / "known")
    write_model(folder / "known", model.without([image.name for image in model.images[8:]]))
    first = model.images[1].name
    (folder / "masks").mkdir()
    width, height = model.cameras[model.images[1].camera_id].size_wh
    mask = np.full((height, width), 255, np.uint8)
    mask[: height // 3] = 0
    cv2.imwrite(str(folder / "masks" / mask_name(first)), mask)
    result = scene_from_colmap(folder / "known", town / "images", folder / "sfm", lambda progress: None, folder / "masks")
    write_json(folder / "sfm" / "result.json", sfm_record(result, folder / "sfm"))
    photographs = PooledPhotographs(
        config=RunConfig(source=town / "images", out=folder), scene=result.scene, images=result.undistorted_folder
    )
    aggregate = with_joins(aggregate_preset("paper"), {"cloud.epochs": 2, "edge.epochs": 2}, {})
    recipe = planned(photographs, even_system(2, 2), PAPER, aggregate)
    return World(photographs=photographs, recipe=replace(recipe, upload="float16"))


COMPARED = "hamlet of two tiers"
"""The world whose versions of the scene are compared in photographs held out."""
WORLDS: dict[str, Callable[[Path], World]] = {
    "hamlet of two tiers": hamlet_of_two_tiers,
    "ground of a lone edge": ground_of_a_lone_edge,
    "ground crop-merged": ground_crop_merged,
    "ground that only fades": ground_that_only_fades,
    "town of the paper": town_of_the_paper,
}


ON_RAY = (COMPARED,)
"""Ray starts the same processes of the same folders: one recipe of two tiers is enough."""


@pytest.fixture(scope="module")
def worlds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, World]:
    return {name: world_of(tmp_path_factory.mktemp("world")) for name, world_of in WORLDS.items()}


@pytest.fixture(scope="module")
def oracle(worlds: dict[str, World]) -> dict[str, Oracle]:
    return {name: Oracle(world) for name, world in worlds.items()}


@pytest.fixture(scope="module")
def command(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[NodeTask], list[str]]]:
    with forked_workers(tmp_path_factory.mktemp("server")) as start:
        yield start


@pytest.fixture(scope="module", params=["local", "ray"])
def runs(
    request: pytest.FixtureRequest,
    worlds: dict[str, World],
    command: Callable[[NodeTask], list[str]],
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, Path]:
    """Worlds folded by an executor, all of them as one tree: the folders of the runs."""
    folder = tmp_path_factory.mktemp(request.param)
    worlds = {name: worlds[name] for name in (WORLDS if request.param == "local" else ON_RAY)}
    dealers = {name: world.dealer(folder / name) for name, world in worlds.items()}
    nodes = {f"{name}/{node.id}": (dealers[name], node) for name, world in worlds.items() for node in world.tree}

    def prepare(node: Tree) -> NodeTask | None:
        if node.id not in nodes:
            return None
        dealer, own = nodes[node.id]
        return dealer.prepare(own)

    if request.param == "local":
        executor: Executor = LocalExecutor(num_workers=2, command=command)
    else:
        executor = RayExecutor(address=request.getfixturevalue("address"), log=folder / "ray.log", command=command)
    trees = [world.tree.map_ids(f"{name}/{{}}".format) for name, world in worlds.items()]
    executor.fold(Tree(id="all", tier="cloud", children=tuple(trees)), prepare, lambda event: None)
    rounds = {name: plan_rounds(dealer, lambda event: None) for name, dealer in dealers.items()}
    for number in range(max(map(len, rounds.values()))):
        trees = {name: each[number] for name, each in rounds.items() if len(each) > number}
        fold_round(dealers, trees, executor)
        for name in trees:
            dealers[name].refined = dealers[name].refined_by(number + 1)
    compared = dealers[COMPARED]
    save_plan(compared.run / "plan.json", compared.recipe.cloud_plan, compared.recipe.edge_plans)
    progress = SimpleNamespace(listen=lambda event: None, clock=time.monotonic, manifest=SimpleNamespace(access_log=[]))
    compared.photographs.score(compared, executor, cast(Any, progress))  # type: ignore[attr-defined]
    return {name: dealer.scene_folder for name, dealer in dealers.items()}


def fold_round(dealers: dict[str, Dealer], trees: dict[str, Tree], executor: Executor) -> None:
    """A round of every world, all of them as one tree."""
    nodes = {f"{name}/{node.id}": (dealers[name], node) for name, tree in trees.items() for node in tree}

    def prepare(node: Tree) -> NodeTask | None:
        return nodes[node.id][0].prepare(nodes[node.id][1]) if node.id in nodes else None

    children = tuple(tree.map_ids(f"{name}/{{}}".format) for name, tree in trees.items())
    executor.fold(Tree(id="all", tier="cloud", children=children), prepare, lambda event: None)


def run_of(scene_folder: Path) -> Path:
    """The run whose finished scene lies in that folder."""
    return next(folder for folder in scene_folder.parents if (folder / "run.json").is_file())


def assert_same(ours: Splats | None, theirs: Splats) -> None:
    assert ours is not None
    for name, array in ours.arrays().items():
        np.testing.assert_array_equal(array, theirs.arrays()[name], err_msg=name)


def test_every_executor_makes_the_scene_of_the_fold_in_one_process(
    runs: dict[str, Path], oracle: dict[str, Oracle], tmp_path: Path
) -> None:
    for name, scene_folder in runs.items():
        (tmp_path / name).mkdir()
        assert_made_as_in_one_process(name, scene_folder, oracle[name], tmp_path / name)


def assert_made_as_in_one_process(name: str, scene_folder: Path, oracle: Oracle, tmp_path: Path) -> None:
    finished, run, made = scene_folder / "scene.ply", run_of(scene_folder), oracle.run
    assert_same(made.scene.splats, load_ply(finished))
    save_ply(tmp_path / "scene.ply", made.scene.splats)
    assert (tmp_path / "scene.ply").read_bytes() == finished.read_bytes()
    assert (finished != run / "cloud" / "scene.ply") == (name != "town of the paper"), name
    assert sorted(made.edges) == sorted(path.name for path in (run / "edges").iterdir())
    for edge, model in made.edges.items():
        folder = run / "edges" / edge
        assert_same(model.splats, load_splats(folder / "model.safetensors"))
        sends_cameras = (folder / "virtual_cameras.safetensors").is_file()
        assert sends_cameras == (len(model.cameras) > 0)
        if sends_cameras:
            again = tmp_path / edge
            again.mkdir()
            save_cameras(again / "cameras", model.cameras)
            assert (again / "cameras").read_bytes() == (folder / "virtual_cameras.safetensors").read_bytes()


def test_what_photographs_show_is_counted_in_the_first_round_alone(runs: dict[str, Path]) -> None:
    rounds = [path for run in map(run_of, runs.values()) for path in run.glob("edges/*/refine[2-9]")]
    assert rounds
    for later in rounds:
        senders = sorted(path.name for path in (later / "inbox").iterdir())
        assert sorted(path.stem for path in (later.parent / "refine" / "counted").iterdir()) == senders
        assert not (later / "counted").exists()
        assert read_json(later / "task.json")["counted_in"] == [1] * len(senders)


def test_every_executor_keeps_the_version_that_the_fold_in_one_process_keeps(
    runs: dict[str, Path], oracle: dict[str, Oracle], worlds: dict[str, World]
) -> None:
    run, made, world = run_of(runs[COMPARED]), oracle[COMPARED].run, worlds[COMPARED].photographs
    assert [*made.versions] == [REFINED, JOINED, CUT]
    assert_same(made.versions[CUT], load_ply(run / "cloud" / CUT_SCENE))
    assert_same(made.versions[JOINED], load_ply(run / "cloud" / "scene.ply"))
    cameras = world.scene.cameras.select(np.flatnonzero(held_out_mask(world.scene.cameras.names)))
    views = load_training_views(world.images, cameras.scaled(SIDE_PX))
    kept = keep_best(made, lambda splats: held_out_psnr_db(splats, views, "native"), Recorder())
    result = read_json(run / "evaluation" / "result.json")
    assert kept.choice is not None and result["version"] == kept.choice.version
    assert result["versions"] == pytest.approx(dict(kept.choice.mean_db), abs=1e-9)


def test_every_executor_decides_what_the_fold_in_one_process_decides(runs: dict[str, Path], oracle: dict[str, Oracle]) -> None:
    heard = [(name, stage) for name in runs for stage in oracle[name].recorders]
    for name, stage in heard:
        recorder, notes = oracle[name].recorders[stage], read_json(run_of(runs[name]) / stage / "notes.json")
        assert notes["warnings"] == recorder.warnings == []
        ours, theirs = (
            [(one["topic"], one["choice"], one["figure"]) for one in decisions]
            for decisions in (map(asdict, recorder.decisions), notes["decisions"])
        )
        assert ours == theirs, (name, stage)


def test_the_worlds_differ_in_how_they_are_joined(oracle: dict[str, Oracle]) -> None:
    def choices(name: str, stage: str, topic: str) -> list[str]:
        return [one.choice for one in oracle[name].recorders[stage].decisions if one.topic == topic]

    for stage in ("edges/edge-1", "cloud"):
        (retrained,) = choices("hamlet of two tiers", stage, "retraining")
        assert "steps on" in retrained, stage
    (retrained,) = choices("ground of a lone edge", "edges/edge-1", "retraining")
    assert "steps on" in retrained and choices("ground of a lone edge", "cloud", "retraining") == ["skipped"]
    assert oracle["ground crop-merged"].run.scene.summary.keys() == {"num_splats", "num_dropped"}
    for stage in ("edges/edge-1", "edges/edge-2", "cloud"):
        (retrained,) = choices("town of the paper", stage, "retraining")
        assert "steps on all Gaussians" in retrained
