"""What planning from a count raster and capacity curves costs: makespan over that of the exact plan from positions and devices.

    python -m radiant_app.bench.raster_plan [--town sample_scenes/town/known] [--photographs FOLDER_WITH_GPS]

Also the share of cameras that another edge gets than by the exact plan, and the curves' part of the cost: the same with a cell of 1 mm.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from radiant_app.bench.plan import camera_layout, unequal_system
from radiant_app.files.system_file import even_system
from radiant_core.io.colmap.model import read_model
from radiant_core.io.waypoints.reader import exif_waypoints
from radiant_core.numerics import FloatArray
from radiant_core.plan.counts.count_raster import count_raster, followed_by_edges, known_to_the_cloud, regions_of_raster
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.edge_sites import place_edges
from radiant_core.plan.regions.region_plan import plan_regions
from radiant_core.plan.system import System

CELLS_M = (0.001, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
SEEDS = range(5)


def costs(positions: FloatArray, system: System, seed: int) -> list[tuple[float, float]]:
    """For each cell: makespan over the exact plan's, both with edges where a seed puts them, and the share of cameras that change edges."""
    exact = plan_regions(positions, place_edges(system, positions, None, seed))
    assert isinstance(exact, CloudPlan)
    found = []
    for cell_m in CELLS_M:
        raster = count_raster(positions, cell_m)
        placed = place_edges(system, positions, None, seed)
        regions = regions_of_raster(raster, known_to_the_cloud(placed, len(positions)))
        assert isinstance(regions, CloudPlan)
        plan = followed_by_edges(regions, positions, placed)
        found.append((plan.makespan_s / exact.makespan_s, float((plan.edge_of_camera != exact.edge_of_camera).mean())))
    return found


def cases(town: Path | None, photographs: Path | None) -> Iterator[tuple[str, FloatArray, System, int]]:
    """Name, positions (C,2) m, system and seed of every measurement."""
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        for name, source in (("town, 2 × 2 devices", town), ("photographs, 2 × 2 devices", photographs)):
            if source is not None:
                yield name, _positions(source), even_system(2, 2), seed
                yield name.replace("2 × 2", "4 unequal edges of"), _positions(source), unequal_system(4, rng), seed
        for kind in ("uniform", "lawnmower", "street", "clustered"):
            for num_edges in (4, 16):
                yield (
                    f"{kind}, 1,700 cameras, {num_edges} unequal edges",
                    camera_layout(kind, 1700, rng),
                    unequal_system(num_edges, rng),
                    seed,
                )


def _positions(source: Path) -> FloatArray:
    if (source / "images.bin").is_file() or (source / "images.txt").is_file():
        images = read_model(source).images
        return np.array([-image.cam_from_world[:3, :3].T @ image.cam_from_world[:3, 3] for image in images])[:, :2]
    return exif_waypoints(source).waypoints.positions_m[:, :2]


def main() -> None:
    """Print one row per case: median and worst makespan over exact for each cell, over the seeds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--town", type=Path)
    parser.add_argument("--photographs", type=Path)
    arguments = parser.parse_args()
    rows: dict[str, list[list[tuple[float, float]]]] = {}
    sides_m: dict[str, float] = {}
    for name, positions, system, seed in cases(arguments.town, arguments.photographs):
        sides_m.setdefault(name, float(np.ptp(positions, axis=0).max()))
        rows.setdefault(name, []).append(costs(positions, system, seed))
    print("| case | " + " | ".join(f"{cell_m:g} m" for cell_m in CELLS_M) + " |\n" + "|---" * (1 + len(CELLS_M)) + "|")
    for name, found in rows.items():
        table = np.array(found)
        cells = [f"{np.median(c[:, 0]):.3f} / {c[:, 0].max():.3f} ({100 * np.median(c[:, 1]):.0f} %)" for c in table.transpose(1, 0, 2)]
        print(f"| {name}, {sides_m[name]:.0f} m | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
