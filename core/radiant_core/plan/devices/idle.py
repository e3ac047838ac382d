"""Why a device gets nothing to do in a plan, in a sentence. Once per plan."""

from __future__ import annotations

from collections.abc import Sequence

from radiant_core.plan.plans import CloudPlan, EdgePlan
from radiant_core.plan.system import Device, Edge, System


def idle_reasons(cloud: CloudPlan, edges: Sequence[EdgePlan], system: System) -> dict[str, str]:
    """The reason for each device without a camera, by its id."""
    edge_of = {edge.id: edge for edge in system.edges}
    reasons: dict[str, str] = {}
    for plan in edges:
        edge, busy_s = edge_of[plan.edge_id], float(plan.device_time_s.max(initial=0.0))
        devices_by_id = {device.id: device for device in edge.devices}
        for name in plan.device_ids:
            if not len(plan.cameras_of(name)):
                reasons[name] = _reason(devices_by_id[name], edge, len(plan.camera_indices), busy_s, cloud.makespan_s)
    return reasons


def _reason(device: Device, edge: Edge, num_cameras: int, busy_s: float, makespan_s: float) -> str:
    if device.max_cameras == 0:
        return "its memory holds none"
    one_s = float(device.init_s(1) + device.train_s(1)) + float(device.model_bytes(1)) / device.uplink_bytes_per_s
    if not num_cameras:
        whole_s = one_s + edge.aggregation_s(1, 1)
        slow = f", and one would take it {_seconds(whole_s)}" if whole_s > makespan_s else ""
        return f"its edge {edge.id} has none: the others are done with all in {_seconds(makespan_s)}{slow}"
    if one_s > busy_s:
        return f"one takes it {_seconds(one_s)}, and the others of {edge.id} are done with all in {_seconds(busy_s)}"
    return f"{edge.id} has no more than {num_cameras} to deal, and each further device costs it time to join"


def _seconds(value: float) -> str:
    return f"{value:,.0f} s" if value >= 10 else f"{value:.1f} s"
