"""Predicts how long a joined scene is refined by its devices. Once per plan.

    device n   1.2 G_n(c) + 1.4 F_n(c) R(c) / S(c), then H_n / B^n      c photographs, R of S steps
    edge m     the greatest G_n of its devices, half of it after round 1, then Σ_n H_n / B^m
    cloud      half of the greatest G_n of all
    round      the slowest edge, its devices before it; then the cloud

G and F are those of the devices' own trainings. That a node reads, writes and, in the first round,
weighs in about the time in which a device of its tree initialises, and that a step on the scene
takes 1.4 times as long as one on a device's own model, is what four runs took: their rounds are
predicted within ±20 % (docs/experiments/planner.md). The scene's way down is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from radiant_core.plan.plans import EdgePlan
from radiant_core.plan.system import Device, Edge, System

OVERHEAD, STEP, AT_EDGE, AT_EDGE_LATER, AT_CLOUD = 1.2, 1.4, 1.0, 0.5, 0.5
"""Factors of what a device needs beside training, of its training by the share of steps, and of the
first at an edge, in the first round and later, and at the cloud."""
LEAST_DEVICES = 2
"""One device alone refines nothing: it has fitted its model to its photographs before."""


@dataclass(frozen=True, kw_only=True)
class RefiningLaw:
    """How much of a training a round of refining repeats."""

    num_rounds: int
    """0: nothing is refined."""
    share_of_training: Callable[[int], float]
    """Steps of a round over steps of the training, of a device with so many photographs."""


def predict_round(law: RefiningLaw, *, beside_s: float, train_s: float, num_photographs: int) -> float:
    """Seconds of a device in one round, by what it needs beside training and in training."""
    return OVERHEAD * beside_s + STEP * train_s * law.share_of_training(num_photographs)


def predict_refining(system: System, edge_plans: Sequence[EdgePlan], law: RefiningLaw, *, with_sending: bool = True) -> float:
    """Seconds from the joined scene to the refined one if every machine works for itself; 0 where
    too few devices have photographs. Edges whose devices are not known take no time."""
    first_s, later_s, beside_s, num_devices = [0.0], [0.0], [0.0], 0
    for edge, plan in zip(system.edges, edge_plans, strict=True):
        if edge.time_s is not None:
            continue
        counts = np.bincount(plan.device_of_camera, minlength=len(edge.devices)).tolist()
        busy = [(device, count) for device, count in zip(edge.devices, counts, strict=True) if count]
        if busy:
            for at_edge, edges_s in ((AT_EDGE, first_s), (AT_EDGE_LATER, later_s)):
                edges_s.append(_edge_s(edge, busy, law, at_edge, sending=float(with_sending)))
            beside_s += [float(device.init_s(count)) for device, count in busy]
            num_devices += len(busy)
    if num_devices < LEAST_DEVICES or not law.num_rounds:
        return 0.0
    return max(first_s) + (law.num_rounds - 1) * max(later_s) + law.num_rounds * AT_CLOUD * max(beside_s)


def _edge_s(edge: Edge, busy: Sequence[tuple[Device, int]], law: RefiningLaw, at_edge: float, sending: float) -> float:
    sent_bytes = sending * sum(float(device.model_bytes(count)) for device, count in busy)
    devices_s = max(
        predict_round(law, beside_s=float(device.init_s(count)), train_s=float(device.train_s(count)), num_photographs=count)
        + sending * float(device.model_bytes(count)) / device.uplink_bytes_per_s
        for device, count in busy
    )
    return devices_s + at_edge * max(float(device.init_s(count)) for device, count in busy) + sent_bytes / edge.uplink_bytes_per_s
