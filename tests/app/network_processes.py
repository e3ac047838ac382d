"""A run over a network whose machines are processes, so that they can be killed and started again."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import pytest

from radiant_app.commands.network import node as commands
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.pipeline import run
from radiant_app.config.run_config import ExecutionOptions, RunConfig, SfmOptions, TrainOptions
from radiant_app.events import encode
from radiant_app.executors import local
from radiant_app.executors.protocol import NodeTask
from radiant_app.executors.sessions import signal_session
from radiant_app.network import cloud as far_cloud
from radiant_app.network import executor as network
from radiant_app.network import hub
from radiant_app.network import line as lines
from radiant_core.io.run_store import read_json, write_json
from tests.app import network_worker
from tests.app.blank_reports import leave_pictures_blank
from tests.app.network_nodes import POLL_S, Nodes, split_photographs
from tests.app.network_worker import HOLD, STARTS
from tests.forked import run_module, start_module
from tests.forked_workers import client_command

ROOT = Path(__file__).parents[2]
TINY = TrainOptions(long_side_px=64, num_steps=60, max_num_splats=600)
CHECKPOINTS, WIRE, OPTIONS = "checkpoints", "wire", "options.json"
WORKERS = "RADIANT_TEST_WORKERS"
"""Names the address of a server of forked workers; without it each worker starts anew."""


def command(task: NodeTask) -> list[str]:
    """A worker with one core."""
    if WORKERS in os.environ:
        return client_command(Path(os.environ[WORKERS]), task, network_worker.__name__)
    return network_worker.command(task)


@dataclass
class Fleet:
    """A cloud, an edge with devices; made once, started and killed by name."""

    folder: Path
    devices: tuple[str, ...] = ("d",)
    frames: Literal["gps", "known"] = "known"
    train: TrainOptions = TINY
    checkpoint_every_s: float = 0.05
    saved_at_kill: list[int] = field(default_factory=list)
    """Step of the newest checkpoint of the first device, after each of its kills."""
    running: dict[str, Any] = field(default_factory=dict)
    workers: Path | None = None
    """Where a server of forked workers listens; None: all processes start anew."""

    def make(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        split_photographs(sample_scenes_folder() / "hamlet" / "images", self.folder / "photos", self.devices)
        rows = "".join(f'[[edge.device]]\nid = "{device}"\n' for device in self.devices)
        (self.folder / "system.toml").write_text(f'[[edge]]\nid = "e"\n{rows}')
        options = {"long_side_px": self.train.long_side_px, "num_steps": self.train.num_steps, "max_num_splats": self.train.max_num_splats}
        write_json(self.folder / OPTIONS, {"frames": self.frames, "checkpoint_every_s": self.checkpoint_every_s, "train": options})
        (self.folder / WIRE).mkdir()
        Nodes(folder=self.folder).make({"e": list(self.devices)})

    def environment(self) -> dict[str, str]:
        return environment_of(self.folder, "starts.txt", self.workers)

    def hold_training(self) -> None:
        """Have the device's training wait after its first checkpoint until the device was killed."""
        (self.folder / "hold").touch()

    def start(self, name: str) -> None:
        module, environment = "tests.app.network_processes", self.environment()
        with (self.folder / f"{name}.log").open("ab") as log:
            if self.workers is not None:
                self.running[name] = start_module(module, name, self.folder, log=log, cwd=ROOT, environment=environment)
            else:
                command = [sys.executable, "-m", module, name, str(self.folder)]
                self.running[name] = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=log, stderr=log, start_new_session=True)

    def kill(self, name: str) -> bool:
        """SIGKILL; whether it was running."""
        process = self.running.pop(name)
        alive = process.poll() is None
        if alive:
            signal_session(process.pid, signal.SIGKILL)
        process.wait()
        if alive and name == self.devices[0]:
            (self.folder / "hold").unlink(missing_ok=True)
            self.saved_at_kill.append(self.saved_step())
        return alive

    def saved_step(self) -> int:
        """Step of the newest checkpoint of the first device; 0 without one."""
        names = [path.stem for path in (self.device_folder(self.devices[0]) / CHECKPOINTS).glob("step-*.json")]
        return max([int(name.removeprefix("step-")) for name in names], default=0)

    def close(self) -> None:
        for name in [*self.running]:
            self.kill(name)

    def run_with(self, kills: list[tuple[str, Callable[[], bool]]], timeout_s: float = 900.0) -> int:
        """Run everything; kill the named process at each moment in turn and start it again. How
        many kills hit. Fails where the cloud does not end by itself."""
        until_s, hits = time.monotonic() + timeout_s, 0
        for name in ("cloud", "e", *self.devices):
            self.start(name)
        waiting = list(kills)
        while (code := self.running["cloud"].poll()) is None:
            assert time.monotonic() < until_s, self.logs()
            for name in ("e", *self.devices):
                assert self.running[name].poll() is None, self.logs()
            if waiting and waiting[0][1]():
                name, _ = waiting.pop(0)
                hits += self.kill(name)
                self.start(name)
            time.sleep(0.005)
        assert code == 0, self.logs()
        return hits

    def logs(self) -> str:
        return "".join(f"== {path.name}\n{path.read_text()[-3000:]}" for path in sorted(self.folder.glob("*.log")))

    def trained_from(self, kind: str) -> list[int]:
        """Steps from which workers of this kind trained, each time that one did."""
        path = self.folder / "starts.txt"
        rows = [line.split() for line in path.read_text().splitlines()] if path.is_file() else []
        return [int(row[1]) for row in rows if row[0] == kind]

    def device_folder(self, device: str) -> Path:
        found = list((self.folder / device / "runs").glob(f"*/devices/{device}"))
        return found[0] if found else self.folder / "nothing"


def config_of(folder: Path, executor: bool) -> RunConfig:
    """The run over the network, or that on one machine."""
    options = read_json(folder / OPTIONS)
    frames = "gps" if options["frames"] == "gps" else "known"
    return RunConfig(
        source=folder / ("cloud" if executor else "photos"),
        frames=frames,
        sfm=SfmOptions() if executor or frames == "gps" else SfmOptions(poses=sample_scenes_folder() / "hamlet" / "known"),
        system=folder / "system.toml",
        out=folder / ("far" if executor else "here"),
        train=TrainOptions(**options["train"]),
        execution=ExecutionOptions(executor="network" if executor else "local", checkpoint_every_s=options["checkpoint_every_s"]),
    )


def environment_of(folder: Path, starts: str, workers: Path | None = None) -> dict[str, str]:
    """Variables of the processes of a run, whose trainings are told in the file `starts`."""
    told = {STARTS: str(folder / starts), HOLD: str(folder / "hold"), "OMP_NUM_THREADS": "1"}
    return {**os.environ, **told, **({} if workers is None else {WORKERS: str(workers)})}


def run_here(folder: Path, workers: Path | None = None) -> bytes:
    """The scene of the run on one machine, in a process with one core."""
    environment = environment_of(folder, "here.txt", workers)
    done = run_module("tests.app.network_processes", "here", folder, cwd=ROOT, environment=environment)
    assert done.returncode == 0, done.stderr
    return (folder / "here" / "scene.ply").read_bytes()


def _main(name: str, folder: Path) -> None:
    os.cpu_count = lambda: 1
    hub.POLL_S = POLL_S
    leave_pictures_blank(pytest.MonkeyPatch())
    for module in (local, network, far_cloud):
        vars(module)["worker_command"] = command
    if name in ("cloud", "here"):
        config = config_of(folder, name == "cloud")
        if name == "here":
            vars(sys.modules["radiant_app.run.stages"])["LocalExecutor"] = _one_core
        with (folder / f"{name}.events").open("a", buffering=1) as events:
            run(config, lambda event: print(encode(event), file=events), resume=(config.out / "manifest.json").is_file())
        return
    lines.Line.ask_once = _dumped(folder / WIRE / f"{name}.{os.getpid()}")  # type: ignore[method-assign]
    running = commands.Running(say=lambda text: print(text, flush=True), command=command, poll_s=POLL_S)
    if name == "e":
        running.serve(folder / "e")
    else:
        poses = sample_scenes_folder() / "hamlet" / "known" if read_json(folder / OPTIONS)["frames"] == "known" else None
        running.work(folder / name, folder / "photos" / name, poses, lambda text: True)


def _dumped(file: Path) -> Callable[..., lines.Answer | None]:
    """`Line.ask_once` that keeps what passes in both directions, as it is before it is encrypted."""
    ask = lines.Line.ask_once

    def ask_and_keep(
        line: lines.Line, method: str, target: str, body: bytes = b"", headers: Mapping[str, str] | None = None
    ) -> lines.Answer | None:
        answer = ask(line, method, target, body, headers)
        with file.open("ab") as out:
            out.write(f"{method} {target} {headers}\n".encode() + body)
            out.write(b"" if answer is None else f"{answer.status} {answer.headers}\n".encode() + answer.body)
        return answer

    return ask_and_keep


def _one_core(**options: object) -> local.LocalExecutor:
    return local.LocalExecutor(**{**options, "command": command})  # pyright: ignore[reportArgumentType]


if __name__ == "__main__":
    _main(sys.argv[1], Path(sys.argv[2]))
