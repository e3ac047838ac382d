"""SIGKILL of the cloud, an edge or a device: started again, the run ends by itself with the scene of a run left alone."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.app.network_processes import CHECKPOINTS, Fleet, run_here
from tests.forked_workers import forked_workers


def has_state(home: Path, stage: str, *states: str) -> Callable[[], bool]:
    """Whether a task of this stage is in one of these states at a node."""

    def found() -> bool:
        try:
            with sqlite3.connect(f"file:{home / 'hub.sqlite'}?mode=ro", uri=True) as database:
                rows = database.execute("select state from tasks where stage = ?", (stage,)).fetchall()
            database.close()
        except sqlite3.OperationalError:
            return False
        return any(row[0] in states for row in rows)

    return found


@pytest.fixture
def fleet(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    place = tmp_path_factory.mktemp("server")
    with forked_workers(place, "tests.app.network_worker"):
        fleet = Fleet(folder=tmp_path, workers=place / "workers")
        fleet.make()
        yield fleet
        fleet.close()


def test_a_run_whose_machines_are_killed_ends_with_the_scene_of_one_left_alone(fleet: Fleet) -> None:
    """The device in its training, the edge with its device's model and at the end, the cloud at the begin and before it joins."""
    kills: list[tuple[str, Callable[[], bool]]] = [
        ("cloud", has_state(fleet.folder / "cloud", "edges/e/count", "taken")),
        ("d", lambda: any((fleet.device_folder("d") / CHECKPOINTS).glob("*.json"))),
        ("e", has_state(fleet.folder / "e", "devices/d", "received", "accepted")),
        ("cloud", has_state(fleet.folder / "cloud", "edges/e", "received", "accepted")),
        ("e", has_state(fleet.folder / "cloud", "edges/e/score", "taken")),
    ]
    fleet.hold_training()
    assert fleet.run_with(kills) == len(kills), fleet.logs()
    assert (fleet.folder / "far" / "scene.ply").read_bytes() == run_here(fleet.folder, fleet.workers)
    first, *later = fleet.trained_from("own_field")
    assert first == 0 and later == fleet.saved_at_kill and all(step > 0 for step in later), "a training begins once"
