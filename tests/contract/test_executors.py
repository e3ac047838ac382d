"""What every executor owes its caller, on `local` and on a Ray cluster of one machine with two CPUs."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.pipeline import run
from radiant_app.config.run_config import ExecutionOptions, RunConfig
from radiant_app.events import Event, Failed, StageDone, StageProgress, StageSkipped, StageStarted, Warned, encode
from radiant_app.executors.fold import RetryPolicy
from radiant_app.executors.local import LocalExecutor
from radiant_app.executors.protocol import Executor, NodeTask
from radiant_app.executors.ray_cluster import RayExecutor, _environment, resource_of
from radiant_core.aggregate.tree import Tree
from radiant_core.errors import BadInput

DEVICES = tuple(Tree(id=f"devices/{number}", tier="device") for number in "123")
TREE = Tree(id="cloud", tier="cloud", children=(Tree(id="edges/a", tier="edge", children=DEVICES),))
SEAL = """
import json, os
from pathlib import Path
Path('made').write_text(os.environ['OMP_NUM_THREADS'])
# As `seal` writes it, without the start of numpy.
Path('done.json').write_text(json.dumps({'version': 1, 'key': 'key', 'files': {}}))
"""
PROGRESS = StageProgress(stage="devices/1", done=1, total=2, note="half")
Make = Callable[[dict[str, str]], Executor]


@pytest.fixture(params=["local", "ray"])
def make(request: pytest.FixtureRequest, tmp_path: Path) -> Make:
    """Executors whose nodes run a script each, those without one just seal."""

    def executor(scripts: dict[str, str]) -> Executor:
        def command(task: NodeTask) -> list[str]:
            return [sys.executable, "-S", "-c", f"import os; os.chdir({str(task.folder)!r})\n{scripts.get(task.stage, SEAL)}"]

        if request.param == "local":
            return LocalExecutor(num_workers=2, command=command, retry_policy=RetryPolicy(max_attempts=2))
        return RayExecutor(
            address=request.getfixturevalue("address"), log=tmp_path / "ray.log", command=command, retry_policy=RetryPolicy(max_attempts=2)
        )

    return executor


def preparer(run: Path, order: list[str]) -> Callable[[Tree], NodeTask]:
    def prepare(node: Tree) -> NodeTask:
        order.append(node.id)
        (run / node.id).mkdir(parents=True, exist_ok=True)
        return NodeTask(kind=node.tier, stage=node.id, folder=run / node.id, key="key")

    return prepare


def test_a_tree_is_folded_a_crash_is_tried_again_and_a_second_fold_skips_all(make: Make, tmp_path: Path) -> None:
    scripts = {
        "devices/1": f"print({encode(PROGRESS)!r})\n{SEAL}",
        "devices/2": f"import os, pathlib, signal\nif not pathlib.Path('once').exists():\n"
        f"    pathlib.Path('once').touch()\n    os.kill(os.getpid(), 9)\n{SEAL}",
    }
    order: list[str] = []
    events: list[Event] = []
    times = make(scripts).fold(TREE, preparer(tmp_path, order), events.append)
    assert (
        set(times) == {node.id for node in TREE} and order[:3] == [device.id for device in DEVICES] and order[-2:] == ["edges/a", "cloud"]
    )
    assert times["edges/a"].started_s >= max(times[device.id].ended_s for device in DEVICES)
    assert times["cloud"].started_s >= times["edges/a"].ended_s
    assert PROGRESS in events
    (warning,) = (event for event in events if isinstance(event, Warned))
    assert warning.stage == "devices/2" and "killed by signal 9" in warning.message and "tried again" in warning.message
    done = [event.stage for event in events if isinstance(event, StageDone)]
    assert done[-2:] == ["edges/a", "cloud"] and {device.id for device in DEVICES} <= set(done)
    assert {(tmp_path / name / "made").read_text() for name in ("devices/1", "edges/a", "cloud")} == {"1"}, "two CPUs, three leaves"
    again: list[Event] = []
    make({node.id: "raise SystemExit(1)" for node in TREE}).fold(TREE, preparer(tmp_path, []), again.append)
    assert {type(event) for event in again} == {StageSkipped}


def test_a_failure_is_named_the_others_are_stopped_and_what_was_sealed_stays(make: Make, tmp_path: Path) -> None:
    refusal = encode(Failed(stage="devices/2", message="no photographs: take some.", exit_code=2))
    waits = f"import time, pathlib\nwhile not pathlib.Path({str(tmp_path / 'pid')!r}).exists(): time.sleep(0.01)\n"
    scripts = {
        "devices/1": f"import os, time, pathlib; pathlib.Path({str(tmp_path / 'pid')!r}).write_text(str(os.getpid())); time.sleep(60)",
        "devices/2": f"{waits}print({refusal!r}); raise SystemExit(2)",
    }
    events: list[Event] = []
    with pytest.raises(BadInput, match=r"devices/2: no photographs: take some\."):
        make(scripts).fold(TREE, preparer(tmp_path, []), events.append)
    assert StageStarted not in {type(event) for event in events if getattr(event, "stage", "") == "edges/a"}
    deadline_s = time.monotonic() + 10
    while is_alive(int((tmp_path / "pid").read_text())) and time.monotonic() < deadline_s:
        time.sleep(0.1)
    assert not is_alive(int((tmp_path / "pid").read_text()))
    assert not (tmp_path / "devices/1/done.json").exists()


def is_alive(pid: int) -> bool:
    """Whether a process runs; one that has ended and was not collected does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z" and os.getpgid(pid) > 0
    except (OSError, ProcessLookupError):
        return False


def test_a_cluster_of_this_machine_alone_gets_a_secret_of_its_own_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    first, second = _environment("local"), _environment("local")
    assert first["RAY_AUTH_MODE"] == "token" and len(first["RAY_AUTH_TOKEN"]) == 64
    assert first["RAY_AUTH_TOKEN"] != second["RAY_AUTH_TOKEN"] and first["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] == "0"
    assert _environment("127.0.0.1:6379") == dict(os.environ), "how another cluster is joined is for its owner to say"


def test_the_machines_of_nodes_are_named_by_what_they_are() -> None:
    assert [resource_of(node) for node in TREE] == ["device:1", "device:2", "device:3", "edge:a", "cloud"]
    assert resource_of(Tree(id="devices/1/score", tier="device")) == "device:1"


@pytest.mark.parametrize(("address", "said"), [("nowhere", "no host:port"), ("127.0.0.1:1", "no Ray cluster answers at 127.0.0.1:1")])
def test_an_address_where_no_cluster_is_gets_one_sentence(address: str, said: str, tmp_path: Path) -> None:
    if find_spec("ray") is None:
        pytest.skip("Ray is not installed: the extra `cluster` brings it")
    with pytest.raises(BadInput, match=said):
        RayExecutor(address=address, log=tmp_path / "ray.log").fold(TREE, preparer(tmp_path, []), lambda event: None)
    # A run asks before it begins, not after structure from motion.
    execution = ExecutionOptions(executor="ray", address=address)
    config = RunConfig(source=sample_scenes_folder() / "hamlet" / "images", out=tmp_path / "run", execution=execution)
    with pytest.raises(BadInput, match=said):
        run(config)
    assert not (tmp_path / "run").exists()
