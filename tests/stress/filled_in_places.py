"""How far filled-in points of each rule lie from the true surfaces, by how far they are from an observed point: a row a kind of scene.

    python -m tests.stress.filled_in_places OUT [--photographs 30] [--kind room]

Median |log(depth / true depth)| over the empty cells of the scenes that `radiant bench kinds --out OUT` makes; the generator's rays are the
truth.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_args

import numpy as np
from scipy.spatial import KDTree

from benchmarks.kinds.scenes import KINDS, _size, make_scene
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_core.numerics import FloatArray
from radiant_core.sfm.reconstruct import scene_from_colmap
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.train.fill_in import CELLS_ACROSS, Rule, _cells, _place, _project
from radiant_core.train.photographs import load_training_views

LONG_SIDE_PX, MOST_VIEWS = 160, 30
BORDERS_CELLS = (0.5, 1.0, 1.5, 2.0, 3.0, np.inf)
RULES: tuple[Rule, ...] = get_args(Rule)


def errors_of_kind(out: Path, kind: str, num_photographs: int) -> Iterator[FloatArray]:
    """For each photograph, rows (F,3) of its empty cells: cells from the nearest observed point, error of each of `RULES`."""
    sys.path.insert(0, str(sample_scenes_folder()))
    import generate
    from scenegen.flight import plan_flight
    from scenegen.raycast import Photographer

    project = make_scene(out, kind, num_photographs, LONG_SIDE_PX)
    switches = [*KINDS[kind].switches(num_photographs), *_size(num_photographs, LONG_SIDE_PX)]
    config, _ = generate.parse_config(["--out", str(out), *switches])
    photographer = Photographer(config)
    with TemporaryDirectory() as work:
        result = scene_from_colmap(project / "sparse" / "0", project / "images", Path(work), lambda progress: None, None, Placement())
        views = load_training_views(result.undistorted_folder, result.scene.cameras)
    cameras, seen_by, planned = views.cameras, result.scene.points_of_cameras(), plan_flight(config)
    shots = [planned[int(name.removesuffix(".jpg").split("_")[1])] for name in cameras.names]
    # Scenes without GPS have a frame of their own size.
    sizes = [np.linalg.norm(centers - centers.mean(axis=0)) for centers in (cameras.centers, np.array([shot.center_m for shot in shots]))]
    for index in range(0, len(cameras), -(-len(cameras) // MOST_VIEWS)):
        points, cells = result.scene.points[seen_by[index]], _cells(views.images[index])
        by_rule = [placed for rule in RULES if (placed := _place(cameras, index, points, cells, rule)) is not None]
        if not by_rule:
            continue
        is_empty = by_rule[RULES.index("height")][2]
        column, row = cells.middles[is_empty].astype(np.int64).T
        truth = sizes[0] / sizes[1] * photographer.depth(shots[index])[row, column]
        pixels, depths = _project(cameras, index, points)
        apart = KDTree(pixels[depths > 0]).query(cells.middles[is_empty])[0] * CELLS_ACROSS / LONG_SIDE_PX
        is_surface = np.isfinite(truth)
        errors = [np.abs(np.log(_project(cameras, index, at[is_empty][is_surface])[1] / truth[is_surface])) for at, _, _ in by_rule]
        yield np.column_stack([apart[is_surface], *errors])


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--photographs", type=int, default=30)
    parser.add_argument("--kind", action="append", choices=list(KINDS))
    arguments = parser.parse_args()
    spans = list(pairwise(BORDERS_CELLS))
    print("| scene | rule | " + " | ".join(f"{low:g} to {high:g} cells" for low, high in spans) + " |")
    for kind in arguments.kind or KINDS:
        rows = np.concatenate(list(errors_of_kind(arguments.out, kind, arguments.photographs)))
        for column, rule in enumerate(RULES, start=1):
            parts = [rows[(rows[:, 0] >= low) & (rows[:, 0] < high), column] for low, high in spans]
            figures = [f"{100 * np.median(part):.0f} % of {len(part)}" if len(part) else "" for part in parts]
            print(f"| {kind}-{arguments.photographs} | {rule} | {' | '.join(figures)} |", flush=True)


if __name__ == "__main__":
    main()
