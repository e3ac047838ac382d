"""The main job on every real set, two edges with two devices each. Minutes."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_app.commands.run.pipeline import run
from radiant_app.config.run_config import PlanOptions, RunConfig, TrainOptions
from radiant_core.evaluate.split import held_out_mask
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_scene
from tests.joined_again import held_out_db, joined_again

DATA = Path(os.environ.get("RADIANT_DATA", Path(__file__).parents[3] / "shared" / "data"))


@pytest.mark.stress
@pytest.mark.parametrize("name", ["brighton", "lewis", "caliterra"])
def test_a_real_set_becomes_a_scene(name: str, tmp_path: Path) -> None:
    if not (DATA / name).is_dir():
        pytest.skip(f"{name} is not in {DATA}: set RADIANT_DATA to the folder of the real sets")
    out = tmp_path / "run"
    metrics = run(RunConfig(source=DATA / name / "images", out=out, plan=PlanOptions(devices=4))).metrics
    names = load_scene(out / "sfm" / "scene.safetensors").cameras.names
    training = sorted(name for name, held in zip(names, held_out_mask(names), strict=True) if not held)
    assert sorted(path.name for path in out.glob("devices/*/photos/*")) == training
    assert len(load_ply(out / "scene.ply")) == metrics["num_gaussians"]
    gains = np.array([[row["psnr_db"] - row["initial_psnr_db"], row["psnr_db"] - row["mean_color_psnr_db"]] for row in metrics["images"]])
    assert (gains[:, 0] >= 3).all(), "every photograph beyond the untrained Gaussians"
    # The mean colour knows each photograph's exposure, the model does not: 3 dB beyond it hold for
    # the set, not for each photograph.
    assert np.median(gains[:, 1]) >= 1.5, np.round(gains[:, 1], 2)
    # Nothing limits joining but the machine; what a limit leaves is worth no more.
    ample, cut = (joined_again(out, tmp_path / str(limit), memory_bytes=limit) for limit in (1.6e10, 1e8))
    assert ample.warnings == [] and len(cut.warnings) == 1
    np.testing.assert_array_equal(ample.splats.means, load_ply(out / "cloud" / "scene.ply").means)
    joined_db, cut_db = held_out_db(out, ample.splats), held_out_db(out, cut.splats)
    print(f"{name}: {joined_db:.2f} dB joined, {cut_db:.2f} dB cut")
    assert joined_db >= cut_db


@pytest.mark.stress
def test_few_photographs_are_better_off_with_one_device(tmp_path: Path) -> None:
    if not (DATA / "brighton").is_dir():
        pytest.skip(f"brighton is not in {DATA}: set RADIANT_DATA to the folder of the real sets")
    train = TrainOptions(preset="draft", num_steps=500, long_side_px=384)
    config = RunConfig(source=DATA / "brighton" / "images", out=tmp_path / "one", train=train)
    one = run(config).metrics
    all_four = run(replace(config, out=tmp_path / "all", plan=PlanOptions(devices=4))).metrics
    print(f"one device {one['psnr_db']:.2f} dB, four {all_four['psnr_db']:.2f} dB")
    assert [path.name for path in (tmp_path / "one" / "devices").iterdir()] == ["edge-1-1"]
    assert len(list((tmp_path / "all" / "devices").iterdir())) == 4
    assert one["psnr_db"] > all_four["psnr_db"] + 0.3
