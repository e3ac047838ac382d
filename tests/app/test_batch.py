"""A batch of real runs on the smallest sample scene: it goes on after a crash and bad input, resumes, and stops as a whole."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from radiant_app.commands.run.batch import BatchResult, JobResult
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_core.io.records import load_plan
from tests.app.pipeline_kit import radiant, refused
from tests.forked import has_ended

HAMLET = sample_scenes_folder() / "hamlet"
WAIT_S = 60.0
FLEET = """
[[edge]]
id = "e"
speed = 1
[[edge.device]]
id = "d"
speed = 1
[[edge]]
id = "idle"
speed = 0.01
[[edge.device]]
id = "idle-1"
speed = 0.01
relative_speed = 0.001
"""
NIGHT = """
[defaults]
steps = 2
long-side-px = 48
max-splats = 200

[[job]]
name = "crashes"
source = "lonely"

[[job]]
name = "empty"
source = "nothing"

[[job]]
name = "good"
source = "hamlet"
emulate = "one.toml"
devices = "all"
"""


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a COLMAP project (no matching: quick), a single photograph, an empty folder and
    a job file of all three.

    The system has an edge that is too slow to get a camera.
    """
    folder = tmp_path_factory.mktemp("desk")
    shutil.copytree(HAMLET / "images", folder / "hamlet" / "images")
    shutil.copytree(HAMLET / "known", folder / "hamlet" / "sparse" / "0")
    for name in ("nothing", "lonely"):
        (folder / name).mkdir()
    shutil.copy(next((HAMLET / "images").iterdir()), folder / "lonely")
    (folder / "one.toml").write_text(FLEET)
    (folder / "night.toml").write_text(NIGHT)
    return folder


@pytest.fixture(scope="module")
def finished(desk: Path) -> subprocess.CompletedProcess[str]:
    """The batch of the job file, its first job killed as by a segmentation fault."""
    process = batch(desk / "night.toml", "--json")
    os.kill(job_of(process), signal.SIGSEGV)
    output, errors = process.communicate(timeout=3 * WAIT_S)
    return subprocess.CompletedProcess(process.args, process.returncode, output, errors)


def batch(*arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "radiant_app", "run", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def job_of(process: subprocess.Popen[str]) -> int:
    """The process of the job that a batch runs."""
    return waited_for(lambda: next(iter(children_of(process.pid)), None))


def children_of(pid: int) -> list[int]:
    path = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(child) for child in path.read_text().split()] if path.exists() else []


def waited_for(find):
    deadline_s = time.monotonic() + WAIT_S
    while not (found := find()):
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
    return found


def summary(folder: Path) -> dict:
    return json.loads((folder / "summary.json").read_text())


def test_a_batch_goes_on_after_a_crash_and_bad_input(desk: Path, finished: subprocess.CompletedProcess[str]) -> None:
    """Alone runs a batch in real processes three deep: the batch, its jobs and their nodes."""
    assert finished.returncode == 1, finished.stderr
    record = json.loads(finished.stdout)
    assert record == summary(desk / "night") and record["exit_code"] == 1
    crashed, empty, good = record["jobs"]
    assert [job["status"] for job in record["jobs"]] == ["failed", "failed", "done"]
    assert "was killed by signal 11" in crashed["message"] and crashed["exit_code"] == 1
    assert "photograph" in empty["message"] and empty["exit_code"] == 2 and "Traceback" not in finished.stderr
    metrics = json.loads((desk / "night" / "good" / "metrics.json").read_text())
    assert good["figures"]["psnr_db"] == metrics["psnr_db"] and good["seconds"] > 0
    assert "done devices/d" in finished.stderr and "job 3 of 3: good" in finished.stderr
    page = (desk / "night" / "summary.html").read_text()
    assert 'href="good/report.html"' in page and (desk / "night" / "good" / "report.html").is_file()
    assert not (desk / "night" / "empty").exists(), "bad input leaves nothing half-written"


def test_a_run_whose_plan_leaves_an_edge_without_cameras_has_its_report(desk: Path, finished: subprocess.CompletedProcess[str]) -> None:
    _, edge_plans = load_plan(desk / "night" / "good" / "plan.json")
    assert [len(plan.camera_indices) for plan in edge_plans] == [10, 0]
    assert "idle-1" in (desk / "night" / "good" / "report.html").read_text()


def test_an_emulated_run_keeps_emulated_times_apart(desk: Path, finished: subprocess.CompletedProcess[str]) -> None:
    run = desk / "night" / "good"
    manifest, metrics = (json.loads((run / f"{name}.json").read_text()) for name in ("manifest", "metrics"))
    assert manifest["config"]["emulate"] == str(desk / "one.toml")
    assert set(manifest["stages"]) == {"sfm", "cloud", "evaluation"} == set(metrics["seconds"])
    assert set(manifest["emulated"]) == {"devices/d", "devices/d/uplink", "edges/e", "edges/e/uplink"} == set(metrics["emulated_seconds"])
    nodes_s = metrics["emulated_seconds"]["devices/d"] + metrics["emulated_seconds"]["edges/e"]
    assert metrics["emulated_makespan_s"] == pytest.approx(nodes_s, abs=1e-9)
    page = (run / "report.html").read_text()
    assert "Emulated (s)" in page and "When each emulated machine ran" in page
    assert "done devices/d in" in finished.stderr and "(emulated)" in finished.stderr


def test_resuming_skips_finished_jobs_and_tries_the_others_again(desk: Path, finished: subprocess.CompletedProcess[str]) -> None:
    again = radiant("run", desk / "night.toml", "--resume")
    assert again.returncode == 2, "both failures are bad input now"
    assert [job["status"] for job in summary(desk / "night")["jobs"]] == ["failed", "failed", "skipped"]
    assert summary(desk / "night")["jobs"][2]["figures"]["num_gaussians"] > 0
    assert "good" in again.stdout and "skipped" in again.stdout and "summary.html" in again.stdout, again.stderr


def test_a_finished_batch_is_not_begun_again_and_options_belong_into_the_file(
    desk: Path, finished: subprocess.CompletedProcess[str]
) -> None:
    before = summary(desk / "night")
    for arguments, told in (
        ((), "not empty"),
        (("--steps", 3), "--steps stands beside a job file"),
        (("--out", desk / "one.toml"), "file"),
    ):
        ended = refused("run", desk / "night.toml", *arguments)
        assert ended.returncode == 2 and told in ended.stderr and "Traceback" not in ended.stderr, ended.stderr
    assert summary(desk / "night") == before


def slow_jobs(desk: Path) -> Path:
    """A job file whose first job takes long."""
    path = desk / "slow.toml"
    path.write_text(f'[[job]]\nname = "slow"\nsource = "{HAMLET / "images"}"\n[[job]]\nname = "later"\nsource = "nothing"\n')
    return path


def test_ctrl_c_stops_the_running_job_and_names_the_rest(desk: Path) -> None:
    out = desk / "stopped"
    process = batch(slow_jobs(desk), "--out", out)
    job = job_of(process)
    worker = waited_for(lambda: next(iter(children_of(job)), None))
    waited_for((out / "slow" / "manifest.json").exists)
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=WAIT_S)
    assert process.returncode == 130 and "--resume" in errors and "not started" in output, errors
    assert [job["status"] for job in summary(out)["jobs"]] == ["interrupted", "not started"]
    assert summary(out)["exit_code"] == 130
    assert all(has_ended(pid) for pid in (job, worker)), "nothing outlives the batch"
    assert json.loads((out / "slow" / "manifest.json").read_text())["status"] == "interrupted"


def test_a_killed_batch_takes_its_job_along(desk: Path) -> None:
    process = batch(slow_jobs(desk), "--out", desk / "killed")
    job = job_of(process)
    worker = waited_for(lambda: next(iter(children_of(job)), None))
    process.kill()
    process.communicate(timeout=WAIT_S)
    waited_for(lambda: all(has_ended(pid) for pid in (job, worker)))
    assert summary(desk / "killed")["jobs"][0]["status"] == "running"


@pytest.mark.parametrize(
    ("ends", "code"),
    [
        ([("done", 0), ("skipped", 0)], 0),
        ([("done", 0), ("failed", 2)], 2),
        ([("failed", 2), ("failed", 1)], 1),
        ([("failed", 1)], 1),
        ([("failed", 2), ("interrupted", 130), ("not started", None)], 130),
    ],
)
def test_the_exit_code_says_what_a_user_can_do(ends: list, code: int) -> None:
    jobs = tuple(JobResult(name=str(k), source="s", out="o", status=status, exit_code=each) for k, (status, each) in enumerate(ends))
    assert BatchResult(folder=Path(), jobs=jobs).exit_code == code
