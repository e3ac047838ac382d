#!/usr/bin/env bash
# Open3D has two readings of K: one has the first pixel's centre at 0, the other at 0.5.
#
# One would expect that depth drawn with a K is turned back into places by the same K. Open3D
# casts rays (`create_rays_pinhole`) through centres at 0.5. `create_from_depth_image`, of the
# older and of the tensor clouds, has them at 0, so a cloud of the depth that was cast lies half a
# pixel off. The two volumes differ the same way: `VoxelBlockGrid.integrate` rounds a voxel's
# place in the picture down (centres at 0.5), `UniformTSDFVolume` to the nearest number (centres
# at 0). A plane that faces the camera shows none of it; on slopes the surface moves along each
# view.
# It matters to who fuses rendered or measured depth to a mesh: subtract 0.5 from COLMAP's
# principal point for the older volume and for clouds, and not for rays and for the voxel grid.
# Seen on 2026-12-01 with Open3D 0.20.0: "create_rays_pinhole: first centre at 0.50",
# "create_from_depth_image: 0.50 px off the plane", "the tensor one: 0.50", "VoxelBlockGrid:
# 0.04", "UniformTSDFVolume: 0.54".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "open3d==0.20.0" "numpy>=2,<3"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
import open3d as o3d

WIDTH, HEIGHT, F, CX, CY = 160, 120, 100.0, 80.0, 60.0
core = o3d.core
K = core.Tensor(np.array([[F, 0, CX], [0, F, CY], [0, 0, 1]]))
pose = core.Tensor(np.eye(4))
# The plane z = 5 + x, by its depth at centres that lie at 0.5.
rays_x = np.broadcast_to((np.arange(WIDTH) + 0.5 - CX) / F, (HEIGHT, WIDTH))
depth = (5 / (1 - rays_x)).astype(np.float32)
depth[depth > 8.5] = 0


def off_px(points: np.ndarray) -> float:
    return float(np.median((points[:, 2] - 5 - points[:, 0]) * F / points[:, 2]))


ray = o3d.t.geometry.RaycastingScene.create_rays_pinhole(K, pose, WIDTH, HEIGHT).numpy()[0, 0, 3:]
first_centre = float(ray[0] / ray[2] * F + CX)
old_depth = o3d.geometry.Image(depth)
intrinsic = o3d.camera.PinholeCameraIntrinsic(WIDTH, HEIGHT, F, F, CX, CY)
old = o3d.geometry.PointCloud.create_from_depth_image(old_depth, intrinsic, depth_scale=1.0, depth_trunc=9.0)
image = o3d.t.geometry.Image(core.Tensor(np.ascontiguousarray(depth[..., None])))
new = o3d.t.geometry.PointCloud.create_from_depth_image(image, K, depth_scale=1.0, depth_max=9.0)

names, types, shapes = ("tsdf", "weight"), (core.float32,) * 2, ((1,), (1,))
grid = o3d.t.geometry.VoxelBlockGrid(names, types, shapes, 0.04, 16, 20000, core.Device("CPU:0"))
blocks = grid.compute_unique_block_coordinates(image, K, pose, 1.0, 9.0, 4.0)
grid.integrate(blocks, image, K, pose, 1.0, 9.0, 4.0)
by_grid = grid.extract_point_cloud(weight_threshold=0.5).point.positions.numpy()

volume = o3d.pipelines.integration.UniformTSDFVolume(
    8.0, 200, 0.16, o3d.pipelines.integration.TSDFVolumeColorType.NoColor, np.array([-4.0, -4.0, 2.0])
)
black = o3d.geometry.Image(np.zeros((HEIGHT, WIDTH, 3), np.uint8))
volume.integrate(o3d.geometry.RGBDImage.create_from_color_and_depth(black, old_depth, 1.0, 9.0, False), intrinsic, np.eye(4))
errors_px = {
    "create_from_depth_image": off_px(np.asarray(old.points)),
    "the tensor one": off_px(new.point.positions.numpy()),
    "VoxelBlockGrid": off_px(by_grid),
    "UniformTSDFVolume": off_px(np.asarray(volume.extract_triangle_mesh().vertices)),
}
print("Open3D", o3d.__version__)
print(f"create_rays_pinhole: first centre at {first_centre:.2f}")
for name, error in errors_px.items():
    print(f"{name}: {error:.2f} px off the plane")
at_zero = [errors_px[name] for name in ("create_from_depth_image", "the tensor one", "UniformTSDFVolume")]
at_half = abs(first_centre - 0.5) < 1e-3 and abs(errors_px["VoxelBlockGrid"]) < 0.15
sys.exit(0 if at_half and all(0.35 < error < 0.65 for error in at_zero) else 1)
PYTHON
