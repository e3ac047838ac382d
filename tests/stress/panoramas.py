"""How many faces a panorama should have, and whether their borders show in a trained model.

    python -m tests.stress.panoramas FOLDER --panoramas 16 --width 1024 --steps 400

A walk along the town's street (tests/panorama_scene.py) is placed and trained by each rig below, every eighth panorama held
out with all its faces. The same views are scored for all: those of held-out panoramas turned by 45°, so that a cube's borders
run through their middle. Printed: faces, CPU seconds of placing, errors of poses, PSNR, and the step of brightness at a
cube's border over that at other columns: 1 where no border shows.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import cv2
import numpy as np

import radiant
from radiant_app.workers.sources import load_scene_of
from radiant_core.cameras import Cameras
from radiant_core.evaluate.split import held_out_mask
from radiant_core.geometry.align import fit_sim3
from radiant_core.io.panoramas.cutting import cut_panoramas, face_name
from radiant_core.panoramas import FaceRig, frame_of, ring, turned_face
from radiant_core.splats import Splats
from tests.panorama_scene import Walk, walk, write_walk

RIGS = {
    "cube, 90°": ring(4, 90.0),
    "cube, 100°": ring(4, 100.0),
    "cube, 110°": ring(4, 110.0),
    "6 around, up, down, 75°": ring(6, 75.0),
    "8 around, up, down, 75°": ring(8, 75.0),
    "4 around, 90°": ring(4, 90.0, poles=False),
}
JUDGED = FaceRig(faces=tuple(turned_face(f"{turn:03d}", turn, -15) for turn in (45, 135, 225, 315)), fov_deg=80.0)
STEP_PX, BLOCK_ROWS = 3, 8


def quiet(done: int, total: int) -> None:
    del done, total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--panoramas", type=int, default=16)
    parser.add_argument("--width", type=int, default=1024)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--rigs", nargs="*", default=list(RIGS))
    asked = parser.parse_args()
    made = walk(asked.panoramas, asked.width, step_m=1.2)
    if not (asked.folder / "panoramas").is_dir():
        write_walk(asked.folder / "panoramas", made, xmp=False)
    cut_panoramas(asked.folder / "panoramas", made.names, asked.folder / "judged", quiet, JUDGED)
    for number, name in enumerate(asked.rigs):
        print(f"{name:26}", measured(made, asked.folder, RIGS[name], asked.folder / str(number), asked.steps), flush=True)


def measured(made: Walk, folder: Path, rig: FaceRig, work: Path, steps: int) -> str:
    begun = time.process_time()
    cut_panoramas(folder / "panoramas", made.names, work / "faces", quiet, rig)
    scene = radiant.reconstruct(work / "faces", work / "scene")
    placed_s, begun = time.process_time() - begun, time.process_time()
    cameras = load_scene_of(work / "scene").cameras
    off_mm, off_deg = pose_errors(made, cameras, rig)
    splats = radiant.train(scene, num_steps=steps).splats
    trained_s = time.process_time() - begun
    names = sorted({frame_of(name) for name, held in zip(cameras.names, held_out_mask(cameras.names), strict=True) if held})
    mse, border = judged(splats, cameras, rig, names, folder / "judged")
    return (
        f"{len(cameras)} faces of {len({frame_of(name) for name in cameras.names})} panoramas, {placed_s:.0f} + {trained_s:.0f} CPU s, "
        f"{off_mm:.1f} mm, {off_deg:.3f}°, {-10 * np.log10(mse):.2f} dB, border {border:.2f}"
    )


def pose_errors(made: Walk, cameras: Cameras, rig: FaceRig) -> tuple[float, float]:
    """Medians in mm and degrees."""
    turns = {face.folder: face.cam_from_rig for face in rig.faces}
    rows = [made.names.index(frame_of(name)) for name in cameras.names]
    fit = fit_sim3(cameras.centers, made.centers[rows])
    off_m = np.linalg.norm(fit.apply(cameras.centers) - made.centers[rows], axis=1)
    wanted = np.array([turns[name.split("/")[0]] @ made.axes[row] for name, row in zip(cameras.names, rows, strict=True)])
    traces = np.einsum("nij,nij->n", cameras.cam_from_world[:, :3, :3] @ fit.rotation.T, wanted)
    return 1e3 * float(np.median(off_m)), float(np.median(np.degrees(np.arccos(np.clip((traces - 1) / 2, -1, 1)))))


def judged(splats: Splats, cameras: Cameras, rig: FaceRig, panoramas: list[str], photos: Path) -> tuple[float, float]:
    """Mean squared error of the views of held-out panoramas, and the step at a cube's borders over that elsewhere."""
    turns = {face.folder: face.cam_from_rig for face in rig.faces}
    row_of = {frame_of(name): row for row, name in enumerate(cameras.names)}
    errors, steps, others = [], [], []
    for panorama in panoramas:
        row = row_of[panorama]
        rig_from_world = np.eye(4)
        rig_from_world[:3, :3] = turns[cameras.names[row].split("/")[0]].T
        rig_from_world = rig_from_world @ cameras.cam_from_world[row]
        for face in JUDGED.faces:
            picture = cv2.imread(str(photos / face_name(face.folder, panorama)))
            assert picture is not None
            side = picture.shape[0]
            pose = np.eye(4)
            pose[:3, :3] = face.cam_from_rig
            one = Cameras(
                names=("view",), Ks=JUDGED.K(side)[None], cam_from_world=(pose @ rig_from_world)[None], sizes_wh=np.array([[side, side]])
            )
            (view,) = radiant.render(splats, one)
            error = np.asarray(view.image, np.float64) - picture[:, :, ::-1] / 255
            errors.append((error**2).mean())
            at_border, elsewhere = border_steps(error)
            steps.append(at_border)
            others.append(elsewhere)
    return float(np.mean(errors)), float(np.mean(steps) / np.mean(others))


def border_steps(error: np.ndarray) -> tuple[float, float]:
    """Mean step of the error (S,S,3) across the middle column, which a cube's border runs along, and across all others; means
    of blocks, since an edge between two colours is nothing else than a step of the picture itself."""
    side = error.shape[0]
    rows = side // BLOCK_ROWS * BLOCK_ROWS
    blocks = error[:rows].reshape(-1, BLOCK_ROWS, side, 3).mean(axis=1)
    sums = np.cumsum(np.concatenate([np.zeros((len(blocks), 1, 3)), blocks], axis=1), axis=1)
    means = (sums[:, STEP_PX:] - sums[:, :-STEP_PX]) / STEP_PX
    across = np.abs(means[:, STEP_PX:] - means[:, :-STEP_PX]).mean(axis=(0, 2))
    middle = side // 2 - STEP_PX
    near = np.abs(np.arange(len(across)) - middle) <= 1
    return float(across[near].mean()), float(across[~near].mean())


if __name__ == "__main__":
    main()
