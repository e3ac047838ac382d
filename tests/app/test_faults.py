"""Devices that are late or lost: who is given up, who gets their photographs, and what a resumed run makes of it."""

from __future__ import annotations

import sys
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from radiant_app.config.run_config import ExecutionOptions, PlanOptions, RunConfig
from radiant_app.events import Event, StageDone, StageStarted, Warned
from radiant_app.executors.fold import RetryPolicy
from radiant_app.executors.local import LocalExecutor
from radiant_app.executors.protocol import NodeTask
from radiant_app.files.system_file import even_system
from radiant_app.run.captured import Captured
from radiant_app.run.dealing import Dealer
from radiant_app.run.on_devices import DevicePhotographs
from radiant_app.run.pooled import PooledPhotographs
from radiant_app.run.promises import promises_of
from radiant_app.run.reassignment import Reassignment, load_replan, plan_key
from radiant_app.run.source import Plan
from radiant_app.run.time_left import LEAST_S, OVERDUE_FACTOR, TimeLeftListener
from radiant_app.run.uncaptured import deal_uncaptured
from radiant_core.aggregate.config import aggregate_preset
from radiant_core.aggregate.tree import Tree, tree_of_plan
from radiant_core.frames import Frame, geodetic_from_enu
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.io.records import load_plan, save_plan
from radiant_core.numerics import FloatArray
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.waypoints import Waypoints
from radiant_core.scene import SfmScene
from radiant_core.train.config import train_preset
from radiant_core.waypoints.reader import read_waypoints
from tests.core.scenes import cameras_above


def planned(run: Path) -> tuple[Dealer, Tree]:
    """Two edges of two devices over 40 photographs, beside 6 that are held out."""
    scene = SfmScene(
        cameras=cameras_above([tuple(xy) for xy in np.random.default_rng(0).uniform(-20, 20, (46, 2)).round(2).tolist()]),
        points=np.zeros((0, 3)),
        colors=np.zeros((0, 3), np.uint8),
        observations=np.zeros((0, 2), np.int64),
        frame=Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3)),
    )
    photographs = PooledPhotographs(config=RunConfig(source=run, out=run), scene=scene, images=run)
    positions = photographs.training.cameras.centers[:, :2]
    system = place_edges(even_system(2, 2), positions, None, 0)
    cloud = plan_regions(positions, system)
    assert isinstance(cloud, CloudPlan)
    edges = split_edges(positions, cloud, system)
    save_plan(run / "plan.json", cloud, edges)
    train, aggregate = train_preset("draft"), aggregate_preset("default")
    recipe = Recipe(system=system, cloud_plan=cloud, edge_plans=edges, train=train, aggregate=aggregate, backend="native")
    return Dealer(run=run, recipe=recipe, photographs=photographs), tree_of_plan(cloud, edges)


def positions_of(dealer: Dealer) -> FloatArray:
    positions = dealer.photographs.positions
    assert positions is not None
    return positions


def plan_of(dealer: Dealer) -> Plan:
    return Plan(system=dealer.recipe.system, cloud=dealer.recipe.cloud_plan, edges=dealer.recipe.edge_plans)


def cameras_by_device(edges: Collection[EdgePlan]) -> dict[str, set[int]]:
    return {device: set(plan.cameras_of(device).tolist()) for plan in edges for device in plan.device_ids}


def test_a_lost_devices_photographs_go_to_those_that_have_not_begun_and_a_resumed_run_knows(tmp_path: Path) -> None:
    dealer, tree = planned(tmp_path)
    first = plan_of(dealer)
    lost, other, *waiting = [node for node in tree if node.tier == "device"]
    before = cameras_by_device(dealer.recipe.edge_plans)
    events: list[Event] = []
    reassignment = Reassignment(
        dealer=dealer, positions=positions_of(dealer), tree=tree, first_plan_key=plan_key(first.cloud, first.edges), listen=events.append
    )
    # As the fold says it: who is lost neither runs nor is done.
    reassignment(lost, {other.id})
    after = cameras_by_device(dealer.recipe.edge_plans)
    assert after[lost.name] == set() and after[other.name] == before[other.name]
    assert set().union(*(after[node.name] for node in waiting)) == set(range(40)) - before[other.name]
    assert sum(map(len, after.values())) == 40
    assert any(
        isinstance(event, Warned) and f"{len(before[lost.name])} photographs of {lost.name} go to" in event.message for event in events
    )
    save_plan(tmp_path / "plan.json", first.cloud, first.edges)
    assert cameras_by_device(load_replan(tmp_path, first).edges) == after == cameras_by_device(load_plan(tmp_path / "plan.json")[1])
    assert load_replan(tmp_path, plan_of(dealer)).edges is dealer.recipe.edge_plans, "another plan is left as it is"


def test_a_device_that_cannot_score_loses_no_photographs(tmp_path: Path) -> None:
    dealer, tree = planned(tmp_path)
    device = next(node for node in tree if node.tier == "device")
    events: list[Event] = []
    Reassignment(dealer=dealer, positions=positions_of(dealer), tree=tree, first_plan_key="", listen=events.append)(
        Tree(id=f"{device.id}/score", tier="device"), set()
    )
    assert events == []


def test_where_every_other_device_has_begun_the_plan_stays_and_the_loss_is_named(tmp_path: Path) -> None:
    dealer, tree = planned(tmp_path)
    plan, (lost, *_) = dealer.recipe.cloud_plan, [node for node in tree if node.tier == "device"]
    events: list[Event] = []
    Reassignment(dealer=dealer, positions=positions_of(dealer), tree=tree, first_plan_key="", listen=events.append)(
        lost, {node.id for node in tree}
    )
    assert dealer.recipe.cloud_plan is plan and not (tmp_path / "replanned").exists()
    (warning,) = events
    assert isinstance(warning, Warned) and "are in no model: every other device has begun or is full; --resume" in warning.message
    assert set(dealer.missing_devices()) == set(cameras_by_device(dealer.recipe.edge_plans)), "nothing of this run is done"


def test_photographs_in_one_folder_follow_the_new_plan_where_devices_fetch_them(tmp_path: Path) -> None:
    pooled, tree = planned(tmp_path)
    assert isinstance(pooled.photographs, PooledPhotographs)
    cameras, training = pooled.photographs.scene.cameras, pooled.photographs.training.cameras
    captured = Captured(names=cameras.names, owners=(None,) * len(cameras), positions=cameras.centers, origin=None)
    config = RunConfig(source=tmp_path, out=tmp_path, frames="known")
    field = DevicePhotographs(config=config, captured=captured, folders=None, poses=None)
    dealer = Dealer(run=tmp_path, recipe=pooled.recipe, photographs=field)
    lost, other, *_ = [node for node in tree if node.tier == "device"]
    kept = field.shares[other.name]
    Reassignment(dealer=dealer, positions=positions_of(dealer), tree=tree, first_plan_key="", listen=lambda event: None)(lost, {other.id})
    assert lost.name not in field.shares and field.shares[other.name] == kept
    assert sorted(name for share in field.shares.values() for name in share.names) == sorted(training.names)


def test_planned_positions_of_a_device_without_photographs_are_dealt_to_the_others_for_a_new_flight(tmp_path: Path) -> None:
    positions = np.random.default_rng(0).uniform(-200, 200, (60, 2))
    waypoints = Waypoints(
        names=tuple(f"w{row}" for row in range(60)),
        lat_lon_alt=geodetic_from_enu(np.column_stack([positions, np.full(60, 50.0)]), np.array([47.0, 8.0, 400.0])),
    )
    positions = waypoints.positions_m[:, :2]
    system = place_edges(even_system(2, 2), positions, None, 0)
    cloud = plan_regions(positions, system)
    assert isinstance(cloud, CloudPlan)
    plan = (cloud, split_edges(positions, cloud, system), waypoints)
    ids = [device.id for device in system.devices]
    assert deal_uncaptured(tmp_path, plan, system, ids) is None
    told = deal_uncaptured(tmp_path, plan, system, ids[1:])
    lost = cameras_by_device(plan[1])[ids[0]]
    assert told is not None and told.startswith(f"{len(lost)} planned positions of {ids[0]} were not captured")
    listed = {name: read_waypoints(tmp_path / "uncaptured" / f"{name}.csv").waypoints.names for name in ids[1:] if name in told}
    assert sorted(name for names in listed.values() for name in names) == sorted(f"w{row}" for row in lost)
    _, after = load_plan(tmp_path / "uncaptured" / "plan.json")
    before = cameras_by_device(plan[1])
    assert all(before[name] <= rows for name, rows in cameras_by_device(after).items() if name != ids[0]), (
        "who has captured keeps what it has"
    )
    assert deal_uncaptured(tmp_path, plan, system, ids) is None and not (tmp_path / "uncaptured").exists()


def test_a_node_is_late_by_the_plan_only_once_another_of_its_tier_was_measured(tmp_path: Path) -> None:
    dealer, tree = planned(tmp_path)
    now_s = 0.0
    told: list[Event] = []
    watch = TimeLeftListener(
        listen=told.append,
        system=dealer.recipe.system,
        edge_plans=dealer.recipe.edge_plans,
        num_workers=4,
        emulated=False,
        clock=lambda: now_s,
        deadline_factor=10.0,
    )
    first, second, *_ = [node.id for node in tree if node.tier == "device"]
    watch(StageStarted(stage=first))
    watch(StageStarted(stage=second))
    assert watch.overdue_reason(second, 1e9) is None and watch.timeout_reason(second, 1e9) is None
    now_s = 100.0
    watch(StageDone(stage=first, seconds=100.0))
    assert watch.overdue_reason(second, LEAST_S) is None and watch.timeout_reason(second, 100.0 * OVERDUE_FACTOR) is None
    late = watch.overdue_reason(second, 100.0 * OVERDUE_FACTOR * 1.5)
    assert late is not None and "says 1" in late and watch.timeout_reason(second, 1500.0) is not None
    assert watch.overdue_reason("edges/a", 1e9) is None, "no edge was measured"


class Impatient:
    """Waits for nobody."""

    def overdue_reason(self, node_id: str, ran_s: float) -> str | None:
        return "it is slow"

    def timeout_reason(self, node_id: str, ran_s: float) -> str | None:
        return "it is too slow" if node_id == "devices/2" else None

    def exclude_pause(self, node_ids: Collection[str], seconds: float) -> None:
        """It makes no difference."""


def test_who_is_too_late_is_stopped_and_the_rest_goes_on(tmp_path: Path) -> None:
    devices = tuple(Tree(id=f"devices/{number}", tier="device") for number in "12")
    tree = Tree(id="cloud", tier="cloud", children=(Tree(id="edges/a", tier="edge", children=devices),))
    seal = "from pathlib import Path\nfrom radiant_core.io.run_store import seal\nseal(Path('.'), 'key', [])"

    def command(task: NodeTask) -> list[str]:
        work = "import time; time.sleep(60)" if task.stage == "devices/2" else seal
        return [sys.executable, "-c", f"import os; os.chdir({str(task.folder)!r})\n{work}"]

    def prepare(node: Tree) -> NodeTask:
        (tmp_path / node.id).mkdir(parents=True, exist_ok=True)
        return NodeTask(kind=node.tier, stage=node.id, folder=tmp_path / node.id, key="key")

    events: list[Event] = []
    lost: list[tuple[str, frozenset[str]]] = []
    retry_policy = RetryPolicy(
        may_fail=lambda node, error: node.tier == "device",
        max_attempts=3,
        deadlines=Impatient(),
        on_given_up=lambda node, begun: lost.append((node.id, frozenset(begun))),
    )
    times = LocalExecutor(num_workers=2, command=command, retry_policy=retry_policy).fold(tree, prepare, events.append)
    assert set(times) == {node.id for node in tree} and [node_id for node_id, _ in lost] == ["devices/2"]
    assert "devices/1" in lost[0][1]
    assert Warned(stage="devices/2", message="it is too slow, and was given up.") in events
    assert [event.stage for event in events if isinstance(event, StageDone)] == ["devices/1", "edges/a", "cloud"]


def test_a_cluster_keeps_no_secret_of_a_device_and_the_report_says_so(tmp_path: Path) -> None:
    field = RunConfig(source=tmp_path, out=tmp_path, frames="gps")
    cluster = RunConfig(source=tmp_path, out=tmp_path, frames="gps", execution=ExecutionOptions(executor="ray", address="local"))
    shared = RunConfig(source=tmp_path, out=tmp_path)
    told = replace(field, plan=PlanOptions(raster_cell_m=0.0))

    def holds(config: RunConfig, *, pooled: bool) -> list[bool]:
        return [row["holds"] for row in promises_of(config, pooled=pooled)]

    assert holds(field, pooled=False) == [True, True, True, True]
    assert holds(field, pooled=True) == [True, False, True, True], "whoever made the one folder had all photographs"
    assert holds(told, pooled=False) == [True, True, False, True], "whoever plans has all positions"
    assert holds(cluster, pooled=False) == holds(shared, pooled=True) == [True, False, False, True]
