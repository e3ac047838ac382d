"""A run whose devices train as one model: below the cloud it is the scene, below an edge that edge's model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.aggregate.config import AggregateConfig, Join, Refine
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.frames import Frame
from radiant_core.hierarchy.group_in_process import train_group
from radiant_core.hierarchy.groups import GroupTraining
from radiant_core.hierarchy.in_process import InProcessRun, run_in_process
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.hierarchy.refining_plan import plan_refining
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import Device, Edge, System
from radiant_core.render.rendered_view import render_views
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from radiant_core.train.config import train_preset
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats

TRUTH = ground_splats()
CAMERAS = cameras_above([(x, y) for x in (-3.0, -1.0, 1.0, 3.0) for y in (-1.0, 0.0, 1.0)])
VIEWS = TrainingViews(cameras=CAMERAS, images=tuple(view.image_bytes for view in render_views(TRUTH, CAMERAS, "native")))
SCENE = SfmScene(
    cameras=CAMERAS,
    points=TRUTH.means.astype(float),
    colors=np.full((len(TRUTH), 3), 128, np.uint8),
    observations=np.indices((len(TRUTH), len(CAMERAS))).reshape(2, -1).T,
    frame=Frame(kind="metric", origin_lat_lon_alt=np.zeros(3), residual_m=0.0),
)


def device(name: str) -> Device:
    cost = CostCurve(linear=1.0)
    return Device(id=name, init_s=CostCurve(), train_s=cost, model_bytes=cost, uplink_bytes_per_s=1e6)


def edge(name: str, x: float) -> Edge:
    devices = (device(f"{name}1"), device(f"{name}2"))
    return Edge(id=name, position=(x, 0.0), aggregate_s=CostCurve(linear=0.1), uplink_bytes_per_s=1e6, devices=devices)


@pytest.fixture(scope="module")
def recipe() -> Recipe:
    """Two edges of two devices, three photographs each."""
    system = System(edges=(edge("a", -2.0), edge("b", 2.0)))
    cloud_plan = plan_regions(CAMERAS.centers[:, :2], system)
    assert isinstance(cloud_plan, CloudPlan)
    made = Recipe(
        system=system,
        cloud_plan=cloud_plan,
        edge_plans=split_edges(CAMERAS.centers[:, :2], cloud_plan, system),
        train=replace(train_preset("draft"), num_steps=12, long_side_px=48, max_num_splats=500),
        aggregate=AggregateConfig(cloud=Join(epochs=1), edge=Join(epochs=1), refine=Refine(epochs=1, rounds=1)),
        backend="native",
        upload="float16",
    )
    assert [len(made.cameras_of(name)) for name in ("a1", "a2", "b1", "b2")] == [3] * 4
    return made


def group(root: str, *edges: str, num_steps: int = 24) -> dict[str, GroupTraining]:
    views = {edge: {f"{edge}1": 1, f"{edge}2": 1} for edge in edges}
    return {root: GroupTraining(root=root, views=views, num_steps=num_steps)}


def run_of(recipe: Recipe) -> tuple[InProcessRun, dict[str, Recorder]]:
    recorders: dict[str, Recorder] = {}
    run = run_in_process(recipe, SCENE, VIEWS, lambda stage: recorders.setdefault(stage, Recorder(stage=stage)))
    return run, recorders


def quality_db(splats: Splats | None) -> float:
    assert splats is not None
    shown = [view.image for view in render_views(splats, CAMERAS, "native")]
    return float(np.mean([psnr_db(image, photograph / 255) for image, photograph in zip(shown, VIEWS.images, strict=True)]))


def assert_same_bits(one: Splats | None, other: Splats | None) -> None:
    assert one is not None and other is not None
    for name, array in one.arrays().items():
        np.testing.assert_array_equal(array, other.arrays()[name])


def test_a_group_of_the_cloud_makes_the_scene_and_nothing_is_joined_or_refined(recipe: Recipe) -> None:
    together = replace(recipe, groups=group("cloud", "a", "b", num_steps=48))
    run, recorders = run_of(together)
    trained = train_group(together, together.groups["cloud"], SCENE, VIEWS)
    assert_same_bits(run.scene.splats, trained.result.splats)
    assert list(recorders) == ["devices/a1", "devices/a2", "devices/b1", "devices/b2", "cloud"]
    assert {decision.stage for decision in recorders["cloud"].decisions} == {"cloud"}
    assert {"light of the devices", "densification"} <= {decision.topic for decision in recorders["cloud"].decisions}
    assert not run.refinements and list(run.versions.values()) == [run.scene.splats] and run.joined is run.scene
    moves = [*run.scene.corrections.values(), *(move for each in run.edges.values() for move in each.corrections.values())]
    assert len(moves) == 2 + 4 and all(move is not None and move.scale == 1 and not move.translation.any() for move in moves)
    assert run.groups["cloud"].result.num_steps == 12 and not run.scene.refused
    alone, _ = run_of(recipe)
    assert quality_db(run.scene.splats) > quality_db(alone.scene.splats)


def test_groups_of_edges_are_joined_and_refined_as_any_edges(recipe: Recipe) -> None:
    per_edge = replace(recipe, groups=group("edges/a", "a") | group("edges/b", "b"))
    run, recorders = run_of(per_edge)
    again, _ = run_of(per_edge)
    assert_same_bits(run.scene.splats, again.scene.splats)
    stages = ["devices/a1", "devices/a2", "edges/a", "devices/b1", "devices/b2", "edges/b", "cloud"]
    assert list(recorders)[:7] == stages and [*run.refinements] == [
        f"{node}/refine" for node in ("devices/a1", "devices/a2", "edges/a", "devices/b1", "devices/b2", "edges/b")
    ]
    for name, model in run.edges.items():
        assert model.splats is not None and len(model.splats) == len(run.groups[f"edges/{name}"].result.splats)
        assert len(model.cameras) == 6 and model.summary["num_models"] == 2 and list(model.corrections) == [f"{name}1", f"{name}2"]
        # Virtual cameras are near those of photographs, but none of them.
        distances_m = np.linalg.norm(model.cameras.centers[:, None] - CAMERAS.centers, axis=2).min(axis=1)
        assert distances_m.min() > 0 and distances_m.max() < 3


def test_one_edge_may_train_a_model_where_another_joins(recipe: Recipe) -> None:
    mixed, recorders = run_of(replace(recipe, groups=group("edges/b", "b")))
    plain, _ = run_of(recipe)
    assert list(mixed.groups) == ["edges/b"] and len(recorders["edges/a"].decisions) > 0
    assert_same_bits(mixed.edges["a"].splats, plain.edges["a"].splats)


def test_devices_that_all_trained_one_model_do_not_refine_it(recipe: Recipe) -> None:
    present = {"a": ["a1", "a2"]}
    together = replace(recipe, groups=group("edges/a", "a"))
    assert plan_refining(recipe, present, 300).devices == {"a": ("a1", "a2")}
    planned = plan_refining(together, present, 300)
    assert not planned.devices and "devices that train one model" in planned.decisions[0].reason
    assert plan_refining(together, {**present, "b": ["b1"]}, 300).devices == {"a": ("a1", "a2"), "b": ("b1",)}


def test_a_group_without_one_of_its_devices_is_refused(recipe: Recipe) -> None:
    lacking = GroupTraining(root="cloud", views={"a": {"a1": 1, "a2": 1}, "b": {"b1": 1}}, num_steps=24)
    with pytest.raises(BadInput, match="expected all that have photographs: a1, a2, b1, b2"):
        run_of(replace(recipe, groups={"cloud": lacking}))


def test_masks_of_any_keys_give_one_model_and_say_what_two_devices_know(recipe: Recipe) -> None:
    plan = replace(group("cloud", "a", "b")["cloud"], masked=True)
    recorder = Recorder(stage="cloud")
    first = train_group(recipe, plan, SCENE, VIEWS, lambda stage: recorder if stage == "cloud" else Recorder(stage=stage))
    again = train_group(recipe, plan, SCENE, VIEWS)
    for name, array in first.result.splats.arrays().items():
        np.testing.assert_array_equal(array, again.result.splats.arrays()[name])
    (said,) = [one for one in recorder.decisions if one.topic == "masks of gradients"]
    assert said.figure == 2 and "either of two devices needs only the sum" in said.reason
    open_run = train_group(recipe, replace(plan, masked=False), SCENE, VIEWS)
    assert first.cost.bytes_up["a1"][0] > 2 * open_run.cost.bytes_up["a1"][0]


def test_masks_of_one_device_at_an_edge_are_refused() -> None:
    with pytest.raises(BadInput, match="masks hide nothing of the one device of edge b"):
        GroupTraining(root="cloud", views={"a": {"a1": 1, "a2": 1}, "b": {"b1": 1}}, num_steps=24, masked=True)
