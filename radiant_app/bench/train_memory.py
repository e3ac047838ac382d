"""A process of its own that trains a made-up scene and prints how many bytes it held before and at most: `train/memory.py`'s constants.

python -m radiant_app.bench.train_memory GAUSSIANS VIEWS LONG_SIDE_PX SH_DEGREE DENSIFY [STATISTICS_MB]

Training begins with GAUSSIANS / 4 and grows to GAUSSIANS where DENSIFY is planned, adc or mcmc, with checkpoints on the way; none begins
with all of them. The libraries of `radiant train` are loaded first, as there. One JSON object: base_bytes, peak_bytes, num_splats.
"""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import radiant_app.commands.train  # noqa: F401 - what `radiant train` has loaded by then
from radiant_app.bench.drone_scene import SceneSize, drone_scene
from radiant_app.workers.memory import peak_bytes, resident_bytes
from radiant_core.cameras import Cameras
from radiant_core.splats import SH_BASES, Splats
from radiant_core.train.checkpoint import CheckpointFolder
from radiant_core.train.config import TrainConfig
from radiant_core.train.densification import Adc, densification_of
from radiant_core.train.trainer import FitOptions, fit_splats
from radiant_core.train.views import TrainingViews

STEPS = 40


def main(num_splats: int, num_views: int, long_side_px: int, sh_degree: int, densify: str, statistics_mb: float = 0.0) -> None:
    """Print the resident memory before the training and its peak, in bytes."""
    base = resident_bytes()
    config = TrainConfig(
        num_steps=STEPS,
        schedule_steps=STEPS,
        sh_degree=sh_degree,
        max_num_splats=num_splats,
        density=densification_of(
            densify,  # type: ignore[arg-type]
            Adc(from_step=1, until_step=STEPS - 20, every=2, min_gradient=0.0, reset_opacity_every=10 * STEPS),
        ),
    )
    splats, views = _scene(num_splats if densify == "none" else num_splats // 4, num_views, long_side_px, sh_degree)
    with tempfile.TemporaryDirectory() as folder:
        checkpoints = CheckpointFolder(Path(folder), "memory", every_s=0.5)
        options = FitOptions(checkpoints=checkpoints, statistics_bytes=round(1e6 * statistics_mb))
        result = fit_splats(splats, views, config, options)
    print(json.dumps({"base_bytes": base, "peak_bytes": peak_bytes(), "num_splats": len(result.splats)}))


def _scene(num_splats: int, num_views: int, long_side_px: int, sh_degree: int) -> tuple[Splats, TrainingViews]:
    """Gaussians and random photographs from one place: what they show is of no account for memory."""
    size = SceneSize(num_splats=num_splats, width=long_side_px, height=long_side_px * 3 // 4)
    splats, camera = drone_scene(size)
    rng = np.random.default_rng(0)
    images = tuple(rng.integers(0, 256, (size.height, size.width, 3), dtype=np.uint8) for _ in range(num_views))
    cameras = Cameras(
        names=tuple(f"view-{number}" for number in range(num_views)),
        Ks=np.repeat(camera.Ks[:1], num_views, axis=0),
        cam_from_world=np.repeat(camera.cam_from_world[:1], num_views, axis=0),
        sizes_wh=np.repeat(camera.sizes_wh[:1], num_views, axis=0),
    )
    splats = replace(splats, shN=np.zeros((num_splats, SH_BASES[sh_degree] - 1, 3), np.float32))
    return splats, TrainingViews(cameras=cameras, images=images)


if __name__ == "__main__":
    counts = [int(text) for text in sys.argv[1:5]]
    main(counts[0], counts[1], counts[2], counts[3], sys.argv[5], float(sys.argv[6]) if len(sys.argv) > 6 else 0.0)
