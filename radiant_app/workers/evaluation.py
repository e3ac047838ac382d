"""Scores models on held-out photographs: a render, its figures and pictures per photograph.

`score_images` is the one scorer: of a run (once per machine that has held-out photographs), of
`radiant train` and of `radiant evaluate`.

Two baselines stand beside every figure: the Gaussians before any training, and the photograph's own
mean colour.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_app.reporting import EventReporter
from radiant_app.workers.delivering import belongs_to_run, deliver
from radiant_app.workers.score_files import LPIPS_NAME, SCENE_NAME, SCORES_NAME, version_file
from radiant_app.workers.scores import scored_name
from radiant_app.workers.tasks import HELD_OUT_NAME, INITIAL_NAME, OWN_NAME, TRAINED_NAME, ScoreTask
from radiant_app.workers.training import MASKS
from radiant_core.cameras import Cameras
from radiant_core.choices import Version
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import (
    image_errors,
    inner_pixels,
    psnr_db,
    ssim,
)
from radiant_core.evaluate.image_pair import Used
from radiant_core.evaluate.lpips import Lpips, load_lpips
from radiant_core.evaluate.seam_excess import BorderError, border_errors
from radiant_core.evaluate.support import support_of
from radiant_core.geometry.similarity import move_cameras
from radiant_core.geometry.support import SUPPORT_NAME, Support, save_support
from radiant_core.hierarchy.codec import MODEL_NAME
from radiant_core.io.photos.listing import load_photograph
from radiant_core.io.photos.masks import pixel_weights, used_pixels
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_cameras, load_plan, load_scene, load_splats
from radiant_core.io.run_store import read_json, write_atomic, write_json
from radiant_core.light.canonical import LightOfScore, light_of_score, show_in_light
from radiant_core.light.captures import load_captures
from radiant_core.light.held_out import held_out_psnr_db
from radiant_core.light.lights import Lights
from radiant_core.light.solve import COMPARED_PX
from radiant_core.plan.plans import CloudPlan
from radiant_core.render.contract import Backend
from radiant_core.render.rendered_view import RenderedView, render_views
from radiant_core.splats import Splats
from radiant_core.train.photographs import load_images, load_training_views
from radiant_core.train.views import TrainingViews

NUM_LOADED = 16
"""Photographs in memory at a time while versions of a scene are compared."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HeldOutViews:
    """Held-out photographs, with their cameras at the size at which they are scored."""

    cameras: Cameras
    """In the frame of their machine."""
    photographs: Sequence[Path]
    used: Sequence[Used]
    """What masks leave of each."""
    initial: Splats | None = None
    """The Gaussians before training, in the same frame; None: unknown."""
    light: LightOfScore | None = None
    """In which light the photographs were taken beside the model's; None: in the same."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ScoredImage:
    """A render beside its photograph."""

    row: dict[str, Any]
    """The name and the figures."""
    view: RenderedView
    photograph: NDArray[np.float32]
    """(H,W,3) in 0..1."""
    used: Used
    canonical: NDArray[np.float32] | None = None
    """The render in the model's own light, where `view` has the photograph's; None: the same."""

    @property
    def version_psnr_db(self) -> float:
        """The figure that `held_out_psnr_db` has of this version of the scene: there the photograph
        is divided in float64."""
        return psnr_db(self.view.image, np.rint(self.photograph * 255).astype(np.float64) / 255, self.used)

    def save(self, folder: Path) -> list[str]:
        """Write render, photograph and their absolute difference (×3, where `used`) as PNG, and the
        canonical render where there is one; returns the names relative to `folder`."""
        render, name = self.view.image, self.view.name
        difference = np.clip(3 * np.abs(render - self.photograph), 0, 1) * (1.0 if self.used is None else self.used[..., None])
        names = []
        images = {"renders": render, "photographs": self.photograph, "differences": difference}
        if self.canonical is not None:
            images["canonical"] = self.canonical.clip(0, 1)
        for kind, image in images.items():
            names.append(f"{kind}/{name}.png")
            (folder / names[-1]).parent.mkdir(parents=True, exist_ok=True)
            write_atomic(folder / names[-1], png_bytes((image * 255).round().astype(np.uint8)))
        return names


def run_score(folder: Path, task: ScoreTask, reporter: EventReporter) -> Sequence[str]:
    """Score the scene in inbox/ on the held-out photographs of this machine; writes scores.json and
    three pictures per photograph, and the owner of all of them support.safetensors."""
    machine_folder, inbox = folder.parent if task.owned else folder, folder / "inbox"
    places = read_json(machine_folder / OWN_NAME, ("images",))
    images = Path(places["images"])
    cameras, used = select_scored(
        load_cameras(machine_folder / HELD_OUT_NAME).scaled(task.long_side_px), machine_folder / MASKS, reporter.warn
    )
    photographs = [images / name for name in cameras.names]
    leakage = _measure_leakage(machine_folder, images, task, reporter) if task.owned else None
    scene, (plan, _) = load_ply(inbox / SCENE_NAME), load_plan(inbox / "plan.json")
    training_images = Path(places.get("training_images", images))
    # By the photographs' own names, which EXIF is known by.
    small = None if task.light == "none" else _trained_views(machine_folder, training_images, task)
    light = _light_of_score(scene, cameras, small, machine_folder, task)
    if light is not None:
        reporter.decide(light.decision(reporter.stage))
    named = cameras
    if task.owned:
        cameras = replace(cameras, names=tuple(scored_name(machine_folder.name, index) for index in range(len(cameras))))
    views = HeldOutViews(
        cameras=cameras, photographs=photographs, used=used, initial=load_splats(machine_folder / INITIAL_NAME), light=light
    )
    lpips = load_lpips(inbox / LPIPS_NAME, task.lpips) if task.lpips else None
    rows, pictures, scored_db = score_views(scene, views, task, lpips, folder, reporter)
    trained = TrainedPhotographs(folder=machine_folder, images=training_images, light=light)
    errors = measure_borders(scene, plan, trained, task, reporter)
    if not task.owned:
        save_support(folder / SUPPORT_NAME, _support(scene, machine_folder, task, reporter))
    # The first one is the scene that was scored.
    compared = dict.fromkeys(task.versions[:1], scored_db)
    for number, name in enumerate(task.versions[1:], 2):
        compared[name] = _compare(name, inbox, named, (machine_folder, images, small), task)
        reporter.progress(number, len(task.versions), "versions of the scene")
    borders = [asdict(error) for error in errors]
    write_json(folder / SCORES_NAME, {"images": rows, "borders": borders, "leakage": leakage, "versions": compared})
    if not task.owned:
        return [SCORES_NAME, SUPPORT_NAME, *pictures]
    # Checking a seal reads every file it lists, and the owner's process checks those of devices.
    signed = deliver(folder, {SCORES_NAME: folder / SCORES_NAME}, "scores", machine_folder) if belongs_to_run(folder) else []
    return [SCORES_NAME, *signed]


def _compare(
    name: Version,
    inbox: Path,
    cameras: Cameras,
    photographs: tuple[Path, Path, TrainingViews | None],
    task: ScoreTask,
) -> list[float]:
    """PSNR of another version of the scene in the photographs of held-out `cameras`, in the light
    that is predicted of them beside that version."""
    machine_folder, images, small = photographs
    scene = load_ply(inbox / version_file(name))
    light = _light_of_score(scene, cameras, small, machine_folder, task)
    figures = []
    for start in range(0, len(cameras), NUM_LOADED):
        rows = np.arange(start, min(start + NUM_LOADED, len(cameras)))
        views = load_training_views(images, cameras.select(rows), machine_folder / MASKS)
        views = replace(views, cameras=_correct_cameras(views.cameras, task))
        figures += held_out_psnr_db(scene, views, task.backend, None if light is None else light.held_out.select(rows))
    return figures


def score_views(
    scene: Splats, views: HeldOutViews, task: ScoreTask, lpips: Lpips | None, folder: Path, reporter: EventReporter
) -> tuple[list[dict[str, Any]], list[str], list[float]]:
    """Score a scene on one machine's views and write the pictures of each into `folder` before the
    next is made, so that one is in memory at a time; returns the rows, the pictures' names, and
    what other versions of the scene are compared with."""
    cameras = _correct_cameras(views.cameras, task)
    rows: list[dict[str, Any]] = []
    pictures: list[str] = []
    version_db: list[float] = []
    for image in score_images(scene, cameras, views, task.backend, lpips):
        rows.append(image.row)
        pictures += image.save(folder)
        if task.versions:
            version_db.append(image.version_psnr_db)
        reporter.progress(len(rows), len(cameras), image.view.name)
    return rows, pictures, version_db


def score_images(
    model: Splats, cameras: Cameras, views: HeldOutViews, backend: Backend = "auto", lpips: Lpips | None = None
) -> Iterator[ScoredImage]:
    """Score a model on held-out photographs, one of them in memory at a time.

    Args:
        model: the Gaussians to render.
        cameras: those of the views, in the frame of the model.
        views: the photographs, and the Gaussians to compare the model with.
        backend: the renderer.
        lpips: the network of LPIPS; None: without.

    Yields:
        Each render with its figures, in the order of the views.
    """
    lights = None if views.light is None else views.light.held_out
    rendered = render_views(model, cameras, backend)
    untrained = repeat(None, len(cameras)) if views.initial is None else render_views(views.initial, views.cameras, backend)
    for index, (render, before, path, used) in enumerate(zip(rendered, untrained, views.photographs, views.used, strict=True)):
        view = render if lights is None else replace(render, image=show_in_light(render.image, lights, index, cameras))
        height, width = view.image.shape[:2]
        photograph = load_photograph(path, (width, height))
        row = _score_render(view, photograph, before=before, lpips=lpips, used=used)
        yield ScoredImage(row=row, view=view, photograph=photograph, used=used, canonical=None if lights is None else render.image)


def _shown_in(lights: Lights, rendered: Iterator[RenderedView], cameras: Cameras) -> Iterator[RenderedView]:
    """Renders of `cameras` as photographs of these lights."""
    for index, view in enumerate(rendered):
        yield replace(view, image=show_in_light(view.image, lights, index, cameras))


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainedPhotographs:
    """The photographs in `images` that a machine, whose files are in `folder`, trained on."""

    folder: Path
    images: Path
    light: LightOfScore | None = None
    """As of `HeldOutViews`."""


def measure_borders(
    scene: Splats, plan: CloudPlan, trained: TrainedPhotographs, task: ScoreTask, reporter: EventReporter
) -> list[BorderError]:
    """Measure a scene at the plan's borders on photographs trained on, in the light of each."""
    folder, images, light = trained.folder, trained.images, trained.light
    if len(plan.sites) < 2:
        return []
    cameras = _trained_cameras(folder, task).scaled(task.long_side_px)
    weights = pixel_weights(folder / MASKS, cameras)

    def render() -> Iterator[RenderedView]:
        rendered = render_views(scene, _correct_cameras(cameras, task), task.backend)
        for num_done, view in enumerate(rendered if light is None else _shown_in(light.trained, rendered, cameras), 1):
            reporter.progress(num_done, len(cameras), "training photographs at the borders")
            yield view

    photographs = (
        load_photograph(images / name, (int(width), int(height)))
        for name, (width, height) in zip(cameras.names, cameras.sizes_wh, strict=True)
    )
    used = None if weights is None else [used_pixels(weight) for weight in weights]
    return list(border_errors(_correct_cameras(cameras, task), render(), photographs, plan, used))


def _support(scene: Splats, folder: Path, task: ScoreTask, reporter: EventReporter) -> Support:
    """Which photographs that were trained on constrain each Gaussian, where one owner has them
    all: a device sees a part of the scene only."""
    cameras = _correct_cameras(_trained_cameras(folder, task), task).scaled(task.long_side_px)

    def report(num_done: int, total: int) -> None:
        reporter.progress(num_done, total, "which photographs constrain each Gaussian")

    return support_of(scene, cameras, task.backend, report)


def _trained_cameras(folder: Path, task: ScoreTask) -> Cameras:
    return load_scene(folder / "scene.safetensors").cameras if task.owned else load_cameras(folder / TRAINED_NAME)


def _trained_views(folder: Path, images: Path, task: ScoreTask) -> TrainingViews:
    """The photographs that this machine trained on, as small as light is compared in."""
    trained = load_training_views(images, _trained_cameras(folder, task).scaled(COMPARED_PX), folder / MASKS)
    return replace(trained, cameras=_correct_cameras(trained.cameras, task))


def _light_of_score(scene: Splats, held_out: Cameras, trained: TrainingViews | None, folder: Path, task: ScoreTask) -> LightOfScore | None:
    """The light of this machine's photographs beside the scene's, by those it trained on."""
    if trained is None:
        return None
    return light_of_score(scene, trained, _correct_cameras(held_out, task), load_captures(folder), task.light, task.backend)


def _correct_cameras(cameras: Cameras, task: ScoreTask) -> Cameras:
    """Cameras of this machine in the frame of the scene."""
    for move in task.corrections:
        cameras = move_cameras(cameras, move.sim3)
    return cameras


def _measure_leakage(folder: Path, images: Path, task: ScoreTask, reporter: EventReporter) -> dict[str, float]:
    """PSNR and SSIM against its photographs of a device's model at its training poses, which its
    edge can render."""
    cameras = load_scene(folder / "scene.safetensors").cameras.scaled(task.long_side_px)
    figures = []
    for number, view in enumerate(render_views(load_splats(folder / MODEL_NAME), cameras, task.backend), 1):
        photograph = load_images(images, cameras.select([number - 1]))[0] / 255.0
        figures.append((psnr_db(view.image, photograph), ssim(view.image, photograph)))
        reporter.progress(number, len(cameras), "synthetic views against photographs")
    mean = np.mean(figures, axis=0)
    return {"psnr_db": float(mean[0]), "ssim": float(mean[1]), "num_images": len(figures)}


def _score_render(
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
    used = [used_pixels(weight) for weight in weights]
    has_pixels = np.array([inner_pixels(weight).any() for weight in used])
    if not has_pixels.any():
        raise BadInput("the masks leave nothing of any held-out photograph to score: 0 is ignored, 255 is used.")
    for name in np.array(cameras.names)[~has_pixels]:
        warn(f"the mask of the held-out photograph {name} leaves nothing to score: it is left out")
    return cameras.select(np.flatnonzero(has_pixels)), [weight for weight, scored in zip(used, has_pixels, strict=True) if scored]


def png_bytes(image: NDArray[np.uint8]) -> bytes:
    """An RGB image (H,W,3) as PNG."""
    import cv2

    encoded, data = cv2.imencode(".png", image[..., ::-1])
    assert encoded
    return data.tobytes()
