"""How far the dense points of a scene are from the surface that the generator knows.

    python sample_scenes/dense_error.py SCENE [--known KNOWN] [--long-side-px 576]

SCENE is a folder of `radiant sfm` or a run on photographs of the generator. The truth's mesh is
moved into its frame by a similarity of the camera centres. Distances to the mesh are given in
ground sampling distances, the width of a pixel at the point; leaves are ruffled in photographs
alone. Prints CPU seconds, numbers of points, median and 95th percentile, of all points and of those
that a training would begin with.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import fields
from pathlib import Path
from typing import Any, cast

import numpy as np
import open3d as o3d

from radiant_app.workers.sources import load_scored_scene
from radiant_core.geometry.align import fit_sim3
from radiant_core.io.colmap.model import read_model
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.sfm.world_frame.world import cameras_of
from radiant_core.train.dense.fuse import thinned
from radiant_core.train.dense.points import dense_points
from radiant_core.train.dense.seeding import PIXELS_PER_POINT
from radiant_core.train.photographs import load_training_views
from scenegen.config import SceneConfig
from scenegen.layout import Layout
from scenegen.town import build_town

MOST_COMPARED = 5_000
"""A distance to the mesh takes longer than to find the point."""


def main() -> None:
    """Measure one scene and print its figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--known", type=Path, default=Path(__file__).parent / "town" / "known")
    parser.add_argument("--long-side-px", type=int, default=576)
    chosen = parser.parse_args()
    scene, _, images = load_scored_scene(chosen.scene)
    views = load_training_views(images, scene.cameras.scaled(chosen.long_side_px))
    begun_s = time.process_time()
    found = dense_points(scene, views, most=10**9)
    few = thinned(found, int(views.cameras.sizes_wh.prod(axis=1).sum()) // PIXELS_PER_POINT)
    print(f"{len(views)} photographs, {time.process_time() - begun_s:.1f} CPU s")
    for name, points in (("all", found), ("first Gaussians", few)):
        tried = points.select(np.linspace(0, len(points) - 1, min(len(points), MOST_COMPARED)).astype(np.int64))
        distances = distances_to_truth(scene, chosen.known, tried.points) / tried.pixels_m
        median, high = np.quantile(distances, [0.5, 0.95])
        far = float((distances > 2).mean())
        print(f"{name}: {len(points):,} points, median {median:.2f}, 95 % {high:.2f} ground sampling distances, beyond 2: {far:.1%}")


def distances_to_truth(scene: SfmScene, known: Path, points: FloatArray) -> FloatArray:
    """Distances (N,) of points (N,3) to the generator's surface, in the scene's unit."""
    record = json.loads((known / "frame.json").read_text())["config"]
    names = {field.name for field in fields(SceneConfig)}
    given: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in record.items() if key in names}
    config = SceneConfig(**given)
    truth = cameras_of(read_model(known))
    shared = sorted(set(truth.names) & set(scene.cameras.names))
    move = fit_sim3(truth.named(shared).centers, scene.cameras.named(shared).centers)
    mesh = build_town(Layout(extent_m=config.extent_m, seed=config.seed))
    tensor = cast(Any, o3d.core.Tensor)
    caster = o3d.t.geometry.RaycastingScene()
    caster.add_triangles(
        tensor(np.ascontiguousarray(move.apply(mesh.vertices), np.float32)), tensor(np.ascontiguousarray(mesh.triangles, np.uint32))
    )
    return caster.compute_distance(tensor(points.astype(np.float32))).numpy().astype(np.float64)


if __name__ == "__main__":
    main()
