"""How far edges of a run's orthophoto are from those of the generator's town seen from above.

    python sample_scenes/ortho_error.py RUN ORTHO.tif [--known FOLDER] [--picture OUT.png]

The truth is painted from straight above at the orthophoto's cells, and the orthophoto is read where
the truth's surface lies on its map: the run's frame is moved onto the truth's by a similarity of
the camera centres, so that what GPS is off by does not count. At strong edges of the truth, along
their gradient, profiles of 17 px are shifted against each other by a tenth of a pixel until they
agree best. Prints the share of edges found again and the median and 90th percentile of their
|shift| in px.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
from numpy.typing import NDArray

from radiant_core.georef.crs import parse_crs
from radiant_core.numerics import FloatArray
from radiant_core.survey.map_grid import MapGrid, map_frame_of
from radiant_viewer.runs.run_view import load_run_view
from scenegen.raycast import Photographer
from truth import ABOVE_M, Truth, load_truth, sample

NUM_EDGES, MIN_APART_PX = 4000, 3
HALF_PROFILE_PX, MOST_SHIFT_PX, STEP_PX = 8, 4.0, 0.1
MIN_CORRELATION = 0.7


def main() -> None:
    """Measure one orthophoto and print its figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("ortho", type=Path)
    parser.add_argument("--known", type=Path, default=Path(__file__).parent / "town" / "known")
    parser.add_argument("--picture", type=Path)
    chosen = parser.parse_args()
    scene = load_run_view(chosen.run).scene
    truth = load_truth(chosen.known, scene)
    with rasterio.open(chosen.ortho) as file:
        bands = np.moveaxis(file.read(), 0, -1)
        grid = MapGrid(
            north_west=np.array([file.transform.c, file.transform.f]),
            cell=file.transform.a,
            rows=file.height,
            columns=file.width,
            epsg=file.crs.to_epsg(),
        )
    places, shape = truth.flown(grid.cell)
    heights = truth.heights(places)
    world = truth.truth_from_run.inverse().apply(np.column_stack([places, heights]))
    cells = grid.cells_of(map_frame_of(scene.frame, parse_crs(f"EPSG:{grid.epsg}")).from_world(world)[:, :2])
    inside = ((cells >= 1) & (cells < np.array(grid.shape) - 1)).all(axis=1)
    known = inside & (bands[tuple(np.clip(cells, 0, np.array(grid.shape) - 1).astype(int).T)][:, 3] > 0)
    ours = sample(np.ascontiguousarray(bands[..., :3]), cells).reshape(*shape, 3)
    painted = paint_from_above(truth, places).reshape(*shape, 3)
    shifts = edge_shifts(cv2.cvtColor(painted, cv2.COLOR_RGB2GRAY), cv2.cvtColor(ours, cv2.COLOR_RGB2GRAY), known.reshape(shape))
    found = np.isfinite(shifts)
    median, high = np.quantile(np.abs(shifts[found]), [0.5, 0.9])
    print(f"{shape[1]} x {shape[0]} cells of {grid.cell:.3f} m over the flown area, {known.mean():.1%} seen")
    print(f"edges: {found.sum()} of {len(shifts)} found again, |shift| median {median:.2f} px, 90 % {high:.2f} px")
    if chosen.picture:
        cv2.imwrite(str(chosen.picture), cv2.cvtColor(np.concatenate([painted, ours.astype(np.uint8)], axis=1), cv2.COLOR_RGB2BGR))


def paint_from_above(truth: Truth, places: FloatArray) -> NDArray[np.uint8]:
    """Colours (P,3) of the truth from straight above, the mean of 4 rays per cell: by a camera so
    far up that its rays are parallel to 1e-3 of a cell, through the generator's own light."""
    photographer = Photographer(truth.config)
    step = float(places[1, 0] - places[0, 0]) / 4
    total = np.zeros((len(places), 3))
    for dx, dy in ((-1, -1), (1, -1), (-1, 1), (1, 1)):
        for rows in np.array_split(np.arange(len(places)), max(1, len(places) // 30_000)):
            origins = np.column_stack([places[rows] + step * np.array([dx, dy]), np.full(len(rows), ABOVE_M / 5)])
            directions = np.broadcast_to(np.array([0.0, 0.0, -1.0]), origins.shape)
            total[rows] += photographer.radiance_along(origins.astype(np.float32), directions.astype(np.float32))
    return photographer.developed((total / 4).astype(np.float32)[None])[0]


def edge_shifts(truth: NDArray[Any], ours: NDArray[Any], known: NDArray[np.bool_]) -> FloatArray:
    """Shift (K,) in px of the orthophoto at strong edges of the truth, NaN where none agrees."""
    smooth, other = (cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0) for image in (truth, ours))
    gx, gy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    strength = np.hypot(gx, gy)
    peak = (strength == cv2.dilate(strength, np.ones((2 * MIN_APART_PX + 1,) * 2, np.uint8))) & known
    margin = HALF_PROFILE_PX + int(MOST_SHIFT_PX) + 1
    peak[:margin] = peak[-margin:] = peak[:, :margin] = peak[:, -margin:] = False
    rows, columns = np.nonzero(peak)
    order = np.argsort(-strength[rows, columns])[:NUM_EDGES]
    rows, columns = rows[order], columns[order]
    across = np.stack([gy[rows, columns], gx[rows, columns]], axis=1) / strength[rows, columns][:, None]
    middle = np.column_stack([rows, columns]) + 0.5
    along = np.arange(-HALF_PROFILE_PX, HALF_PROFILE_PX + 1)
    reference = _profiles(smooth, middle, across, along)
    shifts = np.arange(-MOST_SHIFT_PX, MOST_SHIFT_PX + STEP_PX / 2, STEP_PX)
    agreement = np.stack([(reference * _profiles(other, middle, across, along + shift)).mean(axis=1) for shift in shifts])
    best = agreement.argmax(axis=0)
    inside = (agreement.max(axis=0) > MIN_CORRELATION) & (best > 0) & (best < len(shifts) - 1)
    return np.where(inside, shifts[best], np.nan)


def _profiles(image: NDArray[Any], middle: NDArray[Any], across: NDArray[Any], along: NDArray[Any]) -> FloatArray:
    """Profiles (K,S) through places (K,2) along directions (K,2), of mean 0 and variance 1."""
    at = middle[:, None] + along[None, :, None] * across[:, None]
    values = sample(image, at.reshape(-1, 2)).reshape(len(middle), -1).astype(np.float64)
    values -= values.mean(axis=1, keepdims=True)
    return values / np.maximum(values.std(axis=1, keepdims=True), 1e-6)


if __name__ == "__main__":
    main()
