"""Both levels of a plan deal the same cameras, each once."""

from __future__ import annotations

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
