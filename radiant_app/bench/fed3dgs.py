"""Radiant's plans beside Fed3DGS's sequential merge, by the number of clients, on fleets made of the paper's systems 1 and 2.

A fleet of N clients is the system's list of devices repeated; edges come with their devices. The scene grows with it: 150 images per
client, the middle of the 100 to 200 that Fed3DGS gives each. Fed3DGS has no regions: clients train 150 images each and send to one server.
Assumed for its merge of one client of n images: 5 epochs over n renders of the client and n of the global model (its published
settings), so 10 n iterations, as many as the 10 epochs over n views that an edge of these systems retrains in 5 s + 0.6 s · n. Hence a
merge takes the same 5 s + 0.6 s · n; reading models, choosing views and its appearance network are left out, in its favour. One server
merges client after client; with several mergers they take turns, and what they made is joined for nothing, again in its favour.
Band: 5th to 95th percentile over draws in which every curve, uplink and the merge vary by ±30 %.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import radiant_app
from radiant_app.bench.plan import camera_layout
from radiant_app.bench.plan_scale import replace_aggregation, varied
from radiant_app.files.system_file import load_system
from radiant_app.report.progress import tracked
from radiant_core.evaluate.metric import Metric
from radiant_core.plan.counts.deadline import edge_table
from radiant_core.plan.counts.wide_deadline import fastest_edge_counts
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import Edge, System
from radiant_core.plan.timeline.simulate import fleet_of, merged_s, simulate

IMAGES_PER_CLIENT = 150
MERGE_CONSTANT_S, MERGE_S_PER_IMAGE = 5.0, 0.6
NUM_CLIENTS = (4, 8, 16, 32, 64, 128, 256, 512, 1024)
MOST_PAPER_CLIENTS = 64
"""Alg. 1 in its fixed steps takes minutes beyond."""
METHODS = {
    "exact": "Radiant, exact",
    "paper": "Radiant, Alg. 1",
    "even": "Equal images per device",
    "fed3dgs": "Fed3DGS, one server",
    "fed3dgs_4": "Fed3DGS, 4 mergers",
    "fed3dgs_edges": "Fed3DGS, a merger per edge",
}


def bench_fed3dgs(quick: bool, plot: Path | None = None) -> list[Metric]:
    """`fed3dgs.system<N>.<clients>.<method>.<simulated|p5|p95>_s`; the picture goes to `plot`."""
    metrics: list[Metric] = []
    counts, num_draws = ((4, 16) if quick else NUM_CLIENTS), (3 if quick else 20)
    for number, num_clients in tracked([(system, count) for system in (1, 2) for count in counts], "bench fed3dgs"):
        system = load_system(Path(radiant_app.__file__).parent / "systems" / f"paper_{number}.toml")
        fleet = repeated_system(system, num_clients)
        rng = np.random.default_rng(0)
        nominal = methods_s(fleet, num_clients, 1.0, with_paper=num_clients <= MOST_PAPER_CLIENTS)
        draws = [methods_s(varied(fleet, rng), num_clients, float(rng.uniform(0.7, 1.3)), with_paper=False) for _ in range(num_draws)]
        for method, seconds in nominal.items():
            key = f"fed3dgs.system{number}.{num_clients}.{method}"
            metrics.append(Metric(key=f"{key}.simulated_s", value=seconds, unit="s", direction="info"))
            for percentile in (5, 95) if method in draws[0] else ():
                value = float(np.percentile([draw[method] for draw in draws], percentile))
                metrics.append(Metric(key=f"{key}.p{percentile}_s", value=value, unit="s", direction="info"))
    if plot is not None:
        from radiant_viewer.charts.fleet_chart import fleet_picture
        from radiant_viewer.pictures.images import save_png

        save_png(plot, fleet_picture(lines_of(metrics)))
    return metrics


def repeated_system(system: System, num_devices: int) -> System:
    """The first `num_devices` devices of the system repeated without end, each copy with edges of its own and without memory limits."""
    edges: list[Edge] = []
    copy = 0
    while num_devices:
        for edge in system.edges:
            taken = edge.devices[:num_devices]
            num_devices -= len(taken)
            if taken:
                devices = tuple(replace(device, id=f"{device.id}-{copy}", max_cameras=None) for device in taken)
                edges.append(replace(edge, id=f"{edge.id}-{copy}", position=None, devices=devices))
        copy += 1
    return System(edges=tuple(edges))


def methods_s(system: System, num_clients: int, merge_factor: float, *, with_paper: bool) -> dict[str, float]:
    """Seconds until the scene is whole by each method."""
    num_cameras = num_clients * IMAGES_PER_CLIENT
    counts = fastest_edge_counts(system, num_cameras).counts
    quotas = np.concatenate([edge_table(edge, int(count)).quotas(int(count)) for edge, count in zip(system.edges, counts, strict=True)])
    even = np.full(num_clients, IMAGES_PER_CLIENT)
    seconds = {"exact": simulate(fleet_of(system, quotas)).makespan_s}
    if with_paper:
        positions = camera_layout("lawnmower", num_cameras, np.random.default_rng(0))
        placed = place_edges(system, positions, None, seed=0)
        plan = plan_regions(positions, placed, method="paper")
        assert isinstance(plan, CloudPlan), "devices without a memory limit hold every plan"
        edges = split_edges(positions, plan, placed)
        dealt = np.concatenate([np.bincount(own.device_of_camera, minlength=len(own.device_ids)) for own in edges])
        seconds["paper"] = simulate(fleet_of(placed, dealt)).makespan_s
    seconds["even"] = simulate(fleet_of(system, even)).makespan_s
    arrivals_s = simulate(fleet_of(replace_aggregation(system), even)).device_done_s
    merge_s = merge_factor * (MERGE_CONSTANT_S + MERGE_S_PER_IMAGE * IMAGES_PER_CLIENT)
    for name, num_mergers in (("fed3dgs", 1), ("fed3dgs_4", 4), ("fed3dgs_edges", len(system.edges))):
        seconds[name] = merged_s(arrivals_s, merge_s, num_mergers=num_mergers)
    return seconds


def lines_of(metrics: Sequence[Metric]) -> Mapping[str, Mapping[str, Any]]:
    """Panel → method → rows (clients, seconds, low, high); without a band low and high are the seconds."""
    values = {metric.key: metric.value for metric in metrics}
    panels: dict[str, dict[str, list[tuple[float, ...]]]] = {}
    for key, seconds in values.items():
        if key.endswith(".simulated_s"):
            _, system, clients, method, _ = key.split(".")
            stem = key.removesuffix("simulated_s")
            row = (float(clients), seconds, values.get(f"{stem}p5_s", seconds), values.get(f"{stem}p95_s", seconds))
            panels.setdefault(f"System {system.removeprefix('system')}", {}).setdefault(METHODS[method], []).append(row)
    return panels
