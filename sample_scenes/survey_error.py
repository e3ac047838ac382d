"""How far a run's heights are from the truth that the generator knows.

    python sample_scenes/survey_error.py RUN DSM.tif [--known FOLDER] [--share 1.0] [--ground]

Truth are the heights of the topmost surface of the generator's mesh, or with --ground of its ground
alone, at the middles of the raster's cells over the area of the flight, or a share of its sides,
moved into the run's frame by a similarity of the camera centres. Prints shares of cells, bias,
median and 95th percentile of |error| in m and in ground sampling distances, and how many errors lie
within one and two of the σ that the raster gives. For level fields also the errors from the plane
that fits best.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import rasterio

from radiant_core.numerics import FloatArray
from radiant_core.survey.heights import MEASURED, UNKNOWN, HeightMap
from radiant_core.survey.map_grid import MapGrid, map_frame_of
from radiant_core.survey.seen_ground import seen_ground
from radiant_viewer.runs.run_view import load_run_view
from scenegen.raycast import layout_of
from truth import load_truth


def main() -> None:
    """Measure one raster and print its figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("raster", type=Path)
    parser.add_argument("--known", type=Path, default=Path(__file__).parent / "town" / "known")
    parser.add_argument("--share", type=float, default=1.0)
    parser.add_argument("--ground", action="store_true")
    chosen = parser.parse_args()
    scene = load_run_view(chosen.run).scene
    surface, truth = read_heights(chosen.raster), load_truth(chosen.known, scene)
    map_frame = map_frame_of(scene.frame, surface.grid.epsg)
    gsd = seen_ground(scene, map_frame).gsd
    places, _ = truth.flown(surface.grid.cell, chosen.share)
    heights = layout_of(truth.config).height_m(*places.T).astype(np.float64) if chosen.ground else truth.heights(places)
    at = map_frame.from_world(truth.truth_from_run.inverse().apply(np.column_stack([places, heights])))
    found, sigma = surface.at(at[:, :2])
    source = HeightMap(grid=surface.grid, heights=surface.source.astype(np.float64), sigma=surface.sigma, source=surface.source).at(
        at[:, :2]
    )[0]
    shares = f"{(source == MEASURED).mean():.1%} measured, {np.isfinite(found).mean():.1%} known"
    print(f"cells of {surface.grid.cell} m, GSD {gsd:.3f} m: {shares}")
    for name, rows in (("measured", source == MEASURED), ("measured and filled", np.isfinite(found))):
        errors = (found - at[:, 2])[rows]
        _print(name, errors, gsd)
        within = [float((np.abs(errors) < times * sigma[rows]).mean()) for times in (1, 2)]
        print(f"  within 1 σ {within[0]:.0%}, 2 σ {within[1]:.0%}; median σ {np.median(sigma[rows]):.3f} m")
    if truth.config.scenery == "fields":
        rows = np.isfinite(found)
        design = np.column_stack([at[rows, :2] - at[rows, :2].mean(axis=0), np.ones(rows.sum())])
        plane = np.linalg.lstsq(design, found[rows], rcond=None)[0]
        _print("from the plane that fits best", found[rows] - design @ plane, gsd)


def read_heights(path: Path) -> HeightMap:
    """The heights of a GeoTIFF that `radiant export --format dsm` wrote."""
    with rasterio.open(path) as file:
        heights, sigma, source = file.read()
        known = file.read_masks(1) > 0
        grid = MapGrid(
            north_west=np.array([file.transform.c, file.transform.f]),
            cell=file.transform.a,
            rows=file.height,
            columns=file.width,
            epsg=file.crs.to_epsg() if file.crs else None,
        )
    return HeightMap(
        grid=grid,
        heights=np.where(known, heights, np.nan).astype(np.float64),
        sigma=np.where(known, sigma, np.nan).astype(np.float32),
        source=np.where(known, source, UNKNOWN).astype(np.uint8),
    )


def _print(name: str, errors: FloatArray, gsd: float) -> None:
    median, high = np.quantile(np.abs(errors), [0.5, 0.95])
    text = (
        f"bias {np.median(errors):+.3f} m, |error| median {median:.3f} m ({median / gsd:.2f} GSD), 95 % {high:.3f} m ({high / gsd:.2f} GSD)"
    )
    print(f"{name}: {len(errors):,} cells, {text}, most {np.abs(errors).max() / gsd:.1f} GSD")


if __name__ == "__main__":
    main()
