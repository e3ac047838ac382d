"""End-to-end latency of `radiant bench paper`: what is emulated obeys speeds, uplinks and waiting, every time says what it is, and
a second call makes nothing anew."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.methods import cells
from benchmarks.methods.arms import Arms, load_arms
from benchmarks.methods.bench import METHODS, join_at_server
from benchmarks.methods.cells import Layout, bench_settings
from benchmarks.methods.emulated_latency import EmulatedLatency, NodeClock, NodeWork, emulate_server, emulate_tree, joining_s
from benchmarks.paper.latency import Costs, imbalance, latency_part
from radiant_core.aggregate.tree import refined_at
from radiant_core.errors import BadInput
from radiant_core.hierarchy.refining_plan import choose_rounds
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.system import Device, Edge, System

NOTHING = CostCurve()
WORKS = (
    NodeWork(stage="devices/a", cpu_s=2.0, sent_bytes=1000),
    NodeWork(stage="devices/b", cpu_s=3.0, sent_bytes=4000),
    NodeWork(stage="devices/c", cpu_s=1.0, sent_bytes=500),
    NodeWork(stage="edges/ab", cpu_s=4.0, sent_bytes=6000),
    NodeWork(stage="edges/c", cpu_s=0.5, sent_bytes=500),
    NodeWork(stage="cloud", cpu_s=7.0),
)

pytestmark = pytest.mark.usefixtures("short_rounds")


def device(name: str, speed: float | None, bytes_per_s: float) -> Device:
    return Device(id=name, init_s=NOTHING, train_s=NOTHING, model_bytes=NOTHING, uplink_bytes_per_s=bytes_per_s, speed=speed)


def edge(name: str, devices: tuple[Device, ...], speed: float = 1.0, bytes_per_s: float = 2000.0) -> Edge:
    return Edge(id=name, position=None, aggregate_s=NOTHING, uplink_bytes_per_s=bytes_per_s, devices=devices, speed=speed)


def system(speeds: tuple[float | None, float] = (1.0, 0.5), bytes_per_s: float = 1000.0) -> System:
    pair = (device("a", speeds[0], bytes_per_s), device("b", speeds[1], bytes_per_s))
    return System(edges=(edge("ab", pair, speed=0.8), edge("c", (device("c", 1.0, bytes_per_s),)), edge("idle", (device("d", 1.0, 1.0),))))


def test_a_tree_waits_for_its_slowest_device_and_edge() -> None:
    # b: 3 / 0.5 + 4000 / 1000 = 10; ab: 10 + 4 / 0.8 + 6000 / 2000 = 18; c: 1 + 0.5 + 0.5 + 0.25.
    played = emulate_tree(system(), WORKS)
    assert played == EmulatedLatency(edge_s=(18.0, 2.25, 0.0), devices_s=10.0, joined_s=25.0, scene_s=25.0)
    assert imbalance(played.edge_s) == pytest.approx((18 - 6.75) / 6.75)


def test_refining_adds_its_slowest_edge_and_the_clouds_end() -> None:
    # b: 1 / 0.5 + 3000 / 1000 = 5; ab: 5 + 0.4 / 0.8 + 1000 / 2000 = 6; c: 0.5 + 1 + 0.25 + 0.25; the cloud: 2.
    refining = (
        NodeWork(stage="devices/b/refine", cpu_s=1.0, sent_bytes=3000),
        NodeWork(stage="edges/ab/refine", cpu_s=0.4, sent_bytes=1000),
        NodeWork(stage="devices/c/refine", cpu_s=0.5, sent_bytes=1000),
        NodeWork(stage="edges/c/refine", cpu_s=0.25, sent_bytes=500),
        NodeWork(stage="cloud/refine", cpu_s=2.0),
    )
    played = emulate_tree(system(), [*WORKS, *refining])
    assert played == EmulatedLatency(edge_s=(18.0, 2.25, 0.0), devices_s=10.0, joined_s=25.0, scene_s=33.0)
    # b: 0.5 / 0.5 + 1000 / 1000 = 2; a: 1; c has nothing to compare in.
    compared = (NodeWork(stage="devices/a/score", cpu_s=1.0), NodeWork(stage="devices/b/score", cpu_s=0.5, sent_bytes=1000))
    assert emulate_tree(system(), [*WORKS, *refining, *compared]) == replace(played, scene_s=35.0)
    # Each on a core of its own, without links: 4 + 7 to join, 1 + 0.4 + 2 to refine, 1 to compare.
    assert joining_s([*WORKS, *refining, *compared]) == pytest.approx(4 + 7 + 1 + 0.4 + 2 + 1)
    assert joining_s(WORKS) == 11 and joining_s(WORKS[:3]) == 0
    # A second round: c: 2 + 0.5 / 1, the cloud: 1.
    second = (NodeWork(stage="devices/c/refine2", cpu_s=2.0, sent_bytes=500), NodeWork(stage="cloud/refine2", cpu_s=1.0))
    assert emulate_tree(system(), [*WORKS, *refining, *second]) == replace(played, scene_s=36.5)


@pytest.mark.parametrize("factor", [0.25, 0.5])
def test_what_is_emulated_obeys_speed_and_bandwidth(factor: float) -> None:
    """Of b, which its edge waits for, 6 s are work and 4 s sending; of the rest nothing changes."""
    usual = emulate_tree(system(), WORKS)
    slower = emulate_tree(system(speeds=(1.0, 0.5 * factor)), WORKS)
    assert slower.devices_s - usual.devices_s == pytest.approx(6 / factor - 6) == pytest.approx(slower.scene_s - usual.scene_s)
    thinner = emulate_tree(system(bytes_per_s=1000 * factor), WORKS)
    assert thinner.devices_s - usual.devices_s == pytest.approx(4 / factor - 4) == pytest.approx(thinner.scene_s - usual.scene_s)
    longer = emulate_tree(system(), [replace(work, cpu_s=work.cpu_s / factor, sent_bytes=int(work.sent_bytes / factor)) for work in WORKS])
    assert longer.scene_s == pytest.approx(usual.scene_s / factor), "twice the work and bytes take twice as long"
    with pytest.raises(BadInput, match="'a' has no speed to emulate"):
        emulate_tree(system(speeds=(None, 0.5)), WORKS)


def test_a_server_takes_in_one_client_after_another_and_waits_for_none_that_it_refused() -> None:
    merges = {name: NodeWork(stage=f"cloud/{name}", cpu_s=cpu_s) for name, cpu_s in {"a": 0.0, "b": 5.0, "c": 2.0}.items()}
    arrivals_s = {"a": 3.0, "b": 10.0, "c": 1.5}
    for names in ("abc", "acb", "ac", "ca", "a"):
        now_s = 0.0
        for name in names:
            now_s = max(now_s, arrivals_s[name]) + merges[name].cpu_s
        played = emulate_server(system(), [*WORKS[:3], *(merges[name] for name in names)])
        assert played == EmulatedLatency(edge_s=(), devices_s=max(arrivals_s[name] for name in names[:2]), joined_s=now_s, scene_s=now_s)


def test_waiting_is_no_cpu_time() -> None:
    clock = NodeClock()
    clock.reporter_of("sleeps")
    time.sleep(0.4)
    assert clock.reporter_of("works").stage == "works"
    ends_s = time.process_time() + 0.1
    while time.process_time() < ends_s:
        pass
    seconds = clock.seconds()
    assert list(seconds) == ["sleeps", "works"] and seconds["sleeps"] < 0.1 <= seconds["works"]


def test_costs_are_of_a_machine_of_speed_one() -> None:
    costs = Costs(train_s=CostCurve(constant=1, linear=2), model_bytes=CostCurve(linear=10), aggregate_s=CostCurve(linear=3))
    made = costs.of(system())
    assert [float(each.train_s(4)) for each in made.devices] == [9, 18, 9, 9]
    assert [float(each.model_bytes(4)) for each in made.devices] == [40] * 4
    assert [edge.aggregation_s(4, 2) for edge in made.edges] == [15, 12, 12]


@pytest.fixture
def arms_of(hamlet_scene: Path, paper_models: Path) -> Callable[[], Arms]:
    """As a call of the benchmark begins."""
    return lambda: load_arms(hamlet_scene, paper_models, Layout(num_edges=2, num_devices=1), bench_settings(48, 8))


def test_every_time_is_marked_and_nothing_is_made_twice(arms_of: Callable[[], Arms], monkeypatch: pytest.MonkeyPatch) -> None:
    part = latency_part(arms_of(), [0], True)
    header, _, *lines = [line for line in part.text.splitlines() if line.startswith("|")]
    times = [title.strip() for title in header.split("|") if " s" in title or "imbalance" in title]
    assert len(times) == 7 and all(title.rsplit(", ")[-1] in ("simulated", "emulated", "measured") for title in times)
    assert [line.split("|")[1].strip() for line in lines] == ["exact plan", "even plan"]
    rows = {row["method"]: row for row in part.figures["latency"]}
    for row in part.figures["rows"]:
        own = rows[row["arm"]]
        assert own["measured_cpu_s"] == pytest.approx(sum(node["cpu_s"] for node in row["nodes"]))
        assert sum(own["photographs"]) == 10 and own["psnr_db"] == pytest.approx(np.mean(row["psnr_db"]))
        stages = [node["stage"] for node in row["nodes"]]
        assert stages[-1].split("/")[0] == "cloud" and len(stages) == len(set(stages))
        slowest_s = max(node["cpu_s"] for node in row["nodes"] if node["stage"].count("/") == 1 and node["stage"].startswith("devices/"))
        assert 0 < own["emulated_devices_s"] < own["emulated_edges_s"] < own["emulated_joined_s"] < own["emulated_scene_s"]
        # The slowest device need not be of the edge that is last.
        assert slowest_s < own["emulated_scene_s"]
    assert rows["even plan"]["photographs"] == (2, 2, 2, 2, 2)
    assert part.pictures["latency.png"].std() > 0

    def made_anew(*args: object) -> None:
        raise AssertionError("a training or a join was made anew")

    monkeypatch.setattr(cells, "prepare_training", made_anew)
    monkeypatch.setattr("benchmarks.methods.bench.run_in_process", made_anew)
    again = latency_part(arms_of(), [0], True)
    assert again.text == part.text and again.figures == part.figures


def test_the_work_of_a_server_is_told_client_by_client(arms_of: Callable[[], Arms]) -> None:
    arms = arms_of()
    cell = arms.cell(arms.layout)
    made = join_at_server(cell, cell.recipe)
    stages = [node.stage for node in made.nodes]
    assert stages == ["devices/e0d0", "devices/e1d0", "cloud/e0d0", "cloud/e1d0"]
    assert made.nodes[2].cpu_s == 0 and made.nodes[3].cpu_s == pytest.approx(made.cpu_s)
    trained = cell.devices
    assert [node.cpu_s for node in made.nodes[:2]] == [trained[name].summary["cpu_s"] for name in ("e0d0", "e1d0")]
    joined = METHODS["ours"].make(cell, cell.recipe)
    nodes = ["devices/e0d0", "devices/e1d0", "edges/e0", "edges/e1"]
    owners, numbers = ("devices/e0d0", "edges/e0", "devices/e1d0", "edges/e1"), range(1, choose_rounds(cell.recipe) + 1)
    refining, averaged = [refined_at(owner, n) for n in numbers for owner in owners], [refined_at("cloud", n) for n in numbers]
    compared = [node.stage for node in joined.nodes if node.stage.endswith("/score")]
    assert compared and {*compared} <= {"devices/e0d0/score", "devices/e1d0/score"}
    assert [node.stage for node in joined.nodes] == [*nodes, *refining, *compared, "cloud", *averaged]
    assert [node.sent_bytes for node in joined.nodes[:2]] == [node.sent_bytes for node in made.nodes[:2]]
    assert sum(node.cpu_s for node in joined.nodes[2:] if node.stage not in compared) <= joined.cpu_s
