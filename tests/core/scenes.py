"""Small made-up scenes for training and aggregation: bumpy coloured ground, a few cameras above."""

from __future__ import annotations

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.splats import SH_C0, Splats


def ground_splats(count: int = 300, *, seed: int = 0, half_side_m: float = 4.0) -> Splats:
    """Opaque Gaussians on a square of bumpy ground about the origin."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-half_side_m, half_side_m, (count, 2))
    z = 0.3 * np.sin(xy[:, 0]) * np.cos(xy[:, 1])
    color = 0.5 + 0.4 * np.sin(np.stack([xy[:, 0], xy[:, 1], xy.sum(1)], axis=1))
    return Splats(
        means=np.column_stack([xy, z]),
        quats=np.tile([1.0, 0, 0, 0], (count, 1)),
        log_scales=np.full((count, 3), np.log(1.2 * half_side_m / np.sqrt(count))),
        logit_opacities=np.full(count, 2.0),
        sh0=((color - 0.5) / SH_C0)[:, None],
        shN=np.zeros((count, 0, 3)),
    )


def cameras_above(xy: list[tuple[float, float]], *, height_m: float = 6.0, size_wh: tuple[int, int] = (48, 36)) -> Cameras:
    """Cameras looking straight down from `height_m`."""
    down = np.diag([1.0, -1.0, -1.0])
    poses = []
    for x, y in xy:
        pose = np.eye(4)
        pose[:3, :3] = down
        pose[:3, 3] = -down @ [x, y, height_m]
        poses.append(pose)
    width, height = size_wh
    K = [[0.9 * width, 0, width / 2], [0, 0.9 * width, height / 2], [0, 0, 1]]
    return Cameras(
        names=tuple(f"view_{x:+.2f}_{y:+.2f}.png" for x, y in xy), Ks=[K] * len(xy), cam_from_world=poses, sizes_wh=[size_wh] * len(xy)
    )
