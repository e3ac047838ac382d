"""Both levels of a plan deal the same cameras, each once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.plan.plans import CloudPlan, EdgePlan, require_plan_of


def cloud(edge_of_camera: list[int]) -> CloudPlan:
    return CloudPlan(
        method="exact", edge_ids=("e0", "e1"), sites=np.array([[0.0, 0.0], [9.0, 0.0]]), weights=np.zeros(2),
        borders=(np.zeros((0, 2)), np.zeros((0, 2))), edge_of_camera=np.array(edge_of_camera), edge_time_s=np.ones(2),
        lower_bound_s=1.0, status="stopped", certified=False,
    )  # fmt: skip


def edge(name: str, cameras: list[int]) -> EdgePlan:
    return EdgePlan(
        edge_id=name, device_ids=(f"{name}-1",), camera_indices=np.array(cameras, np.int64),
        device_of_camera=np.zeros(len(cameras), np.int64), strips=(np.zeros((0, 2)),), device_time_s=np.ones(1),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("regions", "dealt"),
    [
        ([1, 1], ([0], [0])),  # one twice, one by nobody, and both where the cloud says
        ([0, 0], ([0], [])),
        ([0, 1], ([1], [0])),
        ([0, 1], ([0], [0, 1])),
        ([0, 1], ([0], [1, 2])),
    ],
)
def test_levels_that_disagree_are_refused(regions: list[int], dealt: tuple[list[int], list[int]]) -> None:
    with pytest.raises(BadInput, match="plan again"):
        require_plan_of(2, cloud(regions), [edge("e0", dealt[0]), edge("e1", dealt[1])])


def test_levels_that_agree_pass_and_other_numbers_or_edges_do_not() -> None:
    edges = [edge("e0", [0]), edge("e1", [1])]
    require_plan_of(2, cloud([0, 1]), edges)
    with pytest.raises(BadInput, match="of 2 cameras, there are 3"):
        require_plan_of(3, cloud([0, 1]), edges)
    with pytest.raises(BadInput, match="other edges"):
        require_plan_of(2, cloud([0, 1]), edges[::-1])


WHOLE = edge("e0", [0, 2])


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"edge_ids": ()}, r"the plan has the edges \(\), expected one or more, each with its own id"),
        ({"edge_ids": ("a", "a")}, r"the plan has the edges \('a', 'a'\)"),
        ({"status": "fine"}, r"the plan has status 'fine' and lower bound 1\.0 s: plan again"),
        ({"lower_bound_s": np.inf}, "the plan has status 'stopped' and lower bound inf s"),
        ({"borders": (np.zeros((0, 2)),)}, "the plan has 1 borders for 2 edges: give one polygon per edge"),
        ({"edge_of_camera": np.array([0, 2])}, "the plan assigns a camera to an edge that is not there: check edge_of_camera"),
        ({"edge_of_camera": np.array([-1, 0])}, "the plan assigns a camera to an edge that is not there"),
        ({"edge_of_camera": np.zeros(0, np.int64)}, None),
        *(({"status": status}, None) for status in ("optimal", "converged", "stopped", "infeasible", "slack", "constrained")),
    ],
)
def test_limits_of_a_clouds_plan(change: dict, told: str | None) -> None:
    plan = cloud([0, 1, 1])
    assert (plan.counts.tolist(), plan.makespan_s, plan.history, plan.slack, plan.constrained, plan.num_outside) == (
        [1, 2],
        1.0,
        (),
        None,
        (),
        0,
    )
    if told is None:
        replace(plan, **change)
    else:
        with pytest.raises(BadInput, match=told):
            replace(plan, **change)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"dealt": False}, "the plan of edge 'e0' has devices and says that it is not dealt: plan again"),
        ({"device_ids": ("a", "a")}, r"the plan of edge 'e0' has the devices \('a', 'a'\): give each its own id"),
        ({"camera_indices": np.array([0, 0])}, "the plan of edge 'e0' has a camera twice or a negative index: check camera_indices"),
        ({"camera_indices": np.array([-1, 0])}, "has a camera twice or a negative index"),
        ({"strips": ()}, "the plan of edge 'e0' has 0 strips for 1 devices"),
        ({"device_of_camera": np.array([0, 1])}, "the plan of edge 'e0' gives a camera to a device that is not there"),
        ({"device_of_camera": np.array([0, -1])}, "gives a camera to a device that is not there"),
    ],
)
def test_limits_of_an_edges_plan(change: dict, told: str) -> None:
    with pytest.raises(BadInput, match=told):
        replace(WHOLE, **change)


def test_an_edge_that_deals_its_cameras_later_names_no_device() -> None:
    late = replace(WHOLE, device_ids=(), device_of_camera=np.array([-1, -1]), strips=(), device_time_s=np.zeros(0), dealt=False)
    assert not late.dealt and WHOLE.dealt and WHOLE.cameras_of("e0-1").tolist() == [0, 2]
    for wrong in ([0, 0], [-1, 0], [-2, -1]):
        with pytest.raises(BadInput, match="gives a camera to a device that is not there"):
            replace(late, device_of_camera=np.array(wrong))


@pytest.mark.parametrize(
    ("dealt", "told"),
    [
        (([0], [1, 3]), "the plan of edge 'e1' deals camera 3 of 3: plan again"),
        (([0], [1]), "the plan's two levels disagree about 1 of 3 cameras: plan again"),
        (([0, 1], [1, 2]), "the plan's two levels disagree about 0 of 3 cameras"),
        (([1], [0, 2]), "disagree about 2 of 3 cameras"),
        (([0], [1, 2]), None),
    ],
)
def test_how_two_levels_disagree_is_told(dealt: tuple[list[int], list[int]], told: str | None) -> None:
    edges = [edge("e0", dealt[0]), edge("e1", dealt[1])]
    if told is None:
        require_plan_of(3, cloud([0, 1, 1]), edges)
        with pytest.raises(BadInput, match="the plan is of 3 cameras, there are 2: it was made from others, plan again"):
            require_plan_of(2, cloud([0, 1, 1]), edges)
        with pytest.raises(BadInput, match="the plan has regions of e0, e1 and deals cameras of other edges: plan again"):
            require_plan_of(3, cloud([0, 1, 1]), edges[:1])
    else:
        with pytest.raises(BadInput, match=told):
            require_plan_of(3, cloud([0, 1, 1]), edges)
