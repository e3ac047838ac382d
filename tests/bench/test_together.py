"""Devices that train as one model in `radiant bench methods`: views by speeds, times over links, the arms, how they scale."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.methods.arms import load_arms
from benchmarks.methods.bench import METHODS, methods_table
from benchmarks.methods.cells import Layout, bench_settings
from benchmarks.methods.emulated_latency import NodeWork
from benchmarks.methods.group_latency import LINKS, GroupWork, Link, group_s, scene_times
from benchmarks.methods.scaling import Reached, ScalingBench, bench_together, seconds_to
from benchmarks.methods.together import grouped, views_of_speeds
from benchmarks.options import BenchOptions
from benchmarks.runner import run_bench
from radiant_core.errors import BadInput

LINK = Link(bits_per_s=8000.0, latency_s=0.01)
"""1,000 bytes a second."""
WORK = GroupWork(
    edges={"e0": ("e0d0", "e0d1"), "e1": ("e1d0",)},
    has_relays=True,
    overlaps=False,
    prepare_s={"e0d0": 2.0, "e0d1": 1.0, "e1d0": 1.0},
    begin_s=0.5,
    start_bytes={"e0d0": 100, "e0d1": 200, "e1d0": 100},
    initial_bytes=1000,
    contribute_s={"e0d0": np.array([1.0, 2.0]), "e0d1": np.array([0.9, 0.6]), "e1d0": np.array([1.0, 5.0])},
    sum_s={"e0": np.array([0.2, 0.2]), "e1": np.array([0.1, 0.1]), "root": np.array([0.3, 0.4])},
    take_s=np.array([0.3, 0.3]),
    bytes_up={name: np.array([100.0, 200.0]) for name in ("e0d0", "e0d1", "e1d0")}
    | {name: np.array([300.0, 300.0]) for name in ("e0", "e1")},
    bytes_down=np.array([400.0, 500.0]),
)
SPEEDS = {"e0d1": 0.5}


def test_a_step_waits_for_its_slowest_edge_and_travels_twice_up_and_down() -> None:
    # Before: e0d0 2 + 0.11 = 2.11 < e0d1 1/0.5 + 0.21 = 2.21; the edge passes on 0.3 + 0.01; the root 0.5; down 2 × 1.01.
    before_s = 2.21 + 0.31 + 0.5 + 2.02
    # Step 1: e0d1 sends at 0.9/0.5; e0 1.8 + 0.11 + 0.2 + 0.31 = 2.42; e1 1 + 0.11 + 0.1 + 0.31; the root 2.72; down 3.54.
    # Step 2: e1d0 takes until 3.84 and sends at 8.84; e1 8.84 + 0.21 + 0.1 + 0.31 = 9.46; the root 9.86, which takes until 10.16.
    assert group_s(WORK, SPEEDS, LINK) == pytest.approx(before_s + 10.16)
    # Nobody waits for step 1: e1d0 sends at 6; e1 6.62; the root 7.02, which takes until 7.32.
    assert group_s(replace(WORK, overlaps=True), SPEEDS, LINK) == pytest.approx(before_s + 7.32)
    assert group_s(replace(WORK, overlaps=True, edits_every=2), SPEEDS, LINK) == pytest.approx(before_s + 7.32)
    # Step 1 moves rows: all wait for it.
    assert group_s(replace(WORK, overlaps=True, edits_every=1), SPEEDS, LINK) == pytest.approx(before_s + 10.16)


def test_without_relays_devices_send_to_their_edge_alone() -> None:
    alone = replace(WORK, has_relays=False, edges={"e0": ("e0d0", "e0d1")}, sum_s={"root": WORK.sum_s["root"]})
    # The edge sums at half the speed. Before: 2.21 + 0.5/0.5 + 1.01. Step 1: 1.91, the root 2.51, down 2.92.
    # Step 2: e0d0 takes until 3.22, sends at 5.22, there 5.43; the root 6.23, which takes until 6.83.
    assert group_s(alone, SPEEDS | {"e0": 0.5}, LINK) == pytest.approx(4.22 + 6.83)


@pytest.mark.parametrize(("way_s", "period_s"), [(0.2, 0.5), (0.5, 0.5), (1.5, 1.0)])
def test_a_step_that_overlaps_takes_its_computing_or_half_of_its_round(way_s: float, period_s: float) -> None:
    """Two steps are on their way at most: one device, 0.4 s to contribute and 0.1 s to take."""

    def work(num_steps: int) -> GroupWork:
        every = np.ones(num_steps)
        return GroupWork(
            edges={"e": ("d",)},
            has_relays=False,
            overlaps=True,
            prepare_s={"d": 0.0},
            begin_s=0.0,
            start_bytes={},
            initial_bytes=0,
            contribute_s={"d": 0.4 * every},
            sum_s={"root": 0 * every},
            take_s=0.1 * every,
            bytes_up={"d": 0 * every},
            bytes_down=0 * every,
        )

    link = Link(bits_per_s=1e9, latency_s=way_s / 2)
    rise_s = (group_s(work(220), {}, link) - group_s(work(20), {}, link)) / 200
    assert rise_s == pytest.approx(period_s)


def test_an_edge_that_trained_a_model_sends_it_when_its_group_is_done() -> None:
    system = Layout(num_edges=2, num_devices=2).system((1.0, 0.5))
    work = replace(WORK, has_relays=False, edges={"e0": ("e0d0", "e0d1")}, sum_s={"root": WORK.sum_s["root"]})
    nodes = [
        NodeWork(stage="edges/e0", cpu_s=0.0, sent_bytes=2000),
        NodeWork(stage="devices/e1d1", cpu_s=2.0, sent_bytes=1000),
        NodeWork(stage="edges/e1", cpu_s=0.5, sent_bytes=1000),
        NodeWork(stage="cloud", cpu_s=3.0),
    ]
    (time,) = scene_times(system, nodes, {"edges/e0": work}, [LINK])
    # e1: 2 / 0.5 + 1 + 0.5 + 1 = 6.5; e0's group is done later.
    trained_s = group_s(work, {"e0d1": 0.5}, LINK)
    assert trained_s + 2 > 6.5 and time.scene_s == pytest.approx(trained_s + 2 + 3)
    assert scene_times(system, [], {}) == ()
    assert [time.link for time in scene_times(system, nodes, {"edges/e0": work})] == ["20 Mbit/s", "100 Mbit/s", "1 Gbit/s"]


def test_faster_devices_give_more_views() -> None:
    assert views_of_speeds([1.0, 0.6]) == [2, 1] and views_of_speeds([1.0, 0.6, 1.0, 0.6]) == [2, 1, 2, 1]
    assert views_of_speeds([0.7] * 5) == [1] * 5 and views_of_speeds([0.3]) == [1]
    for seed in range(20):
        speeds = np.random.default_rng(seed).uniform(0.2, 1.0, 6).tolist()
        views = views_of_speeds(speeds)
        assert min(views) >= 1 and 6 <= sum(views) <= 12
        slowest = max(count / speed for count, speed in zip(views, speeds, strict=True))
        assert slowest <= max(1 / min(speeds), 1.5 * sum(views) / sum(speeds)), "no slower than the slowest device's one view"


def test_both_arms_make_a_scene_and_say_when_it_is_done(hamlet_scene: Path, tmp_path: Path, short_rounds: None) -> None:
    del short_rounds
    arms = load_arms(hamlet_scene, tmp_path, Layout(num_edges=2, num_devices=1), bench_settings(48, 12))
    rows = [arms.row(arms.first, METHODS[name]) for name in ("together", "together per edge", "ours")]
    for row in rows:
        assert [time.link for time in row.times] == [str(link) for link in LINKS] and row.num_gaussians > 100
        seconds = [time.scene_s for time in row.times]
        assert seconds[0] > seconds[1] > seconds[2] > 0
    assert not rows[0].nodes and {"edges/e0", "edges/e1", "cloud"} <= {node.stage for node in rows[1].nodes}
    assert rows[0].training_px > 0 and rows == [arms.row(arms.first, METHODS[row.arm]) for row in rows]
    table = methods_table([arms.row(arms.first, METHODS["centralised"]), *rows])
    assert f"| {rows[0].times[2].scene_s:.1f} |" in table and "scene s at 20 Mbit/s" in table


def test_a_group_shows_as_many_views_as_its_devices_would(hamlet_scene: Path, tmp_path: Path) -> None:
    arms = load_arms(hamlet_scene, tmp_path, Layout(num_edges=2, num_devices=1), bench_settings(48, 12))
    recipe = arms.first.recipe
    own = {device.id: recipe.training_of(device.id).num_steps for device in recipe.system.devices}
    assert grouped(recipe, "cloud").groups["cloud"].num_steps == sum(own.values())
    per_edge = grouped(recipe, "edges").groups
    assert {root: plan.num_steps for root, plan in per_edge.items()} == {"edges/e0": own["e0d0"], "edges/e1": own["e1d0"]}


def test_seconds_to_a_target_lie_between_two_trainings() -> None:
    trainings = [Reached(num_views=10, psnr_db=20.0, seconds=4.0), Reached(num_views=20, psnr_db=22.0, seconds=8.0)]
    assert seconds_to(21.5, trainings) == pytest.approx(7.0)
    assert seconds_to(19.0, trainings[:1]) == 4.0 and seconds_to(20.5, trainings[:1]) is None and seconds_to(20.0, []) is None


def test_scaling_is_measured_until_the_target_and_not_twice(hamlet_scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = ScalingBench(scene=hamlet_scene, out=tmp_path, devices=(1, 2), num_views=(8, 16, 24), target_db=0.0, long_side_px=48)
    metrics = bench_together(bench)
    found = {metric.key.removeprefix("together.scene."): metric.value for metric in metrics}
    assert list(found) == [
        f"devices_{n}.{name}" for n in (1, 2) for name in ("views_8.psnr_db", "views_8.seconds", "seconds_to_0_db", "efficiency")
    ]
    assert found["devices_1.efficiency"] == 1 and found["devices_2.seconds_to_0_db"] == found["devices_2.views_8.seconds"]
    assert found["devices_2.efficiency"] == pytest.approx(found["devices_1.seconds_to_0_db"] / found["devices_2.seconds_to_0_db"] / 2)
    monkeypatch.setattr("benchmarks.methods.scaling.run_in_process", None)
    assert bench_together(bench) == metrics
    unreached = bench_together(replace(bench, devices=(1,), target_db=99.0, num_views=(8,)))
    assert [metric.key.split(".")[-1] for metric in unreached] == ["psnr_db", "seconds"]
    with pytest.raises(BadInput, match="3 devices have no layout here: use 1, 2, 4, 8, 16"):
        replace(bench, devices=(3,))
    with pytest.raises(BadInput, match="the benchmark together needs --scene"):
        run_bench("together", None, BenchOptions(out=tmp_path))
