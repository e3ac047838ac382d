"""`--masks` through whole runs: who gets which mask, what figures say of it, and that a changed one is noticed."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from radiant_app.commands.model.evaluate import EvaluateRequest, evaluate
from radiant_app.commands.run.pipeline import RunResult, run
from radiant_app.commands.run.train import TrainRequest, train
from radiant_app.config.run_config import RunConfig, SfmOptions
from radiant_app.events import Event, StageSkipped
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.dealing import count_received
from radiant_core.errors import BadInput
from radiant_core.io.photos.masks import mask_name, save_mask
from radiant_core.io.run_store import read_json
from tests.app.pipeline_kit import FOUR
from tests.app.test_masks import HELD_OUT, TINY, USED, masked_hamlet


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return masked_hamlet(tmp_path_factory.mktemp("project"))


@pytest.fixture(scope="module")
def finished(project: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[RunConfig, RunResult]:
    out = tmp_path_factory.mktemp("out") / "run"
    config = RunConfig(source=project, out=out, sfm=SfmOptions(masks=project / "masks"), train=TINY, plan=FOUR)
    return config, run(config)


@pytest.mark.stress
def test_each_device_has_the_masks_of_its_photographs_and_they_count_as_no_photographs(finished: tuple[RunConfig, RunResult]) -> None:
    config, _ = finished
    dealt = 0
    for device in (config.out / "devices").iterdir():
        photographs = {path.name for path in (device / "photos").iterdir()}
        assert {path.name for path in (device / "masks").iterdir()} == {mask_name(name) for name in photographs - {HELD_OUT}}
        ledger = count_received([device / "photos", device / "scene.safetensors", device / "masks"])
        assert ledger["num_photographs"] == len(photographs)
        dealt += len(photographs)
    manifest = read_json(config.out / "manifest.json")
    assert sum(row["num_photographs"] for row in manifest["ledger"] if row["tier"] == "device") == dealt == 10
    (told,) = [decision for decision in manifest["decisions"] if decision["topic"] == "masks"]
    assert told["choice"].startswith("11 of 12") and told["figure"] == pytest.approx(100 * 11 / 12 / 6, abs=0.1)


@pytest.mark.stress
def test_held_out_figures_say_which_share_they_are_of(finished: tuple[RunConfig, RunResult]) -> None:
    config, result = finished
    shares = {row["name"]: row["used_share"] for row in result.metrics["images"]}
    assert shares == {"drone_0000.jpg": pytest.approx(5 / 6, abs=0.01), HELD_OUT: 1.0}
    assert {path.name for path in (config.out / "evaluation" / "masks").iterdir()} == {"drone_0000.jpg.png"}
    again = evaluate(EvaluateRequest(model=config.out), ProgressDisplay(Console(quiet=True)))
    assert again["psnr_db"] == pytest.approx(result.metrics["psnr_db"], abs=1e-6)


@pytest.mark.stress
def test_resuming_notices_a_changed_mask_and_skips_all_where_none_changed(
    finished: tuple[RunConfig, RunResult], project: Path, tmp_path: Path
) -> None:
    config, result = finished
    events: list[Event] = []
    assert run(config, events.append, resume=True).metrics["images"] == result.metrics["images"]
    assert StageSkipped(stage="sfm") in events
    with pytest.raises(BadInput, match="another --masks"):
        run(replace(config, sfm=SfmOptions()), resume=True)
    shutil.copytree(project / "masks", tmp_path / "masks")
    request = TrainRequest(source=project, out=tmp_path / "trained", masks=tmp_path / "masks", overrides=TINY.overrides)
    train(request)
    before = (tmp_path / "trained" / "scene.ply").read_bytes()
    save_mask(tmp_path / "masks" / "drone_0003.png", USED[::-1])
    events.clear()
    train(request, events.append, resume=True)
    assert StageSkipped(stage="sfm") not in events and StageSkipped(stage="train") not in events
    assert (tmp_path / "trained" / "scene.ply").read_bytes() != before
