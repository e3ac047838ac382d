"""How good a model is that four devices train together, by views a step, what overlaps and what travels: a row as JSON.

    python -m tests.stress.together_views SCENE [--views 2,1] [--layout 2x2] [--steps 500] [--overlaps] [--form blocks] [--beta1 0.8]
        [--harmonics-every 4]

SCENE: a folder of `radiant sfm`. `--views`: of the devices of an edge, in turn. `--harmonics-every`: gradients of harmonics travel, and
count, in every n-th step only; in the others they are 0. The rows of docs/experiments/together.md are its.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import PropertyMock, patch

import numpy as np

from benchmarks.methods.cells import ModelCache, bench_settings, deal_cell, layout_of, load_bench_scene
from radiant_core.choices import StepFormat
from radiant_core.evaluate.color_correction import correct_colors
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.hierarchy.group_in_process import train_group
from radiant_core.hierarchy.groups import GroupTraining
from radiant_core.light.canonical import light_of_score, show_in_light
from radiant_core.render.rendered_view import render_views
from radiant_core.train.together import roles
from radiant_core.train.together.codec import decode_gradients, encode_gradients
from radiant_core.train.together.gradients import Layout, StepGradients
from radiant_core.train.together.replica import Group

HARMONICS = "shN"


@contextmanager
def harmonics_every(every: int) -> Iterator[None]:
    """Messages without harmonics in all steps but every n-th."""

    def travelling(step: int, layout: Layout) -> Layout:
        if step % every == 0 or HARMONICS not in layout.shapes:
            return layout
        return replace(layout, shapes={name: shape for name, shape in layout.shapes.items() if name != HARMONICS})

    def encode(gradients: StepGradients, step: int, num_splats: int, layout: Layout, form: StepFormat) -> bytes:
        sent = travelling(step, layout)
        columns = [*(column for name in sent.shapes for column in range(layout.num_columns)[layout.columns[name]]), layout.growth]
        return encode_gradients(replace(gradients, values=gradients.values[:, columns]), step, num_splats, sent, form)

    def decode(
        message: bytes | memoryview, step: int, num_splats: int, layout: Layout, most_views: int, *, checks: bool = True
    ) -> StepGradients:
        sent = travelling(step, layout)
        gradients = decode_gradients(message, step, num_splats, sent, most_views, checks=checks)
        values = np.zeros((len(gradients.rows), layout.num_columns), np.float32)
        for name, columns in sent.columns.items():
            values[:, layout.columns[name]] = gradients.values[:, columns]
        values[:, layout.growth] = gradients.values[:, sent.growth]
        return replace(gradients, values=values)

    with patch.object(roles, "encode_gradients", encode), patch.object(roles, "decode_gradients", decode):
        yield


def main() -> None:
    """Train one group and print its row."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--views", default="2,1")
    parser.add_argument("--layout", default="2x2")
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--px", type=int, default=384)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--overlaps", action="store_true")
    parser.add_argument("--form", choices=["float32", "bfloat16", "blocks"], default="blocks")
    parser.add_argument("--beta1", type=float)
    parser.add_argument("--harmonics-every", type=int, default=1)
    asked = parser.parse_args()
    layout, scene = layout_of(asked.layout), load_bench_scene(asked.scene, asked.px)
    assert layout is not None
    settings = bench_settings(asked.px, asked.steps)
    settings = replace(settings, train=replace(settings.train, seed=asked.seed))
    with TemporaryDirectory() as cache:
        recipe = deal_cell(scene, ModelCache(folder=Path(cache)), settings, layout).recipe
    views = cycle(map(int, asked.views.split(",")))
    plan = GroupTraining(
        root="cloud",
        views={each.edge_id: {device: next(views) for device in each.device_ids} for each in recipe.edge_plans},
        num_steps=sum(recipe.training_of(device).num_steps for each in recipe.edge_plans for device in each.device_ids),
        overlaps=asked.overlaps,
        form=asked.form,
    )
    begun_s = time.process_time()
    with ExitStack() as changes:
        changes.enter_context(harmonics_every(asked.harmonics_every))
        if asked.beta1 is not None:
            changes.enter_context(patch.object(Group, "beta1", new_callable=PropertyMock, return_value=asked.beta1))
        run = train_group(recipe, plan, scene.training, scene.views)
    cpu_s, cameras = time.process_time() - begun_s, scene.held_out_views.cameras
    light = light_of_score(run.result.splats, scene.views, cameras, scene.captures, recipe.train.light)
    shown = [each.image for each in render_views(run.result.splats, cameras)]
    shown = shown if light is None else [show_in_light(each, light.held_out, index, cameras) for index, each in enumerate(shown)]
    pairs = [(image, photograph / 255) for image, photograph in zip(shown, scene.held_out_views.images, strict=True)]
    row = {
        "views": plan.views_per_step,
        "overlaps": plan.overlaps,
        "form": plan.form,
        "harmonics_every": asked.harmonics_every,
        "beta1": asked.beta1 or run.start.group.beta1,
        "psnr_db": round(float(np.mean([psnr_db(*pair) for pair in pairs])), 3),
        "psnr_cc_db": round(float(np.mean([psnr_db(correct_colors(*pair), pair[1]) for pair in pairs])), 3),
        "num_splats": len(run.result.splats),
        "up_mb": round(float(np.mean([np.mean(run.cost.bytes_up[device]) for device in plan.of_devices])) / 1e6, 3),
        "down_mb": round(float(np.mean(run.cost.bytes_down)) / 1e6, 3),
        "cpu_s": round(cpu_s, 1),
    }
    print(json.dumps(row))


if __name__ == "__main__":
    main()
