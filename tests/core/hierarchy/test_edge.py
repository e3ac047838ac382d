"""An edge: a refusal costs the others no bit, a lone model stays, memory decides between at once, tiles and a cut."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.aggregate import join_memory
from radiant_core.aggregate.config import EDGE_EPOCHS, Join, aggregate_preset
from radiant_core.aggregate.join_memory import plan_join_memory
from radiant_core.hierarchy.edge import join_edge
from radiant_core.hierarchy.join_limits import MACHINE_SHARE
from radiant_core.hierarchy.reporter import Machine, Recorder
from radiant_core.splats import Splats, morton_order
from tests.core.hierarchy.grounds import AGGREGATE, CAMERAS, NAMES, device_models, edge_task, part


def assert_same(ours: Splats | None, theirs: Splats | None) -> None:
    assert ours is not None and theirs is not None
    for name, array in ours.arrays().items():
        np.testing.assert_array_equal(array, theirs.arrays()[name], err_msg=name)


def choices(reporter: Recorder, topic: str) -> list[str]:
    return [decision.choice for decision in reporter.decisions if decision.topic == topic]


def test_a_refused_device_is_named_and_changes_no_bit_of_what_the_others_make() -> None:
    reporter = Recorder(stage="edges/north")
    models = device_models()
    found = join_edge(edge_task(*NAMES), {**models, "b": "its signature is another's."}, reporter)
    assert found.refused == {"b": "its signature is another's."} and found.corrections["b"] is None
    assert [move is None for move in map(found.corrections.get, NAMES)] == [False, True, False]
    assert reporter.warnings == ["the model of b is left out: its signature is another's."]
    assert {decision.stage for decision in reporter.decisions} == {"edges/north"}
    assert found.summary["num_models"] == 2 and found.summary["num_steps"] > 0
    others = {name: models[name] for name in "ac"}
    without = join_edge(edge_task("a", "c"), others, Recorder())
    assert_same(found.splats, without.splats)
    np.testing.assert_array_equal(found.cameras.cam_from_world, without.cameras.cam_from_world)


def test_whoever_sends_more_cameras_than_photographs_or_a_model_elsewhere_is_refused() -> None:
    models = device_models()
    far = replace(models["c"], splats=replace(part(2), means=part(2).means + np.float32(500)))
    found = join_edge(edge_task(*NAMES, num_dealt=(2, 1, 2)), {**models, "c": far}, Recorder())
    assert found.refused["b"] == "it sends 2 cameras, where 1 photographs were dealt to it."
    assert list(found.refused) == ["b", "c"] and "its own cameras see 0.0%" in found.refused["c"]
    assert_same(found.splats, join_edge(edge_task("a"), {"a": models["a"]}, Recorder()).splats)


def test_an_edge_all_of_whose_devices_are_refused_has_no_model() -> None:
    reporter = Recorder()
    found = join_edge(edge_task("a", "b"), dict.fromkeys("ab", "nothing arrived."), reporter)
    assert found.splats is None and not len(found.cameras)
    assert found.refused == dict.fromkeys("ab", "nothing arrived.") and found.corrections == dict.fromkeys("ab")
    assert len(reporter.warnings) == 2 and not reporter.decisions


def test_a_lone_devices_model_passes_as_it_is_along_a_z_curve() -> None:
    reporter = Recorder()
    models = {"a": device_models()["a"]}
    found = join_edge(edge_task("a"), models, reporter)
    assert_same(found.splats, part(0).select(morton_order(part(0).means)))
    assert choices(reporter, "retraining") == ["skipped"] and found.summary["num_steps"] == 0
    assert len(found.cameras) == 2, "the cloud renders what the model shows"
    retrained = join_edge(edge_task("a", join=replace(aggregate_preset("paper").edge, epochs=1)), models, Recorder())
    assert retrained.summary["num_steps"] == 2


def test_virtual_cameras_follow_from_what_arrived_and_stand_where_no_device_stood() -> None:
    models = device_models()
    found, again = (join_edge(edge_task("a", "b"), {name: models[name] for name in "ab"}, Recorder()) for _ in range(2))
    np.testing.assert_array_equal(found.cameras.cam_from_world, again.cameras.cam_from_world)
    other = {**models, "a": replace(models["a"], received={"model.safetensors": "f" * 64})}
    drawn = join_edge(edge_task("a", "b"), {name: other[name] for name in "ab"}, Recorder())
    assert_same(found.splats, drawn.splats)
    assert (found.cameras.centers != drawn.cameras.centers).any()
    assert not np.isin(found.cameras.centers, [own.centers for own in CAMERAS]).any()
    assert not len(join_edge(edge_task("a", draws_cameras=False), {"a": models["a"]}, Recorder()).cameras)


def test_an_edge_shows_each_view_as_often_as_its_own_epochs_say_whatever_the_cloud_does() -> None:
    models = {name: device_models()[name] for name in "ab"}
    for draws_cameras in (True, False):
        joined = join_edge(edge_task("a", "b", draws_cameras=draws_cameras), models, Recorder())
        assert joined.summary["num_steps"] == 4 * EDGE_EPOCHS
    thrice = join_edge(edge_task("a", "b", join=Join(epochs=3)), models, Recorder())
    assert thrice.summary["num_steps"] == 12


def test_where_the_pictures_lie_changes_no_bit(tmp_path: Path) -> None:
    models = {name: device_models()[name] for name in "ab"}
    stored = join_edge(edge_task("a", "b"), models, Recorder(), Machine(scratch=tmp_path))
    assert_same(stored.splats, join_edge(edge_task("a", "b"), models, Recorder()).splats)
    assert list(tmp_path.iterdir()) == [], "the file has no name"


def test_what_exceeds_an_edges_memory_is_cut_with_a_warning_that_says_how_to_join() -> None:
    models = {name: device_models()[name] for name in "ab"}
    reporter = Recorder(stage="edges/north")
    found = join_edge(edge_task("a", "b", memory_bytes=1e8), models, reporter)
    (warning,) = reporter.warnings
    assert "memory_gb of this edge allows 100 MB" in warning and "raise memory_gb of this edge" in warning and "radiant join" in warning
    assert choices(reporter, "memory") == ["models are cut at their borders instead of retrained"]
    assert found.splats is not None and found.summary["num_steps"] == 0 and not found.cut_for_memory
    assert 0 < len(found.splats) < sum(len(model.splats) for model in models.values())
    enough = Recorder()
    assert_same(
        join_edge(edge_task("a", "b", memory_bytes=1e9), models, enough).splats, join_edge(edge_task("a", "b"), models, Recorder()).splats
    )
    assert not enough.warnings


def test_without_a_limit_edges_share_what_their_machine_has_free() -> None:
    models = {name: device_models()[name] for name in "ab"}
    needed = plan_join_memory([part(0), part(1)], CAMERAS[:2], 48, np.inf).needed_bytes
    free = 1.01 * needed / MACHINE_SHARE
    plain = join_edge(edge_task("a", "b"), models, Recorder())
    alone, among_two = Recorder(), Recorder()
    assert_same(join_edge(edge_task("a", "b"), models, alone, Machine(free_bytes=lambda: free)).splats, plain.splats)
    assert not alone.warnings
    found = join_edge(edge_task("a", "b"), models, among_two, Machine(free_bytes=lambda: free, num_edges=2))
    (warning,) = among_two.warnings
    assert found.summary["num_steps"] == 0, "half of the memory holds no tile of so small models"
    assert "80% of what this machine has free, divided among 2 edges at a time, allows" in warning
    assert (
        "free memory there before the next run (--resume tries a cut again), or give this edge memory_gb" in warning
        and "radiant join RUN" in warning
    )
    assert found.cut_for_memory, "another try may join"
    # What its process holds already is not asked of the memory that is free.
    holds = Machine(free_bytes=lambda: 1e6, held_bytes=lambda: needed, num_edges=16)
    assert_same(join_edge(edge_task("a", "b"), models, Recorder(), holds).splats, plain.splats)
    # What the system file says counts before what is free.
    given = Recorder()
    assert_same(
        join_edge(edge_task("a", "b", memory_bytes=1.01 * needed), models, given, Machine(free_bytes=lambda: 1.0)).splats, plain.splats
    )
    assert not given.warnings


def test_what_exceeds_an_edges_memory_by_little_is_joined_in_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    # Tiles spare little of 300 Gaussians: most of the memory is the process's and the views'.
    monkeypatch.setattr(join_memory, "RASTERIZER_BYTES_PER_SPLAT", 5e6)
    models = {name: device_models()[name] for name in "ab"}
    at_once = plan_join_memory([part(0), part(1)], CAMERAS[:2], 48, np.inf).needed_bytes
    reporter = Recorder()
    found = join_edge(edge_task("a", "b", memory_bytes=at_once - 1), models, reporter)
    (warning,) = reporter.warnings
    (choice,) = choices(reporter, "memory")
    assert choice.startswith("models are joined in ") and choice in warning and "raise memory_gb of this edge" in warning
    assert found.splats is not None and found.summary["num_steps"] > 0
    paper = Recorder()
    join = replace(aggregate_preset("paper").edge, epochs=1)
    cut = join_edge(edge_task("a", "b", join=join, memory_bytes=at_once - 1), models, paper)
    assert cut.summary["num_steps"] == 0 and choices(paper, "memory") == ["models are cut at their borders instead of retrained"]


def test_no_field_of_the_config_is_needed_to_pass_a_lone_model() -> None:
    for join in (AGGREGATE.edge, Join(epochs=1)):
        found = join_edge(edge_task("c", join=join), {"c": device_models()["c"]}, Recorder())
        assert found.splats is not None and len(found.splats) == len(part(2))
