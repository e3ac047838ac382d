"""Models: train, join, score, load, save and export them."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rich.console import Console

from radiant.scenes import Scene
from radiant_app.commands.export.export import export as export_by_request
from radiant_app.commands.export.request import ExportRequest
from radiant_app.events import Listener, StageDone, StageProgress, StageStarted, Warned
from radiant_app.report.progress import ProgressDisplay
from radiant_app.reporting import EventReporter
from radiant_app.workers.evaluation import HeldOutViews, score_images, select_scored
from radiant_core.aggregate.config import Join
from radiant_core.aggregate.join import join_models
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.cameras import Cameras
from radiant_core.choices import ExportFormat, LightMode
from radiant_core.errors import BadInput
from radiant_core.export.scene import save_spz
from radiant_core.export.sog import save_sog
from radiant_core.hierarchy.device import fit_prepared, prepare_training
from radiant_core.hierarchy.messages import DeviceTask
from radiant_core.io.model_reader import read_model
from radiant_core.io.ply import save_ply
from radiant_core.light.canonical import light_of_score
from radiant_core.light.solve import COMPARED_PX
from radiant_core.render.backends import resolve_backend
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.needs import Overrides, fit_to_backend
from radiant_core.train.parts import Part
from radiant_core.train.results import TrainProgress, TrainResult
from radiant_core.train.trainer import FitOptions
from radiant_core.train.view_loss import ImageLoss

_WRITERS = {".ply": save_ply, ".spz": save_spz, ".sog": save_sog}


def _silent(event: object) -> None:
    del event


def load_splats(path: str | Path) -> Splats:
    """Load a model from a file of any kind that is read, told by its content.

    Use it for models of this and of other programs, to render, clean, join or convert them.

    Args:
        path: a .ply (3DGS's or compressed), .spz, .splat, .sog, lod-meta.json or model.safetensors.

    Returns:
        The Gaussians as they are stored, before activation.

    Raises:
        BadInput: the file is missing, broken or of another kind.

    Gaussians that cannot be drawn are left out with a `UserWarning` that counts them.

    Example:
        >>> splats = radiant.load_splats("model.ply")
        >>> splats.means.shape[1], splats.quats.shape[1]
        (3, 4)
        >>> len(splats.opacities) == len(splats)
        True
    """
    model = read_model(Path(path))
    for note in model.notes:
        warnings.warn(note, stacklevel=2)
    return model.splats


def save_splats(splats: Splats, path: str | Path) -> None:
    """Write a model: .ply keeps every bit; .spz and .sog round, some 16 and 20 bytes a Gaussian.

    Use it for a model in memory; `export` writes a run or a file in all formats.

    Args:
        splats: the model.
        path: the file, which is replaced where there is one.

    Raises:
        BadInput: another ending.

    Example:
        >>> splats = radiant.load_splats("model.ply")
        >>> opaque = splats.select(splats.opacities > 0.1)
        >>> radiant.save_splats(opaque, "opaque.spz")
    """
    path = Path(path)
    if path.suffix.lower() not in _WRITERS:
        raise BadInput(f"{path.name} ends in none of {', '.join(_WRITERS)}: choose one, or use export for other formats.")
    _WRITERS[path.suffix.lower()](path, splats)


def train(  # noqa: PLR0913
    scene: Scene,
    config: TrainConfig | str = "default",
    listen: Listener = _silent,
    *,
    num_steps: int | None = None,
    long_side_px: int | None = None,
    seed: int = 0,
    rows: ArrayLike | None = None,
    loss: ImageLoss | None = None,
    parts: Sequence[Part] = (),
    **settings: Any,
) -> TrainResult:
    """Fit one model to the training photographs of a scene, as `radiant train`.

    Use it for a scene that one machine holds; `run` divides one among several.

    Args:
        scene: its held-out photographs, every eighth by name, are not looked at.
        config: a preset ("draft", "default", "standard", "paper"), reduced to what this machine
            finishes in minutes where it has no GPU; or a `TrainConfig`, which is taken as it is.
        listen: hears progress, decisions and warnings.
        num_steps: of one photograph each; None: the preset's, 1,500 of default on a CPU.
        long_side_px: photographs are reduced to it; None: the preset's, 576 px on a CPU.
        seed: of the order of photographs and every random choice; by default 0.
        rows: (K,) of `scene.cameras`, the photographs to train on; None: all but the held-out ones.
        loss: of a render and its photograph, torch tensors (H,W,3) of 0 to 1, to a scalar tensor;
            None: L1 and SSIM. Where settings are chosen by trials, these use L1 and SSIM.
        parts: subclasses of `Part`, called in every step after the built-in ones, such as
            your own densification, with `**{"density.kind": "none"}`.
        settings: other fields of `TrainConfig`, such as `sh_degree=2`.

    Returns:
        The model in `.splats`, in one light where photographs differ, and what it took.

    Raises:
        BadInput: a setting, part or photograph that cannot be used.
        StageFailed: the training diverges.
        TypeError: `loss` returns anything but a scalar tensor with a gradient.

    Example:
        >>> scene = radiant.load_scene("SCENE")
        >>> result = radiant.train(scene, num_steps=30, long_side_px=64)
        >>> radiant.save_splats(result.splats, "trained.ply")
    """
    for number, part in enumerate(parts):
        if Part not in type(part).__mro__:
            raise BadInput(f"parts[{number}] is a {type(part).__name__}, expected an object of a subclass of radiant.Part.")
    backend = resolve_backend("auto")
    train_config = config if isinstance(config, TrainConfig) else train_preset(config)
    overrides = Overrides(num_steps=num_steps, long_side_px=long_side_px, settings=settings)
    if isinstance(config, TrainConfig):
        train_config = replace(train_config, reduce_on_cpu=False)
    fitted, _ = fit_to_backend(replace(train_config, seed=seed), backend, overrides)
    reporter = EventReporter(stage="train", emit=listen)
    chosen = scene.indices("training") if rows is None else np.asarray(rows, np.int64)
    task = DeviceTask(scene=scene.sfm.restricted_to(chosen), train=fitted, backend=backend)
    listen(StageStarted(stage="train"))
    prepared = prepare_training(task, scene.views(chosen, fitted.long_side_px), reporter)
    options = replace(prepared.options, loss=loss, parts=tuple(parts))
    result = fit_prepared(replace(prepared, options=options), reporter)
    listen(StageDone(stage="train", seconds=result.seconds))
    return result


def join(
    models: Sequence[tuple[Splats, Cameras]], listen: Listener = _silent, *, long_side_px: int = 576, num_epochs: int | None = None
) -> Splats:
    """Join models of neighbouring places, in one frame, into one without their photographs.

    Use it where models were trained apart: by several owners, or one after another.

    Args:
        models: each with the cameras that it was trained on, which say what it is trusted to show.
        listen: hears progress.
        long_side_px: of the pictures that models show each other; by default 576 px.
        num_epochs: how often each is shown; None: as the cloud of a run after long trainings (5).

    Returns:
        One model; where it is no better than the models cut at their borders, these.

    Raises:
        BadInput: no model, or cameras of one name in two of them.

    Example:
        >>> scene, splats = radiant.load_scene("SCENE"), radiant.load_splats("model.ply")
        >>> halves = [scene.cameras.select(scene.indices("training")[part::2]) for part in (0, 1)]
        >>> parts = [(splats, half) for half in halves]
        >>> joined = radiant.join(parts, long_side_px=64, num_epochs=1)
    """
    config, _ = fit_to_backend(train_preset("default"), resolve_backend("auto"), Overrides(long_side_px=long_side_px))
    rules = Join(epochs=num_epochs)

    def report(progress: TrainProgress) -> None:
        listen(StageProgress(stage="join", done=progress.step, total=progress.num_steps))

    listen(StageStarted(stage="join"))
    teachers = [Teacher(splats=splats, cameras=cameras.scaled(long_side_px)) for splats, cameras in models]
    joined = join_models(teachers, config, rules, FitOptions(report=report))
    listen(StageDone(stage="join", seconds=joined.trained.seconds))
    return joined.splats


@dataclass(frozen=True, kw_only=True)
class Scores:
    """How near renders are to K photographs; lists (K,) in the order of `names`."""

    names: tuple[str, ...]
    psnr_db: tuple[float, ...]
    ssim: tuple[float, ...]
    psnr_cc_db: tuple[float, ...]
    """PSNR after one affine map of the colours of each render."""

    def __repr__(self) -> str:
        return f"Scores({self.mean_psnr_db:.2f} dB PSNR, {np.mean(self.ssim):.3f} SSIM, mean of {len(self.names)} photographs)"

    @property
    def mean_psnr_db(self) -> float:
        """Mean over photographs."""
        return float(np.mean(self.psnr_db))


def evaluate(splats: Splats, scene: Scene, listen: Listener = _silent, *, long_side_px: int = 576, light: LightMode = "auto") -> Scores:
    """Score a model on the held-out photographs of its scene, as `radiant train` and `run` do.

    Use it to compare models of one scene: 20 dB is rough, 25 good, 30 like the photographs.

    Args:
        splats: the model, in the frame of the scene.
        scene: the photographs.
        listen: hears progress and warnings.
        long_side_px: size at which they are compared; by default 576 px.
        light: as the training's: auto predicts the light of a held-out photograph from the others,
            where light differs.

    Returns:
        Figures of each held-out photograph.

    Raises:
        BadInput: masks leave nothing to compare.

    Example:
        >>> scene, splats = radiant.load_scene("SCENE"), radiant.load_splats("model.ply")
        >>> scores = radiant.evaluate(splats, scene, long_side_px=64)
        >>> len(scores.psnr_db), scores.mean_psnr_db > 10
        (2, True)
    """
    cameras = scene.cameras.select(scene.indices("held_out")).scaled(long_side_px)
    cameras, used = select_scored(cameras, scene.masks, lambda message: listen(Warned(stage="evaluation", message=message)))
    trained = None if light == "none" else scene.views("training", COMPARED_PX)
    predicted = None if trained is None else light_of_score(splats, trained, cameras, scene.captures, light)
    views = HeldOutViews(cameras=cameras, photographs=[scene.images / name for name in cameras.names], used=used, light=predicted)
    listen(StageStarted(stage="evaluation"))
    rows = []
    for image in score_images(splats, cameras, views):
        rows.append(image.row)
        listen(StageProgress(stage="evaluation", done=len(rows), total=len(cameras), note=image.view.name))
    figures = {figure: tuple(float(row[figure]) for row in rows) for figure in ("psnr_db", "ssim", "psnr_cc_db")}
    return Scores(names=tuple(str(row["name"]) for row in rows), **figures)


def export(
    model: str | Path, out: str | Path, *, kind: ExportFormat | None = None, crs: str | None = None, **options: Any
) -> dict[str, Any]:
    """Write a run or a model in the files of other programs, as `radiant export`.

    Use it for other viewers, for survey programs and for the web.

    Args:
        model: the folder of a run, or a model file.
        out: the file or folder; its ending says the format.
        kind: the format where the ending does not say it, such as "ortho" of a .tif.
        crs: coordinate system of the file, such as "EPSG:25832".
        options: as those of `radiant export`, such as `resolution=0.05`.

    Returns:
        What was written, with its figures and losses.

    Raises:
        BadInput: the file exists, or the model cannot be written so.

    Example:
        >>> written = radiant.export("model.ply", "model.sog")
        >>> written["format"]
        'sog'
    """
    with ProgressDisplay(Console(quiet=True)) as display:
        return export_by_request(ExportRequest(model=Path(model), out=Path(out), format=kind, crs=crs, **options), display)
