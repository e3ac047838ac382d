"""What a training would gain by doing less, or by going further, in a step: rows as JSON.

    python -m tests.stress.training_shortcuts SCENE [--steps 1500] [--px 384] [--seed 0] VARIANT…

SCENE: a folder of `radiant sfm`. A variant is a setting (`full_size_from=0.6`) or one of

    views:E       photographs drawn by their last loss to the power of E, each between half and twice as often as all
    blocks:S      of every step, the share S of the 16 × 16 px blocks with the least error sends no gradient back
    roulette:S    the same in the mean, drawn by error; the others' gradients are divided by their chance
    strips:S      a step renders a share S of the picture's rows, at a random place
    curvature:G   every tenth step estimates the diagonal of JᵀJ by random signs; steps are m / (G h), at most Adam's rate
    steps:F       F times the steps
    a+b           both

The rows of docs/experiments/training.md are its.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from torch import Tensor

from benchmarks.methods.cells import BenchScene, bench_settings, load_bench_scene
from radiant_core.evaluate.color_correction import correct_colors
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.hierarchy.device import fit_prepared, prepare_training
from radiant_core.hierarchy.messages import DeviceTask
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.light.canonical import light_of_score, show_in_light
from radiant_core.render.rasterize import rasterize
from radiant_core.render.rendered_view import render_views
from radiant_core.train import optimizer, view_loss
from radiant_core.train.config import with_settings
from radiant_core.train.trainer import Training
from radiant_core.train.view_loss import ViewLoss

BLOCK_PX = 16
PROBED_EVERY = 10


@contextmanager
def views_by_loss(exponent: float) -> Iterator[None]:
    """Each view's turn comes when its credit is the largest, and credit grows by its last loss."""
    state: dict[str, np.ndarray] = {}
    of_step, count_loss = Training._moment, Training._count_loss

    def moment(self: Any) -> Any:
        made, num_views = of_step(self), len(self._views)
        if self.step < num_views:
            state.setdefault("credit", np.random.default_rng(self._config.seed).random(num_views))
            state.setdefault("losses", np.ones(num_views))
            return made
        weights = np.clip((state["losses"] / state["losses"].mean()) ** exponent, 0.5, 2.0)
        state["credit"] += weights / weights.sum()
        view = int(np.argmax(state["credit"]))
        state["credit"][view] -= 1
        return replace(made, view=view)

    def count(self: Any, moment: Any, loss: float) -> None:
        count_loss(self, moment, loss)
        state["losses"][moment.view] = loss

    with patch.object(Training, "_moment", moment), patch.object(Training, "_count_loss", count):
        yield


class _Sparse(torch.autograd.Function):
    """Passes a picture on; its gradient goes back multiplied."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, factors: Tensor) -> Tensor:
        ctx.save_for_backward(factors)
        return image.view_as(image)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:  # pyright: ignore[reportIncompatibleMethodOverride]
        (factors,) = ctx.saved_tensors
        return gradient * factors, None


@contextmanager
def fewer_blocks(share: float, *, drawn: bool) -> Iterator[None]:
    """Blocks of least error have no gradient."""
    rng, loss_of = np.random.default_rng(0), view_loss.target_loss

    def sparse_loss(image: Tensor, statistics: Any, weights: Tensor | None, ssim_weight: float) -> Tensor:
        error = (image.detach() - statistics.target).abs().sum(2).numpy()
        height, width = error.shape
        rows, columns = -(-height // BLOCK_PX), -(-width // BLOCK_PX)
        padded = np.zeros((rows * BLOCK_PX, columns * BLOCK_PX), np.float32)
        padded[:height, :width] = error
        of_blocks = padded.reshape(rows, BLOCK_PX, columns, BLOCK_PX).sum((1, 3))
        if drawn:
            chances = _chances(of_blocks.ravel(), 1 - share).reshape(rows, columns)
            factors = np.where(rng.random(chances.shape) < chances, 1 / chances, 0)
        else:
            factors = (of_blocks > np.quantile(of_blocks, share)).astype(np.float32)
        whole = np.repeat(np.repeat(factors, BLOCK_PX, 0), BLOCK_PX, 1)[:height, :width, None]
        return loss_of(_Sparse.apply(image, torch.from_numpy(np.ascontiguousarray(whole, np.float32))), statistics, weights, ssim_weight)

    with patch.object(view_loss, "target_loss", sparse_loss):
        yield


def _chances(errors: np.ndarray, mean: float) -> np.ndarray:
    """Proportional to errors, at most 1 and at least 0.1, with that mean."""
    low, high = 0.0, 1e12
    for _ in range(100):
        factor = (low * high) ** 0.5 if low else high / 2
        chances = np.clip(factor * errors, 0.1, 1)
        low, high = (factor, high) if chances.mean() < mean else (low, factor)
        if not low and high < 1e-30:
            break
    return np.clip(high * errors, 0.1, 1)


@contextmanager
def strips(share: float) -> Iterator[None]:
    """A step's picture is a band of rows of the photograph, at a random place."""
    rng, backward = np.random.default_rng(0), ViewLoss.backward

    def of_strip(self: Any, splats: Any, moment: Any, parts: Any, watch: Any) -> Any:
        whole, Ks, statistics = self._views, self._Ks, self._statistics
        height = whole.images[moment.view].shape[0]
        rows = min(height, BLOCK_PX * round(share * height / BLOCK_PX))
        top = int(rng.integers(0, height - rows + 1))
        shifted = Ks.clone()
        shifted[moment.view, 1, 2] -= top
        self._views = SimpleNamespace(images={moment.view: whole.images[moment.view][top : top + rows]}, weights=None)
        self._Ks, self._statistics = shifted, view_loss.StatisticsCache(0)
        try:
            return backward(self, splats, moment, parts, watch)
        finally:
            self._views, self._Ks, self._statistics = whole, Ks, statistics

    with patch.object(ViewLoss, "backward", of_strip):
        yield


@contextmanager
def curvature(factor: float) -> Iterator[None]:
    """m / (factor · h), each at most its rate, h the mean of squared gradients of random signs: the
    diagonal of JᵀJ (Liu 2023, Sophia; Hutchinson)."""
    backward = ViewLoss.backward
    state: dict[str, Any] = {}

    def probing(self: Any, splats: Any, moment: Any, parts: Any, watch: Any) -> Any:
        if (moment.step - 1) % PROBED_EVERY == 0:
            height, width = self._views.images[moment.view].shape[:2]
            view = slice(moment.view, moment.view + 1)
            output = rasterize(
                splats, self._viewmats[view], self._Ks[view], width, height, sh_degree=view_loss.sh_degree_at(moment, splats, self._config)
            )
            signs = torch.from_numpy(np.random.default_rng((3, moment.step)).integers(0, 2, (height, width, 3)).astype(np.float32) * 2 - 1)
            (output.images[0] * signs).sum().backward()
            scale = 1 / (3 * height * width)
            state["probe"] = {
                name: tensor.grad.detach().clone().square() * scale for name, tensor in splats.tensors().items() if tensor.grad is not None
            }
            for tensor in splats.tensors().values():
                tensor.grad = None
        return backward(self, splats, moment, parts, watch)

    def stepping(self: Any, visible: Tensor | None = None) -> None:
        self._step += 1
        for name, group in self._groups.items():
            gradient = group.tensor.grad
            if gradient is None:
                continue
            group.first_moments.lerp_(gradient, 1 - self._beta1)
            probe = state.get("probe", {}).get(name)
            if probe is not None and probe.shape == group.second_moments.shape:
                group.second_moments.lerp_(probe, 0.05)
            corrected = group.second_moments / (1 - 0.95 ** (1 + (self._step - 1) // PROBED_EVERY))
            with torch.no_grad():
                moved = group.first_moments / (1 - self._beta1**self._step) / (factor * corrected + 1e-15)
                group.tensor -= group.rate * moved.clamp_(-1, 1)
        state.pop("probe", None)

    with patch.object(optimizer.SelectiveAdam, "step", stepping), patch.object(ViewLoss, "backward", probing):
        yield


def _changes(variant: str) -> tuple[list[Any], dict[str, str], float]:
    """Context managers, settings, and how many times the steps."""
    managers, settings, more = list[Any](), dict[str, str](), 1.0
    for part in variant.split("+"):
        name, _, value = part.partition(":")
        if name == "views":
            managers.append(views_by_loss(float(value)))
        elif name in ("blocks", "roulette"):
            managers.append(fewer_blocks(float(value), drawn=name == "roulette"))
        elif name == "strips":
            managers.append(strips(float(value)))
        elif name == "curvature":
            managers.append(curvature(float(value)))
        elif name == "steps":
            more = float(value)
        elif "=" in part:
            settings |= dict([part.split("=")])
        elif part != "none":
            raise SystemExit(f"{part} is no variant")
    return managers, settings, more


def train(scene: BenchScene, variant: str, steps: int, px: int, seed: int) -> dict[str, Any]:
    """One training and its row."""
    managers, settings, more = _changes(variant)
    base = bench_settings(px, round(steps * more))
    config = with_settings(replace(base.train, seed=seed, max_epochs=None), settings)
    recorder = Recorder()
    prepared = prepare_training(DeviceTask(scene=scene.training, train=config, backend=base.backend), scene.views, recorder)
    with ExitStack() as changes:
        for manager in managers:
            changes.enter_context(manager)
        begun_s = time.process_time()
        result = fit_prepared(prepared, recorder)
        cpu_s = time.process_time() - begun_s
    cameras = scene.held_out_views.cameras
    light = light_of_score(result.splats, scene.views, cameras, scene.captures, config.light)
    shown = [each.image for each in render_views(result.splats, cameras)]
    shown = shown if light is None else [show_in_light(each, light.held_out, index, cameras) for index, each in enumerate(shown)]
    pairs = [(image, photograph / 255) for image, photograph in zip(shown, scene.held_out_views.images, strict=True)]
    return {
        "scene": scene.name,
        "variant": variant,
        "seed": seed,
        "psnr_db": round(float(np.mean([psnr_db(*pair) for pair in pairs])), 2),
        "psnr_cc_db": round(float(np.mean([psnr_db(correct_colors(*pair), pair[1]) for pair in pairs])), 2),
        "cpu_s": round(cpu_s, 1),
        "num_gaussians": len(result.splats),
    }


def main() -> None:
    """Print a row per variant."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("variants", nargs="+")
    parser.add_argument("--steps", type=int, default=1500)
    parser.add_argument("--px", type=int, default=384)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    scene = load_bench_scene(asked.scene, asked.px)
    for variant in asked.variants:
        print(json.dumps(train(scene, variant, asked.steps, asked.px, asked.seed)), flush=True)


if __name__ == "__main__":
    main()
