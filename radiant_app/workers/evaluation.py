"""Scores a finished scene on held-out photographs. Once per run: a render, its figures and pictures
per photograph.

Two baselines stand beside every figure: the Gaussians before any training, and the photograph's own
mean colour. Seam masks come from the scene's own depth here; a comparison of methods has to fix
them by one depth for all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_app.workers.reporting import EventReporter
from radiant_app.workers.tasks import EvaluateTask
from radiant_app.workers.training import MASKS
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import (
    FIGURES,
    NO_FLIP_REASON,
    NO_LPIPS_REASON,
    ImageErrors,
    image_errors,
    inner_pixels,
    mean_errors,
    median_errors,
    psnr_db,
)
from radiant_core.evaluate.image_pair import Used
from radiant_core.evaluate.lpips import Lpips, LpipsNetwork, load_lpips
from radiant_core.evaluate.seam_error import band_and_interior_psnr_db, seam_masks
from radiant_core.io.photos.listing import load_photograph
from radiant_core.io.photos.masks import pixel_weights, used_pixels
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_cameras, load_plan, load_splats
from radiant_core.io.run_store import write_atomic, write_json
from radiant_core.render.rendered_view import RenderedView, render_views

LPIPS_NAME = "lpips.safetensors"
"""Weights of LPIPS in the folder where a scene is scored."""
PICTURE_KINDS = ("photographs", "renders", "differences")
"""Folders with one PNG per held-out photograph."""


def run_evaluate(folder: Path, task: EvaluateTask, reporter: EventReporter) -> Sequence[str]:
    """Score scene.ply in `folder` on the photographs there; writes result.json and three pictures per photograph."""
    cameras = load_cameras(folder / "cameras.safetensors")
    scene, initial = load_ply(folder / "scene.ply"), load_splats(folder / "initial.safetensors")
    lpips = load_dealt_lpips(folder, task.lpips)
    cameras, used = select_scored(cameras, folder / MASKS, reporter.warn)
    photographs = [load_photograph(folder / "photos" / name, size) for name, size in _names_and_sizes(cameras)]
    report = _report_views(3 * len(cameras), reporter)
    rendered = [report(view) for view in render_views(scene, cameras, task.backend)]
    untrained = [report(view) for view in render_views(initial, cameras, task.backend)]
    rows, pictures = [], []
    for view, before, photo, pixels in zip(rendered, untrained, photographs, used, strict=True):
        rows.append(score_render(view, photo, before=before, lpips=lpips, used=pixels))
        pictures += save_comparison(folder, view, photo, pixels)
        report(view)
    result = {**summarize_scores(rows, lpips_network=lpips.network if lpips else None), "num_gaussians": len(scene)}
    if task.seams:
        result |= _seam_figures(folder / "plan.json", cameras, rendered, photographs, used)
    write_json(folder / "result.json", result)
    return ["result.json", *pictures]


def load_dealt_lpips(folder: Path, network: LpipsNetwork | None) -> Lpips | None:
    """Load the LPIPS network that a task names from `folder`; None if it names none."""
    return load_lpips(folder / LPIPS_NAME, network) if network else None


def score_render(
    view: RenderedView,
    photograph: NDArray[np.float32],
    *,
    before: RenderedView | None = None,
    lpips: Lpips | None = None,
    used: Used = None,
) -> dict[str, Any]:
    """Score one render against its photograph (H,W,3) in 0..1, with the PSNR of both baselines: the
    photograph's mean colour and, if given, the render `before` training. With a mask only pixels in
    `used` (H,W) are scored, the share `used_share`."""
    errors = image_errors(view.name, view.image, photograph, lpips, used)
    untrained = {} if before is None else {"initial_psnr_db": psnr_db(before.image, photograph, used)}
    mean_color = np.broadcast_to(photograph.mean(axis=(0, 1), where=True if used is None else used[..., None]), photograph.shape)
    share = {} if used is None else {"used_share": float(used.mean())}
    return {"name": view.name, **errors.figures(), **untrained, "mean_color_psnr_db": psnr_db(mean_color, photograph, used), **share}


def select_scored(cameras: Cameras, masks: Path | None, warn: Callable[[str], None]) -> tuple[Cameras, list[Used]]:
    """Select the cameras whose photographs can be scored, with the used pixels (H,W) of each; None:
    all.

    Raises:
        BadInput: the masks leave no pixel of any photograph.
    """
    weights = pixel_weights(masks, cameras)
    if weights is None:
        return cameras, [None] * len(cameras)
    used = [used_pixels(each) for each in weights]
    left = np.array([inner_pixels(each).any() for each in used])
    if not left.any():
        raise BadInput("the masks leave nothing of any held-out photograph to score: 0 is ignored, 255 is used.")
    for name in np.array(cameras.names)[~left]:
        warn(f"the mask of the held-out photograph {name} leaves nothing to score: it is left out")
    return cameras.select(np.flatnonzero(left)), [each for each, scored in zip(used, left, strict=True) if scored]


def summarize_scores(rows: Sequence[Mapping[str, Any]], *, lpips_network: str | None) -> dict[str, Any]:
    """Summarize rows of `score_render` for metrics.json: means, medians, the reason for a missing figure, the rows."""
    errors = [ImageErrors(name=row["name"], **{figure: row[figure] for figure in FIGURES}) for row in rows]
    mean, median = mean_errors(errors), median_errors(errors)
    return {
        **mean.figures(),
        "median": median.figures(),
        "flip_reason": NO_FLIP_REASON if mean.flip is None else None,
        "lpips_reason": NO_LPIPS_REASON if mean.lpips is None else None,
        "lpips_network": lpips_network,
        "images": list(rows),
    }


def save_comparison(folder: Path, view: RenderedView, photograph: NDArray[np.float32], used: Used = None) -> list[str]:
    """Write render, photograph and their absolute difference (×3, where `used`) as PNG; returns the names relative to `folder`."""
    difference = np.clip(3 * np.abs(view.image - photograph), 0, 1) * (1.0 if used is None else used[..., None])
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
    """Half the width of the band beside a border: 1/20 of the smallest distance between two edges."""
    gaps = np.linalg.norm(plan_sites[:, None] - plan_sites, axis=2)
    return float(gaps[gaps > 0].min()) / 20 if (gaps > 0).any() else 1.0


def _seam_figures(
    plan_path: Path,
    cameras: Cameras,
    rendered: Sequence[RenderedView],
    photographs: Sequence[NDArray[np.float32]],
    used: Sequence[Used],
) -> dict[str, Any]:
    plan, _ = load_plan(plan_path)
    half_band = region_width(plan.sites)
    masks = seam_masks(cameras, [view.depth for view in rendered], plan, half_band).within(used)
    error = band_and_interior_psnr_db([view.image for view in rendered], photographs, masks)
    return {
        "seam_psnr_db": error.seam_psnr_db,
        "interior_psnr_db": error.interior_psnr_db,
        "seam_reason": error.reason,
        "seam_half_band": half_band,
    }


def _names_and_sizes(cameras: Cameras) -> list[tuple[str, tuple[int, int]]]:
    return [(name, (int(w), int(h))) for name, (w, h) in zip(cameras.names, cameras.sizes_wh, strict=True)]


def _report_views(total: int, reporter: EventReporter) -> Callable[[RenderedView], RenderedView]:
    """Return a function that reports progress for each view and returns it."""
    seen = count(1)

    def report(view: RenderedView) -> RenderedView:
        reporter.progress(next(seen), total, view.name)
        return view

    return report
