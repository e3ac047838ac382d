"""Figures that documents and other programs rely on, and what a curve does when it is scaled."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.plan.borders.footprints import Optics
from radiant_core.plan.borders.forecast import RiskModel
from radiant_core.plan.counts.slack_curve import SLACKS
from radiant_core.plan.counts.wide_deadline import FastestCounts
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.profiles.profile import ProfileKey
from radiant_core.plan.regions.edge_sites import separate_sites
from radiant_core.plan.regions.paper_arp import estimated_times_s
from radiant_core.plan.regions.paper_config import PaperConfig
from radiant_core.plan.system import Cloud, Device, Edge, System

from .instances import linear_system


def test_what_holds_where_nobody_says_otherwise() -> None:
    assert PaperConfig() == PaperConfig(threshold=0.05, boundary_step=0.01, max_iterations=500)
    assert Optics() == Optics(field_of_view_deg=73.7, aspect=0.75)
    assert [RiskModel().risk(support) for support in (3.24, 3.25, 4.99, 5.0)] == ["high", "medium", "medium", "low"]
    assert CostCurve() == CostCurve(constant=0, linear=0, power_coefficient=0, exponent=1)
    assert Cloud() == Cloud(memory_bytes=None, time_s=None, max_cameras=None)
    assert SLACKS == (1.0, 1.02, 1.05, 1.1, 1.2, 1.5, 2.0)
    assert ProfileKey(preset="p", num_steps=1, long_side_px=1).aggregate_preset == "default"


@pytest.mark.parametrize("factor", [0.0, 0.25, 3.0])
def test_a_scaled_curve_costs_so_many_times_as_much(factor: float) -> None:
    curve, counts = CostCurve(constant=2.0, linear=3.0, power_coefficient=0.5, exponent=1.5), np.array([0, 1, 4, 100])
    np.testing.assert_allclose(curve(counts), [0, 5.5, 18, 802], rtol=1e-14)
    np.testing.assert_allclose(curve.scaled(factor)(counts), factor * curve(counts), rtol=1e-14)


@pytest.mark.parametrize("name", ["constant", "linear", "power_coefficient", "exponent"])
def test_a_coefficient_is_finite_and_at_least_0(name: str) -> None:
    for wrong in (-1e-300, np.nan, np.inf):
        with pytest.raises(BadInput, match=f"cost curve: {name} is {wrong}, expected a finite number of at least 0"):
            CostCurve(**{name: wrong})
    CostCurve(**{name: 0.0})
    assert CostCurve(exponent=4.0).exponent == 4
    with pytest.raises(BadInput, match=r"exponent is 4\.1, expected at most 4"):
        CostCurve(exponent=4.1)


@pytest.mark.parametrize(
    ("angle", "aspect", "fits"), [(1, 0.1, True), (170, 10, True), (0.9, 1, False), (171, 1, False), (90, 0.09, False), (90, 10.1, False)]
)
def test_angles_and_sides_that_a_flat_picture_can_have(angle: float, aspect: float, fits: bool) -> None:
    if fits:
        assert Optics(field_of_view_deg=angle, aspect=aspect).aspect == aspect
    else:
        with pytest.raises(BadInput, match=rf"the field of view is {angle}°|the image's height over width is {aspect}, expected 0.1 to 10"):
            Optics(field_of_view_deg=angle, aspect=aspect)


def test_sites_at_one_spot_step_aside_by_the_golden_angle() -> None:
    sites = separate_sites(np.full((5, 2), 3.0), 1000.0)
    steps = sites[1:] - sites[0]
    np.testing.assert_array_equal(sites[0], [3, 3])
    np.testing.assert_allclose(np.hypot(*steps.T), np.sqrt([1, 2, 3, 4]), rtol=1e-12)
    turns = [(np.degrees(np.arctan2(*b[::-1]) - np.arctan2(*a[::-1]))) % 360 for a, b in pairwise(steps)]
    np.testing.assert_allclose(turns, 137.50776405, atol=1e-6)
    for gap_m, moves in ((1e-3, True), (1.001e-3, False)):
        near = np.array([[0.0, 0.0], [gap_m, 0.0]])
        assert (separate_sites(near, 1000.0) != near).any() == moves


def test_beyond_an_edges_capacity_times_grow_in_proportion() -> None:
    from radiant_core.plan.counts.deadline import edge_tables

    tables = edge_tables(linear_system(np.eye(3, 2), np.array([1.0, 2.0, 1.0]), 4), 10)
    np.testing.assert_allclose(estimated_times_s(tables, np.array([3, 4, 6])), [3, 8, 6])
    full = edge_tables(linear_system(np.eye(1, 2), np.array([1.0]), 0), 10)
    assert estimated_times_s(full, np.array([0])).tolist() == estimated_times_s(full, np.array([3])).tolist() == [0.0]


def machine(name: str, **more: object) -> Device:
    return Device(id=name, init_s=CostCurve(), train_s=CostCurve(), model_bytes=CostCurve(linear=2.0), uplink_bytes_per_s=1.0, **more)  # type: ignore[arg-type]


def place(name: str = "e", devices: tuple[Device, ...] | None = None, **more: object) -> Edge:
    made = {
        "position": None,
        "aggregate_s": CostCurve(),
        "uplink_bytes_per_s": 1.0,
        "devices": (machine("d"),) if devices is None else devices,
    }
    return Edge(id=name, **{**made, **more})  # type: ignore[arg-type]


CURVE = CostCurve(linear=1.0)


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: machine("x" * 64), None),
        (lambda: machine("x" * 65), "device id 'x+' cannot name a folder: use up to 64 letters"),
        (lambda: machine(""), "device id '' cannot name a folder"),
        (lambda: machine("-a"), "device id '-a'"),
        (lambda: place("a/b"), "edge id 'a/b' cannot name a folder"),
        (lambda: machine("d", max_cameras=0), None),
        (lambda: machine("d", max_cameras=-1), "device 'd': max_cameras is -1, expected at least 0"),
        (lambda: machine("d", memory_bytes=0.5), None),
        (lambda: machine("d", memory_bytes=0), "device 'd': memory_bytes is 0, expected a positive number"),
        (lambda: machine("d", memory_bytes=np.inf), "device 'd': memory_bytes is inf"),
        (lambda: machine("d", speed=1.0), None),
        (lambda: machine("d", speed=0.0), r"device 'd': speed is 0\.0, expected more than 0 and at most 1"),
        (lambda: machine("d", speed=1.001), r"device 'd': speed is 1\.001"),
        (lambda: place(uplink_bytes_per_s=0.0), r"edge 'e': uplink_bytes_per_s is 0\.0, expected a positive number of bytes"),
        (lambda: place(uplink_bytes_per_s=np.inf), "edge 'e': uplink_bytes_per_s is inf"),
        (lambda: place(uplink_bytes_per_s=1e-9), None),
        (lambda: place(memory_bytes=-1), "edge 'e': memory_bytes is -1"),
        (lambda: place(speed=2.0), r"edge 'e': speed is 2\.0"),
        (lambda: place(position=(0.0, np.nan)), r"edge 'e': position \(0\.0, nan\) is not finite: give two numbers"),
        (lambda: place(lat_lon_deg=(np.inf, 0.0)), r"edge 'e': position \(inf, 0\.0\) is not finite"),
        (lambda: place(devices=()), "edge 'e' has no devices: give it at least one, or its time_s alone"),
        (lambda: place(max_cameras=3), "edge 'e' has max_cameras and no time_s: limit its devices instead"),
        (lambda: place(devices=(), time_s=CURVE, max_cameras=0), None),
        (lambda: place(devices=(), time_s=CURVE, max_cameras=-1), "edge 'e': max_cameras is -1, expected at least 0"),
        (lambda: place(time_s=CURVE), "edge 'e' has time_s, its whole time, and devices or aggregate_s too"),
        (lambda: place(devices=(), time_s=CURVE, aggregate_s=CURVE), "edge 'e' has time_s, its whole time"),
        (lambda: place(devices=(), time_s=CURVE, aggregate_alone_s=CURVE), "edge 'e' has time_s, its whole time"),
        (lambda: System(edges=()), "the system has no edges"),
        (lambda: System(edges=(place("a"), place("b", devices=(machine("d"),)))), "device id 'd' comes twice"),
        (lambda: System(edges=(place("a"), place("a", devices=(machine("c"),)))), "edge id 'a' comes twice"),
        (lambda: Cloud(memory_bytes=0, time_s=0, max_cameras=0), None),
        *(
            (lambda name=name: Cloud(**{name: -1}), f"cloud: {name} is -1, expected a finite number")
            for name in ("memory_bytes", "time_s", "max_cameras")
        ),
        (lambda: Cloud(time_s=np.nan), "cloud: time_s is nan"),
    ],
)
def test_limits_of_what_a_machine_may_be(make, told: str | None) -> None:
    if told is None:
        make()
    else:
        with pytest.raises(BadInput, match=told):
            make()


def test_uploads_of_another_size_and_an_edge_known_by_its_curve() -> None:
    system = System(edges=(place("a"), place("b", devices=(), time_s=CURVE, max_cameras=7)))
    assert [float(d.model_bytes(3)) for d in system.with_uploads_of(0.25).devices] == [1.5]
    (worker,) = system.edges[1].workers
    assert (worker.id, worker.train_s, worker.max_cameras, float(worker.init_s(5)), float(worker.model_bytes(5))) == ("b", CURVE, 7, 0, 0)
    assert [w.id for w in system.workers] == ["d", "b"] and [d.id for d in system.devices] == ["d"]
    joined = place(aggregate_s=CostCurve(constant=9.0), aggregate_alone_s=CostCurve(constant=4.0))
    assert [joined.aggregation_s(5, devices) for devices in (1, 2)] == [4.0, 9.0]
    assert place(aggregate_s=CostCurve(constant=2.0), aggregate_alone_s=CostCurve(constant=4.0)).aggregation_s(5, 1) == 2.0
    slower = joined.with_aggregation_scaled(2.0)
    assert [slower.aggregation_s(5, devices) for devices in (1, 2)] == [8.0, 18.0] and place().with_aggregation_scaled(
        2.0
    ).aggregate_alone_s is None
    assert machine("d", costs_from="measured x").origin == "measured x" and machine("d").origin is None


def test_counts_that_are_remembered_are_read_only() -> None:
    found = FastestCounts(counts=np.array([1]), edge_time_s=np.array([1.0]))
    assert not found.counts.flags.writeable and not found.edge_time_s.flags.writeable
