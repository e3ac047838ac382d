"""What the gradient of a step tells of its photographs: python -m tests.stress.gradient_inversion SCENE [--px 64] [--steps 30,300]
[--cases 1:float32,1:bfloat16,2:bfloat16,4:bfloat16] [--iterations 150].

The attacker is who receives a message: it has the model before the step, the settings, which Gaussians the views show
and their gradient, and is given the cameras (where they stood a message of one view tells, measured first). It renders
with the plain renderer, which has second derivatives, and moves the pixels of the photographs until the gradient that they
would cause is the one that came (Geiping 2020; the model is known, so that the renders are where it starts). L1 has no
second derivative: |x| is √(x² + τ²) in the attacker's loss. SCENE is a folder of `radiant sfm`. PSNR, mean over
the views: what is recovered, beside the render of the model at these cameras, which whoever has the joined model and the
cameras can make as well.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks.methods.cells import bench_settings, load_bench_scene
from radiant_core.cameras import Cameras
from radiant_core.choices import StepFormat
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.hierarchy.device import prepare_training
from radiant_core.hierarchy.messages import DeviceTask
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.render.contract import SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.losses import ssim_map
from radiant_core.train.together.codec import decode_gradients, encode_gradients
from radiant_core.train.together.gradients import Layout
from radiant_core.train.together.replica import Group, Replica, Share
from radiant_core.train.trainer import FitOptions, fit_splats
from radiant_core.train.views import TrainingViews

RATE, SOFT, SMOOTH = 0.01, 0.01, 3e-5
"""Of Adam at the start; τ; weight of the total variation: the best of six tries."""


@dataclass(frozen=True, kw_only=True)
class Message:
    """What an attacker has of a step: rows (R,), dense gradients by tensor, as they came."""

    rows: np.ndarray
    gradients: dict[str, Tensor]


def send(splats: Splats, views: TrainingViews, config: TrainConfig, form: StepFormat) -> Message:
    """The gradient of all of `views`, as it travels."""
    config = replace(config, start_scale=1.0, density=NoDensification(), drop_gaussians="none")
    group = Group(config=config, num_photographs=len(views), views_per_step=len(views), extent=1.0, form=form)
    replica = Replica(splats, group, FitOptions(backend="native"), Share(views=views, num_views=len(views), first=0))
    message = encode_gradients(replica.contribute(), 0, len(splats), replica.layout, form)
    came = decode_gradients(message, 0, len(splats), replica.layout, len(views))
    return Message(rows=came.rows, gradients=_dense(came.values, came.rows, replica.layout, splats))


def _dense(values: np.ndarray, rows: np.ndarray, layout: Layout, splats: Splats) -> dict[str, Tensor]:
    dense = {}
    for name, columns in layout.columns.items():
        table = torch.zeros(splats.arrays()[name].shape)
        table[rows] = torch.from_numpy(values[:, columns]).reshape(len(rows), *table.shape[1:])
        dense[name] = table
    return dense


def attack(
    splats: Splats, cameras: Cameras, message: Message, config: TrainConfig, iterations: int
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """What is recovered, and the renders, (H,W,3) of each camera."""
    tensors = SplatTensors.from_splats(splats)
    leaves = {name: tensor.requires_grad_() for name, tensor in tensors.tensors().items()}
    width, height = cameras.sizes_wh[0]
    renders = []
    for view in range(len(cameras)):
        viewmat, K = (torch.tensor(array[view : view + 1]).float() for array in (cameras.cam_from_world, cameras.Ks))
        output = rasterize(replace(tensors, **leaves), viewmat, K, int(width), int(height), sh_degree=config.sh_degree, backend="reference")
        renders.append(output.images[0])
    pictures = [render.detach().clone().clamp(0, 1).requires_grad_() for render in renders]
    adam = torch.optim.Adam(pictures, lr=RATE)
    wanted = {name: message.gradients[name] for name in message.gradients if message.gradients[name].numel()}
    lengths = {name: float(each.norm()) for name, each in wanted.items()}
    for iteration in range(iterations):
        share = iteration / iterations
        for each in adam.param_groups:
            each["lr"] = RATE * (1.05 - share)
        loss = sum((_loss(x, y, config.ssim_weight) for x, y in zip(renders, pictures, strict=True)), torch.zeros(()))
        made = torch.autograd.grad(loss, [leaves[name] for name in wanted], create_graph=True)
        miss = torch.stack([((g - wanted[name]) ** 2).sum() / lengths[name] ** 2 for name, g in zip(wanted, made, strict=True)]).sum()
        smooth = torch.stack([(y.diff(dim=0).abs().mean() + y.diff(dim=1).abs().mean()) for y in pictures]).sum()
        adam.zero_grad()
        moved = torch.autograd.grad(miss + SMOOTH * smooth, pictures, retain_graph=True)
        for picture, gradient in zip(pictures, moved, strict=True):
            picture.grad = gradient
        adam.step()
        with torch.no_grad():
            for picture in pictures:
                picture.clamp_(0, 1)
    return [each.detach().numpy() for each in pictures], [each.detach().clamp(0, 1).numpy() for each in renders]


def _loss(image: Tensor, target: Tensor, ssim_weight: float) -> Tensor:
    errors = (1 - ssim_weight) * ((image - target) ** 2 + SOFT**2).sqrt().mean()
    return errors + ssim_weight * (1 - ssim_map(image, target).mean())


def camera_center(splats: Splats, message: Message) -> np.ndarray:
    """The place (3,) from which the view of a message was taken. The gradient of a harmonic of degree 1 is that of the base
    colour times Y_k(d) / Y_0, d the direction of sight to the Gaussian: lines that meet in the camera."""
    base, harmonics = (message.gradients[name].numpy().astype(np.float64)[message.rows] for name in ("sh0", "shN"))
    strength = (base[:, 0] ** 2).sum(axis=1)
    rows = np.flatnonzero(strength > np.quantile(strength, 0.5))
    ratios = (harmonics[rows, :3] * base[rows]).sum(axis=2) / strength[rows, None]
    directions = np.stack([-ratios[:, 2], -ratios[:, 0], ratios[:, 1]], axis=1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    means = splats.means[message.rows[rows]].astype(np.float64)
    center = np.median(means, axis=0)
    for _ in range(10):  # by least absolute distances
        away = np.linalg.norm((across @ (means - center)[:, :, None])[:, :, 0], axis=1)
        weights = 1 / np.maximum(away, 1e-3)
        matrix = (weights[:, None, None] * across).sum(axis=0)
        center = np.linalg.solve(matrix, (weights[:, None] * (across @ means[:, :, None])[:, :, 0]).sum(axis=0))
    return center


def main() -> None:
    """Print a row per model and message."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", type=Path)
    parser.add_argument("--px", type=int, default=64)
    parser.add_argument("--steps", default="30,300")
    parser.add_argument("--cases", default="1:float32,1:bfloat16,2:bfloat16,4:bfloat16")
    parser.add_argument("--iterations", type=int, default=150)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    scene = load_bench_scene(arguments.scene, arguments.px)
    for steps in map(int, arguments.steps.split(",")):
        train = replace(bench_settings(arguments.px, steps).train, light="none")
        prepared = prepare_training(DeviceTask(scene=scene.training, train=train, backend="native"), scene.views, Recorder())
        splats = fit_splats(prepared.initial, prepared.views, prepared.config, prepared.options).splats
        first = prepared.views.select([0])
        message = send(splats, first, train, "bfloat16")
        away_m = float(np.linalg.norm(camera_center(splats, message) - first.cameras.centers[0]))
        distance_m = float(np.median(np.linalg.norm(splats.means[message.rows] - first.cameras.centers[0], axis=1)))
        shown = f"{len(splats)} Gaussians, {len(message.rows)} shown in {distance_m:.0f} m"
        print(f"{steps} steps, {shown}: the camera that bfloat16 tells is {away_m:.3f} m off", flush=True)
        for case in filter(None, arguments.cases.split(",")):
            begun_s = time.process_time()
            count, form = int(case.split(":")[0]), case.split(":")[1]
            views = prepared.views.select(range(count))
            message = send(splats, views, train, "float32" if form == "float32" else "bfloat16")
            recovered, renders = attack(splats, views.cameras, message, train, arguments.iterations)
            photographs = [np.asarray(image) / 255 for image in views.images]
            ours, theirs = (
                np.mean([psnr_db(a, b) for a, b in zip(pictures, photographs, strict=True)]) for pictures in (recovered, renders)
            )
            cpu_s = time.process_time() - begun_s
            print(f"    {count} views, {form}: recovered {ours:.2f} dB, render {theirs:.2f} dB, {cpu_s:.0f} CPU s", flush=True)


if __name__ == "__main__":
    main()
