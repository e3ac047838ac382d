"""Rounds of refining: their time by hand, who takes part, and what a law of rounds comes from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_app.run.predictions import refining_law_of
from radiant_core.aggregate.config import AggregateConfig
from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.system import Device, Edge, System
from radiant_core.plan.timeline.refining import RefiningLaw, predict_refining
from radiant_core.train.config import train_preset
from tests.core.plan.test_prediction import SYSTEM, planned

TWICE = RefiningLaw(num_rounds=2, share_of_training=lambda count: count / 1000)


def by_hand(edges: tuple[EdgePlan, ...], *, sending: float) -> float:
    edges_s, beside_s = [], []
    for edge, plan in zip(SYSTEM.edges, edges, strict=True):
        counts = {name: len(plan.cameras_of(name)) for name in plan.device_ids}
        busy = [(device, counts[device.id]) for device in edge.devices if counts[device.id]]
        own = [float(device.init_s(count)) for device, count in busy]
        trained = [float(device.train_s(count)) for device, count in busy]
        slowest = max(
            1.2 * beside + 1.4 * train * count / 1000 + sending * 5e5 * count / 5e6
            for beside, train, (_, count) in zip(own, trained, busy, strict=True)
        )
        edges_s.append(slowest + max(own) + sending * 5e5 * sum(count for _, count in busy) / 1e7)
        beside_s += own
    return 2 * (max(edges_s) + 0.5 * max(beside_s))


@pytest.mark.parametrize("sending", [True, False])
def test_a_round_is_the_slowest_edge_behind_its_devices_and_then_the_cloud(sending: bool) -> None:
    edges = planned()[1]
    assert predict_refining(SYSTEM, edges, TWICE, with_sending=sending) == pytest.approx(by_hand(edges, sending=float(sending)), rel=1e-12)


def test_nothing_is_refined_by_one_device_or_in_no_round() -> None:
    edges = planned()[1]
    assert predict_refining(SYSTEM, edges, RefiningLaw(num_rounds=0, share_of_training=lambda count: 1.0)) == 0
    alone = System(edges=(Edge(id="a", position=(0.0, 0.0), aggregate_s=CostCurve(), uplink_bytes_per_s=1.0, devices=(device(),)),))
    plan = EdgePlan(edge_id="a", device_ids=("a1",), device_of_camera=np.zeros(9, int), camera_indices=np.arange(9), **rest_of(edges[0]))
    assert predict_refining(alone, (plan,), TWICE) == 0


def test_edges_whose_devices_are_not_known_take_no_time() -> None:
    unknown = Edge(id="c", position=(9.0, 9.0), aggregate_s=CostCurve(), devices=(), time_s=CostCurve(linear=1.0), uplink_bytes_per_s=1.0)
    wider = System(edges=(*SYSTEM.edges, unknown))
    edges = planned()[1]
    nothing = EdgePlan(
        edge_id="c",
        device_ids=(),
        device_of_camera=np.full(5, -1),
        camera_indices=np.arange(500, 505),
        dealt=False,
        **rest_of(edges[0], num_devices=0),
    )
    assert predict_refining(wider, (*edges, nothing), TWICE) == predict_refining(SYSTEM, edges, TWICE)


def test_the_law_has_the_rounds_and_steps_of_a_run() -> None:
    train, aggregate = train_preset("default"), AggregateConfig()
    train = replace(train, num_steps=1500)
    long, short = (refining_law_of(train, aggregate, count, 4) for count in (52, 400))
    assert (long.num_rounds, short.num_rounds) == (aggregate.rounds_after(1500 / 13), aggregate.rounds_after(15)) == (1, 5)
    # Eight epochs of 13 photographs, and 200 steps at most of 100; trainings of 1,500 steps each.
    assert long.share_of_training(13) == pytest.approx(104 / 1500) and short.share_of_training(100) == pytest.approx(200 / 1500)
    for nothing in (refining_law_of(train, AggregateConfig(refine_epochs=0), 52, 4), refining_law_of(train, aggregate, 0, 4)):
        assert nothing.num_rounds == 0 and nothing.share_of_training(5) == 0


def device() -> Device:
    return Device(id="a1", init_s=CostCurve(constant=1.0), train_s=CostCurve(constant=1.0), model_bytes=CostCurve(), uplink_bytes_per_s=1.0)


def rest_of(plan: EdgePlan, num_devices: int = 1) -> dict:
    return {
        "strips": plan.strips[:num_devices],
        "device_time_s": plan.device_time_s[:num_devices],
    }


def test_the_plan_is_not_changed_by_it() -> None:
    cloud, edges, stages = planned()
    assert isinstance(cloud, CloudPlan) and max(row.stop_s for row in stages) == pytest.approx(cloud.makespan_s)
    assert predict_refining(SYSTEM, edges, TWICE) > 0
