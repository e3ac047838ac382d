"""What a training makes of each alignment of a scene, beside one from the true poses:

    python -m tests.stress.pose_formats sample_scenes/town --steps 300 --long-side-px 192 --seeds 3

Photographs are bent by a lens with k1 … k3, p1, p2 (Bundler: k1, k2; Polycam: none), and every format is written from the
truth by the tests' own writers, without points: they are triangulated for all. A row: format, held-out PSNR as the mean of
so many seeds, its mean difference from a COLMAP model of the true poses and lens without points, seed by seed, with the
standard error of that, and seconds of CPU until the scene stands. "moved" is the true poses moved by a micrometre, which
shows by how much two trainings of the same poses differ; "turned" turns them about z by as much as OPF's world, east and
north of a map, is turned against theirs.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import radiant
from radiant_core.io.colmap.records import ColmapCamera, ColmapImage, ColmapModel, check_model
from radiant_core.io.colmap.text import write_model
from radiant_core.sfm.known_poses import NO_POINTS
from tests.core.io.poses.bent_hamlet import Truth, bent_scene
from tests.core.io.poses.test_readers import FORMATS

TURN_DEG = 0.339
"""Meridian convergence at the place of the tests."""


def true_model(truth: Truth) -> ColmapModel:
    """COLMAP's model of the truth, without points."""
    k1, k2, p1, p2, k3 = truth.dist
    params = (truth.fx, truth.fy, truth.cx, truth.cy, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0)
    camera = ColmapCamera(camera_id=1, model="FULL_OPENCV", size_wh=(truth.width, truth.height), params=params)
    images = [
        ColmapImage(
            image_id=number + 1, name=name, camera_id=1, quat_wxyz=np.roll(Rotation.from_matrix(R).as_quat(), 1), translation=t,
            points2d=np.zeros((0, 2)), point3d_ids=np.zeros(0, np.int64),
        )
        for number, (name, R, t) in enumerate(zip(truth.names, truth.R, truth.t, strict=True))
    ]  # fmt: skip
    return check_model([camera], images, NO_POINTS, "truth")


def trained(source: Path, out: Path, asked: argparse.Namespace) -> tuple[np.ndarray, float]:
    """Held-out PSNR by seed, and CPU seconds of the scene."""
    before = sum(os.times()[:4])
    scene = radiant.reconstruct(source, out)
    scene_s = sum(os.times()[:4]) - before
    options = {"num_steps": asked.steps, "long_side_px": asked.long_side_px}
    models = [radiant.train(scene, asked.preset, seed=seed, **options).splats for seed in range(asked.seeds)]
    return np.array([radiant.evaluate(model, scene, long_side_px=asked.long_side_px).mean_psnr_db for model in models]), scene_s


def said(name: str, psnr_db: np.ndarray, base_db: np.ndarray, scene_s: float) -> str:
    off_db = psnr_db - base_db
    error_db = off_db.std(ddof=1) / np.sqrt(len(off_db)) if len(off_db) > 1 else float("nan")
    return f"{name:28} {psnr_db.mean():.2f} dB, {off_db.mean():+.3f} ± {error_db:.3f} from true poses, scene {scene_s:.0f} CPU s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--long-side-px", type=int, default=192)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--preset", default="default")
    parser.add_argument("--formats", nargs="*", default=[name for name in FORMATS if "ecef" not in name])
    asked = parser.parse_args()
    baselines: dict[str, np.ndarray] = {}
    with tempfile.TemporaryDirectory() as made:
        for number, name in enumerate(asked.formats):
            write, dist, given, _ = FORMATS[name]
            # COLMAP has no model with these, and the others share one base.
            changed = {key: value for key, value in given.items() if key not in ("k4", "skew", "fx")}
            folder, key = Path(made) / str(number), repr((dist, changed))
            truth = bent_scene(asked.scene, folder, dist, **changed)
            none = np.zeros((0, 2)), np.zeros(0, np.int64)
            truth = replace(truth, points=truth.points[:0], colors=truth.colors[:0], seen=[none] * len(truth.names))
            if key not in baselines:
                moved = replace(truth, t=truth.t + 1e-6)
                turned = replace(truth, R=truth.R @ Rotation.from_euler("z", -TURN_DEG, degrees=True).as_matrix())
                for base, poses in (("true poses", truth), ("moved", moved), ("turned", turned)):
                    write_model(folder / "sparse" / "0", true_model(poses))
                    psnr_db, scene_s = trained(folder, Path(made) / f"{base}{number}", asked)
                    shutil.rmtree(folder / "sparse")
                    print(said(base, psnr_db, baselines.setdefault(key, psnr_db), scene_s), flush=True)
            write(folder, truth)
            psnr_db, scene_s = trained(folder, Path(made) / f"out{number}", asked)
            print(said(name, psnr_db, baselines[key], scene_s), flush=True)


if __name__ == "__main__":
    main()
