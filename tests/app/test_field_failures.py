"""Photographs that stay on their devices: devices that cannot deliver, what they say without a name, and what is refused."""

from __future__ import annotations

import io
import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from rich.console import Console

from radiant_app.commands.model.extend import ExtendRequest, extend
from radiant_app.commands.plan.replan import ReplanRequest, replan_files
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.pipeline import run
from radiant_app.config.run_config import RunConfig, SfmOptions
from radiant_app.events import Decided, Event, Failed, StageProgress, Warned, encode
from radiant_app.files.event_file import read_progress
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.captured import Captured, _middle, _warn_of_unplaced
from radiant_app.run.progress import Progress
from radiant_app.workers.nodes import run_node
from radiant_app.workers.redaction import HIDDEN, NOTES_NAME, Redactor, make_redactor
from radiant_app.workers.tasks import FieldTask, PositionsTask
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput, StageFailed
from radiant_core.evaluate.split import held_out_mask
from radiant_core.hierarchy.codec import save_task
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_plan, load_scene
from radiant_core.io.run_store import read_json
from radiant_core.plan.revision.replan import FleetChange
from radiant_core.train.config import train_preset
from tests.app.field_kit import TINY, TWO_EDGES, placing_in, split_by_device
from tests.told import stages_done


@pytest.fixture(scope="module")
def hamlet() -> Path:
    return sample_scenes_folder() / "hamlet"


@pytest.fixture(scope="module")
def system(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("system") / "system.toml"
    path.write_text(TWO_EDGES)
    return path


@pytest.mark.draws
def test_a_device_that_cannot_deliver_is_named_and_the_rest_goes_on(hamlet: Path, system: Path, tmp_path: Path) -> None:
    """Alone goes on, after a device failed at its work, to a scene, a report and a new plan."""
    source = split_by_device(hamlet / "images", tmp_path / "captured")
    import cv2

    for index, path in enumerate((source / "south-1").iterdir()):
        # The sky at different times: equal files would be copies of one photograph.
        cv2.imwrite(str(path), np.full((240, 320, 3), (235, 180, 120 + index), np.uint8))
    events: list[Event] = []
    # The poses lie beside the devices' folders.
    shutil.copytree(hamlet / "known", source / "sparse" / "0")
    config = RunConfig(source=source, frames="known", system=system, out=tmp_path / "run", train=TINY)
    result = run(config, events.append)
    names = [f"{path.parent.name}/{path.name}" for path in sorted(source.glob("*/*.jpg"))]
    lost = sum(name.startswith("south-1/") for name, held in zip(names, held_out_mask(names), strict=True) if held)
    assert lost == result.metrics["num_unscored"] > 0
    assert f"Scored on {len(result.metrics['images'])} of {len(result.metrics['images']) + lost} held-out" in result.report.read_text()
    assert list(result.metrics["missing"]) == ["south-1"] and "triangulated" in result.metrics["missing"]["south-1"]
    assert any(isinstance(event, Warned) and event.stage == "devices/south-1" for event in events)
    assert "south-1" in result.report.read_text() and len(load_ply(config.out / "scene.ply")) > 100
    assert (result.metrics["refined"], result.metrics["not_refined"]) == (False, {}), "one device alone is left, which knows all"
    decisions = read_json(config.out / "manifest.json")["decisions"]
    assert [one["choice"] for one in decisions if one["stage"] == "refining"] == ["no device refines the scene"]
    progress = read_progress(config.out)
    ended = {stage.stage for stage in progress.stages if stage.state == "done"}
    assert set(progress.expected) <= ended and "cloud/refine" not in progress.expected, "the count of stages ends"
    new = replan_files(ReplanRequest(source=config.out, out=tmp_path / "new.json"), ProgressDisplay(Console(file=io.StringIO())))
    dealt = next(plan for plan in load_plan(config.out / "plan.json")[1] if "south-1" in plan.device_ids)
    assert f"photographs that never arrived, of south-1 ({len(dealt.cameras_of('south-1'))}): have them taken again" in new["warnings"]


def test_a_device_that_fails_names_no_photograph(hamlet: Path, tmp_path: Path) -> None:
    source, folder = tmp_path / "captured", tmp_path / "devices" / "north-1"
    source.mkdir()
    folder.mkdir(parents=True)
    name = "secret [of] mine.jpg"
    (source / name).write_bytes((hamlet / "images" / "drone_0000.jpg").read_bytes()[:5000])
    placing = replace(placing_in(source), names=(name,))
    save_task(folder, FieldTask(train=train_preset("draft"), backend="native", placing=placing, changed=()))
    events: list[Event] = []
    run_node("field", folder, "devices/north-1", events.append)
    assert any("truncated" in event.message for event in events if isinstance(event, Warned))
    assert name in (folder / NOTES_NAME).read_text()
    told = [*map(encode, events), (folder / "frame.json").read_text(), (folder / "notes.json").read_text()]
    assert "truncated" in told[-2] and not any("secret" in text for text in told)


def test_whatever_a_device_says_is_without_its_names(tmp_path: Path) -> None:
    for name in ("a.jpg", "a.jpg.png", "night\n.jpg", "zoo.jpg"):
        (tmp_path / name).touch()
    names = Redactor(notes=tmp_path / NOTES_NAME, source=tmp_path, names_in_task=("gone.jpg",))
    decision = Decision(stage="devices/a.jpg", topic="a.jpg", choice="left out: a.jpg, zoo.jpg", figure=1.0, unit="px", reason="(gone.jpg)")
    hidden = names.redact_event(Decided(decision=decision))
    assert isinstance(hidden, Decided) and hidden.decision.stage == "devices/a.jpg"
    assert {hidden.decision.topic, hidden.decision.choice.removeprefix("left out: "), hidden.decision.reason[1:-1]} == {HIDDEN}
    failed = names.redact_event(
        Failed(stage="s", message=f"cannot read {tmp_path / 'a.jpg.png'} or {'night' + chr(10) + '.jpg'!r}", exit_code=2)
    )
    assert failed == Failed(stage="s", message=f"cannot read {tmp_path}/{HIDDEN} or '{HIDDEN}'", exit_code=2)
    kept = StageProgress(stage="s", done=1, total=2, note="data.jpg of 3, a.jpgx")
    assert names.redact_event(kept) == kept, "other words stay"
    assert "left out: a.jpg, zoo.jpg" in (tmp_path / NOTES_NAME).read_text()


def test_a_folder_of_all_devices_has_no_secret_names(tmp_path: Path) -> None:
    for fetch, said in ((True, "a.jpg"), (False, HIDDEN)):
        placing = replace(placing_in(tmp_path), names=("a.jpg",), fetch=fetch)
        save_task(tmp_path, FieldTask(train=train_preset("draft"), backend="native", placing=placing, changed=()))
        assert make_redactor("field", tmp_path).redact("a.jpg is truncated") == f"{said} is truncated"
    save_task(tmp_path, PositionsTask(source=str(tmp_path), cell_m=None, held_out=("a.jpg",), owned=True))
    assert make_redactor("positions", tmp_path).redact("a.jpg is truncated") == f"{HIDDEN} is truncated"
    assert make_redactor("device", tmp_path).redact("a.jpg is truncated") == "a.jpg is truncated"


def test_unplaced_photographs_of_a_devices_own_folder_are_counted() -> None:
    nowhere = np.full((3, 3), np.nan)
    nowhere[1] = 0.0
    for owners, expected in [
        (("north-1", "north-1", "south-1"), ["1 of 2 photographs of device north-1 have", "1 of 1 photographs of device south-1 have"]),
        ((None, None, None), ["2 of 3 photographs have no usable position: a.jpg, c.jpg."]),
    ]:
        heard: list[Event] = []
        captured = Captured(names=("a.jpg", "b.jpg", "c.jpg"), owners=owners, positions=nowhere, origin=None)
        _warn_of_unplaced(captured, cast(Progress, SimpleNamespace(listen=heard.append)))
        told = [event.message for event in heard if isinstance(event, Warned)]
        assert len(told) == len(expected) and all(message.startswith(start) for message, start in zip(told, expected, strict=True))
        assert owners[0] is None or ".jpg" not in " ".join(told)


def test_a_device_with_an_empty_folder_is_named_and_the_rest_goes_on(hamlet: Path, tmp_path: Path) -> None:
    """Alone runs `--frames gps` in full: planned anew, extended and resumed from devices that mapped their own photographs."""
    system = tmp_path / "system.toml"
    system.write_text(TWO_EDGES + '[[edge.device]]\nid = "south-2"\n')
    source = tmp_path / "captured"
    for index, path in enumerate(sorted((hamlet / "images").iterdir())):
        folder = source / ("north-1" if index < 6 else "south-1")
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, folder / path.name)
    (source / "south-2").mkdir()
    (source / "south-1" / "lost.jpg").symlink_to("nowhere")
    config = RunConfig(source=source, frames="gps", system=system, out=tmp_path / "run", train=TINY)
    result = run(config)
    assert "no photograph" in result.metrics["missing"]["south-2"] and "north-1" not in result.metrics["missing"]
    manifest = json.loads((tmp_path / "run" / "manifest.json").read_text())
    assert any("south-2 takes no part" in warning for warning in manifest["warnings"])
    told = next(row for row in manifest["ledger"] if row["node"] == "plan")
    assert told["num_photographs"] == 0 and 0 < told["other_bytes"] < 10_000, "names and positions alone"
    # What was delivered can be planned anew and extended; nobody knows more than the plan of what
    # arrived.
    display = ProgressDisplay(Console(file=io.StringIO()))
    delivered = len(load_scene(config.out / "delivered" / "scene.safetensors").cameras)
    assert 0 < delivered <= sum(len(plan.camera_indices) for plan in load_plan(config.out / "plan.json")[1]), "some may have no pose"
    new = replan_files(
        ReplanRequest(source=config.out, out=tmp_path / "new.json", change=FleetChange(dead=frozenset(["south-1"]))), display
    )
    assert new["captured"] == delivered and new["lost"] == new["moved"] == 0, "what a dead device has delivered stays"
    assert "Nothing changes by the loss of south-1, whose models have arrived." in new["warnings"]
    extended = extend(ExtendRequest(old=config.out, new=config.out, out=tmp_path / "more.ply", num_epochs=1), display)
    assert extended["frames"] == "both runs have one origin" and extended["views"] > 0 and extended["gaussians"] > 100
    # Without a place it is not planned, so that nobody else has anything new to do.
    import cv2

    cv2.imwrite(str(source / "south-2" / "found.png"), np.full((240, 320, 3), 200, np.uint8))
    events: list[Event] = []
    again = run(config, events.append, resume=True)
    assert stages_done(events) == ["positions/south-2"]
    assert again.metrics["psnr_db"] == result.metrics["psnr_db"] and "whose place is known" in again.metrics["missing"]["south-2"]
    warnings = json.loads((tmp_path / "run" / "manifest.json").read_text())["warnings"]
    assert any("1 of 1 photographs of device south-2 have no usable position" in warning for warning in warnings)
    assert not any("takes no part" in warning or "found.png" in warning for warning in warnings), "names stay with the device"


def test_the_middle_of_a_site_on_the_180th_meridian_lies_there() -> None:
    site = np.array([[-17.0, 179.999, 5.0], [-17.0, -179.999, 5.0], [-17.001, 179.998, 9.0], [-17.001, -179.998, 1.0]])
    lat, lon, alt = _middle(site)
    assert abs(abs(lon) - 180) < 1e-3 and lat == pytest.approx(-17.0005) and alt == 5.0


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        ({"source": "unknown"}, BadInput, "no device of the system"),
        ({"source": "twice"}, BadInput, "both have a photograph 'drone_0000.jpg'"),
        ({"poses": None}, BadInput, "no poses beside its photographs"),
        ({"frames": "gps", "poses": None, "source": "stripped"}, BadInput, "no photograph has a GPS position"),
        ({"source": "strange"}, BadInput, "and the folder 'other'"),
        ({"source": "lost"}, BadInput, r"photograph 'drone_0000.jpg' of the poses is not in"),
        ({"source": "sky"}, BadInput, "does not fit its photographs"),
    ],
)
def test_what_cannot_be_placed_is_refused(hamlet: Path, system: Path, tmp_path: Path, change: dict, error: type, said: str) -> None:
    import cv2

    make = {
        "stripped": lambda folder: [
            cv2.imwrite(str(folder / p.name), np.asarray(cv2.imread(str(p)))) for p in (hamlet / "images").iterdir()
        ],
        "unknown": lambda folder: shutil.copytree(hamlet / "images", folder / "East-9"),
        "twice": lambda folder: [shutil.copytree(hamlet / "images", folder / name) for name in ("north-1", "south-1")],
        "strange": lambda folder: [(folder / name).mkdir() for name in ("north-1", "other")],
        "lost": lambda folder: [shutil.copyfile(p, folder / p.name) for p in sorted((hamlet / "images").iterdir())[1:]],
        "sky": lambda folder: [
            cv2.imwrite(str(folder / p.name), np.full((240, 320, 3), 200 + index, np.uint8))
            for index, p in enumerate((hamlet / "images").iterdir())
        ],
    }
    settings = {"source": hamlet / "images", "poses": hamlet / "known", "frames": "known", **change}
    if isinstance(settings["source"], str):
        folder = tmp_path / settings["source"]
        folder.mkdir()
        make[settings["source"]](folder)
        settings["source"] = folder
    sfm = SfmOptions(poses=settings.pop("poses"))
    with pytest.raises(error, match=said):
        run(RunConfig(system=system, sfm=sfm, out=tmp_path / "run", train=TINY, **settings))
    assert (tmp_path / "run").exists() == (error is StageFailed)


def test_options_that_contradict_are_refused(hamlet: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="one owner"):
        RunConfig(source=hamlet, out=tmp_path, single_owner=True)
