"""A worker, a machine and the head of a Ray cluster die in the middle of a run: it finishes, or
resumes, and trains nothing twice that was finished. All machines of the cluster are on this
computer, each with processes of its own; a machine dies by SIGKILL of all of them.
"""

from __future__ import annotations

import os
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

import radiant_app.commands.run.pipeline
import radiant_app.report.html
from radiant_app.config.run_config import RunConfig
from radiant_app.events import Event, StageDone, StageProgress, StageStarted, Warned
from radiant_core.errors import StageFailed
from tests.contract.ray_machines import Cluster, ray_cluster
from tests.stress.kill_harness import differing_files
from tests.stress.test_kill_run import RESULTS, SYSTEM, config_of, hamlet_in, worker_in

pytestmark = pytest.mark.stress

AGAIN = ("devices", "edges", "cloud")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run by the local executor, left alone."""
    folder = tmp_path_factory.mktemp("ray")
    hamlet_in(folder)
    (folder / "system.toml").write_text(SYSTEM)
    radiant_app.commands.run.pipeline.run(config_of(folder / "whole"))
    return folder / "whole"


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[Cluster]:
    monkeypatch.setattr(radiant_app.report.html, "write_report", lambda *arguments: None)
    with ray_cluster() as cluster:
        cluster.start("head", num_cpus=1)
        cluster.start("one", num_cpus=1, offers=["device:b-1", "edge:a"])
        yield cluster


class Witness:
    """Remembers what began and ended, and once does something when a stage has come so far."""

    def __init__(self, stage: str, act) -> None:
        self.stage, self.act = stage, act
        self.story: list[tuple[str, str]] = []
        self.warnings: list[str] = []
        self.acted = False

    def __call__(self, event: Event) -> None:
        if isinstance(event, StageStarted | StageDone):
            self.story.append((type(event).__name__, event.stage))
        elif isinstance(event, Warned):
            self.warnings.append(f"{event.stage}: {event.message}")
        elif isinstance(event, StageProgress) and event.stage == self.stage and event.done >= 30 and not self.acted:
            self.acted = True
            threading.Thread(target=self.act, daemon=True).start()

    def trained_twice(self) -> list[str]:
        """Stages that began once more after they had ended."""
        ended, twice = set(), []
        for kind, stage in self.story:
            if kind == "StageDone":
                ended.add(stage)
            elif stage in ended:
                twice.append(stage)
        return twice


def on_ray(whole: Path, name: str, cluster: Cluster) -> RunConfig:
    """A run of the same scene whose structure from motion is done."""
    out = whole.parent / name
    shutil.copytree(whole, out)
    for kind in AGAIN:
        shutil.rmtree(out / kind)
    config = config_of(out)
    return replace(config, execution=replace(config.execution, executor="ray", address=cluster.address, max_workers=0))


def test_a_killed_worker_of_ray_is_started_again(whole: Path, cluster: Cluster) -> None:
    config = on_ray(whole, "worker", cluster)

    def kill_parent() -> None:
        pid = worker_in(config.out / "devices/b-1")
        assert pid is not None
        os.kill(int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1]), signal.SIGKILL)

    witness = Witness("devices/b-1", kill_parent)
    radiant_app.commands.run.pipeline.run(config, witness, resume=True)
    assert witness.acted and any("Ray's worker is gone" in message for message in witness.warnings)
    assert differing_files(whole, config.out, RESULTS) == [] and witness.trained_twice() == []


def test_a_node_whose_machine_dies_goes_on_elsewhere(whole: Path, cluster: Cluster) -> None:
    config = on_ray(whole, "machine", cluster)
    witness = Witness("devices/b-1", lambda: cluster.kill("one"))
    begun_s = time.monotonic()
    radiant_app.commands.run.pipeline.run(config, witness, resume=True)
    assert witness.acted and any(message.startswith("devices/b-1") and "is gone" in message for message in witness.warnings)
    assert differing_files(whole, config.out, RESULTS) == [] and witness.trained_twice() == []
    print(f"finished {time.monotonic() - begun_s:.0f} s after its start")


def test_a_run_whose_cluster_loses_its_head_says_so_and_resumes_on_another(whole: Path, cluster: Cluster) -> None:
    config = on_ray(whole, "head", cluster)
    witness = Witness("devices/b-1", lambda: cluster.kill("head"))
    with pytest.raises(StageFailed, match=r"the connection to the Ray cluster at .* is lost.* --resume"):
        radiant_app.commands.run.pipeline.run(config, witness, resume=True)
    cluster.kill("one")
    with ray_cluster() as other:
        other.start("head", num_cpus=1)
        radiant_app.commands.run.pipeline.run(
            replace(config, execution=replace(config.execution, address=other.address)), witness, resume=True
        )
    assert differing_files(whole, config.out, RESULTS) == [] and witness.trained_twice() == []
