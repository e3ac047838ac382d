"""Steps a second of a training, its held-out PSNR, and where the time of a step goes, on CPU or CUDA.

    python tools/step_profile.py SCENE PRESET BACKEND STEPS LONG_SIDE_PX

SCENE is a folder of `radiant sfm`; every eighth photograph is held out; the profile (torch's) is of
fifty steps near the end, and its time is left out of the others'.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import get_args

import numpy as np
import torch
from torch.profiler import ProfilerActivity, profile

from radiant_app.commands.run.steps import training_part
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.evaluate.split import held_out_mask
from radiant_core.io.records import load_scene
from radiant_core.render.contract import Backend
from radiant_core.render.rendered_view import render_views
from radiant_core.train.config import train_preset, with_settings
from radiant_core.train.initialize import first_splats
from radiant_core.train.photographs import load_images
from radiant_core.train.trainer import FitOptions, Training
from radiant_core.train.views import TrainingViews

PROFILED_STEPS, STEPS_AFTER = 50, 200


def main() -> None:
    """Train once and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("preset")
    parser.add_argument("backend", choices=get_args(Backend))
    parser.add_argument("steps", type=int)
    parser.add_argument("long_side_px", type=int)
    arguments = parser.parse_args()
    config = with_settings(train_preset(arguments.preset), {"num_steps": arguments.steps, "long_side_px": arguments.long_side_px})
    whole = load_scene(arguments.scene / "scene.safetensors")
    parts = (training_part(whole), whole.restricted_to(np.flatnonzero(held_out_mask(whole.cameras.names))))
    folder = arguments.scene / json.loads((arguments.scene / "result.json").read_text())["images"]
    views = []
    for part in parts:
        cameras = part.cameras.scaled(arguments.long_side_px)
        views.append(TrainingViews(cameras=cameras, images=load_images(folder, cameras)))
    training = Training(first_splats(parts[0], views[0], config)[0], views[0], config, FitOptions(backend=arguments.backend))
    begun_s = time.monotonic()
    while not training.is_done:
        training.take_step()
        if training.step == arguments.steps - STEPS_AFTER:
            before_s = time.monotonic()
            _print_profile(training)
            begun_s += time.monotonic() - before_s
    seconds = time.monotonic() - begun_s
    result = training.result()
    renders = render_views(result.splats, views[1].cameras, arguments.backend)
    errors = [psnr_db(view.image, image / 255) for view, image in zip(renders, views[1].images, strict=True)]
    rate = (result.num_steps - (PROFILED_STEPS if arguments.steps > STEPS_AFTER else 0)) / seconds
    print(f"{rate:.1f} steps/s, {np.mean(errors):.2f} dB held out, {len(result.splats):,} Gaussians, {result.num_rolled_back} not taken")


def _print_profile(training: Training) -> None:
    with profile(activities=[ProfilerActivity.CPU, ProfilerActivity.CUDA]) as profiler:
        for _ in range(PROFILED_STEPS):
            training.take_step()
        if torch.cuda.is_available():
            torch.cuda.synchronize()
    for key in ("self_cpu_time_total", "self_cuda_time_total"):
        print(profiler.key_averages().table(sort_by=key, row_limit=20, max_name_column_width=60))


if __name__ == "__main__":
    main()
