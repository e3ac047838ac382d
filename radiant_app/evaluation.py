"""Scores a finished scene on held-out photographs, where they lie. Once per run: a render, its figures and pictures per photograph.

Two baselines stand beside every figure: the Gaussians before any training, and the photograph's own mean colour.
Seam masks come from the scene's own depth here; a comparison of methods has to fix them by one depth for all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_app.events import Event, StageProgress
from radiant_core.cameras import Cameras
from radiant_core.evaluate.image_error import NO_FLIP_REASON, NO_LPIPS_REASON, image_errors, mean_errors, psnr_db
from radiant_core.evaluate.seam_error import band_and_interior_psnr_db, seam_masks
from radiant_core.io.photos import load_photograph
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_cameras, load_plan, load_splats
from radiant_core.io.run_store import read_json, write_atomic, write_json
from radiant_core.render.rendered_view import RenderedView, render_views

PICTURE_KINDS = ("photographs", "renders", "differences")
"""Folders with one PNG per held-out photograph."""


def run_evaluate(folder: Path, stage: str, emit: Callable[[Event], None]) -> Sequence[str]:
    """Score scene.ply in `folder` on the photographs there; writes result.json and three pictures per photograph."""
    task = read_json(folder / "task.json")
    cameras = load_cameras(folder / "cameras.safetensors")
    scene, initial = load_ply(folder / "scene.ply"), load_splats(folder / "initial.safetensors")
    photographs = [load_photograph(folder / "photos" / name, size) for name, size in _names_and_sizes(cameras)]
    report = _reporter(stage, 2 * len(cameras), emit)
    rendered = [report(view) for view in render_views(scene, cameras, task["backend"])]
    untrained = [report(view) for view in render_views(initial, cameras, task["backend"])]
    pictures = [name for view, photo in zip(rendered, photographs, strict=True) for name in save_comparison(folder, view, photo)]
    result = {**held_out_figures(rendered, untrained, photographs), "num_gaussians": len(scene)}
    if task["seams"]:
        result |= _seam_figures(folder / "plan.json", cameras, rendered, photographs)
    write_json(folder / "result.json", result)
    return ["result.json", *pictures]


def held_out_figures(
    rendered: Sequence[RenderedView], untrained: Sequence[RenderedView], photographs: Sequence[NDArray[np.float32]]
) -> dict[str, Any]:
    """Mean and per-image figures of renders against photographs (H,W,3) in 0..1, with both baselines."""
    errors = [image_errors(view.name, view.image, photo) for view, photo in zip(rendered, photographs, strict=True)]
    mean = mean_errors(errors)
    per_image = [
        {
            "name": error.name,
            "psnr_db": error.psnr_db,
            "ssim": error.ssim,
            "flip": error.flip,
            "initial_psnr_db": psnr_db(before.image, photo),
            "mean_color_psnr_db": psnr_db(np.broadcast_to(photo.mean(axis=(0, 1)), photo.shape), photo),
        }
        for error, before, photo in zip(errors, untrained, photographs, strict=True)
    ]
    return {
        "psnr_db": mean.psnr_db,
        "ssim": mean.ssim,
        "flip": mean.flip,
        "flip_reason": NO_FLIP_REASON if mean.flip is None else None,
        "lpips": None,
        "lpips_reason": NO_LPIPS_REASON,
        "images": per_image,
    }


def save_comparison(folder: Path, view: RenderedView, photograph: NDArray[np.float32]) -> list[str]:
    """Write render, photograph and their absolute difference (×3) as PNG; returns the names relative to `folder`."""
    difference = np.clip(3 * np.abs(view.image - photograph), 0, 1)
    names = []
    for kind, image in (("renders", view.image), ("photographs", photograph), ("differences", difference)):
        name = f"{kind}/{view.name}.png"
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_atomic(folder / name, png_bytes((image * 255).round().astype(np.uint8)))
        names.append(name)
    return names


def png_bytes(image: NDArray[np.uint8]) -> bytes:
    """An RGB image (H,W,3) as PNG."""
    import cv2

    encoded, data = cv2.imencode(".png", image[..., ::-1])
    assert encoded
    return data.tobytes()


def region_width(plan_sites: NDArray[np.float64]) -> float:
    """Half the width of the band beside a border: a twentieth of the smallest distance between two edges."""
    gaps = np.linalg.norm(plan_sites[:, None] - plan_sites, axis=2)
    return float(gaps[gaps > 0].min()) / 20 if (gaps > 0).any() else 1.0


def _seam_figures(
    plan_path: Path, cameras: Cameras, rendered: Sequence[RenderedView], photographs: Sequence[NDArray[np.float32]]
) -> dict[str, Any]:
    plan, _ = load_plan(plan_path)
    half_band = region_width(plan.sites)
    masks = seam_masks(cameras, [view.depth for view in rendered], plan, half_band)
    error = band_and_interior_psnr_db([view.image for view in rendered], photographs, masks)
    return {
        "seam_psnr_db": error.seam_psnr_db,
        "interior_psnr_db": error.interior_psnr_db,
        "seam_reason": error.reason,
        "seam_half_band": half_band,
    }


def _names_and_sizes(cameras: Cameras) -> list[tuple[str, tuple[int, int]]]:
    return [(name, (int(w), int(h))) for name, (w, h) in zip(cameras.names, cameras.sizes_wh, strict=True)]


def _reporter(stage: str, total: int, emit: Callable[[Event], None]) -> Callable[[RenderedView], RenderedView]:
    done = 0

    def report(view: RenderedView) -> RenderedView:
        nonlocal done
        done += 1
        emit(StageProgress(stage=stage, done=done, total=total, note=view.name))
        return view

    return report
