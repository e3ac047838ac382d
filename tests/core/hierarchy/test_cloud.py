"""The cloud: it retrains where limits and memory allow, else cuts with a warning that names one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.aggregate import join_memory
from radiant_core.aggregate.config import Join, aggregate_preset
from radiant_core.aggregate.crop_merge import crop_merge
from radiant_core.aggregate.join_memory import plan_join_memory
from radiant_core.hierarchy.cloud import join_cloud
from radiant_core.hierarchy.join_limits import MACHINE_SHARE
from radiant_core.hierarchy.messages import SceneModel
from radiant_core.hierarchy.reporter import Machine, Recorder
from radiant_core.plan.system import Cloud
from tests.core.hierarchy.grounds import CAMERAS, MIDDLES, NAMES, cloud_task, edge_models, part

PAIR = {name: model for name, model in edge_models().items() if name != "c"}
LEAST_BYTES = plan_join_memory([part(0), part(1)], CAMERAS[:2], 48, 1.0).needed_bytes
"""Of the tiles that take least."""
NEEDED_BYTES = plan_join_memory([part(0), part(1)], CAMERAS[:2], 48, np.inf).needed_bytes
CUT = "models are cut at their borders instead of retrained"


def joined(limits: Cloud | None = None, free_bytes: float = np.inf, **changes: object) -> tuple[SceneModel, Recorder]:
    """The scene of two edges."""
    reporter = Recorder(stage="cloud")
    task = cloud_task("a", "b", limits=limits or Cloud(), **changes)
    return join_cloud(task, PAIR, reporter, Machine(free_bytes=lambda: free_bytes)), reporter


def aggregation(reporter: Recorder) -> str:
    (decision,) = (decision for decision in reporter.decisions if decision.topic == "aggregation")
    return decision.choice


def test_without_a_limit_models_are_retrained_together() -> None:
    scene, reporter = joined()
    assert aggregation(reporter) == "retraining all models together" and not reporter.warnings
    assert scene.summary["num_steps"] > 0 and not scene.cut_for_memory and not scene.refused
    again, _ = joined(free_bytes=1.01 * NEEDED_BYTES / MACHINE_SHARE)
    assert scene.splats is not None and again.splats is not None
    np.testing.assert_array_equal(scene.splats.means, again.splats.means)


def test_a_machine_with_too_little_free_memory_cuts_and_says_that_another_try_may_join() -> None:
    scene, reporter = joined(free_bytes=0.99 * LEAST_BYTES / MACHINE_SHARE)
    (warning,) = reporter.warnings
    assert scene.cut_for_memory and aggregation(reporter) == CUT
    assert "80% of what this machine has free" in warning and "free memory there and go on with --resume" in warning
    assert "radiant join RUN --out JOINED.ply" in warning
    assert scene.splats is not None and scene.summary["num_steps"] == 0
    # A cut keeps to each Gaussian's own region.
    given = sum(len(model.splats or ()) for model in PAIR.values())
    assert 0 < len(scene.splats) < given


@pytest.mark.parametrize(
    ("limits", "told"),
    [
        (Cloud(memory_bytes=0.99 * LEAST_BYTES), "memory"),
        (Cloud(max_cameras=3), "views"),
        (Cloud(time_s=1.0), "time"),
    ],
)
def test_a_limit_of_the_system_file_cuts_and_another_try_would_too(limits: Cloud, told: str) -> None:
    scene, reporter = joined(limits, free_bytes=1e12, edge_times_s=(3.0, 3.0))
    (warning,) = reporter.warnings
    assert not scene.cut_for_memory and aggregation(reporter) == CUT
    assert (
        f"the predicted {told} of retraining" in warning and "raise that limit under [cloud] in the system file of the next run" in warning
    )


def test_a_limit_of_the_task_counts_before_what_the_machine_has_free() -> None:
    scene, reporter = joined(Cloud(memory_bytes=1.01 * NEEDED_BYTES), free_bytes=1.0)
    assert aggregation(reporter) == "retraining all models together" and scene.summary["num_steps"] > 0


def test_where_a_count_of_cameras_forbids_it_anyway_the_machines_memory_is_not_blamed() -> None:
    scene, _ = joined(Cloud(max_cameras=3), free_bytes=1.0)
    assert not scene.cut_for_memory


def test_a_join_that_exceeds_the_memory_by_little_is_done_in_tiles_and_says_how_to_lift_that(monkeypatch: pytest.MonkeyPatch) -> None:
    # Tiles spare little of 300 Gaussians: most of the memory is the process's and the views'.
    monkeypatch.setattr(join_memory, "RASTERIZER_BYTES_PER_SPLAT", 5e6)
    needed = plan_join_memory([part(0), part(1)], CAMERAS[:2], 48, np.inf).needed_bytes
    for limits, free_bytes, lift in (
        (Cloud(memory_bytes=needed - 1), np.inf, "raise that limit under [cloud]"),
        (Cloud(), (needed - 1) / MACHINE_SHARE, "free memory there before the next run"),
    ):
        scene, reporter = joined(limits, free_bytes)
        (warning,) = reporter.warnings
        (memory,) = (decision for decision in reporter.decisions if decision.topic == "memory")
        assert memory.choice.startswith("models are joined in ") and memory.choice in warning
        assert lift in warning and "--resume" not in warning and "radiant join RUN" in warning
        assert scene.summary["num_steps"] > 0 and not scene.cut_for_memory
        assert aggregation(reporter) == "retraining all models together"


def test_a_lone_edges_model_is_not_said_to_be_joined_in_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(join_memory, "RASTERIZER_BYTES_PER_SPLAT", 5e6)
    needed = plan_join_memory([part(0)], CAMERAS[:1], 48, np.inf).needed_bytes
    reporter = Recorder()
    join_cloud(cloud_task("a", limits=Cloud(memory_bytes=needed - 1)), {"a": PAIR["a"]}, reporter)
    assert not reporter.warnings and [decision.topic for decision in reporter.decisions if decision.topic == "memory"] == []


def test_the_papers_cloud_crops_where_its_memory_ends_and_knows_no_tiles() -> None:
    needed = plan_join_memory([part(0), part(1)], CAMERAS[:2], 48, np.inf).needed_bytes
    cropped, reporter = joined(Cloud(memory_bytes=needed - 1), join=replace(aggregate_preset("paper").cloud, epochs=1))
    assert "num_dropped" in cropped.summary and "memory" in reporter.warnings[0]


def test_settings_that_ask_for_crop_merge_get_it_without_any_choice() -> None:
    scene, reporter = joined(Cloud(memory_bytes=1.0), join=Join(epochs=1, method="crop_merge"))
    merged = crop_merge([part(0), part(1)], np.array([[x, 0.0] for x in MIDDLES[:2]]), np.zeros(2))
    assert scene.splats is not None and not reporter.warnings
    np.testing.assert_array_equal(scene.splats.means, merged.means)
    assert [decision.topic for decision in reporter.decisions if decision.topic == "aggregation"] == []
    assert scene.summary["num_dropped"] == len(part(0)) + len(part(1)) - len(merged) > 0


def test_the_papers_cloud_crops_where_its_limits_end() -> None:
    paper = replace(aggregate_preset("paper").cloud, epochs=1)
    retrained, _ = joined(join=paper)
    assert retrained.summary["num_steps"] == 4 and retrained.splats is not None and len(retrained.splats) == len(part(0)) + len(part(1))
    cropped, reporter = joined(Cloud(max_cameras=3), join=paper)
    assert "num_dropped" in cropped.summary and len(reporter.warnings) == 1


def test_a_refused_edge_is_named_and_its_neighbour_keeps_its_own_region() -> None:
    models = {**edge_models(), "b": "its bytes are not those that were signed."}
    reporter = Recorder()
    crop = Join(epochs=1, method="crop_merge")
    scene = join_cloud(cloud_task(*NAMES, join=crop), models, reporter)
    assert scene.refused == {"b": "its bytes are not those that were signed."} and scene.corrections["b"] is None
    assert reporter.warnings == ["the model of b is left out: its bytes are not those that were signed."]
    without = join_cloud(cloud_task("a", "c", join=crop), {name: models[name] for name in "ac"}, Recorder())
    assert scene.splats is not None and without.splats is not None
    np.testing.assert_array_equal(scene.splats.means, without.splats.means)


@pytest.mark.parametrize("names", [NAMES, ()])
def test_a_cloud_that_gets_nothing_has_no_scene(names: tuple[str, ...]) -> None:
    scene = join_cloud(cloud_task(*names), dict.fromkeys(names, "nothing arrived."), Recorder())
    assert scene.splats is None and list(scene.refused) == list(names) and not scene.cut_for_memory
