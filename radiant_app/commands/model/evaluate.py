"""`radiant evaluate MODEL [SCENE]`: any model on the photographs that a scene holds out.

MODEL: the folder of a run, or a model file of any kind that `io.model_reader` reads. SCENE, else
MODEL if it is a run:
    a run          its held-out cameras and photographs at the size it was scored at
    an sfm folder  (`radiant sfm`, or a run that was not scored) every 8th photograph by name
    a COLMAP project, undistorted: every 8th by name, in the project's own frame
One photograph is in memory at a time.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from radiant_app.commands.model.given_model import given_model
from radiant_app.commands.run.steps import require_file_to_be, require_run, stage_bar
from radiant_app.files.out_folder import folder_made_for
from radiant_app.report.progress import ProgressDisplay
from radiant_app.workers.evaluation import HeldOutViews, score_images, select_scored
from radiant_app.workers.score_files import summarize_scores
from radiant_app.workers.sources import captures_of, is_held_out, load_scored_scene, locate_source, masks_folder_of, notes_on_source
from radiant_app.workers.tasks import HELD_OUT_NAME, INITIAL_NAME, OWN_NAME, TRAINED_NAME
from radiant_app.workers.training import MASKS
from radiant_core.cameras import Cameras
from radiant_core.choices import LpipsNetwork
from radiant_core.errors import BadInput
from radiant_core.evaluate.lpips import Lpips, load_lpips
from radiant_core.evaluate.split import held_out_mask
from radiant_core.io.photos.listing import list_photographs
from radiant_core.io.records import load_cameras, load_splats
from radiant_core.io.run_store import read_json, write_json
from radiant_core.light.canonical import LightOfScore, light_of_score
from radiant_core.light.captures import Captures, load_captures, read_captures
from radiant_core.light.solve import COMPARED_PX
from radiant_core.splats import Splats
from radiant_core.train.photographs import load_training_views

DEFAULT_LONG_SIDE_PX = 1_600
"""Where no run says a size: larger photographs are reduced to it, as 3DGS and its successors do."""


@dataclass(frozen=True, kw_only=True)
class EvaluateRequest:
    """What to score and where; `radiant evaluate --help` says what each may be."""

    model: Path
    scene: Path | None = None
    long_side_px: int | None = None
    lpips_weights: Path | None = None
    lpips_network: LpipsNetwork = "vgg"
    out: Path | None = None
    """JSON file for the figures; must not exist."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _HeldOut:
    """Held-out cameras, the folder of their photographs, and a run's untrained Gaussians."""

    cameras: Cameras
    photographs: Path
    masks: Path | None = None
    untrained: Splats | None = None
    trained: Cameras | None = None
    """Those of the training photographs, which tell in which light the others were taken; None:
    that is not asked."""
    trained_photographs: Path | None = None
    """Their folder; None: that of the held-out ones."""
    captures: Captures = field(default_factory=dict)
    copies: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    """What of a COLMAP project is not used."""
    """Warnings about photographs that repeat others and are neither held out nor trained on."""


def evaluate(request: EvaluateRequest, display: ProgressDisplay) -> dict[str, Any]:
    """The figures as in metrics.json, with size and number of images; BadInput for bad requests."""
    if request.out is not None:
        require_file_to_be(request.out)
    lpips = None if request.lpips_weights is None else load_lpips(request.lpips_weights, request.lpips_network)
    if request.model.is_dir():
        require_run(request.model, "scene.ply")
    splats = given_model(request.model, display, as_trained=True).splats
    held_out = _held_out_of(request)
    _require_sizes(held_out.cameras, lpips)
    cameras, used = select_scored(held_out.cameras, held_out.masks, warn=lambda message: None)
    photographs = [held_out.photographs / name for name in cameras.names]
    light = _light_of(splats, cameras, held_out)
    views = HeldOutViews(cameras=cameras, photographs=photographs, used=used, initial=held_out.untrained, light=light)
    started_s = time.monotonic()
    rows = []
    with stage_bar(display, "evaluate") as report:
        for image in score_images(splats, cameras, views, lpips=lpips):
            rows.append(image.row)
            report(len(rows), len(cameras), image.view.name)
    result = {
        **summarize_scores(rows, lpips_network=lpips.network if lpips else None),
        "num_gaussians": len(splats),
        "num_images": len(cameras),
        "long_side_px": int(cameras.sizes_wh.max()),
        "seconds": round(time.monotonic() - started_s, 2),
    }
    if light is not None:
        result["light"] = light.decision("evaluation").choice
    if held_out.notes:
        result["source"] = " ".join(held_out.notes)
    if held_out.copies:
        result["copies"] = " ".join((*held_out.copies, "A model that another program trained on them has seen what is scored."))
    if result["psnr_db"] < np.mean([row["mean_color_psnr_db"] for row in rows]):
        result["warning"] = "worse than one flat colour per photograph: is the model in the frame of this scene?"
    if request.out is not None:
        with folder_made_for(request.out):
            write_json(request.out, result)
    return result


def _light_of(model: Splats, cameras: Cameras, held_out: _HeldOut) -> LightOfScore | None:
    """The light of held-out photographs beside the model's, where it differs and the training
    photographs are here."""
    images = held_out.trained_photographs or held_out.photographs
    if held_out.trained is None or not all((images / name).is_file() for name in held_out.trained.names):
        return None
    trained = load_training_views(images, held_out.trained.scaled(COMPARED_PX), held_out.masks)
    return light_of_score(model, trained, cameras, held_out.captures, "auto")


def load_scored_cameras(run: Path) -> Cameras | None:
    """A run's held-out cameras at the size it was scored at; None where it scored none."""
    # Runs made before devices and owners had one scorer have them under the second name.
    names = [name for name in (HELD_OUT_NAME, "cameras.safetensors") if (run / "evaluation" / name).is_file()]
    return load_cameras(run / "evaluation" / names[0]) if names else None


def _held_out_of(request: EvaluateRequest) -> _HeldOut:
    folder = request.scene or request.model
    if not folder.is_dir():
        raise BadInput(
            f"{folder} holds no photographs to score on: name a run, a folder of 'radiant sfm' or a COLMAP project after the model."
        )
    scored = folder / "evaluation"
    cameras = load_scored_cameras(folder)
    if cameras is not None:
        cameras = cameras if request.long_side_px is None else cameras.scaled(request.long_side_px)
        trained = load_cameras(scored / TRAINED_NAME) if (scored / TRAINED_NAME).is_file() else None
        record = read_json(scored / OWN_NAME) if (scored / OWN_NAME).is_file() else {}
        return _HeldOut(
            cameras=cameras,
            photographs=scored / "photos",
            masks=scored / MASKS,
            untrained=load_splats(scored / INITIAL_NAME),
            trained=trained,
            trained_photographs=Path(record.get("training_images", scored / "photos")),
            captures=load_captures(scored),
        )
    if (folder / "delivered").is_dir():
        raise BadInput(f"the photographs of {folder} stayed on its devices, which scored it: its metrics.json has the figures.")
    kind, images, model = locate_source(folder)
    notes: tuple[str, ...] = ()
    if kind == "colmap" and model is not None:
        everything, copies, notes = _colmap_cameras(model, folder, images)
    else:
        scene, copies, images = load_scored_scene(folder)
        everything = scene.cameras
    masks = None if kind == "colmap" else masks_folder_of(folder)
    held_out = held_out_mask(everything.names) if kind == "colmap" else is_held_out(folder, everything.names)
    cameras = everything.select(held_out)
    if kind == "colmap":
        _require_shapes(cameras, everything, images)
    cameras = cameras.scaled(request.long_side_px or DEFAULT_LONG_SIDE_PX)
    trained = everything.select(~held_out)
    captures = read_captures(images, everything.names) if kind == "colmap" else captures_of(folder)
    return _HeldOut(cameras=cameras, photographs=images, masks=masks, trained=trained, captures=captures, copies=copies, notes=notes)


def _colmap_cameras(model_folder: Path, project: Path, images: Path) -> tuple[Cameras, tuple[str, ...], tuple[str, ...]]:
    """A project's cameras without copies, split as by `radiant train`; warnings about copies, and
    about what of the project is not used."""
    from radiant_core.io.colmap.image_files import read_with_files
    from radiant_core.sfm.copies import cameras_without_repeats
    from radiant_core.sfm.known_poses import without_copies
    from radiant_core.sfm.world_frame.world import cameras_of

    model, files = read_with_files(model_folder, images, required=False)
    if not all(model.cameras[image.camera_id].is_pinhole for image in model.images):
        raise BadInput(
            f"the photographs of {project} are distorted: run 'radiant sfm' or COLMAP's undistorter, and train and score on that."
        )
    cameras, copied = without_copies(cameras_of(model), images)
    cameras, repeated = cameras_without_repeats(cameras, model.points.xyz, images)
    return cameras, (*copied, *repeated), (*notes_on_source(project), *files.notes())


def _require_shapes(cameras: Cameras, everything: Cameras, images: Path) -> None:
    """Photographs of another shape than their cameras would be squeezed, and score too low."""
    from radiant_core.sfm.known_poses import is_almost, misfit_text

    names = cameras.names if len(cameras) > 1 else everything.names[:2]
    listing = list_photographs(images, names=names)
    if listing.stretches:
        raise BadInput(f"in {images} {listing.stretches[0].unstretched}, which cannot be compared with renders: save them in 8 bits.")
    size_of = {photo.name: photo.size_wh for photo in listing.photographs}
    for name, size_wh in zip(cameras.names, cameras.sizes_wh.tolist(), strict=True):
        if name not in size_of:
            raise BadInput(f"the held-out photograph {name!r} is missing or damaged in {images}: put the images of the model there.")
        camera_wh = (size_wh[0], size_wh[1])
        ratios = [side / of_camera for side, of_camera in zip(size_of[name], camera_wh, strict=True)]
        if abs(ratios[0] - ratios[1]) > 0.01 * max(ratios) or is_almost(size_of[name], camera_wh):
            raise BadInput(misfit_text(f"photograph {name!r}", size_of[name], camera_wh))


def _require_sizes(cameras: Cameras, lpips: Lpips | None) -> None:
    from radiant_core.evaluate.image_error import SSIM_WINDOW_PX

    if not len(cameras):
        raise BadInput("this scene holds no photograph out: it has none, and nothing can be scored.")
    least_px, figure = max((SSIM_WINDOW_PX, "SSIM"), (lpips.min_side_px, "LPIPS") if lpips else (0, ""))
    shortest = int(cameras.sizes_wh.min())
    if shortest < least_px:
        raise BadInput(f"a photograph is {shortest} px on its short side, {figure} needs {least_px}: raise --long-side-px.")
