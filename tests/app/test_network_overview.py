"""What people see of the nodes of a network: who joined, who is offline since when, what arrived, what was refused and why."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from radiant_app.commands.network import node as commands
from radiant_app.network.overview import read_rows
from tests.app.test_network_reception import World, poll_body


@pytest.fixture
def world(tmp_path: Path) -> World:
    return World(tmp_path / "made")


def text(world: World) -> str:
    (line,) = (row.text for row in read_rows(world.home.folder) if row.node == "edges/north")
    return line


def test_a_node_is_shown_with_its_task_and_what_arrived(world: World) -> None:
    assert text(world) == "edges/north: joined, edges/north/count offered"
    world.ask("POST", f"/results/{world.task.digest}", world.announcement())
    world.answer(world.part(0, world.report.read_bytes()[:20_000]))
    assert text(world).endswith(", 0.02 of 0.05 MB")
    world.answer(world.part(20_000, world.report.read_bytes()[20_000:]))
    assert text(world).endswith("edges/north/count received, 0.05 of 0.05 MB")


def test_who_is_silent_is_offline_since_then(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    world.ask("POST", "/poll", poll_body())
    then = time.time()
    monkeypatch.setattr("time.time", lambda: then + 3600)
    assert text(world).startswith(f"edges/north: offline since {time.strftime('%H:%M', time.localtime(then))}")
    monkeypatch.setattr("time.time", lambda: then - 3600)
    assert text(world).startswith("edges/north: joined"), "the clock was set back"


def test_a_refusal_says_why_until_the_node_asks_right(world: World) -> None:
    world.ask("POST", "/poll", poll_body("0.0.1"))
    assert "refused: this node has Radiant 0.0.1" in text(world)
    world.ask("POST", "/poll", poll_body())
    assert "refused" not in text(world)
    world.hub.withdraw(world.task.digest, "nothing was heard of it for 15 minutes")
    assert text(world).endswith("edges/north/count withdrawn (nothing was heard of it for 15 minutes)")


def test_strangers_write_no_row(world: World) -> None:
    before = text(world)
    asked = world.sealed("POST", "/poll", poll_body())
    world.answer(type(asked)(method="POST", target="/poll", headers={**asked.headers, "x-radiant-seal": "AAAA"}, body=asked.body))
    assert text(world) == before


def test_invited_and_revoked_nodes_are_shown_after_the_hub_ended(world: World) -> None:
    world.store.invite("edges/south", "w")
    world.store.revoke("edges/north")
    world.store.close()
    record = commands.status(world.home.folder)
    assert [(row["node"], row["state"]) for row in record["nodes"]] == [("edges/north", "revoked"), ("edges/south", "invited")]
    assert commands.status_lines(record)[-1] == "edges/south: invited"
    assert read_rows(world.home.folder / "nowhere") == []
