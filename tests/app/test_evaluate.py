"""`radiant evaluate` on every kind of model and scene: a bumpy ground whose photographs are renders of known Gaussians."""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radiant_app.cli.app import app
from radiant_app.commands.model.evaluate import EvaluateRequest, evaluate
from radiant_app.report.progress import ProgressDisplay
from radiant_app.workers.evaluation import png_bytes
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db, ssim
from radiant_core.evaluate.lpips import load_lpips
from radiant_core.evaluate.split import held_out_mask
from radiant_core.frames import Frame
from radiant_core.io.photos.listing import load_photograph
from radiant_core.io.ply import save_ply
from radiant_core.io.records import save_cameras, save_scene, save_splats
from radiant_core.io.run_store import write_json
from radiant_core.io.transport.upload import save_upload
from radiant_core.render.rendered_view import render_views
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from tests.app.alex_weights import write_alex_weights
from tests.forked import run_module

TRUE_SIZE_WH = (96, 72)


def ground(count: int = 300) -> Splats:
    """Opaque coloured Gaussians on a square of bumpy ground about the origin."""
    rng = np.random.default_rng(0)
    xy = rng.uniform(-4, 4, (count, 2))
    color = 0.4 * np.sin(np.stack([xy[:, 0], xy[:, 1], xy.sum(1)], axis=1)) / 0.28
    return Splats(
        means=np.column_stack([xy, 0.3 * np.sin(xy[:, 0]) * np.cos(xy[:, 1])]),
        quats=np.tile([1.0, 0, 0, 0], (count, 1)),
        log_scales=np.full((count, 3), np.log(0.28)),
        logit_opacities=np.full(count, 2.0),
        sh0=color[:, None],
        shN=np.zeros((count, 0, 3)),
    )


def cameras_above(count: int = 17) -> Cameras:
    """Cameras in a row looking straight down."""
    width, height = TRUE_SIZE_WH
    poses = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (count, 1, 1))
    poses[:, 0, 3], poses[:, 2, 3] = -np.linspace(-2, 2, count), 6
    K = [[90.0, 0, width / 2], [0, 90.0, height / 2], [0, 0, 1]]
    return Cameras(names=tuple(f"{i:02d}.png" for i in range(count)), Ks=[K] * count, cam_from_world=poses, sizes_wh=[TRUE_SIZE_WH] * count)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """true.ply; noisy.ply; sfm/ as `radiant sfm` leaves it; colmap/, a project in text; run/, the parts of a run that scoring reads."""
    site = tmp_path_factory.mktemp("site")
    splats, cameras = ground(), cameras_above()
    noisy = replace(splats, sh0=splats.sh0 + np.random.default_rng(1).normal(scale=0.3, size=splats.sh0.shape).astype(np.float32))
    save_ply(site / "true.ply", splats)
    save_ply(site / "noisy.ply", noisy)
    save_upload(site / "noisy.safetensors", noisy, "float16")
    images = site / "colmap" / "images"
    images.mkdir(parents=True)
    for view in render_views(splats, cameras):
        (images / view.name).write_bytes(png_bytes(view.image_bytes))
    _write_colmap(site / "colmap" / "sparse" / "0", cameras)
    scene = SfmScene(
        cameras=cameras,
        points=np.zeros((1, 3)),
        colors=np.zeros((1, 3), np.uint8),
        observations=np.zeros((0, 2), np.int64),
        frame=Frame(kind="unscaled", origin_lat_lon_alt=np.zeros(3)),
    )
    (site / "sfm").mkdir()
    save_scene(site / "sfm" / "scene.safetensors", scene)
    write_json(site / "sfm" / "result.json", {"images": str(images), "unregistered": []})
    scored = site / "run" / "evaluation"
    (scored / "photos").mkdir(parents=True)
    held_out = cameras.select(held_out_mask(cameras.names))
    save_cameras(scored / "held_out.safetensors", held_out.scaled(48))
    save_splats(scored / "initial.safetensors", replace(splats, sh0=np.zeros_like(splats.sh0)))
    for name in held_out.names:
        (scored / "photos" / name).write_bytes((images / name).read_bytes())
    save_ply(site / "run" / "scene.ply", noisy)
    return site


def _write_colmap(folder: Path, cameras: Cameras, model: str = "PINHOLE 96 72 90 90 48 36") -> None:
    folder.mkdir(parents=True)
    (folder / "cameras.txt").write_text(f"1 {model}\n")
    rows = [
        f"{index + 1} 0 1 0 0 {' '.join(map(repr, pose[:3, 3].tolist()))} 1 {name}\n\n"
        for index, (name, pose) in enumerate(zip(cameras.names, cameras.cam_from_world, strict=True))
    ]
    (folder / "images.txt").write_text("".join(rows))
    (folder / "points3D.txt").write_text("")


@pytest.fixture(scope="module")
def alex_weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_alex_weights(tmp_path_factory.mktemp("weights") / "alex.safetensors")


def score(**request: Any) -> dict[str, Any]:
    from rich.console import Console

    return evaluate(EvaluateRequest(**request), ProgressDisplay(Console(quiet=True)))


def radiant(*arguments: object) -> subprocess.CompletedProcess[str]:
    return run_module("radiant_app", "evaluate", *arguments)


@pytest.mark.parametrize("scene", ["sfm", "colmap"])
def test_the_true_model_scores_as_well_as_8_bits_allow_on_every_eighth_photograph(site: Path, scene: str) -> None:
    result = score(model=site / "true.ply", scene=site / scene)
    assert [row["name"] for row in result["images"]] == ["00.png", "08.png", "16.png"]
    # Rounding to 8 bits alone: 10 log10(12 · 255²) = 58.9 dB.
    assert 58 < result["psnr_db"] < 60 and result["ssim"] > 0.999 and result["psnr_cc_db"] >= result["psnr_db"] - 1e-6
    assert (result["num_images"], result["long_side_px"], result["num_gaussians"]) == (3, 96, 300)
    assert "warning" not in result and all("initial_psnr_db" not in row for row in result["images"])


def test_figures_are_those_of_render_and_photograph(site: Path) -> None:
    result = score(model=site / "noisy.ply", scene=site / "colmap", long_side_px=64)
    from radiant_core.io.ply import load_ply

    cameras = cameras_above().select([0, 8, 16]).scaled(64)
    for row, view in zip(result["images"], render_views(load_ply(site / "noisy.ply"), cameras), strict=True):
        photograph = load_photograph(site / "colmap" / "images" / view.name, (64, 48))
        assert row["psnr_db"] == pytest.approx(psnr_db(view.image, photograph), abs=1e-6)
        assert row["ssim"] == pytest.approx(ssim(view.image, photograph), abs=1e-9)
    psnrs = [row["psnr_db"] for row in result["images"]]
    assert result["psnr_db"] == pytest.approx(np.mean(psnrs)) and result["median"]["psnr_db"] == pytest.approx(np.median(psnrs))


def test_a_run_is_scored_at_its_own_size_with_its_baselines(site: Path) -> None:
    own = score(model=site / "run")
    other = score(model=site / "noisy.ply", scene=site / "run")
    assert {**own, "seconds": 0} == {**other, "seconds": 0}
    assert own["long_side_px"] == 48 and all(row["psnr_db"] > row["initial_psnr_db"] for row in own["images"])
    # Runs of before one scorer have their held-out cameras under another name.
    scored = site / "run" / "evaluation"
    (scored / "held_out.safetensors").rename(scored / "cameras.safetensors")
    older = score(model=site / "run")
    (scored / "cameras.safetensors").rename(scored / "held_out.safetensors")
    assert {**own, "seconds": 0} == {**older, "seconds": 0}
    halved = score(model=site / "noisy.safetensors", scene=site / "run")
    # Colours in float16 have 11 bits.
    assert halved["psnr_db"] == pytest.approx(own["psnr_db"], abs=0.05)


def test_lpips_is_measured_with_weights_and_null_with_the_reason_without(site: Path, alex_weights: Path) -> None:
    without = score(model=site / "noisy.ply", scene=site / "sfm")
    assert without["lpips"] is None and "--lpips-weights" in without["lpips_reason"] and without["lpips_network"] is None
    result = score(model=site / "noisy.ply", scene=site / "sfm", lpips_weights=alex_weights, lpips_network="alex")
    assert result["lpips_reason"] is None and result["lpips_network"] == "alex"
    view = next(iter(render_views(ground(), cameras_above().select([0]))))
    assert load_lpips(alex_weights, "alex")(view.image, view.image) == 0
    assert result["lpips"] == pytest.approx(np.mean([row["lpips"] for row in result["images"]])) and result["lpips"] > 1e-4


def test_the_command_prints_a_table_or_json_and_writes_the_file(
    site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "120")
    arguments = ["evaluate", str(site / "noisy.ply"), str(site / "sfm")]
    app([*arguments, "--out", str(tmp_path / "figures.json")], standalone_mode=False)
    shown = capsys.readouterr().out
    written = json.loads((tmp_path / "figures.json").read_text())
    for name, row in (("08.png", written["images"][1]), ("mean", written), ("median", written["median"])):
        assert re.search(rf"{name}.* {row['psnr_db']:.2f} .* {row['ssim']:.4f} ", shown), shown
    app([*arguments, "--json"], standalone_mode=False)
    assert {**json.loads(capsys.readouterr().out), "seconds": 0} == {**written, "seconds": 0}


def test_a_model_of_another_frame_is_pointed_out(site: Path, tmp_path: Path) -> None:
    splats = ground()
    save_ply(tmp_path / "away.ply", replace(splats, means=splats.means + np.array([500, 0, 0], np.float32)))
    assert "frame" in score(model=tmp_path / "away.ply", scene=site / "sfm")["warning"]


def test_what_cannot_be_scored_gets_one_sentence(site: Path, alex_weights: Path, tmp_path: Path) -> None:
    distorted, squeezed, missing = (tmp_path / name for name in ("distorted", "squeezed", "missing"))
    for folder, model in ((distorted, "SIMPLE_RADIAL 96 72 90 48 36 0.1"), (squeezed, "PINHOLE 96 96 90 90 48 48"), (missing, None)):
        _write_colmap(folder / "sparse", cameras_above(), *([model] if model else []))
        (folder / "images").mkdir()
        for photo in (site / "colmap" / "images").iterdir():
            (folder / "images" / photo.name).write_bytes(photo.read_bytes())
    (missing / "images" / "08.png").unlink()
    (tmp_path / "run" / "delivered").mkdir(parents=True)
    (tmp_path / "taken.json").write_text("mine")
    ply = site / "true.ply"
    cases: list[tuple[dict[str, Any], str]] = [
        ({"model": ply}, "name a run"),
        ({"model": tmp_path / "none.ply", "scene": site / "sfm"}, "none.ply"),
        ({"model": site / "sfm", "scene": site / "sfm"}, "holds no scene.ply"),
        ({"model": site / "colmap" / "images" / "00.png", "scene": site / "sfm"}, "neither a run nor"),
        ({"model": ply, "scene": site / "colmap" / "images"}, "holds no scene.safetensors"),
        ({"model": ply, "scene": tmp_path / "run"}, "stayed on its devices"),
        ({"model": ply, "scene": distorted}, "are distorted"),
        ({"model": ply, "scene": squeezed}, "'00.png' has (96, 72) px and its camera (96, 96)"),
        ({"model": ply, "scene": missing}, "'08.png' is missing"),
        ({"model": ply, "scene": site / "sfm", "long_side_px": 12}, "SSIM needs 11"),
        (
            {"model": ply, "scene": site / "sfm", "long_side_px": 40, "lpips_weights": alex_weights, "lpips_network": "alex"},
            "LPIPS needs 31",
        ),
        ({"model": ply, "scene": site / "sfm", "lpips_weights": alex_weights}, "features"),
        ({"model": ply, "scene": site / "sfm", "lpips_weights": tmp_path / "none"}, "no LPIPS weights"),
        ({"model": ply, "scene": site / "sfm", "out": tmp_path / "taken.json"}, "exists"),
    ]
    for request, told in cases:
        with pytest.raises(BadInput, match=re.escape(told)) as raised:
            score(**request)
        assert "\n" not in str(raised.value), request
    refused = radiant(ply, tmp_path / "nowhere", "--out", tmp_path / "figures.json")
    assert refused.returncode == 2 and "Traceback" not in refused.stderr and not (tmp_path / "figures.json").exists()
