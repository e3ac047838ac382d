#!/usr/bin/env bash
# Open3D: `ScalableTSDFVolume`, the volume of its tutorial on RGBD integration, gives an empty mesh.
#
# One view of a plane 2 m away is integrated into the two volumes of the older pipeline.
# `UniformTSDFVolume` gives the plane. `ScalableTSDFVolume` takes the same picture, intrinsics and
# pose without a complaint and gives a mesh of 0 triangles and a cloud of 0 points, at voxels of 1,
# 2 and 5 cm, and at any stride of sampling the depth.
# It matters to who turns depth pictures of a model into a mesh by older scripts: they run through
# and write an empty mesh. The tensor pipeline's `VoxelBlockGrid` and the uniform volume work.
# Seen on 2026-11-29 with Open3D 0.20.0: "UniformTSDFVolume: 884 vertices, 1650 triangles",
# "ScalableTSDFVolume, voxels of 0.01 m, stride 1: 0 vertices, 0 triangles", the same at 0.02 and
# 0.05 m and at stride 4.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "open3d==0.20.0" "numpy>=2,<3"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
import open3d as o3d

WIDTH, HEIGHT, FOCAL_PX = 64, 48, 60
tsdf = o3d.pipelines.integration
rgb = tsdf.TSDFVolumeColorType.RGB8
intrinsics = o3d.camera.PinholeCameraIntrinsic(WIDTH, HEIGHT, FOCAL_PX, FOCAL_PX, 31.5, 23.5)
view = o3d.geometry.RGBDImage.create_from_color_and_depth(
    o3d.geometry.Image(np.full((HEIGHT, WIDTH, 3), 128, dtype=np.uint8)),
    o3d.geometry.Image(np.full((HEIGHT, WIDTH), 2, dtype=np.float32)),
    depth_scale=1.0,
    depth_trunc=10.0,
    convert_rgb_to_intensity=False,
)


def num_triangles(name: str, volume: tsdf.TSDFVolume) -> int:
    volume.integrate(view, intrinsics, np.eye(4))
    mesh = volume.extract_triangle_mesh()
    print(f"{name}: {len(mesh.vertices)} vertices, {len(mesh.triangles)} triangles")
    return len(mesh.triangles)


print("Open3D", o3d.__version__)
origin = np.array([[-4.0], [-4.0], [-2.0]])
uniform = num_triangles("UniformTSDFVolume", tsdf.UniformTSDFVolume(8.0, 128, 0.2, rgb, origin))
scalable = [
    num_triangles(
        f"ScalableTSDFVolume, voxels of {voxel_m} m, stride {stride}",
        tsdf.ScalableTSDFVolume(voxel_m, 4 * voxel_m, rgb, 16, stride),
    )
    for voxel_m in (0.01, 0.02, 0.05)
    for stride in (1, 4)
]
sys.exit(0 if uniform > 1000 and not any(scalable) else 1)
PYTHON
