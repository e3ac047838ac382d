"""A separate process that retrains two synthetic edge models as the cloud does and prints how far
its peak memory grew.

python -m tests.stress.retrain_memory GAUSSIANS VIEWS LONG_SIDE_PX SH_DEGREE         the constants of `aggregate/cloud_choice.py`
python -m tests.stress.retrain_memory GAUSSIANS VIEWS LONG_SIDE_PX SH_DEGREE BYTES   the peak itself, within a limit of so many bytes
"""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib import import_module

import numpy as np

from radiant_app.bench.drone_scene import SceneSize, drone_scene
from radiant_app.workers.memory import peak_bytes, reset_peak_bytes
from radiant_core.aggregate.cloud_choice import kept_statistics_bytes
from radiant_core.aggregate.config import aggregate_preset
from radiant_core.aggregate.retrain import join_models
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.splats import SH_BASES
from radiant_core.train.config import train_preset
from radiant_core.train.trainer import FitOptions


def main(num_splats: int, num_views: int, long_side_px: int, sh_degree: int, memory_bytes: int | None = None) -> None:
    """Print the growth of the peak resident memory in bytes, or with a limit the peak itself; each view is rendered once."""
    for name in ("radiant_app.workers.nodes", "radiant_app.workers.task_schema"):
        # Modules that a worker has loaded as well.
        import_module(name)
    splats, camera = drone_scene(SceneSize(num_splats=num_splats, width=long_side_px, height=long_side_px * 3 // 4))
    splats = replace(splats, shN=np.zeros((num_splats, SH_BASES[sh_degree] - 1, 3), np.float32))
    half = num_splats // 2
    models = [splats.select(np.arange(half)), splats.select(np.arange(half, num_splats))]
    del splats
    cameras = [_copies(camera, range(half_views.start, half_views.stop)) for half_views in _halves(num_views)]
    aggregate = replace(aggregate_preset("paper"), max_num_steps=num_views)
    model_bytes = sum(model.num_bytes for model in models)
    options = FitOptions()
    if memory_bytes is not None:
        left = kept_statistics_bytes(models, cameras, long_side_px, memory_bytes)
        if left is None:
            raise BadInput("models would be cut: give more bytes.")
        options = FitOptions(statistics_bytes=left)
    before = reset_peak_bytes()
    teachers = [Teacher(splats=model, cameras=own) for model, own in zip(models, cameras, strict=True)]
    join_models(teachers, replace(train_preset("paper"), long_side_px=long_side_px), aggregate, options)
    # The models were in memory before the count began.
    print(peak_bytes() if memory_bytes is not None else peak_bytes() - before + model_bytes)


def _halves(count: int) -> tuple[range, range]:
    return range(count // 2), range(count // 2, count)


def _copies(camera: Cameras, numbers: range) -> Cameras:
    one = camera.select([0])
    return Cameras(
        names=tuple(f"view-{number}" for number in numbers),
        Ks=np.repeat(one.Ks, len(numbers), axis=0),
        cam_from_world=np.repeat(one.cam_from_world, len(numbers), axis=0),
        sizes_wh=np.repeat(one.sizes_wh, len(numbers), axis=0),
    )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:6]))
