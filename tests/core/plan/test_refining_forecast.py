"""Rounds of refining: their time by hand, and who takes part."""

from __future__ import annotations

import numpy as np
import pytest

from radiant_core.plan.plans import EdgePlan
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.system import Device, Edge, System
from radiant_core.plan.timeline.refining import RefiningLaw, predict_refining
from tests.core.plan.test_prediction import SYSTEM, planned

TWICE = RefiningLaw(num_rounds=2, share_of_training=lambda count: count / 1000)


def by_hand(edges: tuple[EdgePlan, ...], *, sending: float) -> float:
    first_s, later_s, beside_s = [], [], []
    for edge, plan in zip(SYSTEM.edges, edges, strict=True):
        counts = {name: len(plan.cameras_of(name)) for name in plan.device_ids}
        busy = [(device, counts[device.id]) for device in edge.devices if counts[device.id]]
        own = [float(device.init_s(count)) for device, count in busy]
        trained = [float(device.train_s(count)) for device, count in busy]
        slowest = max(
            1.2 * beside + 1.4 * train * count / 1000 + sending * 5e5 * count / 5e6
            for beside, train, (_, count) in zip(own, trained, busy, strict=True)
        )
        sent = sending * 5e5 * sum(count for _, count in busy) / 1e7
        first_s.append(slowest + max(own) + sent)
        later_s.append(slowest + 0.5 * max(own) + sent)
        beside_s += own
    return max(first_s) + max(later_s) + 2 * 0.5 * max(beside_s)


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


def device() -> Device:
    return Device(id="a1", init_s=CostCurve(constant=1.0), train_s=CostCurve(constant=1.0), model_bytes=CostCurve(), uplink_bytes_per_s=1.0)


def rest_of(plan: EdgePlan, num_devices: int = 1) -> dict:
    return {
        "strips": plan.strips[:num_devices],
        "device_time_s": plan.device_time_s[:num_devices],
    }
