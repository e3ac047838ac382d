"""`radiant machine profile`: a real short run on generated photographs, the stage times of a finished run, and what it cannot use."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from radiant_app.cli.machine import profile as profile_cli
from radiant_app.commands.machine.profile import ProfileRequest, check_table, profile, profile_of_run
from radiant_app.commands.machine.profiling import MIN_PHOTOGRAPHS, Measuring, Task, choose_counts, shorten_training
from radiant_app.commands.plan.plan import PlanRequest, plan
from radiant_app.commands.run.steps import training_part
from radiant_app.config.run_config import RunConfig
from radiant_app.events import Event, Listener, StageDone, StageProgress, StageStarted, Warned
from radiant_app.executors import fork_server, local
from radiant_app.executors.protocol import NodeTask
from radiant_app.files.profile_file import library_profiles, load_profile
from radiant_app.files.run_folder import Manifest, recorded_config
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.predictions import planned_training
from radiant_app.workers.inbox import save_joining
from radiant_app.workers.nodes import run_node
from radiant_app.workers.tasks import receive_task
from radiant_core.aggregate.config import EDGE_EPOCHS
from radiant_core.errors import BadInput, StageFailed
from radiant_core.evaluate.split import held_out_mask
from radiant_core.frames import Frame, Sim3
from radiant_core.hierarchy.codec import load_uncertainty, save_task
from radiant_core.hierarchy.messages import DeviceTask
from radiant_core.io.records import load_plan, load_scene, save_plan, save_scene
from radiant_core.io.run_store import read_json, write_json
from radiant_core.plan.devices.device_split import split_edges
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.render.rendered_view import render_views
from radiant_core.scene import SfmScene
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.densify.policies import Adc
from radiant_core.train.needs import Overrides
from radiant_viewer.pictures.images import save_png
from tests.core.plan.test_profiles import system as system_of
from tests.core.scenes import cameras_above, ground_splats

QUICK = Overrides(num_steps=24, long_side_px=48, max_num_splats=600)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a scene with 9 rendered photographs, of which 7 are trained on."""
    folder = tmp_path_factory.mktemp("scene")
    splats = ground_splats(300)
    cameras = cameras_above([(x, y) for x in (-2.0, 0.0, 2.0) for y in (-2.0, 0.0, 2.0)])
    (folder / "images").mkdir()
    for view in render_views(splats, cameras):
        save_png(folder / "images" / view.name, view.image_bytes)
    seen = [np.flatnonzero(cameras.select([view]).any_sees(splats.means)) for view in range(len(cameras))]
    made = SfmScene(
        cameras=cameras,
        points=splats.means.astype(np.float64),
        colors=np.full((len(splats), 3), 128, np.uint8),
        observations=np.concatenate([np.column_stack([points, np.full(len(points), view)]) for view, points in enumerate(seen)]),
        frame=Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3), residual_m=None),
    )
    save_scene(folder / "scene.safetensors", made)
    write_json(folder / "result.json", {"images": "images", "unregistered": []})
    return folder


def in_this_process(self: Measuring, kind: str, tasks: Mapping[Path, Task]) -> list[float]:
    """As `Measuring._run`, without processes of its own: the work is real, the start of Python is saved."""
    spent_s: list[float] = []
    for folder, task in tasks.items():
        save_task(folder, task)
        begun_s = time.monotonic()
        run_node(kind, folder, folder.name, lambda event: self._report_progress(0.0))
        # Stands for the start of a process, and makes seconds of these few steps stand out of the
        # noise.
        spent_s.append(time.monotonic() - begun_s + 0.3)
    return spent_s


def test_a_short_real_run_becomes_a_curve_file_that_a_plan_can_use(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tasks: list[DeviceTask] = []

    def keep(self: Measuring, kind: str, given: Mapping[Path, Task]) -> list[float]:
        tasks.extend(task for task in given.values() if isinstance(task, DeviceTask))
        return in_this_process(self, kind, given)

    monkeypatch.setattr(Measuring, "_run", keep)
    events: list[Event] = []
    request = ProfileRequest(
        out=tmp_path / "mine.toml", source=scene, overrides=QUICK, time_s=1.0, num_workers=1, num_threads=1, machine="mine\n"
    )
    result = profile(request, events.append)
    made = load_profile(tmp_path / "mine.toml")
    num_training = int((~held_out_mask(tuple(f"{index}" for index in range(9)))).sum())
    counts = [count for count, _ in made.train_s.samples]
    assert counts == sorted(counts) and len(counts) >= 3 and counts[-1] == num_training == made.train_s.largest_count
    assert (made.kind, made.machine, made.measured_steps) == ("measured", "mine", QUICK.num_steps)
    assert (made.key.num_steps, made.key.long_side_px, made.key.max_num_splats) == (24, 48, 600)
    # A Gaussian of degree 1 has 92 bytes.
    assert made.init_s.curve(5) > 0.2 and made.train_s.curve(5) > 0
    assert 92 * 100 < made.model_bytes.curve(5) <= 92 * 600 * 1.3
    assert made.aggregate_s is not None and made.aggregate_alone_s is not None and made.merge_s is not None
    assert made.latency_s is not None and made.add_s_per_byte is not None
    assert result["exchange"].startswith(f"{1e3 * made.latency_s:.2f} ms one way")
    assert "epochs of retraining at edges" in made.source
    # A device of a run leaves out no Gaussians at random.
    assert {task.train.drop_gaussians for task in tasks} == {"none"}
    rows = {row["quantity"]: row for row in result["check"]}
    assert {"start-up", "training", "device", "model"} <= rows.keys()
    assert all(row["error"] == pytest.approx(row["predicted"] / row["measured"] - 1) for row in rows.values())
    assert f"{rows['model']['predicted']:.2f} MB" in check_table(result["check"])
    progress = [event for event in events if isinstance(event, StageProgress) and event.stage == "profile"]
    assert isinstance(next(event for event in events if getattr(event, "stage", "") == "profile"), StageStarted)
    assert all(0 <= event.done <= event.total for event in progress) and any("photographs" in event.note for event in progress)
    left_s = [event.total - event.done for event in progress]
    assert max(left_s) > 20, "what frames and own structure from motion take is expected from the beginning"
    assert any(isinstance(event, StageDone) and event.stage == "profile" for event in events)
    warnings = planned_with(tmp_path, scene, "long_side_px", 48)
    assert warnings == "none"
    assert "profile 'mine.toml', are of preset default, 24 steps at 48 px" in planned_with(tmp_path, scene, "long_side_px", 96)


def test_nodes_are_forked_as_in_a_run_with_the_threads_that_were_asked_for(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process that starts anew takes seconds longer, and a run starts none."""
    asked: list[tuple[Sequence[str], str, int]] = []

    def refuse(names: Sequence[str], environment: Mapping[str, str]) -> None:
        asked.append((names, environment["OMP_NUM_THREADS"], fork_server._open_servers.num_runs))
        raise StageFailed("asked")

    monkeypatch.setattr(local, "open_server", refuse)
    kept = fork_server._open_servers.num_runs
    for workers, threads, expected in ((1, 3, "3"), (64, None, "1")):
        with pytest.raises(StageFailed, match="asked"):
            profile(
                ProfileRequest(out=tmp_path / "mine.toml", source=scene, overrides=QUICK, num_workers=workers, num_threads=threads),
                lambda event: None,
            )
        assert asked.pop() == (local.IMPORTED, expected, kept + 1)
    assert fork_server._open_servers.num_runs == kept


def test_photographs_alone_are_reconstructed_by_a_task_that_its_worker_accepts(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks: list[Any] = []

    def receive(node: NodeTask, listen: Listener) -> None:
        tasks.append(receive_task(node.kind, node.folder))
        raise StageFailed("received")

    monkeypatch.setattr("radiant_app.commands.machine.profile.run_task", receive)
    with pytest.raises(StageFailed, match="received"):
        profile(ProfileRequest(out=tmp_path / "mine.toml", source=scene / "images"), lambda event: None)
    assert [task.source for task in tasks] == [str((scene / "images").resolve())]


def test_edges_are_timed_at_what_a_run_has_them_do(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They retrain two devices' models on all their views, and pass a lone one on."""
    monkeypatch.setattr(Measuring, "_run", in_this_process)
    measured = measuring_in(tmp_path, scene).measure(1.0)
    summaries = {path.parent.name: read_json(path) for path in (tmp_path / "edges").glob("*/summary.json")}
    joined = [name for name in summaries if name.split("-")[1] == "2"]
    assert len(joined) >= 2 and 1 <= measured.num_epochs <= EDGE_EPOCHS
    for name in joined:
        assert summaries[name]["num_steps"] == measured.num_epochs * int(name.split("-")[0])
    assert all(summary["num_steps"] == 0 for name, summary in summaries.items() if name not in joined)
    merges = {int(path.parent.name): read_json(path) for path in (tmp_path / "cloud").glob("*/summary.json")}
    assert sorted(merges) == [sample.num_cameras for sample in measured.merges] == sorted(int(name.split("-")[0]) for name in joined)
    assert all(summary["num_steps"] > 0 and summary["num_steps"] % views == 0 for views, summary in merges.items())


@pytest.mark.parametrize("outcome", ["moved", "alone", "refused", "fails"])
@pytest.mark.parametrize("num_workers", [1, 2])
def test_what_one_frame_takes_is_a_joins_time_with_frames_by_gps_less_that_with_exact_ones(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, outcome: str, num_workers: int
) -> None:
    """Beside the epoch, which both take; models that are not brought together take less, which is no measure."""
    spent_s = {"exact": 3.0, "unsure": 11.5, "alone": 9.5}
    still = Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))
    asked: list[str] = []

    def play(self: Measuring, kind: str, tasks: Mapping[Path, Task]) -> list[float]:
        if not all(folder.parent.name == "frames" for folder in tasks):
            return in_this_process(replace(self, num_workers=1), kind, tasks)
        (name,) = {folder.name.split("-")[0] for folder in tasks}
        asked.append(name)
        if outcome == "fails" and name == "unsure":
            raise StageFailed("no memory")
        for folder in tasks:
            given = [load_uncertainty(place) for place in (folder / "inbox").iterdir()]
            assert len(given) == 2 and all((own is None) == (name == "exact") for own in given)
            write_json(folder / "summary.json", {"train_s": 2.0 if name == "exact" else 2.5})
            moved = outcome == "moved" and name != "exact"
            second = None if outcome == "refused" and name != "exact" else replace(still, scale=1.001) if moved else still
            save_joining(folder, {"model-1": replace(still, scale=0.999) if moved else still, "model-2": second}, {}, None)
        return [spent_s[name] for _ in tasks]

    monkeypatch.setattr(Measuring, "_run", play)
    events: list[Event] = []
    measured = replace(measuring_in(tmp_path, scene), listen=events.append, num_workers=num_workers).measure(1.0)
    known = outcome == "moved"
    assert measured.frames_s == (pytest.approx(8.0) if known else None)
    assert measured.frames_alone_s == (pytest.approx(8.0 if num_workers == 1 else 6.0) if known else None)
    assert asked == ["exact", "unsure", "alone"][: 3 if known and num_workers > 1 else 2]
    said = [event.message for event in events if isinstance(event, Warned) and "frames of 2 models" in event.message]
    assert len(said) == (not known)


def test_own_structure_from_motion_is_measured_of_few_and_of_many_where_time_allows(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = [0.0]
    monkeypatch.setattr(Measuring, "_place", lambda self, count, start_s: now_s.append(now_s.pop() + 2.0 * count) or 2.0 * count)
    measuring = replace(measuring_in(tmp_path, scene), clock=lambda: now_s[0])
    for time_s, expected in ((200.0, [13, 52]), (129.0, [13]), (1.0, [13])):
        now_s[0] = 0.0
        assert measuring._placements([6, 13, 26, 52, 100], 0.0, time_s) == [(count, 2.0 * count) for count in expected]
    now_s[0] = 0.0
    assert measuring._placements([6, 8], 0.0, 1e9) == [(8, 16.0)] and measuring._placements([3], 0.0, 1e9) == []


def measuring_in(folder: Path, scene: Path) -> Measuring:
    """A measuring whose nodes run in this process."""
    return Measuring(
        work=folder,
        scene=training_part(load_scene(scene / "scene.safetensors")),
        images=scene / "images",
        train=planned_training("default", QUICK),
        backend="native",
        num_workers=1,
        num_threads=1,
        listen=lambda event: None,
    )


def planned_with(folder: Path, scene: Path, name: str, value: int) -> str:
    """Warnings of `radiant plan` for a system of the profile and training of another size; they also stand in the plan's file."""
    out = folder / f"plan_{value}.json"
    (folder / "system.toml").write_text('[[edge]]\nid = "e"\nprofile = "mine.toml"\n[[edge.device]]\nid = "d"\nprofile = "mine.toml"\n')
    overrides = Overrides(**{**asdict(QUICK), name: value})
    request = PlanRequest(source=scene, out=out, system=folder / "system.toml", method="exact", seed=0, overrides=overrides)
    result = plan(request, ProgressDisplay(Console(quiet=True)))
    assert " ".join(read_json(out).get("warnings", [])) == result["warnings"].replace("none", "")
    assert load_plan(out)[0].counts.sum() == 7
    # One device refines nothing; two do; without profiles nobody knows how long a training is.
    (folder / "two.toml").write_text((folder / "system.toml").read_text() + '[[edge.device]]\nid = "d2"\nprofile = "mine.toml"\n')
    others = [replace(request, system=system, out=folder / f"{value}_{system is None}.json") for system in (folder / "two.toml", None)]
    two, without = (plan(other, ProgressDisplay(Console(quiet=True))) for other in others)
    assert result["refining_s"] == 0 < two["refining_s"] and "refining_s" not in without
    return result["warnings"]


def run_folder(folder: Path, *, emulated: bool = False, frames: Any = "shared") -> Path:
    """What a finished run keeps of its times: three devices of one edge with 4, 6 and 10 photographs."""
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(0)
    positions = rng.random((20, 2)) * 100
    system = system_of(None, None, None)
    cloud = plan_regions(positions, system)
    (edge,) = split_edges(positions, cloud, system)  # type: ignore[arg-type]
    edge = type(edge)(**{**vars(edge), "device_of_camera": np.repeat([0, 1, 2], [4, 6, 10])})
    save_plan(folder / "plan.json", cloud, (edge,))  # type: ignore[arg-type]
    config = RunConfig(source=folder, out=folder, emulate=Path("s.toml") if emulated else None, frames=frames)
    manifest = Manifest(folder=folder, config=recorded_config(config))
    for name, count in (("d0", 4), ("d1", 6), ("d2", 10)):
        device = folder / "devices" / name
        device.mkdir(parents=True)
        write_json(device / "task.json", {"train": asdict(train_preset("default"))})
        write_json(device / "summary.json", {"train_s": 10.0 + count, "model_bytes": 1000 * count})
        manifest.stages[f"devices/{name}"] = {"started_s": 5.0, "ended_s": 5.0 + 10.0 + count + 3.0}
    manifest.stages["edges/e"] = {"started_s": 40.0, "ended_s": 52.0}
    manifest.save()
    write_json(folder / "metrics.json", {})
    return folder


def test_stage_times_of_a_run_become_its_curves(tmp_path: Path) -> None:
    result = profile_of_run(run_folder(tmp_path), tmp_path / "mine.json", "mine")
    made = load_profile(tmp_path / "mine.json")
    np.testing.assert_allclose(made.train_s.curve([4, 6, 10]), [14, 16, 20], rtol=1e-9)
    np.testing.assert_allclose(made.init_s.curve([4, 6, 10]), 3, rtol=1e-9)
    np.testing.assert_allclose(made.model_bytes.curve([4, 10]), [4000, 10_000], rtol=1e-9)
    assert made.aggregate_s is not None and float(made.aggregate_s.curve(20)) == pytest.approx(12.0)
    assert made.aggregate_alone_s is None and made.key.preset == "default"
    rows = {row["quantity"]: row for row in result["check"]}
    assert rows["training"]["num_cameras"] == 6 and rows["training"]["error"] == pytest.approx(0, abs=1e-9)


def test_a_run_whose_times_are_played_or_missing_is_refused(tmp_path: Path) -> None:
    played = run_folder(tmp_path / "played", emulated=True)
    with pytest.raises(BadInput, match="emulated"):
        profile_of_run(played, tmp_path / "a.toml")
    run = run_folder(tmp_path / "real")
    (tmp_path / "gps").mkdir()
    own_frames = run_folder(tmp_path / "gps" / "run", frames="gps")
    with pytest.raises(BadInput, match="made with --frames gps"):
        profile_of_run(own_frames, tmp_path / "a.toml")
    shutil.rmtree(run / "devices")
    with pytest.raises(BadInput, match="no times of a device"):
        profile_of_run(run, tmp_path / "a.toml")
    with pytest.raises(BadInput, match=r"holds no metrics.json"):
        profile_of_run(tmp_path, tmp_path / "a.toml")
    assert not (tmp_path / "a.toml").exists()


@pytest.mark.parametrize(
    ("num_photographs", "counts", "held_out"), [(4, [2, 3, 4], None), (10, [2, 3, 6, 10], 4), (52, [6, 13, 26, 52], 18)]
)
def test_counts_are_even_in_ratio_and_one_in_the_middle_is_held_out(num_photographs: int, counts: list[int], held_out: int | None) -> None:
    assert choose_counts(num_photographs) == (counts, held_out)


def test_huge_sets_are_profiled_on_a_part_and_tiny_ones_refused() -> None:
    assert choose_counts(10**6)[0][-1] == 200
    with pytest.raises(BadInput, match=f"expected {MIN_PHOTOGRAPHS} or more"):
        choose_counts(3)


def rounds_every(train: TrainConfig) -> int:
    assert isinstance(train.density, Adc)
    return train.density.every


def test_a_shortened_training_has_as_many_rounds_of_density_control() -> None:
    train = train_preset("default")
    for num_steps in (700, 1_400, 3_500):
        short = shorten_training(train, num_steps)
        assert short.num_steps == num_steps
        assert num_steps / rounds_every(short) == pytest.approx(train.num_steps / rounds_every(train), rel=0.05)
    assert rounds_every(shorten_training(train, 1)) == 1
    assert shorten_training(train, train.num_steps) == train


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"out": "mine.txt"}, "ends in .toml or .json"),
        ({"out": "."}, "is no name for a curve file"),
        ({"out": "there.toml/mine.toml"}, "expected a folder to write"),
        ({"out": "there.toml"}, "exists"),
        ({"time_s": 0.0}, "--time is 0.0"),
        ({"time_s": float("nan")}, "--time is nan"),
        ({"num_threads": 0}, "--threads is 0"),
        ({"num_workers": 0}, "--workers is 0"),
    ],
)
def test_what_cannot_be_asked_for_is_said_before_anything_runs(tmp_path: Path, fields: dict, message: str) -> None:
    (tmp_path / "there.toml").write_text("")
    given = {"out": tmp_path / fields.get("out", "mine.toml"), **{name: value for name, value in fields.items() if name != "out"}}
    with pytest.raises(BadInput, match=message):
        ProfileRequest(**given)


def test_photographs_that_are_not_there_leave_no_file(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="is no folder"):
        profile(ProfileRequest(out=tmp_path / "mine.toml", source=tmp_path / "none"), lambda event: None)
    assert not (tmp_path / "mine.toml").exists()


def test_the_command_prints_the_library_and_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    profile_cli(list_known=True)
    listed = capsys.readouterr().out
    assert max(map(len, listed.splitlines())) <= 80
    for name, path in library_profiles().items():
        known = load_profile(path)
        assert f"{name}: {known.machine}. {known.source}" in " ".join(listed.split())
    run = run_folder(tmp_path / "run")
    profile_cli(out=tmp_path / "mine.toml", from_run=run, as_json=True)
    assert json.loads(capsys.readouterr().out)["largest_count"] == 10
    profile_cli(out=tmp_path / "again.toml", from_run=run)
    assert "predicted" in capsys.readouterr().out
    with pytest.raises(BadInput, match="--out is missing"):
        profile_cli()
    with pytest.raises(BadInput, match="leave out the photographs"):
        profile_cli(source=run, from_run=run, out=tmp_path / "more.toml")
