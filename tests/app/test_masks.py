"""`--masks` from the command to the figures: who gets which mask, that a changed one is noticed, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.steps import sfm
from radiant_app.commands.run.train import TrainRequest, train
from radiant_app.config.run_config import RunConfig, SfmOptions, TrainOptions
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.dealing import count_received, deal_masks
from radiant_app.workers.evaluation import select_scored
from radiant_app.workers.sources import masks_folder_of, reconstruct_source, sfm_task
from radiant_core.errors import BadInput
from radiant_core.io.photos.masks import mask_name, save_mask
from radiant_core.io.run_store import write_json
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.intake import Intake
from radiant_core.sfm.world_frame.placement import Placement
from tests.core.scenes import cameras_above

TINY = TrainOptions(long_side_px=96, num_steps=40, max_num_splats=1500)
USED = np.ones((240, 320), bool)
USED[:80, :160] = False
HELD_OUT = "drone_0008.jpg"
"""A held-out photograph; it has no mask."""


def masked_hamlet(folder: Path) -> Path:
    """The hamlet as a COLMAP project in `folder`, with masks of all photographs but one beside it."""
    hamlet = sample_scenes_folder() / "hamlet"
    (folder / "images").symlink_to(hamlet / "images")
    (folder / "sparse").symlink_to(hamlet / "known")
    for path in (hamlet / "images").iterdir():
        if path.name != HELD_OUT:
            save_mask(folder / "masks" / f"{path.stem}.png", USED)
    return folder


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return masked_hamlet(tmp_path_factory.mktemp("project"))


def test_a_scene_made_with_masks_keeps_them_for_training(project: Path, tmp_path: Path) -> None:
    scene = tmp_path / "scene"
    sfm(project, scene, SfmConfig(), ProgressDisplay(Console(quiet=True)), project / "masks")
    assert masks_folder_of(scene) == scene / "masks" and len(list((scene / "masks").iterdir())) == 11
    metrics = train(TrainRequest(source=scene, out=tmp_path / "trained", overrides=TINY.overrides))
    assert [row["used_share"] < 1 for row in metrics["images"]] == [True, False]
    with pytest.raises(BadInput, match="is a scene"):
        train(TrainRequest(source=scene, out=tmp_path / "other", masks=project / "masks", overrides=TINY.overrides))
    assert not (tmp_path / "other").exists()


def test_masks_that_cannot_be_used_get_one_sentence_and_leave_nothing(project: Path, tmp_path: Path) -> None:
    save_mask(tmp_path / "masks" / "drone_0001.png", USED[1:])
    with pytest.raises(BadInput, match=r"drone_0001\.png is 320 × 239 px") as told:
        train(TrainRequest(source=project, out=tmp_path / "out", masks=tmp_path / "masks"))
    assert "\n" not in str(told.value) and not (tmp_path / "out").exists()


def test_masks_go_with_their_photographs_and_count_as_none_of_them(tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert deal_masks(run, ["a/b.jpg"], tmp_path / "device") == []
    (run / "sfm").mkdir(parents=True)
    write_json(run / "sfm" / "result.json", {"images": "undistorted/images", "masks": "masks"})
    for name in ("a/b.jpg", "c.jpg"):
        save_mask(run / "sfm" / "masks" / mask_name(name), USED)
    (tmp_path / "device" / "masks").mkdir(parents=True)
    (tmp_path / "device" / "masks" / "of_an_older_plan.jpg.png").touch()
    (place,) = deal_masks(run, ["a/b.jpg", "whole.jpg"], tmp_path / "device")
    assert [path.relative_to(place).as_posix() for path in place.rglob("*.png")] == ["a/b.jpg.png"]
    (tmp_path / "device" / "photos").mkdir()
    (tmp_path / "device" / "photos" / "whole.jpg").write_bytes(b"123")
    counts = count_received([tmp_path / "device" / "photos", place])
    size_bytes = (place / "a" / "b.jpg.png").stat().st_size
    assert counts == {"num_photographs": 1, "photograph_bytes": 3, "other_bytes": size_bytes}


def test_devices_that_keep_their_photographs_are_refused(project: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="--frames shared"):
        RunConfig(source=project, out=tmp_path / "out", sfm=SfmOptions(masks=project / "masks"), frames="gps")


def test_a_photograph_of_which_nothing_can_be_scored_is_left_out_and_named(tmp_path: Path) -> None:
    cameras = cameras_above([(0.0, 0.0), (1.0, 0.0)], size_wh=(40, 30))
    sliver = np.zeros((30, 40), bool)
    sliver[:, :4] = True
    save_mask(tmp_path / mask_name(cameras.names[0]), sliver)
    told: list[str] = []
    scored, used = select_scored(cameras, tmp_path, told.append)
    assert scored.names == cameras.names[1:] and len(used) == 1 and used[0] is not None and used[0].all()
    assert len(told) == 1 and cameras.names[0] in told[0]
    save_mask(tmp_path / mask_name(cameras.names[1]), sliver)
    with pytest.raises(BadInput, match="nothing of any held-out photograph"):
        select_scored(cameras, tmp_path, told.append)


def test_masks_beside_the_photographs_are_used_without_being_asked_for(project: Path, tmp_path: Path) -> None:
    """The hamlet's masks leave a sixth out, so that black is taken; the same masks turned are asked about."""
    task = sfm_task(project, SfmConfig(), None, Placement())
    assert task.masks == str((project / "masks").resolve())
    assert sfm_task(project, SfmConfig(), None, Placement(), intake=Intake(mask_ignores="nothing")).masks is None
    with pytest.raises(BadInput, match="leave one of them out"):
        sfm_task(project, SfmConfig(), project / "masks", Placement(), intake=Intake(mask_ignores="nothing"))
    result = reconstruct_source(task, tmp_path / "work", lambda progress: None)
    chosen = {decision.topic: decision for decision in result.decisions}
    assert chosen["colour of masks"].figure == pytest.approx(100 / 6, abs=0.1) and not chosen["colour of masks"].forced
    assert result.masks_folder is not None and len(list(result.masks_folder.iterdir())) == 11
    assert not any("not used" in message for message in result.warnings)


def test_white_is_left_out_when_asked_for_to_the_same_scene(project: Path, tmp_path: Path) -> None:
    turned = tmp_path / "turned"
    turned.mkdir()
    for name in ("images", "sparse"):
        (turned / name).symlink_to(project / name)
    for path in (project / "masks").iterdir():
        save_mask(turned / "masks" / path.name, ~USED)
    task = sfm_task(turned, SfmConfig(), None, Placement())
    with pytest.raises(BadInput, match="--mask-ignores white"):
        reconstruct_source(task, tmp_path / "asked", lambda progress: None)
    white = reconstruct_source(
        sfm_task(turned, SfmConfig(), None, Placement(), intake=Intake(mask_ignores="white")), tmp_path / "white", lambda progress: None
    )
    black = reconstruct_source(sfm_task(project, SfmConfig(), None, Placement()), tmp_path / "black", lambda progress: None)
    np.testing.assert_array_equal(white.scene.observations, black.scene.observations)
    assert [message for message in white.warnings if "mask" in message] == [
        "masks/: masks of 11 of 12 photographs are used, white is left out."
    ]
