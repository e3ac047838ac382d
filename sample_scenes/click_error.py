"""How far distances between clicked places are from the truth, and what a lasso chooses: by our
means and by Open3D's.

    xvfb-run -a -s "-screen 0 1280x1024x24" python sample_scenes/click_error.py RUN

RUN is of the town. Pixels of its held-out photographs, in pairs, at places that the truth has too
and at least 10 m apart: at the depth that our renderer draws (a click of the inspector), at the
depth that Open3D's scene draws, and at the middle of the Gaussian that Open3D's
`VisualizerWithVertexSelection` picks within as many pixels as the inspector looks into holes. Of
lassos the same polygons in the same view, by ours and by `SelectionPolygonVolume`.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import open3d as o3d

from radiant_core.cameras import Cameras
from radiant_core.geometry.selection import Stroke
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats
from radiant_viewer.host.place_tool import REACH
from radiant_viewer.runs.run_view import load_run_view
from radiant_viewer.runs.shown_model import shown_of_run
from radiant_viewer.splats.open3d_rgbd import Open3DRenderer
from radiant_viewer.splats.rgbd import ModelRenderer
from truth import Truth, load_truth

MIN_APART_M, MAX_AWAY_M = 10.0, 200.0
TURNS = 5


def rays_of(camera: Cameras, pixels: FloatArray) -> FloatArray:
    """Directions (P,3) in the world of pixels (P,2), of depth 1 along the view."""
    K, pose = camera.Ks[0], camera.cam_from_world[0]
    in_camera = np.column_stack([(pixels - K[:2, 2]) / K[[0, 1], [0, 1]], np.ones(len(pixels))])
    return in_camera @ pose[:3, :3]


def true_places(truth: Truth, camera: Cameras, pixels: FloatArray) -> FloatArray:
    """Places (P,3) of the truth's frame that pixels show; infinite in the sky."""
    move = truth.truth_from_run
    origin = move.apply(camera.centers)
    ahead = move.apply(camera.centers + rays_of(camera, pixels)) - origin
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    rays = np.concatenate([np.repeat(origin, len(ahead), axis=0), ahead], axis=1).astype(np.float32)
    hit = truth.caster.cast_rays(cast(Any, o3d.core.Tensor)(rays))["t_hit"].numpy().astype(np.float64)
    return origin + np.where(hit < MAX_AWAY_M, hit, np.inf)[:, None] * ahead


def pixel_pairs(truth: Truth, camera: Cameras, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Pixels (2 count, 2), two after another of a pair, and their true places."""
    pixels = np.floor(rng.uniform(0.1, 0.9, (40 * count, 2)) * camera.sizes_wh[0]) + 0.5
    places = true_places(truth, camera, pixels)
    half = np.array(truth.config.extent_m) / 2
    known = np.isfinite(places).all(axis=1) & (np.abs(places[:, :2]) < half).all(axis=1)
    pixels, places = (values[known][: 2 * (known.sum() // 2)].reshape(-1, 2, values.shape[1]) for values in (pixels, places))
    apart = np.linalg.norm(places[:, 1] - places[:, 0], axis=1) >= MIN_APART_M
    return pixels[apart][:count].reshape(-1, 2), places[apart][:count].reshape(-1, 3)


def drawn_places(renderer: Any, camera: Cameras, pixels: FloatArray) -> FloatArray:
    """Places (P,3) of the run at the depths that a renderer draws; NaN where there is none."""
    width, height = camera.sizes_wh[0]
    picture = np.zeros((height, width, 4), np.float32)
    renderer.draw(camera, (0, 0, 0), picture)
    depths = picture[pixels[:, 1].astype(int), pixels[:, 0].astype(int), 3].astype(np.float64)
    return camera.centers + np.where(depths > 0, depths, np.nan)[:, None] * rays_of(camera, pixels)


class PickingWindow:
    """Open3D's window in which points are picked."""

    def __init__(self, splats: Splats) -> None:
        self._means = splats.means.astype(np.float64)
        self._cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(self._means))

    def places(self, camera: Cameras, pixels: FloatArray) -> FloatArray:
        """The middles (P,3) of the Gaussians that are picked; NaN where none is."""
        width, height = (int(side) for side in camera.sizes_wh[0])
        window: Any = o3d.visualization.VisualizerWithVertexSelection()
        window.create_window(width=width, height=height)
        window.add_geometry(self._cloud)
        view = o3d.camera.PinholeCameraParameters()
        focal = float(camera.Ks[0, 1, 1])
        view.intrinsic = o3d.camera.PinholeCameraIntrinsic(width, height, focal, focal, width / 2 - 0.5, height / 2 - 0.5)
        view.extrinsic = camera.cam_from_world[0]
        window.get_view_control().convert_from_pinhole_camera_parameters(view, allow_arbitrary=True)
        window.poll_events()
        window.update_renderer()
        found = np.array([self._picked(window, camera, pixel) for pixel in pixels])
        window.destroy_window()
        return found

    def _picked(self, window: Any, camera: Cameras, pixel: FloatArray) -> FloatArray:
        """Of what its window has within `REACH` pixels the nearest to the click."""
        near = np.asarray(window.pick_points(*(pixel - REACH - 0.5), 2 * REACH + 1, 2 * REACH + 1), int)
        if not len(near):
            return np.full(3, np.nan)
        seen = self._means[near] @ camera.cam_from_world[0, :3, :3].T + camera.cam_from_world[0, :3, 3]
        at = (seen @ camera.Ks[0].T)[:, :2] / seen[:, 2:]
        return self._means[near[np.argmin(np.linalg.norm(at - pixel, axis=1))]]


def told(name: str, errors: list[float], missing: int, seconds: float) -> str:
    """A line of the result."""
    size = np.abs(errors)
    figures = f"median {np.median(size):.2f} %, 95 % {np.quantile(size, 0.95):.2f} %"
    return f"{name}: |error| of {len(errors)} distances {figures}; {missing} without a place; {seconds:.2f} s a picture"


def compare_clicks(splats: Splats, truth: Truth, cameras: Cameras, pairs: int) -> None:
    """Print the errors of distances by each means."""
    ours, scene, window = ModelRenderer(splats), Open3DRenderer(splats), PickingWindow(splats)
    means: dict[str, Callable[[Cameras, FloatArray], FloatArray]] = {
        "our depth": lambda camera, pixels: drawn_places(ours, camera, pixels),
        "Gaussian that Open3D picks": window.places,
        "depth of Open3D's scene": lambda camera, pixels: drawn_places(scene, camera, pixels),
    }
    rng = np.random.default_rng(0)
    clicks = [(camera, *pixel_pairs(truth, camera, pairs, rng)) for camera in (cameras.select([one]) for one in range(len(cameras)))]
    for name, place in means.items():
        errors, missing, began = [], 0, time.monotonic()
        for camera, pixels, true in clicks:
            found = truth.truth_from_run.apply(place(camera, pixels))
            lengths, true_lengths = (np.linalg.norm(np.diff(ends.reshape(-1, 2, 3), axis=1)[:, 0], axis=1) for ends in (found, true))
            here = np.isfinite(lengths)
            missing += int((~here).sum())
            errors += (100 * (lengths[here] / true_lengths[here] - 1)).tolist()
        print(told(name, errors, missing, (time.monotonic() - began) / len(clicks)), flush=True)


def compare_lassos(splats: Splats, camera: Cameras) -> None:
    """Print what both choose by a hand's polygon that crosses itself, and by one that does not."""
    K, pose = camera.Ks[0], camera.cam_from_world[0]
    turn = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    round_px = camera.sizes_wh[0] / 2 + 0.2 * camera.sizes_wh[0, 0] * np.column_stack([np.cos(turn), np.sin(turn)])
    crossing_px = camera.sizes_wh[0] / 2 + 0.2 * camera.sizes_wh[0, 0] * np.column_stack([np.cos(turn), np.sin(2 * turn)])
    for name, path_px in (("round", round_px), ("an eight", crossing_px)):
        path = (path_px - K[:2, 2]) / K[[0, 1], [0, 1]]
        stroke = Stroke(cam_from_world=tuple(pose[:3].ravel().tolist()), path=tuple(map(tuple, path.tolist())))
        ours, ours_s = timed(lambda stroke=stroke: stroke.chosen(splats.means))
        theirs, theirs_s = timed(lambda path=path: chosen_by_open3d(splats, pose, path))
        same = int((ours & theirs).sum()), int((ours ^ theirs).sum())
        print(
            f"lasso, {name}: both choose {same[0]:,} of {len(splats):,}, one alone {same[1]}; ours {ours_s:.3f} s, Open3D {theirs_s:.3f} s"
        )


def chosen_by_open3d(splats: Splats, pose: FloatArray, path: FloatArray) -> Any:
    """Which middles (N,) its volume over a polygon (P,2) of the view has; it knows parallel rays
    alone, so the view's perspective is divided out before."""
    seen = splats.means.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
    ahead = np.flatnonzero(seen[:, 2] > 0)
    volume = o3d.visualization.SelectionPolygonVolume()
    volume.orthogonal_axis, volume.axis_min, volume.axis_max = "Z", 0.0, float(seen[:, 2].max())
    volume.bounding_polygon = o3d.utility.Vector3dVector(np.column_stack([path, np.zeros(len(path))]))
    flat = np.column_stack([seen[ahead, :2] / seen[ahead, 2:], seen[ahead, 2]])
    inside = volume.crop_in_polygon(o3d.geometry.PointCloud(o3d.utility.Vector3dVector(flat)))
    chosen = np.zeros(len(splats), bool)
    chosen[ahead[np.asarray(inside, int)]] = True
    return chosen


def timed(choose: Callable[[], Any]) -> tuple[Any, float]:
    """Its result and the least seconds of some turns."""
    result, seconds = None, []
    for _ in range(TURNS):
        began = time.monotonic()
        result = choose()
        seconds.append(time.monotonic() - began)
    return result, min(seconds)


def main() -> None:
    """Compare both on one run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--known", type=Path, default=Path(__file__).parent / "town" / "known")
    parser.add_argument("--pairs", type=int, default=20)
    chosen = parser.parse_args()
    run = load_run_view(chosen.run)
    splats = shown_of_run(run).splats
    cameras = run.scene.cameras.named(sorted(run.placed_psnr_db)).scaled(640)
    compare_lassos(splats, cameras.select([len(cameras) // 2]))
    compare_clicks(splats, load_truth(chosen.known, run.scene), cameras, chosen.pairs)
    sys.stdout.flush()
    # Open3D 0.20 ends by a signal where it tidies up.
    os._exit(0)


if __name__ == "__main__":
    main()
