"""Gaussians as Open3D draws them, in a process of their own: each process
has one of its renderers.

`python open3d_splats.py IN.npz OUT.npy` is that process. The oracle for our renderer and for the
PLY files that we write: Open3D keeps positions in 16 bits, clamps colours per Gaussian, draws
harmonics up to degree 2, and a tile is sometimes wrong in one frame, so several frames are drawn.
Some 3 s to start, 0.2 s to 0.6 s per frame of 640×480.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput, StageFailed

if TYPE_CHECKING:
    import open3d as o3d

TIMEOUT_S = 120
NEAR_SHARE = 1e-3
"""Near plane as a share of the distance to the farthest Gaussian."""


def render_open3d_splats(ply_path: Path, camera: Cameras, num_frames: int = 5) -> NDArray[np.uint8]:
    """Frames (num_frames,H,W,3) over black of one of our own 3DGS PLYs, as Open3D reads and draws
    it for one camera.

    Pass files that we wrote. Raises BadInput for another number of cameras or a missing file,
    StageFailed when the process ends badly or takes longer than two minutes.
    """
    if len(camera) != 1:
        raise BadInput(f"{len(camera)} cameras came, expected one: choose it with Cameras.named.")
    if not ply_path.is_file():
        raise BadInput(f"there is no file {ply_path}: write it with radiant_core.io.ply.save_ply.")
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "in.npz", Path(folder) / "out.npy"
        request = {"K": camera.Ks[0], "cam_from_world": camera.cam_from_world[0], "size_wh": camera.sizes_wh[0]}
        np.savez(source, ply_path=str(ply_path.resolve()), num_frames=num_frames, **request)
        command = [sys.executable, __file__, str(source), str(target)]
        try:
            result = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
        except subprocess.TimeoutExpired as error:
            raise StageFailed(f"Open3D did not draw {ply_path} within {TIMEOUT_S} s.") from error
        if not target.is_file():
            reason = (result.stderr.strip() or "no message").splitlines()[-1]
            raise StageFailed(f"Open3D could not draw {ply_path} (exit code {result.returncode}): {reason}")
        return np.load(target, allow_pickle=False)


def _draw(source: Path) -> NDArray[np.uint8]:
    import open3d as o3d

    with np.load(source, allow_pickle=False) as request:
        width, height = (int(side) for side in request["size_wh"])
        # The strict reader has no part here: that Open3D itself reads what we write is what is to
        # be seen.
        cloud = o3d.t.io.read_point_cloud(Path(str(request["ply_path"])))
        K, cam_from_world, num_frames = request["K"], request["cam_from_world"], int(request["num_frames"])
    renderer = o3d.visualization.rendering.OffscreenRenderer(width, height)
    renderer.scene.set_background([0.0, 0.0, 0.0, 1.0])
    renderer.scene.scene.enable_sun_light(False)
    renderer.scene.view.set_post_processing(False)
    renderer.scene.add_geometry("splats", cloud, _splat_material())
    renderer.setup_camera(K, cam_from_world, width, height)
    renderer.scene.camera.set_projection(K, *_depth_range(cam_from_world, cloud.point.positions.numpy()), width, height)
    return np.stack([np.asarray(renderer.render_to_image())[:, :, :3] for _ in range(num_frames)])


def _splat_material() -> o3d.visualization.rendering.MaterialRecord:
    import open3d as o3d

    material = o3d.visualization.rendering.MaterialRecord()
    material.shader = "gaussianSplat"
    return material


def _depth_range(cam_from_world: NDArray[np.float64], means: NDArray[np.float32]) -> tuple[float, float]:
    """Near and far planes around the model: those that Open3D chooses cut what lies close to the camera."""
    far = 1.1 * max(float((means @ cam_from_world[2, :3]).max() + cam_from_world[2, 3]), 1e-3)
    return NEAR_SHARE * far, far


if __name__ == "__main__":
    np.save(Path(sys.argv[2]), _draw(Path(sys.argv[1])))
