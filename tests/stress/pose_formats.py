"""What a training makes of each alignment of a scene, beside one from the true poses:

    python -m tests.stress.pose_formats sample_scenes/town --steps 600

Photographs are bent by a lens with k1 … k3, p1, p2 (Bundler: k1, k2; Polycam: none), and every format is written from the
truth by the tests' own writers, without points: they are triangulated for all. A row: format, held-out PSNR, the same
from a COLMAP model of the true poses and lens without points, and seconds of CPU until the scene stands.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from radiant_core.io.colmap.records import ColmapCamera, ColmapImage, ColmapModel, check_model
from radiant_core.io.colmap.text import write_model
from radiant_core.sfm.known_poses import NO_POINTS
from tests.core.io.poses.bent_hamlet import Truth, bent_scene
from tests.core.io.poses.test_readers import FORMATS


def true_model(truth: Truth) -> ColmapModel:
    """COLMAP's model of the truth, without points."""
    from scipy.spatial.transform import Rotation

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


def trained(source: Path, out: Path, steps: int) -> tuple[float, float]:
    """Held-out PSNR, and CPU seconds of the scene."""
    options = ["--steps", str(steps), "--long-side-px", "384", "--json"]
    before = sum(os.times()[2:4])
    subprocess.run(
        [sys.executable, "-m", "radiant_app", "sfm", str(source), "--out", str(out / "sfm"), "--json"], check=True, capture_output=True
    )
    scene_s = sum(os.times()[2:4]) - before
    command = [sys.executable, "-m", "radiant_app", "train", str(out / "sfm"), "--out", str(out / "model"), *options]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return float(json.loads(said)["psnr_db"]), scene_s


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--formats", nargs="*", default=[name for name in FORMATS if "ecef" not in name])
    asked = parser.parse_args()
    baselines: dict[str, tuple[float, float]] = {}
    with tempfile.TemporaryDirectory() as made:
        for number, name in enumerate(asked.formats):
            write, dist, changed, _ = FORMATS[name]
            folder = Path(made) / str(number)
            truth = bent_scene(asked.scene, folder, dist, **changed)
            none = np.zeros((0, 2)), np.zeros(0, np.int64)
            truth = replace(truth, points=truth.points[:0], colors=truth.colors[:0], seen=[none] * len(truth.names))
            key = repr((dist, changed))
            if key not in baselines and not {"k4", "skew"} & changed.keys():
                write_model(folder / "sparse" / "0", true_model(truth))
                baselines[key] = trained(folder, Path(made) / f"base{number}", asked.steps)
                subprocess.run(["rm", "-r", str(folder / "sparse")], check=True)
            write(folder, truth)
            psnr_db, scene_s = trained(folder, Path(made) / f"out{number}", asked.steps)
            base_db, base_s = baselines.get(key, (float("nan"), float("nan")))
            print(f"{name:28} {psnr_db:.2f} dB, true poses {base_db:.2f} dB, scene {scene_s:.0f} s, {base_s:.0f} s", flush=True)


if __name__ == "__main__":
    main()
