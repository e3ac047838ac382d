"""How far a run's surface model is from the truth that the generator knows, and from the run's own
sparse points.

    python sample_scenes/surface_error.py RUN [--known sample_scenes/town/known] [--resolution 0.2]

The run's frame is moved onto the truth's by a similarity of the camera centres. Truth are the
heights of the topmost surface of the generator's mesh at the middles of the cells that are known,
within the flight's area; its leaves are ruffled in photographs alone. Prints a median and a 95th
percentile of height errors in m; without --known of sparse points alone. --depths compares, in six
views of 320 px, rendered depth at the pixels of sparse points with their depth, for opacities as
they are and other ways to leave haze out.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import fields
from pathlib import Path
from typing import Any, cast

import numpy as np
import open3d as o3d

from radiant_core.geometry.align import fit_sim3
from radiant_core.geometry.surface import Surface, extract_surface, sharpen_opacities, trusted_depth
from radiant_core.io.colmap.model import read_model
from radiant_core.numerics import FloatArray
from radiant_core.render.rendered_view import render_views
from radiant_core.scene import SfmScene
from radiant_core.sfm.world_frame.world import cameras_of
from radiant_core.splats import Splats
from radiant_viewer.runs.run_view import load_run_view, require_splats
from scenegen.config import SceneConfig
from scenegen.layout import Layout
from scenegen.town import build_town


def main() -> None:
    """Measure one run and print its figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--known", type=Path)
    parser.add_argument("--long-side-px", type=int, default=640)
    parser.add_argument("--resolution", type=float)
    parser.add_argument("--depths", action="store_true")
    chosen = parser.parse_args()
    run = load_run_view(chosen.run)
    if chosen.depths:
        compare_depths(run.scene, require_splats(run))
        return
    cameras = run.scene.cameras
    surface = extract_surface(require_splats(run), cameras, resolution=chosen.resolution, long_side_px=chosen.long_side_px)
    errors = point_errors(surface, run.scene)
    print(f"resolution {surface.voxel:.3f} {run.unit}, known under {len(errors) / len(run.scene.points):.1%} of the sparse points")
    _print("sparse points", errors)
    if chosen.known is not None:
        _print("generator's surface", truth_errors(surface, run.scene, chosen.known))


def point_errors(surface: Surface, scene: SfmScene) -> FloatArray:
    """Height of the mesh minus that of each sparse point where it has one (K,): a point under a
    roof or a tree counts too."""
    errors = _heights(surface.mesh.vertices, surface.mesh.triangles, scene.points[:, :2]) - scene.points[:, 2]
    return errors[np.isfinite(errors)]


def truth_errors(surface: Surface, scene: SfmScene, known: Path) -> FloatArray:
    """Height of the run's surface minus the generator's (K,) m, both in the truth's frame, over the
    area of the flight."""
    record = json.loads((known / "frame.json").read_text())["config"]
    names = {field.name for field in fields(SceneConfig)}
    given: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in record.items() if key in names}
    config = SceneConfig(**given)
    truth = cameras_of(read_model(known))
    shared = sorted(set(truth.names) & set(scene.cameras.names))
    move = fit_sim3(scene.cameras.named(shared).centers, truth.named(shared).centers)
    mesh = build_town(Layout(extent_m=config.extent_m, seed=config.seed))
    half = np.array(config.extent_m) / 2
    x, y = np.meshgrid(*(np.arange(-side, side, surface.voxel) for side in half))
    places = np.column_stack([x.ravel(), y.ravel()])
    ours = _heights(move.apply(surface.mesh.vertices), surface.mesh.triangles, places)
    errors = ours - _heights(mesh.vertices, mesh.triangles, places)
    return errors[np.isfinite(errors)]


def compare_depths(scene: SfmScene, splats: Splats) -> None:
    """Print the share of pixels that count and the relative error of their depth for each way to
    choose opacities."""
    opacities = 1 / (1 + np.exp(-splats.logit_opacities.astype(np.float64)))
    ways = {
        "as they are": splats,
        **{f"from {least} on": splats.select(opacities >= least) for least in (0.1, 0.3, 0.5)},
        "sharpened": sharpen_opacities(splats),
    }
    views = scene.restricted_to(np.linspace(1, len(scene.cameras) - 2, 6).astype(np.int64))
    cameras = views.cameras.scaled(320)
    rows, pixels = views.observed_pixels(cameras)
    points, seen_by = views.observations[rows].T
    poses = cameras.cam_from_world[seen_by]
    depths = np.einsum("tj,tj->t", poses[:, 2, :3], views.points[points]) + poses[:, 2, 3]
    for name, model in ways.items():
        errors, shares = [], []
        for index, view in enumerate(render_views(model, cameras)):
            trusted = trusted_depth(view, np.inf)
            chosen = seen_by == index
            found = trusted[pixels[chosen, 1], pixels[chosen, 0]]
            errors.append(((found - depths[chosen]) / depths[chosen])[found > 0])
            shares.append(float((trusted > 0).mean()))
        joined = np.concatenate(errors)
        median, high = np.quantile(np.abs(joined), [0.5, 0.95])
        print(f"{name}: {np.mean(shares):.2f} of pixels, bias {np.median(joined):+.2%}, |error| median {median:.2%}, 95 % {high:.2%}")


def _heights(vertices: np.ndarray, triangles: np.ndarray, places: FloatArray) -> FloatArray:
    tensor = cast(Any, o3d.core.Tensor)
    caster = o3d.t.geometry.RaycastingScene()
    corners = np.ascontiguousarray(vertices, np.float32)
    sides = np.ascontiguousarray(triangles, np.uint32)
    caster.add_triangles(tensor(corners), tensor(sides))
    rays = np.zeros((len(places), 6), np.float32)
    rays[:, :2], rays[:, 2], rays[:, 5] = places, 500.0, -1.0
    return 500.0 - caster.cast_rays(tensor(rays))["t_hit"].numpy().astype(np.float64)


def _print(what: str, errors: FloatArray) -> None:
    median, high = np.quantile(np.abs(errors), [0.5, 0.95])
    print(f"{what}: {len(errors)} heights, bias {np.median(errors):+.3f}, |error| median {median:.3f}, 95 % {high:.3f}")


if __name__ == "__main__":
    main()
