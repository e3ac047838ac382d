"""A device whose start cannot be used: it is refused by name and ends, and the others train on."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from radiant_app.events import Event, StageProgress, Warned
from radiant_app.executors.fold import RetryPolicy
from radiant_app.executors.local import LocalExecutor
from radiant_app.run.groups import end_groups, prepare_meetings, tell_parents, with_groups
from radiant_core.hierarchy.messages import CloudTask
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.io.ply import load_ply
from radiant_core.io.run_store import is_sealed, read_json
from tests.contract.lying_worker import LIAR
from tests.contract.test_hierarchy import World
from tests.contract.test_together import all_of_the_hamlet, fold, one_edge_of_two, pids_of
from tests.forked_workers import forked_workers


@pytest.mark.parametrize(
    ("world_of", "root", "liar"), [(all_of_the_hamlet, "cloud", "edge-2-2"), (one_edge_of_two, "edges/edge-1", "edge-1-2")]
)
def test_a_device_with_more_cameras_than_were_dealt_to_it_is_refused_and_ends(
    world_of: Callable[[Path], World], root: str, liar: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "world").mkdir()
    world, warned = world_of(tmp_path / "world"), list[str]()
    dealer, run = world.dealer(tmp_path / "run"), tmp_path / "run"
    count = dealer.photographs.num_dealt
    monkeypatch.setattr(dealer.photographs, "num_dealt", lambda device: 1 if device == liar else count(device))
    cloud_task = Recipe.cloud_task

    def of_one_less(recipe: Recipe, *arguments: Any) -> CloudTask:
        task = cloud_task(recipe, *arguments)
        if root != "cloud":
            return task
        names = list(recipe.groups[root].of_devices)
        return replace(task, of_devices=tuple(1 if name == liar else count for name, count in zip(names, task.of_devices, strict=True)))

    monkeypatch.setattr(Recipe, "cloud_task", of_one_less)

    def listen(event: Event) -> None:
        if isinstance(event, Warned):
            warned.append(f"{event.stage}: {event.message}")

    policy = RetryPolicy(
        may_fail=lambda node, error: node.tier == "device", on_given_up=tell_parents(run, world.recipe, lambda node, begun: None)
    )
    prepare_meetings(run, world.recipe)
    begun_s = time.monotonic()
    with forked_workers(tmp_path) as command:
        executor = LocalExecutor(num_workers=2, command=command, retry_policy=policy)
        executor.fold(with_groups(world.tree, world.recipe.groups), dealer.prepare, listen)
    end_groups(run, world.recipe)
    assert time.monotonic() - begun_s < 100, warned
    assert len(load_ply(run / "cloud" / "scene.ply")) > 100
    edge = f"edges/{liar.rsplit('-', 1)[0]}"
    moves, refused = (read_json(run / edge / name) for name in ("corrections.json", "refused.json"))
    assert moves[liar] is None and sum(move is not None for move in moves.values()) == len(moves) - 1
    assert list(refused) == [liar] and "where 1 photographs were dealt" in refused[liar]
    assert not is_sealed(run / "devices" / liar, dealer.keys[f"devices/{liar}"])
    assert any(f"devices/{liar}" in message and "refuses what this device begins with" in message for message in warned), warned
    assert any(f"steps go on without {liar}" in message for message in warned), warned
    assert read_json(run / root / "summary.json")["num_refused"] == 0


def test_two_devices_of_which_one_lies_are_both_named_once_although_their_edge_is_killed(tmp_path: Path) -> None:
    (tmp_path / "world").mkdir()
    world, run, warned, killed = all_of_the_hamlet(tmp_path / "world"), tmp_path / "run", list[str](), threading.Event()
    edge, honest = f"edges/{LIAR.rsplit('-', 1)[0]}", "edge-1-1"

    def listen(event: Event) -> None:
        if isinstance(event, Warned):
            warned.append(f"{event.stage}: {event.message}")
        if isinstance(event, StageProgress) and event.stage == "cloud" and event.done >= 30 and not killed.is_set():
            killed.set()
            for pid in pids_of(run / edge):
                os.kill(pid, signal.SIGKILL)

    policy = RetryPolicy(max_attempts=3)
    with forked_workers(tmp_path, "tests.contract.lying_worker") as command:
        fold(world, run, LocalExecutor(num_workers=2, command=command, retry_policy=policy), listen)
    assert killed.is_set() and any(message.startswith(f"{edge}: ") and "tried again" in message for message in warned), warned
    (named,) = [message for message in warned if message.startswith(f"{edge}: {honest} and {LIAR} contradict each other")]
    assert "as long as edge-1-2's" in named and "all of them count" in named
    # The other edge has two honest devices, and nothing to say.
    assert not any("edges/edge-2: " in message and "contradict" in message for message in warned)
