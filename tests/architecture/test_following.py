"""How far a message travels to where it is used: in few rooms, and hardly ever upwards."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import radiant
from radiant_app.config.fields import config_of
from radiant_app.config.run_config import RunConfig
from radiant_core.aggregate.config import Join
from radiant_core.hierarchy.cloud import join_cloud
from radiant_core.hierarchy.edge import join_edge
from radiant_core.hierarchy.messages import CloudTask, EdgeTask, RefineTask
from radiant_core.hierarchy.refine import refine_device
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.train.config import TrainConfig
from tests.app.conftest import hamlet, hamlet_project  # noqa: F401
from tests.architecture.following import Way, follow
from tests.core.hierarchy.grounds import cloud_task, device_models, edge_models, edge_task
from tests.core.hierarchy.test_refine import BLURRED, TASK, photographs

MOST_ROOMS, MOST_CLIMBS = 15, 5


def require_short(way: Way) -> None:
    """At least two rooms: one that was not followed would pass."""
    assert 2 <= len(way.rooms) <= MOST_ROOMS, way.rooms
    assert len(way.climbs) <= MOST_CLIMBS, way.climbs


def test_tasks_and_what_they_carry_reach_their_use_in_few_rooms() -> None:
    views = photographs(0)
    models, taught = device_models(), edge_models()
    with follow(RefineTask, TrainConfig) as refining:
        refine_device(replace(TASK, epochs=1), BLURRED, views, Recorder())
    with follow(EdgeTask, Join, TrainConfig) as at_edge:
        join_edge(edge_task("a", "b"), {name: models[name] for name in "ab"}, Recorder())
    with follow(CloudTask, Join, TrainConfig) as at_cloud:
        join_cloud(cloud_task("a", "b"), {name: taught[name] for name in "ab"}, Recorder())
    for way in (refining, at_edge, at_cloud):
        require_short(way)
        assert way.climbs == []
    assert len(refining.rooms) <= len(at_cloud.rooms), "a round is prepared as a tree is"


@pytest.mark.stress
def test_a_configuration_reaches_its_use_in_few_rooms(hamlet_project: Path, tmp_path: Path) -> None:  # noqa: F811
    values = {"plan.devices": 2, "train.num_steps": 20, "train.long_side_px": 48}
    config = config_of({"source": hamlet_project, "out": tmp_path / "run", **values})
    with follow(RunConfig) as way:
        radiant.run(config)
    require_short(way)
    assert "radiant_app.commands.run.pipeline" in way.rooms
