"""A separate process that joins two models of a made-up ground as an edge does and prints its peak memory.

python -m tests.stress.retrain_memory GAUSSIANS VIEWS LONG_SIDE_PX SH_DEGREE LIMIT_BYTES

Tiles and kept statistics are as planned for that limit; one epoch.
"""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np

from radiant_app.workers.memory import peak_bytes, reset_peak_bytes
from radiant_core.aggregate.config import Join
from radiant_core.aggregate.join import join_models
from radiant_core.aggregate.join_memory import plan_join_memory
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.plan.regions.claims import claims_of_cells
from radiant_core.splats import SH_BASES, Splats
from radiant_core.train.config import train_preset
from radiant_core.train.trainer import FitOptions
from tests.core.scenes import cameras_above, ground_splats

HALF_SIDE_M = 24.0


def two_models(num_splats: int, num_views: int, long_side_px: int, sh_degree: int) -> tuple[list[Splats], list[Cameras]]:
    """Two models of one ground, each of the half of it that its cameras see and 8 m more."""
    whole = ground_splats(num_splats * 3 // 4, half_side_m=HALF_SIDE_M)
    whole = replace(whole, shN=np.zeros((len(whole), SH_BASES[sh_degree] - 1, 3), np.float32))
    models, cameras = [], []
    for sign in (-1, 1):
        models.append(whole.select(sign * whole.means[:, 0] > -8.0))
        places = [(sign * x, float(y)) for x in (5.0, 16.0) for y in np.linspace(-20, 20, num_views // 4)]
        cameras.append(cameras_above(places, height_m=20.0, size_wh=(long_side_px, long_side_px * 3 // 4)))
    return models, cameras


def main(num_splats: int, num_views: int, long_side_px: int, sh_degree: int, memory_bytes: int) -> None:
    """Print the plan and the peak as a record; BadInput where models would be cut."""
    for name in ("radiant_app.workers.nodes", "radiant_app.workers.training"):
        # Modules that a worker has loaded as well.
        import_module(name)
    models, cameras = two_models(num_splats, num_views, long_side_px, sh_degree)
    plan = plan_join_memory(models, cameras, long_side_px, memory_bytes)
    if not plan.fits:
        raise BadInput(f"models would be cut: give {plan.needed_bytes:.0f} bytes at least.")
    train = replace(train_preset("default"), long_side_px=long_side_px, max_num_splats=num_splats)
    claims = claims_of_cells(np.array([[-12.0, 0.0], [12.0, 0.0]]), np.zeros(2))
    with tempfile.TemporaryDirectory() as name:
        reset_peak_bytes()
        teachers = [Teacher(splats=model, cameras=own) for model, own in zip(models, cameras, strict=True)]
        options = FitOptions(scratch=Path(name), statistics_bytes=plan.statistics_bytes)
        config = Join(epochs=1, agreement_db=None)
        joined = join_models(teachers, train, config, options, claims, plan.num_tiles)
        peak = peak_bytes()
    figures = {"num_tiles": plan.num_tiles, "needed_bytes": plan.needed_bytes, "statistics_bytes": plan.statistics_bytes}
    print(json.dumps({**figures, "num_steps": joined.trained.num_steps, "num_given": joined.num_given, "peak_bytes": peak}))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:6]))
