"""The version of a scene that is kept by held-out photographs: on one owner's machine and on devices that sign their figures."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from radiant_app.config.run_config import RunConfig
from radiant_app.events import Decided, Event, Warned
from radiant_app.executors.protocol import NodeTask
from radiant_app.network.contents import check_scores
from radiant_app.network.kinds import remove_earlier
from radiant_app.run.choosing import keep_best
from radiant_app.run.scoring import Scoring, ScoringMachine
from radiant_app.workers.delivering import exchange_keys
from radiant_app.workers.nodes import CUT_SCENE, run_node
from radiant_app.workers.score_files import SCORES_NAME
from radiant_core.aggregate.tree import Tree
from radiant_core.choices import Version
from radiant_core.errors import BadInput
from radiant_core.hierarchy.choosing import CUT, JOINED, REFINED
from radiant_core.io.ply import save_ply
from radiant_core.io.records import save_plan
from radiant_core.io.run_store import is_sealed, read_json, seal, write_json
from radiant_core.io.transport.delivery import RECORD_NAME, SIGNATURE_NAME
from radiant_core.splats import Splats

from .test_scoring import AWAY, CAMERAS, PLAN, SCENE, STAY, TRUTH, scored

POISONED = replace(SCENE, sh0=np.random.default_rng(5).normal(0, 1, SCENE.sh0.shape).astype(np.float32))
EDGE = "edges/north"
MOVES = {"a": (range(5), AWAY), "b": (range(5, 12), STAY)}
RECIPE = SimpleNamespace(train=SimpleNamespace(long_side_px=192, light="none"), backend="native")


@dataclass
class InThisProcess:
    """An executor of scoring nodes; `after` may spoil what a node has made."""

    after: Callable[[Path], None] = lambda folder: None
    ran: list[str] = field(default_factory=list)

    def fold(self, tree: Tree, prepare: Callable[[Tree], NodeTask | None], listen: Callable[[Event], None]) -> None:
        for node in tree:
            task = prepare(node)
            if task is None or is_sealed(task.folder, task.key):
                continue
            self.ran.append(task.stage)
            seal(task.folder, task.key, [*run_node(task.kind, task.folder, task.stage, listen), "notes.json"])
            self.after(task.folder)


def owners_run(run: Path) -> list[ScoringMachine]:
    scored(run, "evaluation", CAMERAS)
    return [ScoringMachine(stage="evaluation", inputs=())]


def devices_run(run: Path) -> list[ScoringMachine]:
    exchange_keys(run, "cloud", None)
    exchange_keys(run, EDGE, "cloud")
    for name, (rows, move) in MOVES.items():
        exchange_keys(run, f"devices/{name}", EDGE)
        scored(run, f"devices/{name}/score", CAMERAS.select(list(rows)), move)
    return [
        ScoringMachine(stage=f"devices/{name}/score", inputs=(), moves=() if move is STAY else (move,), edge=EDGE)
        for name, (_, move) in MOVES.items()
    ]


@dataclass
class Versions:
    """What a dealer says of the scene."""

    versions: dict[Version, Path]
    chosen: Version | None = None

    @property
    def version(self) -> Version:
        return self.chosen or next(iter(self.versions))


def versions_of(run: Path, scenes: dict[Version, Splats]) -> Versions:
    """A dealer with these versions of the scene."""
    folders: dict[Version, Path] = {REFINED: run / "cloud/refine/refined", JOINED: run / "cloud", CUT: (run / "cloud" / CUT_SCENE).parent}
    for name, splats in scenes.items():
        folders[name].mkdir(parents=True, exist_ok=True)
        save_ply(folders[name] / "scene.ply", splats)
    write_json(run / "cloud" / "summary.json", {"num_splats": len(scenes[JOINED])})
    save_plan(run / "plan.json", PLAN, ())
    return Versions(versions={name: folders[name] for name in scenes})


@dataclass
class Ended:
    metrics: dict[str, Any]
    dealer: Versions
    events: list[Event]
    executor: InThisProcess
    scoring: Scoring

    @property
    def decisions(self) -> list[Any]:
        return [event.decision for event in self.events if isinstance(event, Decided)]


def score(run: Path, machines: list[ScoringMachine], dealer: Versions, executor: InThisProcess | None = None) -> Ended:
    events: list[Event] = []
    executor = executor or InThisProcess()
    scoring = Scoring(config=RunConfig(source=run, out=run), recipe=cast(Any, RECIPE), machines=machines)
    metrics = scoring.run(cast(Any, dealer), cast(Any, executor), cast(Any, SimpleNamespace(listen=events.append)))
    return Ended(metrics=metrics, dealer=dealer, events=events, executor=executor, scoring=scoring)


@pytest.mark.parametrize("make", [owners_run, devices_run])
def test_a_poisoned_join_is_replaced_by_the_cut_and_scored_in_its_place(
    make: Callable[[Path], list[ScoringMachine]], tmp_path: Path
) -> None:
    half = SCENE.select(np.arange(len(SCENE) - 7))
    ended = score(tmp_path, make(tmp_path), versions_of(tmp_path, {REFINED: POISONED, JOINED: POISONED, CUT: half}))
    assert ended.dealer.chosen == CUT and ended.metrics["version"] == CUT
    (decision,) = [each for each in ended.decisions if each.topic == "refined, joined or cut"]
    assert decision.choice == "the cut scene is kept" and decision.figure > 3 and not decision.changes_nothing
    (warning,) = [event.message for event in ended.events if isinstance(event, Warned)]
    assert warning.startswith("the cut scene is kept, not the refined one: ")
    assert ended.metrics["psnr_db"] == pytest.approx(ended.metrics["versions"][CUT], abs=1e-3), "the report is of what is kept"
    assert ended.metrics["versions"][REFINED] == pytest.approx(ended.metrics["versions"][JOINED])
    assert ended.metrics["num_gaussians"] == len(half)


def test_devices_and_an_owner_choose_alike_and_the_usual_version_is_scored_once(tmp_path: Path) -> None:
    figures = {}
    for name, make in {"owner": owners_run, "devices": devices_run}.items():
        run = tmp_path / name
        run.mkdir()
        ended = score(run, make(run), versions_of(run, {REFINED: TRUTH, JOINED: SCENE, CUT: POISONED}))
        assert ended.dealer.chosen is None and len(ended.executor.ran) == len(set(ended.executor.ran))
        assert [each.changes_nothing for each in ended.decisions if each.topic == "refined, joined or cut"] == [True]
        figures[name] = ended.metrics["versions"]
        again = score(run, ended.scoring.machines, ended.dealer)  # type: ignore[arg-type]
        assert again.executor.ran == [] and again.metrics["versions"] == ended.metrics["versions"], "what is sealed is not scored again"
    assert figures["owner"] == pytest.approx(figures["devices"], abs=1e-3)


def test_a_choice_is_the_same_after_an_interruption_between_comparing_and_scoring(tmp_path: Path) -> None:
    machines, scenes = owners_run(tmp_path), {JOINED: POISONED, CUT: SCENE}
    broken = InThisProcess(after=lambda folder: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        score(tmp_path, machines, versions_of(tmp_path, cast(Any, scenes)), broken)
    ended = score(tmp_path, machines, versions_of(tmp_path, cast(Any, scenes)))
    assert ended.dealer.chosen == CUT and ended.executor.ran == ["evaluation"], "the comparison is sealed, the cut is scored"


def forge(folder: Path) -> None:
    """Better figures of one device, by somebody without its key."""
    if folder.parent.name == "a":
        scores = read_json(folder / SCORES_NAME)
        write_json(folder / SCORES_NAME, {**scores, "versions": {name: [60.0] * 5 for name in scores["versions"]}})
        seal(folder, read_json(folder / "done.json")["key"], [SCORES_NAME, RECORD_NAME, SIGNATURE_NAME, "notes.json"])


def exchange(folder: Path) -> None:
    """The signed figures of the other device."""
    if folder.parent.name == "b":
        for name in (SCORES_NAME, RECORD_NAME, SIGNATURE_NAME):
            shutil.copyfile(folder.parents[1] / "a/score" / name, folder / name)
        seal(folder, read_json(folder / "done.json")["key"], [SCORES_NAME, RECORD_NAME, SIGNATURE_NAME, "notes.json"])


@pytest.mark.parametrize(("spoil", "left_out"), [(forge, "a"), (exchange, "b")])
def test_figures_that_a_device_did_not_sign_do_not_count(spoil: Callable[[Path], None], left_out: str, tmp_path: Path) -> None:
    dealer = versions_of(tmp_path, {JOINED: SCENE, CUT: POISONED})
    ended = score(tmp_path, devices_run(tmp_path), dealer, InThisProcess(after=spoil))
    (warning,) = [event for event in ended.events if isinstance(event, Warned)]
    assert warning.stage == f"devices/{left_out}/score" and "figures of this device are left out" in warning.message
    assert ended.scoring.failed == (f"devices/{left_out}/score",)
    assert len(ended.metrics["images"]) == 12 - len(MOVES[left_out][0])


@pytest.mark.parametrize("wrong", [{}, {"joined": [60.0]}, {"joined": [60.0], "cut": [60.0, 60.0]}])
def test_a_device_that_compares_something_else_does_not_end_the_run(wrong: dict[str, list[float]], tmp_path: Path) -> None:
    for name, versions in {"honest": {"joined": [20.0], "cut": [21.0]}, "other": wrong}.items():
        (tmp_path / f"{name}.json").write_text(json.dumps({"versions": versions}))
    dealer, events = versions_of(tmp_path, {JOINED: SCENE, CUT: SCENE}), []
    paths = {name: tmp_path / f"{name}.json" for name in ("honest", "other")}
    scores, facts = keep_best(cast(Any, dealer), lambda scenes: paths if len(scenes) > 1 else {"honest": paths["honest"]}, events.append)
    assert [*scores] == ["honest"] and dealer.chosen == CUT and facts["versions"] == {"joined": 20.0, "cut": 21.0}
    left_out, _ = (event.message for event in events if isinstance(event, Warned))
    assert left_out.startswith("other does not compare the versions")


def test_a_task_to_score_one_version_leaves_no_file_of_the_comparison_before(tmp_path: Path) -> None:
    """A device refuses a task beside which a file lies that was not sent with it."""
    given = ["task.json", "inbox/scene.ply", "inbox/plan.json", "inbox/joined.ply", "inbox/cut.ply", "given/delivery.json"]
    for name in given:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    remove_earlier("score", tmp_path, given)
    assert all((tmp_path / name).is_file() for name in given)
    remove_earlier("score", tmp_path, given[:3])
    assert sorted(path.name for path in (tmp_path / "inbox").iterdir()) == ["plan.json", "scene.ply"]
    assert (tmp_path / "given/delivery.json").is_file()


@pytest.mark.parametrize(
    "versions",
    [None, [], {"joined": [20.0]}, {"joined": [20.0] * 12, "cut": ["20"] * 12}, {"best": [20.0] * 12}, {"cut": [float("nan")] * 12}],
)
def test_figures_of_strangers_are_checked(versions: Any, tmp_path: Path) -> None:
    record = read_json(scored(tmp_path, "evaluation", CAMERAS))
    good = {**record, "versions": {"joined": [20.0] * 12, "cut": [19.0] * 12}}
    check_scores(good)
    check_scores({**record, "versions": {}})
    with pytest.raises((BadInput, ValueError)):
        check_scores({**record, "versions": versions})
