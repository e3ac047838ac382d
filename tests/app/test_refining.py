"""Refining a scene where a device is late or sends nothing: how long it is waited for, and who tells of it. Processes are stand-ins."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_app.events import Event, Warned
from radiant_app.executors.fold import RetryPolicy
from radiant_app.executors.local import LocalExecutor
from radiant_app.executors.protocol import NodeTask
from radiant_app.reporting import EventReporter
from radiant_app.run import refining_deadlines
from radiant_app.run.dealing import Dealer, Refining
from radiant_app.run.refining import LATE, UNUSED, fold_rounds, left_out, left_out_decision, partly_left_out
from radiant_app.run.refining_deadlines import RefiningDeadlines, expected_times
from radiant_app.run.time_left import LEAST_S, OVERDUE_FACTOR
from radiant_app.workers.delivering import exchange_keys
from radiant_app.workers.refining import (
    COUNTED_SCHEMA,
    KEPT_SCENE,
    NEXT_SCENE,
    NOTHING_REFINED,
    REFINED_SCENE,
    counted_file,
    is_counted,
    run_finish,
)
from radiant_app.workers.tasks import FinishTask
from radiant_core.aggregate.config import Refine
from radiant_core.aggregate.tree import Tree, refined_at, refines_for, round_of, tree_of_round
from radiant_core.hierarchy.codec import CAMERAS_NAME, REFINED_NAME, ROWS_NAME
from radiant_core.hierarchy.refining_plan import choose_rounds, plan_refining, refining_steps
from radiant_core.io.array_file import save_arrays
from radiant_core.io.ply import save_ply
from radiant_core.io.run_store import file_sha256, read_json, seal, write_json
from radiant_core.io.transport.delivery import RECORD_NAME, SIGNATURE_NAME
from radiant_core.regimes import ENOUGH_SHOWS, HARDLY_SHOWN, SHORT_SHOWS, SHORT_STEPS
from tests.app.test_faults import planned
from tests.core.scenes import ground_splats

HANG = """
from radiant_app.events import Heartbeat, encode
import time
while True:
    print(encode(Heartbeat(stage="x")), flush=True)
    time.sleep(0.1)
"""
SEAL = (
    "from radiant_core.io.run_store import seal, write_json\nwrite_json(Path('refused.json'), {})\nseal(Path('.'), 'key', ['refused.json'])"
)


@pytest.fixture
def dealer(tmp_path: Path) -> Dealer:
    """Two edges of two devices, the scene of which has twice the Gaussians of any model."""
    dealer, tree = planned(tmp_path)
    for node in tree:
        (tmp_path / node.id).mkdir(parents=True)
        size = {"num_splats": 2000 if node.tier == "cloud" else 1000}
        write_json(tmp_path / node.id / "summary.json", size | {"num_steps": 200, "train_s": 20.0})
    devices = {edge.name: tuple(device.name for device in edge.children) for edge in tree.children}
    dealer.refining = Refining(run=tmp_path, devices=devices, moves={node.name: () for node in tree if node.tier == "device"})
    return dealer


def tree_of(dealer: Dealer, number: int = 1) -> Tree:
    assert dealer.refining is not None
    return tree_of_round(dealer.refining.devices, number)


def rounds_of(dealer: Dealer) -> tuple[Tree, ...]:
    return tuple(tree_of(dealer, number) for number in range(1, choose_rounds(dealer.recipe) + 1))


def times_of(seconds: dict[str, float]) -> dict[str, dict[str, float]]:
    return {stage: {"started_s": 5.0, "ended_s": 5.0 + spent_s} for stage, spent_s in seconds.items()}


def nodes_of(tree: Tree, tier: str) -> list[Tree]:
    return [node for node in tree if node.tier == tier]


def test_refining_is_expected_to_take_as_long_as_its_share_of_what_was_measured(dealer: Dealer) -> None:
    devices, edges = nodes_of(tree_of(dealer), "device"), nodes_of(tree_of(dealer), "edge")
    owners = [node.id.removesuffix("/refine") for node in devices]
    seconds = {owners[0]: 26.0, owners[1]: 32.0, "edges/edge-1": 7.0, "cloud": 3.0}
    expected = expected_times(dealer, tree_of(dealer), times_of(seconds))
    epochs = dealer.recipe.refining_epochs
    dealt = [dealer.photographs.num_dealt(Path(owner).name) for owner in owners]
    # 20 of a process's seconds trained, 0.1 s a step on half the scene's Gaussians.
    times = [spent_s - 20 + 2 * 0.1 * refining_steps(epochs, count) for spent_s, count in zip((26.0, 32.0), dealt, strict=False)]
    assert [expected[node.id] for node in devices[:2]] == pytest.approx(times)
    assert [expected[node.id] for node in devices[2:]] == pytest.approx([sum(times) / 2] * 2), "the median of those that are known"
    # Twice the 7 s of joining, and 0.2 s for each photograph that an edge renders; the other edge is as its kind.
    rendered_s = 14 + 0.2 * sum(dealer.photographs.num_dealt(Path(child.id).parent.name) for child in edges[0].children)
    assert [expected[node.id] for node in edges] == pytest.approx([rendered_s] * 2) and expected["cloud/refine"] == 3.0
    assert expected_times(dealer, tree_of(dealer), times_of({})) == {}, "what was never measured has no deadline"
    assert set(expected_times(dealer, tree_of(dealer), times_of({"cloud": 0.0}))) == set()


def test_the_rule_is_that_of_trainings(dealer: Dealer) -> None:
    del dealer
    deadlines = RefiningDeadlines(expected_s={"devices/a/refine": 30.0, "devices/b/refine": 1.0}, deadline_factor=10.0)
    assert deadlines.timeout_reason("devices/a/refine", 299.0) is None
    reason = deadlines.timeout_reason("devices/a/refine", 300.0)
    assert reason == "it has run for 300 s, where its own work before the scene was joined says 30 s"
    assert deadlines.overdue_reason("devices/a/refine", OVERDUE_FACTOR * 30) is not None
    assert deadlines.timeout_reason("devices/b/refine", LEAST_S - 1) is None is not deadlines.timeout_reason("devices/b/refine", LEAST_S)
    assert deadlines.timeout_reason("devices/c/refine", 1e9) is None
    patient = replace(deadlines, deadline_factor=0.0)
    assert patient.timeout_reason("devices/a/refine", 1e9) is None is not patient.overdue_reason("devices/a/refine", 1e9)


def test_who_hangs_with_a_heartbeat_is_given_up_left_out_and_named(dealer: Dealer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(refining_deadlines, "LEAST_S", 2.0)
    tree, run = tree_of(dealer), dealer.run
    late = nodes_of(tree_of(dealer), "device")[1]

    def command(task: NodeTask) -> list[str]:
        work = HANG if task.stage == late.id else SEAL
        return [sys.executable, "-c", f"import os; os.chdir({str(task.folder)!r})\nfrom pathlib import Path\n{work}"]

    def prepare(node: Tree) -> NodeTask:
        (run / node.id).mkdir(parents=True, exist_ok=True)
        dealer.keys[node.id] = "key"
        return NodeTask(kind=node.tier, stage=node.id, folder=run / node.id, key="key")

    events: list[Event] = []
    # The stand-ins of the others take as long as a busy machine lets them.
    expected_s = {node.id: 0.1 if node.id == late.id else 1e4 for node in tree}
    deadlines = RefiningDeadlines(expected_s=expected_s, deadline_factor=1.0)
    policy = RetryPolicy(may_fail=lambda node, error: True, max_attempts=3, deadlines=deadlines)
    LocalExecutor(num_workers=4, command=command, retry_policy=policy).fold(tree, prepare, events.append)
    assert any(isinstance(event, Warned) and event.stage == late.id and "was given up" in event.message for event in events)
    name = Path(late.id).parent.name
    assert left_out(dealer, [tree_of(dealer)]) == {name: LATE}
    decision = left_out_decision("cloud/refine", left_out(dealer, [tree_of(dealer)]), 4)
    assert name in decision.choice and (decision.figure, decision.unit) == (1.0, "of 4 devices") and "given up" in decision.reason


def test_every_device_that_did_not_refine_the_scene_has_its_reason(dealer: Dealer) -> None:
    run = dealer.run
    (first, second, third, fourth), edges = nodes_of(tree_of(dealer), "device"), nodes_of(tree_of(dealer), "edge")
    names = [Path(node.id).parent.name for node in (first, second, third, fourth)]

    def done(node: str, refused: dict[str, str]) -> None:
        (run / node).mkdir(parents=True, exist_ok=True)
        write_json(run / node / "refused.json", refused)
        seal(run / node, "key", ["refused.json"])
        dealer.keys[node] = "key"

    assert left_out(dealer, [tree_of(dealer)]) == dict.fromkeys(names, LATE), "none has begun"
    for node in (first, second, third, fourth):
        done(node.id, {})
    assert left_out(dealer, [tree_of(dealer)]) == dict.fromkeys(names, UNUSED)
    done(edges[0].id, {names[1]: "its signature is not its own."})
    done(edges[1].id, {})
    done("cloud/refine", {})
    assert left_out(dealer, [tree_of(dealer)]) == {names[1]: "its signature is not its own."}
    done("cloud/refine", {Path(edges[1].id).parent.name: NOTHING_REFINED})
    assert left_out(dealer, [tree_of(dealer)]) == {
        names[1]: "its signature is not its own.",
        names[2]: NOTHING_REFINED,
        names[3]: NOTHING_REFINED,
    }


def done_in(dealer: Dealer, node: str, refused: dict[str, str]) -> None:
    run = dealer.run
    write_json(run / node / "refused.json", refused)
    seal(run / node, "key", ["refused.json"])
    dealer.keys[node] = "key"


@pytest.mark.usefixtures("usual_rounds")
def test_a_second_round_is_for_trainings_that_left_something_to_fit(dealer: Dealer) -> None:
    recipe = dealer.recipe
    assert dealer.refining is not None
    photographs = sum(len(recipe.cameras_of(Path(node.id).parent.name)) for node in nodes_of(tree_of(dealer), "device"))
    # 4 devices, so that a photograph is shown 4 × steps / photographs times.
    steps_of = {shows: photographs * shows // 4 for shows in (HARDLY_SHOWN - 1, SHORT_SHOWS - 1, ENOUGH_SHOWS - 1, ENOUGH_SHOWS + 1)}
    assert steps_of[SHORT_SHOWS - 1] < SHORT_STEPS <= steps_of[ENOUGH_SHOWS - 1]
    hardly, few, some, often = (replace(recipe, train=replace(recipe.train, num_steps=steps)) for steps in steps_of.values())
    assert [choose_rounds(each) for each in (hardly, few, some, often)] == [5, 2, 3, 1]
    assert choose_rounds(replace(often, num_photographs=2 * photographs)) == 2, "where a recipe knows a part of a run's plans"
    asked = replace(often, aggregate=replace(often.aggregate, refine=Refine(rounds=2)))
    by_steps = replace(often, train=replace(often.train, num_steps=SHORT_STEPS - 1), num_photographs=4)
    for each, number, forced, why in (
        (hardly, 5, False, "below 30"),
        (few, 2, False, "up to 4 devices"),
        (some, 3, False, "below 75"),
        (often, 1, False, "from 75"),
        (asked, 2, True, "asked for; the default after such trainings is 1"),
        (by_steps, 2, False, "up to 4 devices"),
    ):
        decision = plan_refining(each, dealer.refining.devices, 1000).decisions[-1]
        assert (decision.topic, decision.forced) == ("rounds of refining", forced) and f" {number} round" in decision.choice
        epochs = 5 if each is by_steps else 8
        assert f" of at most {epochs} epochs" in decision.choice
        devices = (Path(node.id).parent.name for node in nodes_of(tree_of(dealer), "device"))
        assert {each.refine_task(device).epochs for device in devices} == {epochs}
        assert why in decision.reason and ("steps" in decision.unit) == (each is by_steps)
        assert decision.figure == pytest.approx(SHORT_STEPS - 1 if each is by_steps else each.train.num_steps * 4 / photographs)
    once = replace(by_steps, aggregate=replace(by_steps.aggregate, refine=Refine(epochs=1)))
    decision = plan_refining(once, dealer.refining.devices, 1000).decisions[-1]
    assert decision.forced and decision.choice.endswith("2 rounds of at most 1 epoch")
    none = replace(often, aggregate=replace(often.aggregate, refine=Refine(epochs=0)))
    assert plan_refining(none, dealer.refining.devices, 1000).decisions == ()


def test_every_round_refines_the_scene_of_the_last_one_that_made_one(dealer: Dealer) -> None:
    recipe = dealer.recipe
    dealer.recipe = replace(recipe, aggregate=replace(recipe.aggregate, refine=Refine(rounds=3)))
    rounds, heard = rounds_of(dealer), list[Event]()
    assert len(rounds) == 3
    started: list[Path | None] = []
    late = Path(nodes_of(tree_of(dealer), "device")[0].id).parent.name

    def fold(tree: Tree) -> None:
        started.append(dealer.refined_by(round_of(tree.id) - 1))
        for node in tree:
            owner = refines_for(node.id)
            (dealer.run / node.id).mkdir(parents=True, exist_ok=True)
            if (owner, round_of(tree.id)) not in {(f"devices/{late}", 2), ("cloud", 3)}:
                done_in(dealer, node.id, {})

    tried = fold_rounds(dealer, rounds, fold, heard.append)
    assert started == [None, dealer.run / "cloud/refine/refined", dealer.run / "cloud/refine2/refined"]
    assert dealer.refined == dealer.run / "cloud/refine2/refined", "what the second round made is kept"
    warned = [event.message for event in heard if isinstance(event, Warned)]
    assert warned == ["the scene stays as round 2 left it: no refinement arrived; --resume tries again."]
    assert left_out(dealer, tried) == {} and partly_left_out(dealer, tried) == {late: f"not in round 2: {LATE}"}


def test_a_round_of_which_nothing_came_is_the_last_and_leaves_the_joined_scene(dealer: Dealer) -> None:
    heard: list[Event] = []
    tried = fold_rounds(dealer, rounds_of(dealer), lambda tree: None, heard.append)
    assert len(tried) == 1 and dealer.refined is None
    names = {Path(node.id).parent.name for node in nodes_of(tree_of(dealer), "device")}
    assert left_out(dealer, tried) == dict.fromkeys(names, LATE)
    (warned,) = [event.message for event in heard if isinstance(event, Warned)]
    assert warned == "the scene stays as the cloud left it: no refinement arrived; --resume tries again."


def test_rounds_in_which_no_device_changed_anything_leave_the_scene_and_what_only_faded_is_cut(dealer: Dealer) -> None:
    run = dealer.run

    def fold(tree: Tree) -> None:
        for node in tree:
            (run / node.id).mkdir(parents=True, exist_ok=True)
            refused = dict.fromkeys([Path(child.id).parent.name for child in node.children], "it changed no Gaussian of the scene.")
            done_in(dealer, node.id, refused if node.tier == "edge" else {})

    tried = fold_rounds(dealer, rounds_of(dealer), fold, lambda event: None)
    assert len(left_out(dealer, tried)) == 4 and dealer.refined is None
    (run / "cloud" / "cut").mkdir()
    (run / "cloud" / "cut" / "scene.ply").touch()
    assert [*dealer.versions] == ["joined", "cut"]
    write_json(run / "cloud" / "summary.json", {"num_splats": 2000, "num_steps": 0, "only_faded": 1})
    assert [*dealer.versions] == ["cut", "joined"] and dealer.scene_folder == run / "cloud" / "cut"


def test_nodes_of_rounds_are_told_from_others_by_their_ids() -> None:
    assert [refined_at("devices/a", number) for number in (1, 2, 12)] == ["devices/a/refine", "devices/a/refine2", "devices/a/refine12"]
    for owner in ("devices/a", "cloud", "devices/refine", "edges/refine2"):
        assert {refines_for(refined_at(owner, number)) for number in (1, 2, 10)} == {owner} == {refines_for(owner)}
    assert refines_for("devices/a/score") == "devices/a/score"


@pytest.mark.parametrize("another_round", [False, True])
def test_the_cloud_writes_a_next_start_where_a_round_follows_and_keeps_what_nobody_refined(another_round: bool, tmp_path: Path) -> None:
    scene, kept = ground_splats(50), ground_splats(50, seed=1)
    (tmp_path / "kept").mkdir()
    save_ply(tmp_path / "scene.ply", scene)
    save_ply(tmp_path / KEPT_SCENE, kept)
    reporter = EventReporter(stage="cloud/refine2", emit=lambda event: None)
    task = FinishTask(senders=(), num_dealt=(), another_round=another_round)
    assert (NEXT_SCENE in run_finish(tmp_path, task, reporter)) == another_round == (tmp_path / NEXT_SCENE).is_file()
    assert (tmp_path / REFINED_SCENE).read_bytes() == (tmp_path / KEPT_SCENE).read_bytes()


def test_the_cloud_is_dealt_what_the_round_before_made(dealer: Dealer) -> None:
    recipe = dealer.recipe
    dealer.recipe = replace(recipe, aggregate=replace(recipe.aggregate, refine=Refine(rounds=2)))
    first, second = rounds_of(dealer)
    folder = dealer.run / first.id
    for name, brighter in ((REFINED_SCENE, 0.0), (NEXT_SCENE, 0.1)):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        splats = ground_splats(50)
        save_ply(folder / name, replace(splats, sh0=splats.sh0 + brighter))
    exchange_keys(dealer.run, "cloud", None)
    done_in(dealer, first.id, {})
    for each in nodes_of(second, "edge"):
        (dealer.run / each.id).mkdir(parents=True, exist_ok=True)
        done_in(dealer, each.id, {})
        for name in (REFINED_NAME, ROWS_NAME, RECORD_NAME, SIGNATURE_NAME):
            (dealer.run / each.id / name).write_bytes(b"")
    assert dealer.prepare(second) is not None
    dealt = dealer.run / second.id
    assert (dealt / "scene.ply").read_bytes() == (folder / NEXT_SCENE).read_bytes()
    assert (dealt / KEPT_SCENE).read_bytes() == (folder / REFINED_SCENE).read_bytes()


def test_a_count_holds_for_its_scene_alone(dealer: Dealer) -> None:
    """What an edge counted in an earlier round is read where it lies, unless it is of what another --resume had joined."""
    recipe, run = dealer.recipe, dealer.run
    dealer.recipe = replace(recipe, aggregate=replace(recipe.aggregate, refine=Refine(rounds=2)))
    save_ply(run / "cloud" / "scene.ply", ground_splats(50))
    second = rounds_of(dealer)[1]
    (edge, *_) = nodes_of(second, "edge")
    owner, names = refines_for(edge.id), [refines_for(child.id).split("/")[1] for child in edge.children]
    for child, name in zip(edge.children, names, strict=True):
        (run / child.id).mkdir(parents=True, exist_ok=True)
        done_in(dealer, child.id, {})
        for file in (REFINED_NAME, ROWS_NAME, RECORD_NAME, SIGNATURE_NAME):
            (run / child.id / file).write_bytes(b"")
        (run / owner / "inbox" / name).mkdir(parents=True, exist_ok=True)
        (run / owner / "inbox" / name / CAMERAS_NAME).write_bytes(b"")

    def counted_in(joined: str) -> list[int]:
        path = run / refined_at(owner) / counted_file(names[0])
        path.parent.mkdir(parents=True, exist_ok=True)
        save_arrays(path, COUNTED_SCHEMA, {"photographs": np.ones(50, np.float32)}, {"joined": joined})
        assert dealer.prepare(edge) is not None
        return read_json(run / edge.id / "task.json")["counted_in"]

    exchange_keys(run, "cloud", None, [owner])
    exchange_keys(run, owner, "cloud")
    others = [0] * (len(names) - 1)
    assert counted_in(file_sha256(run / "cloud" / "scene.ply")) == [1, *others]
    assert counted_in("0" * 64) == [0, *others]
    (run / refined_at(owner) / counted_file(names[0])).write_bytes(b"half of a fi")
    assert not is_counted(run / refined_at(owner) / counted_file(names[0]), "0" * 64)
