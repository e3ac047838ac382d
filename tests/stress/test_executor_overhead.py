"""What an executor costs over the bare stages: the nodes of a finished run of four devices, one at
a time, as plain processes, by the local executor (all threads) and by Ray with one CPU (one
thread); interleaved, wall and CPU seconds side by side. Figures: docs/experiments/faults.md.
"""

from __future__ import annotations

import os
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import radiant_app.commands.run.pipeline
from radiant_app.config.run_config import ExecutionOptions, RunConfig, TrainOptions
from radiant_app.executors.local import LocalExecutor, worker_command
from radiant_app.executors.protocol import NodeTask
from radiant_app.executors.ray_cluster import RayExecutor
from radiant_core.aggregate.tree import Tree, tree_of_plan
from radiant_core.io.records import load_plan
from radiant_core.io.run_store import SEAL_NAME, read_json
from tests.app.pipeline_kit import FOUR
from tests.contract.ray_machines import Cluster, ray_cluster
from tests.stress.test_kill_run import hamlet_in

pytestmark = pytest.mark.stress

NUM_ROUNDS = 3
MAX_OVERHEAD = 0.05


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Tree, dict[str, NodeTask]]:
    """The tree of a finished run, and its tasks with what they read in place."""
    folder = tmp_path_factory.mktemp("overhead")
    hamlet_in(folder)
    training = TrainOptions(long_side_px=160, num_steps=2000, max_num_splats=3000)
    execution = ExecutionOptions(max_workers=1)
    config = RunConfig(source=folder / "hamlet", out=folder / "run", train=training, execution=execution, plan=FOUR)
    radiant_app.commands.run.pipeline.run(config)
    tree = tree_of_plan(*load_plan(config.out / "plan.json"))
    tasks = {}
    for node in tree:
        place = config.out / node.id
        tasks[node.id] = NodeTask(kind=node.tier, stage=node.id, folder=place, key=read_json(place / SEAL_NAME)["key"])
    assert sum(node.tier == "device" for node in tree) == 4
    return tree, tasks


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    with ray_cluster() as cluster:
        cluster.start("head", num_cpus=1)
        yield cluster


def test_executors_cost_at_most_a_twentieth(run: tuple[Tree, dict[str, NodeTask]], cluster: Cluster, tmp_path: Path, capsys) -> None:
    tree, tasks = run

    def bare(num_threads: int) -> None:
        environment = {**os.environ, "OMP_NUM_THREADS": str(num_threads), "GOMP_SPINCOUNT": "0"}
        for node in tree:
            command = worker_command(tasks[node.id])
            subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def local() -> None:
        LocalExecutor(num_workers=1).fold(tree, lambda node: tasks[node.id], lambda event: None)

    def ray() -> None:
        RayExecutor(address=cluster.address, log=tmp_path / "ray.log").fold(tree, lambda node: tasks[node.id], lambda event: None)

    ways: dict[str, Callable[[], None]] = {
        "bare": lambda: bare(os.cpu_count() or 1),
        "local": local,
        "bare, one thread": lambda: bare(1),
        "ray": ray,
    }
    walls_s: dict[str, list[float]] = {name: [] for name in ways}
    cpus_s: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(NUM_ROUNDS):
        for name, way in ways.items():
            for task in tasks.values():
                (task.folder / SEAL_NAME).unlink()
            begun_s = time.monotonic()
            with _Spent(cluster) as spent:
                way()
            walls_s[name].append(time.monotonic() - begun_s)
            cpus_s[name].append(spent.cpu_s)
    with capsys.disabled():
        for name in ways:
            print(f"{name}: wall {np.median(walls_s[name]):.2f} s {walls_s[name]}, CPU {np.median(cpus_s[name]):.2f} s {cpus_s[name]}")
    for name, base in (("local", "bare"), ("ray", "bare, one thread")):
        # CPU, since other work on this machine changes the wall time of equal work by more than a
        # twentieth.
        share = np.median(cpus_s[name]) / np.median(cpus_s[base])
        assert 0.8 < share <= 1 + MAX_OVERHEAD, (name, share, cpus_s)


class _Spent:
    """CPU seconds within the block: of this process, its children that ended, and all of the
    cluster with its ended children.

    Ray ends a job's workers with the job and nobody waits for them, so that they are looked at
    while they live.
    """

    def __init__(self, cluster: Cluster) -> None:
        self._cluster, self._end, self._looking_s = cluster, threading.Event(), 0.0
        self._last: dict[tuple[int, str], float] = {}

    def __enter__(self) -> _Spent:
        self._look()
        self._before_s, self._first = _own_cpu_s(), dict(self._last)
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._end.set()
        self._thread.join()
        self._look()
        of_cluster_s = sum(used_s - self._first.get(process, 0.0) for process, used_s in self._last.items())
        self.cpu_s = _own_cpu_s() - self._before_s - self._looking_s + of_cluster_s

    def _watch(self) -> None:
        while not self._end.wait(0.2):
            self._look()
        self._looking_s = time.thread_time()

    def _look(self) -> None:
        for pid in self._cluster.pids("head"):
            try:
                fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
            except OSError:
                continue
            self._last[pid, fields[19]] = sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")


def _own_cpu_s() -> float:
    own = os.times()
    return own.user + own.system + own.children_user + own.children_system
