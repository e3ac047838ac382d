"""What an executor costs over the bare stages: the nodes of a finished run of four devices, one at a time, as plain processes, by the local
executor and by Ray with one CPU; interleaved, wall and CPU seconds side by side. Figures: docs/experiments/faults.md.
"""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import radiant_app.pipeline
from radiant_app.config import RunConfig
from radiant_app.executors.local import LocalExecutor, worker_command
from radiant_app.executors.protocol import NodeTask
from radiant_app.executors.ray_cluster import RayExecutor
from radiant_core.aggregate.tree import Tree, tree_of_plan
from radiant_core.io.records import load_plan
from radiant_core.io.run_store import SEAL_NAME, read_json
from radiant_core.train.needs import Overrides
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
    overrides = Overrides(long_side_px=160, num_steps=800, max_num_splats=3000)
    config = RunConfig(source=folder / "hamlet", out=folder / "run", overrides=overrides, teachers="late", max_workers=1)
    radiant_app.pipeline.run(config)
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

    def bare() -> None:
        environment = {**os.environ, "OMP_NUM_THREADS": str(os.cpu_count()), "GOMP_SPINCOUNT": "0"}
        for node in tree:
            command = worker_command(tasks[node.id])
            subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def local() -> None:
        LocalExecutor(num_workers=1).fold(tree, lambda node: tasks[node.id], lambda event: None)

    def ray() -> None:
        RayExecutor(address=cluster.address, log=tmp_path / "ray.log").fold(tree, lambda node: tasks[node.id], lambda event: None)

    ways: dict[str, Callable[[], None]] = {"bare": bare, "local": local, "ray": ray}
    walls_s: dict[str, list[float]] = {name: [] for name in ways}
    cpus_s: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(NUM_ROUNDS):
        for name, way in ways.items():
            for task in tasks.values():
                (task.folder / SEAL_NAME).unlink()
            begun_s, used_s = time.monotonic(), _cpu_s(cluster)
            way()
            walls_s[name].append(time.monotonic() - begun_s)
            cpus_s[name].append(_cpu_s(cluster) - used_s)
    with capsys.disabled():
        for name in ways:
            print(f"{name}: wall {np.median(walls_s[name]):.2f} s {walls_s[name]}, CPU {np.median(cpus_s[name]):.2f} s {cpus_s[name]}")
    for name in ("local", "ray"):
        # CPU, since other work on this machine changes the wall time of equal work by more than a twentieth.
        assert np.median(cpus_s[name]) <= (1 + MAX_OVERHEAD) * np.median(cpus_s["bare"]), cpus_s


def _cpu_s(cluster: Cluster) -> float:
    """CPU seconds of this process, its children that have ended, and all of the cluster with its ended children."""
    own = os.times()
    total_s = own.user + own.system + own.children_user + own.children_system
    tick_s = 1 / os.sysconf("SC_CLK_TCK")
    for pid in cluster.pids("head"):
        try:
            fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        total_s += tick_s * sum(map(int, fields[11:15]))
    return total_s
