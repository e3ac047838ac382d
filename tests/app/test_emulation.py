"""Emulated machines: shares of a core, links, labels, and that no stopped process is ever left
behind. Small processes stand for work.

Speeds are small, so that a busy machine can still give them; what counts is their ratio.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from radiant_app.events import Event, StageDone, StageProgress, Warned
from radiant_app.executors import emulated_node, local
from radiant_app.executors.emulated import RESUMED, EmulatedExecutor, crowding_of, emulated_figures, require_emulable
from radiant_app.executors.local import LocalExecutor
from radiant_app.executors.protocol import NodeTask
from radiant_app.files.run_folder import Manifest
from radiant_app.files.system_file import load_system
from radiant_app.report.html import timeline_of_emulation
from radiant_app.together.playing import KEEPS, LINKS, SHARE, WORKED
from radiant_core.aggregate.tree import Tree, refined_at, with_gangs
from radiant_core.errors import BadInput, StageFailed
from radiant_core.io.run_store import SEAL_NAME, seal, write_json
from radiant_core.plan.system import System

WAIT_S = 30.0
FAST_LINK = 8e6  # Mbit/s
TREE = Tree(
    id="cloud",
    tier="cloud",
    children=(Tree(id="edges/e", tier="edge", children=tuple(Tree(id=f"devices/{n}", tier="device") for n in "ab")),),
)
BURN = """
import time
end = time.process_time() + {cpu_s}
while time.process_time() < end: pass
"""
FINISH = "import os; os.rename('sealed', 'done.json')"
"""A stub is no Python project: the test seals its product beforehand and the stub only says so."""


@pytest.fixture(autouse=True)
def no_forks(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is emulated is the CPU time of whole processes, their start among it."""

    def open_server(*arguments: object) -> None:
        raise AssertionError("an emulated node is forked")

    monkeypatch.setattr(local, "open_server", open_server)


def system(folder: Path, speeds: tuple[float, float], mbit_per_s: tuple[float, float] = (FAST_LINK, FAST_LINK)) -> System:
    device = '[[edge.device]]\nid = "{}"\nspeed = {}\nuplink_mbit_per_s = {}\n'
    text = f'[[edge]]\nid = "e"\nspeed = 0.5\nuplink_mbit_per_s = {FAST_LINK}\n'
    text += "".join(device.format(*values) for values in zip("ab", speeds, mbit_per_s, strict=True))
    (folder / "system.toml").write_text(text)
    return load_system(folder / "system.toml")


def executor(emulated: System, scripts: dict[str, str]) -> EmulatedExecutor:
    def command(task: NodeTask) -> list[str]:
        return [sys.executable, "-S", "-c", f"import os; os.chdir({str(task.folder)!r})\n{scripts.get(task.stage, FINISH)}"]

    return EmulatedExecutor(system=emulated, local=LocalExecutor(num_workers=1, command=command))


def preparer(run: Path, product_bytes: dict[str, int] | None = None) -> Callable[[Tree], NodeTask]:
    def prepare(node: Tree) -> NodeTask:
        folder = run / node.id
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "model.safetensors").write_bytes(bytes((product_bytes or {}).get(node.id, 1)))
        seal(folder, "key", ["model.safetensors"])
        (folder / SEAL_NAME).rename(folder / "sealed")
        return NodeTask(kind=node.tier, stage=node.id, folder=folder, key="key")

    return prepare


def test_a_quarter_of_the_speed_takes_four_times_as_long(tmp_path: Path) -> None:
    work = BURN.format(cpu_s=0.12) + FINISH
    fleet = executor(system(tmp_path, (0.12, 0.03)), {"devices/a": work, "devices/b": work})
    ratios = []
    # Where others keep every core busy, a process may wait for one at its very end: then it is
    # measured again, six times at most.
    while len(ratios) < 6 and (not ratios or ratios[-1] != pytest.approx(4.0, rel=0.15)):
        begun_s = time.monotonic()
        times = fleet.fold(TREE, preparer(tmp_path / str(len(ratios))), lambda event: None)
        a_s, b_s = (times[f"devices/{name}"].ended_s - times[f"devices/{name}"].started_s for name in "ab")
        ratios.append(b_s / a_s)
        assert a_s > 0.12 / 0.12, "more than the work alone: the start of Python is its own CPU time too"
        assert time.monotonic() - begun_s < a_s + b_s, "they run side by side"
    assert ratios[-1] == pytest.approx(4.0, rel=0.15), ratios


def test_an_emulated_gang_runs_at_once_whatever_the_speeds(tmp_path: Path) -> None:
    meet = "import pathlib, time\npathlib.Path('alive').touch()\n"
    meet += f"while not all(pathlib.Path({str(tmp_path)!r}, name, 'alive').exists() for name in ('edges/e', 'devices/a', 'devices/b')):\n"
    scripts = dict.fromkeys(("edges/e", "devices/a", "devices/b"), f"{meet}    time.sleep(0.01)\n{FINISH}")
    tree = with_gangs(TREE, lambda node_id: None if node_id == "cloud" else "e")
    times = executor(system(tmp_path, (0.5, 0.1)), scripts).fold(tree, preparer(tmp_path), lambda event: None)
    ended = [times[node_id].ended_s for node_id in scripts]
    assert max(times[node_id].started_s for node_id in scripts) < min(ended) and times["cloud"].started_s >= max(ended)


STEPS = f"""
import socket, struct, time
keeper = socket.socket(fileno=int(os.environ[{SHARE!r}].split()[0]))
keeper.sendall({KEEPS!r})
keeper.recv(1)
{{meanwhile}}
keeper.sendall(struct.pack({WORKED.format!r}, {{cpu_s}}, {{seconds}}))
keeper.recv(1)
"""
"""What a machine does that trains together with others, in few words."""
GANG = with_gangs(TREE, lambda node_id: None if node_id == "cloud" else "edges/e")


def test_a_machine_that_waits_for_others_in_its_steps_has_no_credit_for_that_and_is_not_called_late(tmp_path: Path) -> None:
    """1.5 s of waiting would pay for 0.15 s of a tenth of a core. What it says of its steps outweighs what this machine delays."""
    events: list[Event] = []
    script = STEPS.format(meanwhile="time.sleep(1.5)", cpu_s=5.0, seconds=50.0) + BURN.format(cpu_s=0.1) + FINISH
    times = executor(system(tmp_path, (0.1, 0.5)), {"devices/a": script}).fold(GANG, preparer(tmp_path), events.append)
    assert times["devices/a"].ended_s - times["devices/a"].started_s > 1.5 + 0.1 / 0.1
    assert not [event for event in events if isinstance(event, Warned) and event.stage == "devices/a"]


def test_a_machine_that_others_delayed_in_its_steps_is_named(tmp_path: Path) -> None:
    events: list[Event] = []
    script = STEPS.format(meanwhile="pass", cpu_s=0.1, seconds=10.0) + FINISH
    executor(system(tmp_path, (0.5, 0.5)), {"devices/a": script}).fold(GANG, preparer(tmp_path), events.append)
    (warned,) = [event.message for event in events if isinstance(event, Warned) and event.stage == "devices/a"]
    assert "of a core instead of 0.5" in warned


@pytest.mark.parametrize("meanwhile", ["os.kill(os.getpid(), 9)", "keeper.close(); raise SystemExit(3)", "os._exit(3)"])
def test_how_a_machine_ended_in_its_steps_is_told_as_ever(tmp_path: Path, meanwhile: str) -> None:
    script = STEPS.format(meanwhile=meanwhile, cpu_s=0, seconds=0)
    with pytest.raises(StageFailed, match="signal 9" if "kill" in meanwhile else "ended with code 3"):
        executor(system(tmp_path, (0.5, 0.5)), {"devices/b": script}).fold(GANG, preparer(tmp_path), lambda event: None)


def test_machines_that_train_together_know_their_links_and_the_edge_alone_sends_a_model(tmp_path: Path) -> None:
    """1,000,000 bytes at 8 Mbit/s take a second; devices keep theirs."""
    fleet = system(tmp_path, (0.5, 0.5), (8.0, 4.0))
    slow = replace(fleet.edges[0], uplink_bytes_per_s=1e6, latency_s=0.25)
    fleet = replace(fleet, edges=(slow,), cloud=replace(fleet.cloud, latency_s=0.5))
    told = f"open('links', 'w').write(os.environ[{LINKS!r}])\n{FINISH}"
    tree = with_gangs(TREE, lambda node_id: "cloud")
    manifest = Manifest(folder=tmp_path, config={})
    begun_s = time.monotonic()
    nodes = ("cloud", "edges/e", "devices/a", "devices/b")
    prepare = preparer(tmp_path, dict.fromkeys(nodes, 1_000_000))
    executor(fleet, dict.fromkeys(nodes, told)).fold(tree, prepare, lambda event: manifest.record(event, time.monotonic() - begun_s))
    links = {node: json.loads((tmp_path / node / "links").read_text()) for node in nodes}
    assert links["cloud"]["down"] == {"e": [1e6, 0.5]} and links["edges/e"]["up"] == [1e6, 0.5]
    assert links["edges/e"]["down"] == {"a": [1e6, 0.25], "b": [5e5, 0.25]}
    assert links["devices/a"]["up"] == [1e6, 0.25] and links["devices/b"]["up"] == [5e5, 0.25]
    spans = {node: manifest.emulated[f"{node}/uplink"] for node in ("edges/e", "devices/a", "devices/b")}
    sending_s = {node: span["ended_s"] - span["started_s"] for node, span in spans.items()}
    assert sending_s["edges/e"] == pytest.approx(1.0, abs=0.15) and max(sending_s["devices/a"], sending_s["devices/b"]) < 0.1
    write_json(tmp_path / "devices/a/summary.json", {"sent_bytes": 777})
    write_json(tmp_path / "edges/e/summary.json", {"sent_bytes": 333})
    figures = emulated_figures(tmp_path, tree, (), manifest)
    sent = figures["emulated_bytes"]
    assert (sent["devices/a"], sent["devices/b"], sent["edges/e"]) == (777, 0, 1_000_333)
    seconds = figures["emulated_seconds"]
    assert figures["emulated_makespan_s"] == max(seconds[node] for node in spans), "all at once"
    cloud_s = manifest.stages["cloud"]["ended_s"] - manifest.stages["cloud"]["started_s"]
    assert figures["emulated_scene_s"] == max(cloud_s, figures["emulated_makespan_s"])


def test_a_node_that_goes_on_from_a_checkpoint_has_no_whole_time(tmp_path: Path) -> None:
    manifest = Manifest(folder=tmp_path, config={})
    (tmp_path / "edges/e/checkpoints/0001").mkdir(parents=True)
    executor(system(tmp_path, (0.5, 0.5)), {}).fold(GANG, preparer(tmp_path), lambda event: manifest.record(event, time.monotonic()))
    assert [warning for warning in manifest.warnings if "checkpoint" in warning] == [f"edges/e: {RESUMED}"]
    figures = emulated_figures(tmp_path, GANG, (), manifest)
    assert figures["emulated_makespan_s"] is figures["emulated_scene_s"] is None
    assert "went on from a checkpoint" in figures["emulated_reason"] and figures["emulated_seconds"]["edges/e"] > 0


def test_a_model_arrives_when_its_last_byte_would_and_the_edge_waits_for_it(tmp_path: Path) -> None:
    events: list[Event] = []
    fleet = executor(system(tmp_path, (0.5, 0.5), (8.0, 4.0)), {})
    sizes = {"devices/a": 3_000_000, "devices/b": 500_000}
    times = fleet.fold(TREE, preparer(tmp_path, sizes), events.append)
    seconds = {event.stage: event.seconds for event in events if isinstance(event, StageDone)}
    assert seconds["devices/a/uplink"] == pytest.approx(3.0, rel=0.1)
    assert seconds["devices/b/uplink"] == pytest.approx(1.0, rel=0.1)
    assert times["edges/e"].started_s >= times["devices/a"].ended_s >= 3.0
    assert times["edges/e"].started_s < 4.0 + 1.5, "each on its own link, side by side"
    arrived = [event.done for event in events if isinstance(event, StageProgress) and event.stage == "devices/a/uplink"]
    assert len(arrived) >= 3 and arrived == sorted(arrived) and arrived[-1] < 3_000_000


def test_what_is_emulated_says_so_and_the_cloud_is_measured(tmp_path: Path) -> None:
    manifest = Manifest(folder=tmp_path, config={})
    executor(system(tmp_path, (0.5, 0.5)), {}).fold(TREE, preparer(tmp_path), lambda event: manifest.record(event, time.monotonic()))
    assert set(manifest.stages) == {"cloud"}
    assert set(manifest.emulated) == {f"{node}{end}" for node in ("devices/a", "devices/b", "edges/e") for end in ("", "/uplink")}
    figures = emulated_figures(tmp_path, TREE, (), manifest)
    seconds = figures["emulated_seconds"]
    slowest_s = max(seconds["devices/a"], seconds["devices/b"])
    assert figures["emulated_makespan_s"] == pytest.approx(slowest_s + seconds["edges/e"], abs=1e-9)
    cloud_s = manifest.stages["cloud"]["ended_s"] - manifest.stages["cloud"]["started_s"]
    assert figures["emulated_scene_s"] == pytest.approx(figures["emulated_makespan_s"] + cloud_s, abs=1e-9)
    manifest.keep_stages({"cloud", "devices/a"})
    assert set(manifest.emulated) == {"devices/a", "devices/a/uplink"}
    lost = emulated_figures(tmp_path, TREE, (), manifest)
    assert lost["emulated_makespan_s"] is lost["emulated_scene_s"] is None and "on its way" in lost["emulated_reason"]


def test_refining_is_played_too_with_the_bytes_of_its_rows(tmp_path: Path) -> None:
    """2,000 bytes of Gaussians and 1,000,000 of rows over 8 Mbit/s take a second; a node's time and bytes count for the scene alone."""
    manifest = Manifest(folder=tmp_path, config={})
    fleet = executor(system(tmp_path, (0.5, 0.5), (8.0, FAST_LINK)), {})
    begun_s = time.monotonic()

    def record(event: Event) -> None:
        manifest.record(event, time.monotonic() - begun_s)

    fleet.fold(TREE, preparer(tmp_path), record)
    refining = TREE.map_ids(refined_at)

    def prepare(node: Tree) -> NodeTask:
        task = preparer(tmp_path)(node)
        (task.folder / "refined.safetensors").write_bytes(bytes(2_000))
        (task.folder / "rows.safetensors").write_bytes(bytes(1_000_000 if node.id == "devices/a/refine" else 10))
        return task

    fleet.fold(refining, prepare, record)
    sending = manifest.emulated["devices/a/refine/uplink"]
    assert sending["ended_s"] - sending["started_s"] == pytest.approx(1.002, abs=0.15)
    figures = emulated_figures(tmp_path, TREE, [refining], manifest)
    assert figures["emulated_bytes"]["devices/a/refine"] == 1_002_000 and figures["emulated_bytes"]["devices/a"] == 1
    seconds = figures["emulated_seconds"]
    slowest_s = max(seconds[f"devices/{name}/refine"] for name in "ab")
    clouds_s = sum(manifest.stages[node]["ended_s"] - manifest.stages[node]["started_s"] for node in ("cloud", "cloud/refine"))
    expected_s = figures["emulated_makespan_s"] + clouds_s + slowest_s + seconds["edges/e/refine"]
    assert figures["emulated_scene_s"] == pytest.approx(expected_s, abs=1e-9)
    rows = {row.name: [span.stage for span in row.spans] for row in timeline_of_emulation(manifest)}
    assert rows["devices/a/refine"] == ["refine", "send"] and rows["edges/e/refine"][0] == "average"
    assert rows["cloud/refine"] == ["finish"] and rows["cloud"] == ["merge"]


def test_a_device_that_did_not_get_its_share_is_named(tmp_path: Path) -> None:
    events: list[Event] = []
    idle = f"import time; time.sleep(0.5)\n{FINISH}"
    executor(system(tmp_path, (0.5, 0.05)), {"devices/a": idle}).fold(TREE, preparer(tmp_path), events.append)
    warned = [event for event in events if isinstance(event, Warned) and event.stage == "devices/a"]
    assert len(warned) == 1 and "of a core instead of 0.5" in warned[0].message


@pytest.mark.parametrize(
    ("script", "told"),
    [("raise SystemExit(3)", "ended with code 3"), ("os.kill(os.getpid(), 11)", "signal 11"), ("os.kill(os.getpid(), 9)", "signal 9")],
)
def test_how_a_worker_ended_is_told_as_ever(tmp_path: Path, script: str, told: str) -> None:
    with pytest.raises(StageFailed, match=told):
        executor(system(tmp_path, (0.5, 0.5)), {"devices/b": script}).fold(TREE, preparer(tmp_path), lambda event: None)


def test_a_machine_that_cannot_play_the_system_says_what_to_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1})
    require_emulable(system(tmp_path, (1.0, 1.0)))
    with pytest.raises(BadInput, match=r"need 4 cores, this machine has 2: multiply every speed by 0\.5"):
        require_emulable(System(edges=tuple(_renamed(system(tmp_path, (1.0, 1.0)), name) for name in "xy")))
    (tmp_path / "system.toml").write_text('[[edge]]\nid = "e"\nspeed = 1\n[[edge.device]]\nid = "d"\n')
    with pytest.raises(BadInput, match=r"device 'd' has no speed"):
        require_emulable(load_system(tmp_path / "system.toml"))
    for speed in ("0", "1.01", "nan", "-1"):
        (tmp_path / "system.toml").write_text(f'[[edge]]\nid = "e"\nspeed = {speed}\n[[edge.device]]\nid = "d"\n')
        with pytest.raises(BadInput, match=r"edge\[0\]\.speed is"):
            load_system(tmp_path / "system.toml")


def test_machines_that_train_together_are_counted_side_by_side(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Edge of 0.5 and devices of 0.8 and 0.8 need 1.6 cores one after the other, together 2.1; a cloud among them is a core."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1})
    fleet = system(tmp_path, (0.8, 0.8))
    require_emulable(fleet)
    assert crowding_of(fleet, TREE) is None and crowding_of(system(tmp_path, (0.8, 0.7)), GANG) is None
    assert "need 2.1 cores" in str(crowding_of(fleet, GANG))
    with_cloud = with_gangs(TREE, lambda node_id: "cloud")
    assert crowding_of(system(tmp_path, (0.25, 0.25)), with_cloud) is None
    assert "need 2.1 cores" in str(crowding_of(system(tmp_path, (0.3, 0.3)), with_cloud))
    events: list[Event] = []
    executor(fleet, {}).fold(GANG, preparer(tmp_path), events.append)
    assert [event.stage for event in events if isinstance(event, Warned) and "need 2.1 cores" in event.message] == ["cloud"]


def _renamed(emulated: System, name: str):
    edge = emulated.edges[0]
    return replace(edge, id=name, devices=tuple(replace(device, id=f"{name}{device.id}") for device in edge.devices))


def test_a_command_that_ends_just_before_it_would_be_stopped_is_told_as_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    def far_ahead_at_its_end(pid: int) -> float:
        waited_for(lambda: not state_of(pid))
        return 1e9

    monkeypatch.setattr(emulated_node, "_cpu_s", far_ahead_at_its_end)
    assert emulated_node._run_at_share(["/bin/sh", "-c", "exit 3"], 0.5, time.monotonic())[0] == 3


FOLD = """
import signal, sys
# What was started in the background of a shell ignores Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.path.insert(0, {root!r})
from pathlib import Path
from tests.app.test_emulation import BURN, TREE, executor, preparer, system
folder = Path({folder!r})
scripts = {{f"devices/{{name}}": "open('pid', 'w').write(str(os.getpid()))\\n" + BURN.format(cpu_s=60) for name in "ab"}}
executor(system(folder, (0.05, 0.05)), scripts).fold(TREE, preparer(folder), lambda event: None)
"""


@pytest.fixture
def burning(tmp_path: Path):
    """An executor in a process of its own whose two devices work hard, and the devices' processes, one of them just stopped."""
    root = str(Path(__file__).parents[2])
    process = subprocess.Popen([sys.executable, "-c", FOLD.format(root=root, folder=str(tmp_path))], stderr=subprocess.PIPE)
    try:
        devices = [int(waited_for(lambda file=tmp_path / "devices" / name / "pid": file.exists() and file.read_text())) for name in "ab"]
        waited_for(lambda: state_of(devices[0]) == "T")
        yield process, devices
    finally:
        process.kill()
        process.communicate()
    waited_for(lambda: not any(map(state_of, devices)))


def waited_for(find):
    deadline_s = time.monotonic() + WAIT_S
    while not (found := find()):
        assert time.monotonic() < deadline_s
        time.sleep(0.005)
    return found


def state_of(pid: int) -> str:
    """The kernel's letter: R runs, S sleeps, T is stopped; empty when the process has ended, whether or not init has noticed."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0].replace("Z", "")
    except OSError:
        return ""


def test_a_killed_executor_leaves_no_stopped_process(burning) -> None:
    process, devices = burning
    process.kill()
    process.wait()
    waited_for(lambda: not any(map(state_of, devices)))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_leaves_no_stopped_process(burning, number: int) -> None:
    process, devices = burning
    process.send_signal(number)
    process.wait(timeout=WAIT_S)
    waited_for(lambda: not any(map(state_of, devices)))


def test_a_killed_guard_takes_its_stopped_device_along(burning) -> None:
    process, devices = burning
    guard = int(Path(f"/proc/{devices[0]}/stat").read_text().rsplit(")", 1)[1].split()[1])
    os.kill(guard, signal.SIGKILL)
    _, errors = process.communicate(timeout=WAIT_S)
    assert b"devices/a: its process was killed by signal 9" in errors
    assert not any(map(state_of, devices)), "the executor waits for the others that it stops"
