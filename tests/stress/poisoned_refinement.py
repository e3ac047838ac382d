"""What one poisoned refinement of four costs a scene: python -m tests.stress.poisoned_refinement SCENE OUT STEPS ATTACKERS.

One of four devices (2x2, 384 px; so many of them in turn) sends a changed refinement of everything that its own
photographs show, each attack by as much as is admitted, then beyond. Prints held-out PSNR of the whole scene after one
round with `admit_refinement` and without it; an attacker may do the same in every round.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.methods.arms import load_arms
from benchmarks.methods.cells import Cell, Layout, bench_settings
from radiant_core.aggregate import averaging
from radiant_core.aggregate.averaging import Refinement, admit_refinement, join_refinements, refine_scene
from radiant_core.aggregate.config import Refine
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.evaluate.shown_pixels import count_shown_photographs
from radiant_core.geometry.coverage import reached_by
from radiant_core.hierarchy.codec import passed_refinement
from radiant_core.hierarchy.in_process import devices_in, run_in_process
from radiant_core.hierarchy.refine import refine_device
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from radiant_core.train.worth import worth_training

Attack = Callable[[Splats, np.random.Generator], dict[str, np.ndarray]]


def moved(scene: Splats, rng: np.random.Generator, sizes: float) -> np.ndarray:
    """Every Gaussian by so many of its sizes in a random direction."""
    way = rng.normal(size=scene.means.shape)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return scene.means + sizes * np.exp(scene.log_scales.max(axis=1, keepdims=True)) * way


def turned(scene: Splats, rng: np.random.Generator, angle_deg: float) -> np.ndarray:
    """Every Gaussian by this angle about a random axis."""
    half = np.deg2rad(min(angle_deg, 180.0) / 2)
    axes = rng.normal(size=(len(scene), 3))
    axes *= np.sin(half) / np.linalg.norm(axes, axis=1, keepdims=True)
    w, v = scene.quats[:, :1].astype(np.float64), scene.quats[:, 1:].astype(np.float64)
    dot = (v * axes).sum(axis=1, keepdims=True)
    return np.hstack([np.cos(half) * w - dot, np.cos(half) * v + w * axes + np.cross(axes, v)])


def attacks(share: float) -> Mapping[str, Attack]:
    """Each by this share of what is admitted."""
    most = {name: share * value for name, value in averaging.MAX_CHANGES.items()}
    colour, harmonic, denser, growth = most["sh0"], most["shN"], most["logit_opacities"], most["log_scales"]
    move = share * averaging.MAX_MOVE
    single: dict[str, Attack] = {
        "colours inverted": lambda s, rng: {"sh0": s.sh0 + np.clip(-2 * s.sh0, -colour, colour)},
        "colours random": lambda s, rng: {"sh0": s.sh0 + rng.choice([-colour, colour], s.sh0.shape)},
        "harmonics random": lambda s, rng: {"shN": s.shN + rng.choice([-harmonic, harmonic], s.shN.shape)},
        "opacities up": lambda s, rng: {"logit_opacities": s.logit_opacities + denser},
        "opacities down": lambda s, rng: {"logit_opacities": s.logit_opacities - denser},
        "sizes up": lambda s, rng: {"log_scales": s.log_scales + growth},
        "sizes down": lambda s, rng: {"log_scales": s.log_scales - growth},
        "moved": lambda s, rng: {"means": moved(s, rng, move)},
        "turned": lambda s, rng: {"quats": turned(s, rng, share * averaging.MAX_TURN_DEG)},
    }
    chosen = ("colours inverted", "harmonics random", "opacities down", "sizes down", "moved", "turned")
    return {**single, "all at once": lambda s, rng: {k: v for name in chosen for k, v in single[name](s, rng).items()}}


def poison(scene: Splats, rows: np.ndarray, attack: Attack, num_dealt: int) -> Refinement:
    """A refinement of these rows, as heavy as its sender may claim."""
    part = scene.select(rows)
    changed = {name: np.asarray(array, np.float32) for name, array in attack(part, np.random.default_rng(0)).items()}
    return Refinement(rows=rows, splats=replace(part, **changed), weights=np.full(len(rows), num_dealt, np.float32))


def score(cell: Cell, scene: Splats) -> float:
    """Mean held-out PSNR, dB."""
    held = cell.scene.held_out_views
    pairs = zip(render_views(scene, held.cameras, "native"), held.images, strict=True)
    return float(np.mean([psnr_db(view.image, image / 255) for view, image in pairs]))


def tell_changes(scene: Splats, sent: Mapping[str, Refinement]) -> str:
    """How far honest refinements go: 99.9 % of the Gaussians, and the farthest one."""
    found: dict[str, list[np.ndarray]] = {}
    for one in sent.values():
        before, after = scene.select(one.rows), one.splats
        sizes = np.exp(before.log_scales.max(axis=1))
        found.setdefault("place, sizes", []).append(np.linalg.norm(after.means - before.means, axis=1) / sizes)
        found.setdefault("rotation, degrees", []).append(averaging._turned_deg(before.quats, after.quats))
        for name in averaging.MAX_CHANGES:
            change = np.abs(after.arrays()[name] - before.arrays()[name]).reshape(len(before), -1)
            found.setdefault(name, []).append(change.max(axis=1, initial=0))
    values = {name: np.concatenate(parts) for name, parts in found.items()}
    return "\n".join(f"  {name}: {np.quantile(each, 0.999):.3f}, {each.max():.3f}" for name, each in values.items())


def main(scene_folder: Path, out: Path, num_steps: int, num_attackers: int) -> None:
    """Print the table."""
    cell = load_arms(scene_folder, out, Layout(num_edges=2, num_devices=2), bench_settings(384, num_steps)).first
    models = cell.train_devices(cell.recipe)
    bare = replace(cell.recipe, aggregate=replace(cell.recipe.aggregate, refine=Refine(epochs=0)))
    given = cell.scene
    kept = {f"devices/{name}": model for name, model in models.items()}
    run = run_in_process(bare, given.training, given.views, train=lambda task, views, reporter: kept[reporter.stage])
    scene = run.scene.splats
    assert scene is not None
    sent: dict[str, Refinement] = {}
    cameras, dealt = {}, {}
    for edge in devices_in(run.scene.corrections):
        for device in devices_in(run.edges[edge].corrections):
            rows = cell.recipe.cameras_of(device)
            _, views, _ = worth_training(given.training.restricted_to(rows), given.views.select(rows), cell.recipe.train)
            arrived = passed_refinement(refine_device(cell.recipe.refine_task(device), scene, views, Recorder()), "float16", scene)
            assert not isinstance(arrived, str)
            sent[device], cameras[device], dealt[device] = arrived, given.training.cameras.select(rows), len(rows)

    shown = {name: count_shown_photographs(scene, own.scaled(cell.recipe.train.long_side_px)) for name, own in cameras.items()}

    def scene_of(arrived: Mapping[str, Refinement], *, admitted: bool) -> float:
        by_edge = []
        for plan in cell.recipe.edge_plans:
            own = [(name, arrived[name]) for name in plan.device_ids if name in arrived]
            kept = [admit_refinement(one, scene, shown[name]) if admitted else one for name, one in own]
            joined = join_refinements(kept, scene)
            by_edge.append(admit_refinement(joined, scene) if admitted else joined)
        return score(cell, refine_scene(scene, by_edge))

    print(f"honest changes, 99.9 %, 100 %:\n{tell_changes(scene, sent)}")
    honest = scene_of(sent, admitted=True)
    print(f"joined {score(cell, scene):.2f} dB, refined {honest:.2f} dB", flush=True)
    for attacker in [*sent][:num_attackers]:
        rest = {name: one for name, one in sent.items() if name != attacker}
        rows = np.flatnonzero(reached_by(scene, cameras[attacker]))
        print(f"attacker {attacker}: {len(rows):,} of {len(scene):,} Gaussians; left out: {scene_of(rest, admitted=True) - honest:+.2f} dB")
        for share in (0.96, 4.0):
            for name, attack in attacks(share).items():
                bad = {**sent, attacker: poison(scene, rows, attack, dealt[attacker])}
                found = [scene_of(bad, admitted=admitted) - honest for admitted in (True, False)]
                print(f"  {share:g} {name}: {found[0]:+.2f} dB, without admission {found[1]:+.2f}", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
