"""A surface of more blocks than are given to Open3D's extraction at once, which did not survive as
many: it is made in pieces.

Two directions into slopes of all depths: some 50,000 blocks, 9 GB.
"""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import cv2
import numpy as np
from radiant_core.geometry.open3d_ops import DepthView, fused_mesh
rng = np.random.default_rng(0)
coarse = rng.uniform(1, 300, (24, 32)).astype(np.float32)
depth = cv2.resize(coarse, (640, 480))
K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
def views():
    for turn in (0.0, 2.0):
        pose = np.eye(4)
        pose[:3, :3] = [[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]]
        yield DepthView(image=np.zeros((480, 640, 3), np.uint8), depth=depth, K=K, cam_from_world=pose)
        yield DepthView(image=np.zeros((480, 640, 3), np.uint8), depth=depth, K=K, cam_from_world=pose)
print(len(fused_mesh(views(), 0.2, 300.0).triangles))
"""


@pytest.mark.stress
def test_a_mesh_through_many_blocks_is_made() -> None:
    result = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=1200, check=False)
    assert result.returncode == 0, result.stderr[-2000:]
    assert int(result.stdout.split()[-1]) > 100_000
