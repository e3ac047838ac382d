"""What devices that lie in every step cost those that train with them: python -m tests.stress.poisoned_gradients SCENE OTHER
[--px 128] [--views 1000] [--attacks NAME,NAME] [--unchecked] [--devices 6].

SCENE is dealt to one edge with six devices, of which two send poison; OTHER has the photographs of another place. Prints,
per attack, PSNR of the photographs held out where the four others are (nearer to one of their cameras than to the two's),
how many messages of the two were refused, the step in which they were left out, and messages refused of the four.
`absent`: the two are not there from the start; `honest`: they do not lie. With `--devices 2 --attacks honest` how far two that
do not lie are from contradicting each other.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast
from unittest.mock import patch

import numpy as np
import torch
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from benchmarks.methods.cells import BenchScene, Layout, ModelCache, bench_settings, deal_cell, load_bench_scene
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.hierarchy.groups import GroupTraining
from radiant_core.hierarchy.messages import device_task
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.hierarchy.reporter import Machine, Recorder, fit_options
from radiant_core.hierarchy.together import begin_group, hold_share, prepare_share
from radiant_core.light.canonical import light_of_score, show_in_light
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from radiant_core.train.together import fold
from radiant_core.train.together import gradients as together
from radiant_core.train.together.codec import decode_gradients, encode_gradients
from radiant_core.train.together.fold import GroupMembers
from radiant_core.train.together.gradients import StepGradients
from radiant_core.train.together.masking import MaskKeys
from radiant_core.train.together.roles import Holder, Inbox, Root
from radiant_core.train.together.scrutiny import MIN_STEPS, NUM_ERRORS, Scrutiny, tensor_lengths, view_limits
from radiant_core.train.views import TrainingViews

NUM_DEVICES, LIARS = 6, ("e0d1", "e0d4")
Attack = Callable[[StepGradients, together.Layout, np.random.Generator], StepGradients]


def _scaled(factor: float) -> Attack:
    return lambda sent, layout, rng: replace(sent, values=np.float32(factor) * sent.values)


def _noise(sent: StepGradients, layout: together.Layout, rng: np.random.Generator) -> StepGradients:
    """In each tensor the honest length, in random directions."""
    values = sent.values.copy()
    for columns in layout.columns.values():
        drawn = rng.standard_normal(values[:, columns].shape).astype(np.float32)
        values[:, columns] = drawn * (np.linalg.norm(values[:, columns]) / max(float(np.linalg.norm(drawn)), 1e-30))
    return replace(sent, values=values)


def _shuffled(sent: StepGradients, layout: together.Layout, rng: np.random.Generator) -> StepGradients:
    """The honest gradients of other rows."""
    return replace(sent, values=sent.values[rng.permutation(len(sent.values))])


def _growth(factor: float) -> Attack:
    def change(sent: StepGradients, layout: together.Layout, rng: np.random.Generator) -> StepGradients:
        values = sent.values.copy()
        values[:, layout.growth] *= np.float32(factor)
        return replace(sent, values=values)

    return change


ATTACKS: dict[str, Attack] = {
    "not finite": lambda sent, layout, rng: replace(sent, values=np.full_like(sent.values, np.nan)),
    "x 1e6": _scaled(1e6),
    "x 10": _scaled(10),
    "x 3": _scaled(3),
    "sign flipped": _scaled(-1),
    "flipped but growth": lambda sent, layout, rng: _growth(-1)(_scaled(-1)(sent, layout, rng), layout, rng),
    "noise": _noise,
    "shuffled rows": _shuffled,
    "zeros": _scaled(0),
    "growth x 1000": _growth(1000),
    "growth x 5": _growth(5),
    "growth negative": _growth(-1),
    "seen nowhere": lambda sent, layout, rng: replace(sent, view_counts=np.zeros_like(sent.view_counts)),
    "loss 1e9": lambda sent, layout, rng: replace(sent, loss=1e9),
}
HONEST, ABSENT, OTHER, OTHER_START = "honest", "absent", "another place", "another place from the start"


class Liar:
    """A holder that changes what it sends."""

    def __init__(self, holder: Holder, attack: Attack, seed: int) -> None:
        self.holder, self.replica, self._attack, self._rng = holder, holder.replica, attack, np.random.default_rng(seed)

    @property
    def waits_for_total(self) -> bool:
        """As the holder."""
        return self.holder.waits_for_total

    def message(self) -> bytes:
        """Poison."""
        step, count, layout = self.holder.num_sent, self.replica.num_splats, self.replica.layout
        sent = decode_gradients(self.holder.message(), step, count, layout, 255, checks=False)
        with np.errstate(over="ignore"):
            return encode_gradients(self._attack(sent, layout, self._rng), step, count, layout, "bfloat16")

    def take(self, total: bytes) -> None:
        """As the holder."""
        self.holder.take(total)

    def follow(self, other: Holder) -> None:
        """As the holder."""
        self.holder.follow(other)


@dataclass
class Watched:
    """What honest messages come to: by how much lengths differ from the median of a step, which share
    of the limits they are, the lowest share of the median that a mean cosine has, and the lowest that
    one is at most."""

    most: np.ndarray | float = 0.0
    least: np.ndarray | float = 1.0
    logs: np.ndarray | float = 0.0
    num_steps: int = 0
    of_limit: float = 0.0
    direction: float = np.inf
    cosine: float = np.inf

    def look(self, scrutiny: Scrutiny, sent: Mapping[str, StepGradients], layout: together.Layout) -> None:
        """Look at the messages of a step."""
        lengths = np.array([tensor_lengths(each.values, layout) / each.num_views for each in sent.values() if each.num_views])
        factors = np.where(lengths.any(0), lengths / np.maximum(np.median(lengths, axis=0), 1e-30), 1.0)
        self.most, self.least = np.maximum(self.most, factors.max(0)).round(2), np.minimum(self.least, factors.min(0)).round(3)
        if len(factors) == len(scrutiny.standings):
            self.logs, self.num_steps = self.logs + np.log(np.maximum(factors, 1e-3)), self.num_steps + 1
        self.of_limit = max(self.of_limit, (lengths / view_limits(scrutiny.config, layout)).max())
        able = [each for each in scrutiny.standings.values() if each.num_steps >= MIN_STEPS]
        if able:
            usual = float(np.median([each.mean for each in able]))
            self.cosine = min(self.cosine, *(each.mean + NUM_ERRORS * each.error for each in able))
            self.direction = min(self.direction, *((each.mean + NUM_ERRORS * each.error) / usual for each in able))

    def __str__(self) -> str:
        steady = np.exp(self.logs / max(self.num_steps, 1))
        ends = f"of a step {self.least} to {self.most}, of the mean {np.min(steady, 0).round(2)} to {np.max(steady, 0).round(2)}"
        return f"lengths {ends}, {self.of_limit:.4f} of the limits, direction {self.direction:.2f} of the usual, cosine {self.cosine:.3f}"


@dataclass(frozen=True, kw_only=True)
class Case:
    """What runs of one scene have in common."""

    scene: BenchScene
    recipe: Recipe
    other: BenchScene
    num_views: int
    """That six devices show."""


def other_place(views: TrainingViews, other: TrainingViews) -> TrainingViews:
    """The cameras of `views` with photographs of another place, cut or repeated to their sizes."""
    images = []
    for index, image in enumerate(views.images):
        foreign = np.asarray(other.images[index % len(other.images)])
        height, width = np.asarray(image).shape[:2]
        down, across = np.arange(height) % foreign.shape[0], np.arange(width) % foreign.shape[1]
        images.append(np.ascontiguousarray(foreign[down][:, across]))
    return replace(views, images=tuple(images))


def watch(scrutiny: Scrutiny | None, watched: Watched) -> None:
    """Have `watched` look at all that `scrutiny` judges."""
    assert scrutiny is not None
    judge = scrutiny.refuse

    def refuse(step: int, sent: Mapping[str, StepGradients], num_splats: int, layout: together.Layout) -> dict[str, str]:
        reasons = judge(step, sent, num_splats, layout)
        watched.look(scrutiny, sent, layout)
        return reasons

    vars(scrutiny)["refuse"] = refuse


def train(case: Case, attack: str, watched: Watched, *, checked: bool, masked: bool = False) -> tuple[Splats, Inbox]:
    """The group's model, and what its root refused."""
    recipe, liars = case.recipe, () if attack == HONEST else LIARS
    devices = [device for device in recipe.edge_plans[0].device_ids if attack != ABSENT or device not in LIARS]
    plan = GroupTraining(
        root=f"edges/{recipe.edge_plans[0].edge_id}",
        views={recipe.edge_plans[0].edge_id: dict.fromkeys(devices, 1)},
        num_steps=case.num_views * len(devices) // len(recipe.edge_plans[0].device_ids),
    )
    prepared = {}
    for device in devices:
        rows = recipe.cameras_of(device)
        views = case.scene.views.select(rows)
        if attack == OTHER_START and device in liars:
            views = other_place(views, case.other.views)
        task = device_task(recipe.device_settings(device), case.scene.training.restricted_to(rows))
        prepared[device] = prepare_share(task, views, Recorder())
        if attack == OTHER and device in liars:
            prepared[device] = replace(prepared[device], views=other_place(prepared[device].views, case.other.views))
    start = begin_group({device: each.start for device, each in prepared.items()}, plan, recipe.train, Recorder())
    group = replace(start.group, masked=masked)
    holders: dict[str, Any] = {}
    keys = mask_keys(devices) if masked else {}
    for device, each in prepared.items():
        open_holder = hold_share(each, device, start, plan.seat_of(device))
        holders[device] = Holder(open_holder.replica, group, keys[device]) if masked else open_holder
    for number, device in enumerate(liars):
        if attack in ATTACKS:
            holders[device] = Liar(holders[device], ATTACKS[attack], number)
    members = GroupMembers(holders=cast(dict[str, Holder], holders), edges=plan.views, has_relays=False)
    options = fit_options(recipe.backend, Recorder(), Machine(), lambda: "")
    roots: list[Root] = []

    def root(*arguments: Any, **named: Any) -> Root:
        roots.append(Root(*arguments, **named))
        if not checked:
            roots[-1].inbox.scrutiny = None
        elif attack in (HONEST, ABSENT):
            watch(roots[-1].inbox.scrutiny, watched)
        return roots[-1]

    with patch.object(fold, "Root", root):
        result, _ = fold.fit_in_process(start.initial, group, members, start.camera_centers, options)
    return result.splats, roots[0].inbox


def mask_keys(devices: Sequence[str]) -> dict[str, MaskKeys]:
    """New keys of each pair."""
    privates = {device: X25519PrivateKey.generate() for device in devices}
    publics = {device: private.public_key().public_bytes_raw() for device, private in privates.items()}
    return {device: MaskKeys.agree(device, private, publics, "stress") for device, private in privates.items()}


def case_of(source: Path, foreign: Path, px: int, num_views: int, num_devices: int = NUM_DEVICES) -> Case:
    """A scene dealt to one edge with six devices."""
    scene, other = (load_bench_scene(path, px) for path in (source, foreign))
    settings = bench_settings(px, num_views)
    cell = deal_cell(scene, ModelCache(folder=Path("unused")), settings, Layout(num_edges=1, num_devices=num_devices))
    return Case(scene=scene, recipe=cell.recipe, other=other, num_views=num_views)


def honest_psnr(case: Case, splats: Splats) -> float:
    """dB, mean over the held-out photographs nearer to cameras of the four."""
    held = case.scene.held_out_views
    light = light_of_score(splats, case.scene.views, held.cameras, case.scene.captures, case.recipe.train.light)
    liars = np.concatenate([case.recipe.cameras_of(device) for device in LIARS])
    centers = case.scene.training.cameras.centers
    values = []
    for index, view in enumerate(render_views(splats, held.cameras)):
        away = np.linalg.norm(centers - held.cameras.centers[index], axis=1)
        if int(np.argmin(away)) in liars:
            continue
        image = view.image if light is None else show_in_light(view.image, light.held_out, index, held.cameras)
        values.append(psnr_db(image, np.asarray(held.images[index]) / 255))
    return float(np.mean(values))


def main() -> None:
    """Print a row per attack."""
    parser = argparse.ArgumentParser()
    parser.add_argument("scene", type=Path)
    parser.add_argument("other", type=Path)
    parser.add_argument("--px", type=int, default=128)
    parser.add_argument("--views", type=int, default=1_000)
    parser.add_argument("--attacks", default=",".join([ABSENT, HONEST, *ATTACKS, OTHER, OTHER_START]))
    parser.add_argument("--unchecked", action="store_true")
    parser.add_argument("--devices", type=int, default=NUM_DEVICES)
    arguments = parser.parse_args()
    names = arguments.attacks.split(",")
    if unknown := set(names) - {ABSENT, HONEST, OTHER, OTHER_START, *ATTACKS}:
        parser.error(f"no attack is called {', '.join(unknown)}: choose from {', '.join(ATTACKS)}")
    if arguments.devices < NUM_DEVICES and names != [HONEST]:
        parser.error(f"two of {NUM_DEVICES} devices lie: with fewer use --attacks {HONEST}")
    torch.set_num_threads(1)
    case = case_of(arguments.scene, arguments.other, arguments.px, arguments.views, arguments.devices)
    for attack in names:
        begun_s = time.process_time()
        watched = Watched()
        splats, inbox = train(case, attack, watched, checked=not arguments.unchecked)
        refused = {name: each.count for name, each in inbox.refused.items()}
        first = {name: each.first for name, each in inbox.refused.items()}
        out = {} if inbox.scrutiny is None else dict(inbox.scrutiny.left_out)
        cpu_s = time.process_time() - begun_s
        psnr = honest_psnr(case, splats) if arguments.devices == NUM_DEVICES else np.nan
        print(f"{attack}: {psnr:.3f} dB, {len(splats)} Gaussians, refused {refused}, {cpu_s:.0f} CPU s", flush=True)
        print(f"    {watched if attack in (HONEST, ABSENT) else first}\n    {out}", flush=True)


if __name__ == "__main__":
    main()
