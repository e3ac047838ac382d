"""Benchmark of training: held-out PSNR against CPU seconds and Gaussians, presets at equal budgets.

One model of all training photographs of a scene, without tiers. Budgets are CPU seconds of the
whole process, which do not depend on the load of the machine. Equal for all presets: scene,
photographs, size, budgets, seeds, held-out photographs; every row states its number of Gaussians.
Each preset is also trained with half of each budget, and its difference to the reference at the
full budget is stated with the 95 % bounds of a bootstrap over images and seeds. More `splits` hold
out other photographs, each with its own models, so that a single photograph weighs less; the
bootstrap draws from the images of all splits, and with one seed it does not cover how a split's
model varies. `hold_out="line"` leaves out a whole line of the flight instead of every eighth
photograph, "both" the one beside the other, and `off_path` names views that were never flown: how
does a model look away from its photographs? `ablations`: the first preset with one part switched
off at a time, at the first budget, paired. With a folder for its rows an interrupted benchmark
resumes.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.charts.curve_chart import CurvePoint
from benchmarks.hold_out import mask_of, name_of, parts_of
from benchmarks.metric import Metric
from benchmarks.off_path import OffPath, OffPathFigures, figures_of, load_off_path, off_path_metrics
from benchmarks.options import BenchOptions, HeldPart, HoldOut
from benchmarks.tracking import track_items
from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.steps import stage_bar
from radiant_app.report.progress import terminal_display
from radiant_app.reporting import EventReporter
from radiant_app.workers.sources import captures_of, detect_source, load_scored_scene, masks_folder_of, reconstruct_source, sfm_task
from radiant_core import __version__
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.bootstrap import paired_bootstrap
from radiant_core.evaluate.color_correction import correct_colors
from radiant_core.evaluate.image_error import flip, psnr_db
from radiant_core.evaluate.image_pair import Used
from radiant_core.hierarchy.device import PreparedTraining, fit_prepared, prepare_training
from radiant_core.hierarchy.messages import DeviceTask
from radiant_core.hierarchy.reporter import Machine, Recorder
from radiant_core.io.photos.masks import pixel_weights, used_pixels
from radiant_core.io.run_store import content_key, read_json, write_json
from radiant_core.light.canonical import LightOfScore, light_of_score, show_in_light
from radiant_core.light.captures import Captures, read_captures
from radiant_core.light.solve import COMPARED_PX
from radiant_core.numerics import FloatArray
from radiant_core.render.backends import resolve_backend
from radiant_core.render.rendered_view import render_views
from radiant_core.scene import SfmScene
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig, train_preset, with_settings, without_mean
from radiant_core.train.needs import Overrides, fit_to_backend
from radiant_core.train.photographs import load_images, load_training_views

BUDGETS_S = (60.0, 180.0, 600.0)
"""CPU seconds; the last is five minutes on two cores."""
LONG_SIDE_PX = 1152
ABLATION_LONG_SIDE_PX = 576
ABLATION_BUDGET_S = 90.0
ABLATION_SEEDS = (0, 1, 2)
UNLIMITED_STEPS = 10**9
REFERENCE = "standard"
THIN_SURFACES: dict[str, Any] = {
    "thickness_weight": 0.05,
    "depth_spread_weight": 1.0,
}
"""What makes a model that is thinner and more opaque (`docs/experiments/off_path.md`)."""
ABLATIONS: dict[str, dict[str, Any]] = {
    "full size from the start": {"start_scale": 1.0},
    "no densification": {"density.kind": "none"},
    "adc instead of planned growth": {"density.kind": "adc"},
    "mcmc instead of planned growth": {"density.kind": "mcmc"},
    "Adam on visible Gaussians only": {"adam": "visible"},
    "no fill-in points": {"fill_in": False},
    "no sky": {"sky": False},
    "sizes without limit": {"max_scale_per_distance": None},
    "extents without limit": {"max_extent_per_distance": None},
    "needles without limit": {"max_elongation": None},
    "thin surfaces": THIN_SURFACES,
    "faint and round": {"initial_opacity": 0.1, "initial_thickness": 1.0, "density.min_opacity": 0.005},
    "pruned below 0.005": {"density.min_opacity": 0.005},
    "round first Gaussians": {"initial_thickness": 1.0},
    "Gaussians left out at random": {"drop_gaussians": "always"},
    "no Gaussians left out": {"drop_gaussians": "none"},
    "short axes in the loss": {"thickness_weight": 0.05},
    "spread of depth in the loss": {"depth_spread_weight": 1.0},
    "any number of Gaussians": {"density.pixels_per_splat": None},
    "one Gaussian per 80 pixels": {"density.pixels_per_splat": 80},
    "all photographs": {"skip_images": "none"},
    "dense points": {"dense_points": "always"},
    "any number of steps": {"max_epochs": None},
    "rates that never settle": {"settle_epochs": None},
    "the last step alone": dict(without_mean(train_preset("default"))),
    "black background": {"background": "black"},
    "random background": {"background": "random"},
    "antialiased": {"antialiased": True},
    "degree 0": {"sh_degree": 0},
    "degree 2": {"sh_degree": 2},
    "degree 3": {"sh_degree": 3},
    "light as it was taken": {"light": "none"},
}


@dataclass(frozen=True, kw_only=True)
class TrainBench:
    """What to measure. Budgets in CPU seconds."""

    scene: Path
    presets: tuple[str, ...] = ("default", REFERENCE)
    budgets_s: tuple[float, ...] = BUDGETS_S
    seeds: tuple[int, ...] = (0,)
    splits: tuple[int, ...] = (0,)
    """Which photographs are held out: `first` of `held_out_mask`, or numbers of lines."""
    num_photographs: int | None = None
    """Train on so many of those that are not held out, evenly chosen; None for all."""
    hold_out: HoldOut = "interleaved"
    off_path: Path | None = None
    """Views that were never flown, as the generator writes them, at which models are scored too."""
    long_side_px: int = LONG_SIDE_PX
    ablations: bool = False
    changes: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: ABLATIONS)
    out: Path | None = None
    """Folder of the rows; rows that exist are not measured again."""

    def __post_init__(self) -> None:
        asked_for = self.presets, self.budgets_s, self.seeds, self.splits
        if not all(asked_for) or not all(np.isfinite(s) and s > 0 for s in self.budgets_s):
            presets, budgets_s, seeds, splits = asked_for
            raise BadInput(f"bench train was given {presets}, {budgets_s} s, seeds {seeds} and splits {splits}: give one or more of each.")


@dataclass(frozen=True, kw_only=True)
class TrainedRow:
    """One trained model: its variant and budget, its cost and its quality.

    Per held-out image psnr_db, of the render in the light that is predicted where the variant
    models light, psnr_cc_db after an affine correction of its colours to the photograph's, and
    FLIP where it is installed.
    """

    variant: str
    budget_s: float
    seed: int
    cpu_s: float
    num_steps: int
    num_gaussians: int
    psnr_db: tuple[float, ...]
    psnr_cc_db: tuple[float, ...]
    flip: tuple[float | None, ...] = ()
    """Empty in rows that were kept before it was measured."""
    part: HeldPart = "interleaved"
    split: int = 0
    """Which photographs were held out: number `split` of the `part`."""
    off_path: OffPathFigures | None = None
    """At views that were never flown, where there are some."""

    @property
    def mean_psnr_db(self) -> float:
        """Mean over the held-out images."""
        return float(np.mean(self.psnr_db))

    @property
    def mean_psnr_cc_db(self) -> float:
        """The same after the correction of colours."""
        return float(np.mean(self.psnr_cc_db))


@dataclass(frozen=True, kw_only=True, eq=False)
class Source:
    """Photographs with their cameras, as a benchmark loads them."""

    name: str
    scene: SfmScene
    images: Path
    masks: Path | None
    captures: Captures


@dataclass(frozen=True, kw_only=True, eq=False)
class Split:
    """What of a source is trained on, and what is held out."""

    source: Source
    part: HeldPart
    first: int
    training: SfmScene
    held_out: SfmScene
    off_path: OffPath | None = None


def bench_train(bench: TrainBench) -> tuple[list[TrainedRow], list[Metric]]:
    """All rows, and the metrics `train.<scene>.<variant>.<budget>s.<…>` with the differences, of
    <scene>-line for lines held out; the scene is any source. Raises BadInput where nothing can be.
    """
    with TemporaryDirectory(prefix="radiant-bench-train-") as folder:
        source = _load(bench.scene, Path(folder))
        splits = _splits(source, bench)
        if bench.ablations:
            return _ablations(bench, splits)
        halves = {budget_s / 2 for budget_s in bench.budgets_s}
        jobs = [
            (split, preset, _config(preset, bench.long_side_px), budget_s, seed)
            for split in splits
            for budget_s in sorted({*bench.budgets_s, *halves})
            # The reference first: every row after its largest budget completes a difference.
            for preset in sorted(bench.presets, key=lambda preset: preset != REFERENCE)
            for seed in bench.seeds
            if budget_s in bench.budgets_s or preset != REFERENCE
        ]
        rows = [_row(bench.out, *job) for job in track_items(jobs, "bench train")]
    metrics = _alignment_metrics(splits[0])
    for part in parts_of(bench.hold_out):
        metrics += _preset_metrics(bench, name_of(source.name, part), [row for row in rows if row.part == part])
    return rows, metrics


def _preset_metrics(bench: TrainBench, scene: str, rows: Sequence[TrainedRow]) -> list[Metric]:
    """Of the rows of one part: each variant's figures, and its difference to the reference."""
    metrics = [metric for group in _groups(rows).values() for metric in _row_metrics(scene, group)]
    for preset in bench.presets:
        for budget_s in bench.budgets_s if preset != REFERENCE and REFERENCE in bench.presets else ():
            for share, label in ((1.0, "equal_time"), (0.5, "half_time")):
                key = f"train.{scene}.{preset}.{budget_s:g}s.over_{REFERENCE}_at_{label}"
                metrics += _difference_metrics(key, rows, (preset, share * budget_s), (REFERENCE, budget_s))
    return metrics


def bench_of(options: BenchOptions) -> TrainBench:
    """The benchmark that the options ask for; `quick` has budgets of seconds and small images."""
    ablations = options.ablations
    budgets_s = options.budgets_s or ((4.0, 8.0) if options.quick else (ABLATION_BUDGET_S,) if ablations else BUDGETS_S)
    num_seeds = options.num_seeds or (len(ABLATION_SEEDS) if ablations and not options.quick else 1)
    size = options.long_side_px or (240 if options.quick else ABLATION_LONG_SIDE_PX if ablations else LONG_SIDE_PX)
    if unknown := [name for name in options.methods if name not in ABLATIONS]:
        raise BadInput(f"ablation {unknown[0]!r} is unknown: use {', '.join(ABLATIONS)}.")
    if options.methods and not ablations:
        raise BadInput("--method picks among ablations: give --ablations as well.")
    return TrainBench(
        scene=options.scene or sample_scenes_folder() / "town" / "images",
        presets=options.presets or (("default",) if ablations else ("default", REFERENCE)),
        budgets_s=tuple(sorted(set(budgets_s))),
        seeds=tuple(range(num_seeds)),
        splits=tuple(range(options.num_splits)),
        num_photographs=options.num_photographs,
        hold_out=options.hold_out,
        off_path=options.off_path,
        long_side_px=size,
        ablations=ablations,
        changes={name: change for name, change in ABLATIONS.items() if not options.methods or name in options.methods},
        out=options.out,
    )


def curves_of(rows: Sequence[TrainedRow]) -> dict[str, list[CurvePoint]]:
    """The rows by variant, for a picture."""
    curves: dict[str, list[CurvePoint]] = {}
    for row in rows:
        name = row.variant if len({other_row.part for other_row in rows}) == 1 else f"{row.part}: {row.variant}"
        point = CurvePoint(cpu_s=row.cpu_s, num_gaussians=row.num_gaussians, psnr_db=row.mean_psnr_db)
        curves.setdefault(name, []).append(point)
    return curves


def _ablations(bench: TrainBench, splits: Sequence[Split]) -> tuple[list[TrainedRow], list[Metric]]:
    whole, budget_s = bench.presets[0], bench.budgets_s[0]
    base = _config(whole, bench.long_side_px)
    variants = {whole: base, **{name: with_settings(base, change) for name, change in bench.changes.items()}}
    # A change that the preset makes already is no ablation.
    variants = {name: config for name, config in variants.items() if name == whole or config != base}
    jobs = [(split, name, config, budget_s, seed) for split in splits for seed in bench.seeds for name, config in variants.items()]
    rows = [_row(bench.out, *job) for job in track_items(jobs, "bench train")]
    metrics = _alignment_metrics(splits[0])
    for part in parts_of(bench.hold_out):
        scene, rows_of_part = name_of(splits[0].source.name, part), [row for row in rows if row.part == part]
        metrics += [metric for group in _groups(rows_of_part).values() for metric in _row_metrics(scene, group)]
        for name in (name for name in variants if name != whole):
            key = f"train.{scene}.{_key(name)}.{budget_s:g}s.over_{whole}"
            metrics += _difference_metrics(key, rows_of_part, (name, budget_s), (whole, budget_s))
    return rows, metrics


def _config(preset: str, long_side_px: int) -> TrainConfig:
    config = fit_to_backend(train_preset(preset), resolve_backend("auto"), Overrides(long_side_px=long_side_px))[0]
    return replace(config, num_steps=UNLIMITED_STEPS)


def _load(source: Path, work: Path) -> Source:
    try:
        scene, _, images = load_scored_scene(source)
        masks, captures = masks_folder_of(source), captures_of(source)
    except BadInput:
        task = sfm_task(source, SfmConfig(), None, Placement())
        display = terminal_display()
        with stage_bar(display, "sfm"):
            result = reconstruct_source(task, work / "sfm", EventReporter(stage="sfm", emit=display).sfm_progress)
        scene, images, masks = result.scene, result.undistorted_folder, None
        captures = read_captures(detect_source(source)[1], scene.cameras.names)
    name = source.resolve().parent.name if source.name in ("images", "sfm") else source.resolve().name
    return Source(name=name, scene=scene, images=images, masks=masks, captures=captures)


def _splits(source: Source, bench: TrainBench) -> list[Split]:
    jobs = list(product(parts_of(bench.hold_out), bench.splits))
    for part, first in jobs:
        is_held_out = mask_of(part, source.scene.cameras, first)
        if is_held_out.all() or is_held_out.sum() < 2:
            number = bench.splits.index(first)
            then = f": ask for {number} split{'s' * (number > 1)}" if number else ""
            raise BadInput(
                f"{source.name} has {len(is_held_out)} placed photographs, of which split {number + 1} holds out {is_held_out.sum()}, "
                f"but at least 2 are needed, and some to train on{then}."
            )
    views = None if bench.off_path is None else load_off_path(bench.off_path, source.scene.cameras, bench.long_side_px)
    return [split_source(source, part, first, bench, views) for part, first in jobs]


def split_source(source: Source, part: HeldPart, first: int, bench: TrainBench, off_path: OffPath | None = None) -> Split:
    """Part `first` of a source held out, as the benchmark asks."""
    is_held_out = mask_of(part, source.scene.cameras, first)
    trained, most = np.flatnonzero(~is_held_out), bench.num_photographs
    if most is not None:
        trained = trained[np.unique(np.linspace(0, len(trained) - 1, min(most, len(trained))).astype(np.int64))]
    training, held_out = (source.scene.restricted_to(part) for part in (trained, np.flatnonzero(is_held_out)))
    return Split(source=source, part=part, first=first, training=training, held_out=held_out, off_path=off_path)


def _row(out: Path | None, split: Split, variant: str, config: TrainConfig, budget_s: float, seed: int) -> TrainedRow:
    if out is None:
        return _train_row(split, variant, config, budget_s, seed)
    views = {} if split.off_path is None else {"off_path": split.off_path.key}
    key = content_key(__version__, {"scene": split.training.cameras.names, "config": asdict(config), **views})[:16]
    record = out / "rows" / f"{name_of(split.source.name, split.part)}-{_key(variant)}-{budget_s:g}s-{seed}-{key}.json"
    if record.is_file():
        stored = read_json(record)
        figures = {name: tuple(stored.get(name, ())) for name in ("psnr_db", "psnr_cc_db", "flip")}
        return TrainedRow(**{**stored, **figures, "off_path": figures_of(stored.get("off_path"))})
    row = _train_row(split, variant, config, budget_s, seed)
    record.parent.mkdir(parents=True, exist_ok=True)
    write_json(record, asdict(row))
    return row


def _train_row(split: Split, variant: str, config: TrainConfig, budget_s: float, seed: int) -> TrainedRow:
    cameras = split.training.cameras.scaled(config.long_side_px)
    views = load_training_views(split.source.images, cameras, split.source.masks)
    begun_s = time.process_time()
    config = replace(config, seed=seed, budget_s=budget_s)
    task = DeviceTask(scene=split.training, train=config, backend=resolve_backend("auto"))
    machine = Machine(clock=time.process_time)
    prepared = prepare_training(task, views, Recorder(), machine)
    # Work before the first step counts towards the budget as well.
    left_s = max(1e-3, budget_s - (time.process_time() - begun_s))
    result = fit_prepared(replace(prepared, config=replace(prepared.config, budget_s=left_s)), Recorder())
    cpu_s = time.process_time() - begun_s
    figures = score_model(split, prepared, result.splats)
    return TrainedRow(
        variant=variant,
        budget_s=budget_s,
        seed=seed,
        cpu_s=cpu_s,
        num_steps=result.num_steps,
        num_gaussians=len(result.splats),
        psnr_db=figures.psnr_db,
        psnr_cc_db=figures.psnr_cc_db,
        flip=figures.flip,
        part=split.part,
        split=split.first,
        off_path=None if split.off_path is None else split.off_path.score(result.splats),
    )


@dataclass(frozen=True, kw_only=True)
class HeldOutFigures:
    """Of each held-out image: as the fields of the same names in `TrainedRow`."""

    psnr_db: tuple[float, ...]
    psnr_cc_db: tuple[float, ...]
    flip: tuple[float | None, ...]


def score_model(split: Split, prepared: PreparedTraining, splats: Splats) -> HeldOutFigures:
    """Score a model on the photographs that its split holds out, in the light that is predicted."""
    scored = split.held_out.cameras.scaled(prepared.config.long_side_px)
    photographs = load_images(split.source.images, scored)
    weights = pixel_weights(split.source.masks, scored)
    used = [None] * len(photographs) if weights is None else [used_pixels(image_weights) for image_weights in weights]
    renders = [view.image for view in render_views(splats, scored)]
    if (light := _light(split, prepared, splats, scored)) is not None:
        renders = [show_in_light(image, light.held_out, index, scored) for index, image in enumerate(renders)]
    triples = [(image, photograph / 255, pixels_used) for image, photograph, pixels_used in zip(renders, photographs, used, strict=True)]
    figures = [_psnrs_db(*triple) for triple in triples]
    return HeldOutFigures(
        psnr_db=tuple(plain for plain, _ in figures),
        psnr_cc_db=tuple(corrected for _, corrected in figures),
        flip=tuple(flip(*triple) for triple in triples),
    )


def _light(split: Split, prepared: PreparedTraining, splats: Splats, scored: Cameras) -> LightOfScore | None:
    """The light of the photographs held out beside the model's, as it is predicted."""
    if prepared.config.light == "none":
        return None
    trained = load_training_views(split.source.images, prepared.scene.cameras.scaled(COMPARED_PX), split.source.masks)
    return light_of_score(splats, trained, scored, split.source.captures, prepared.config.light)


def _psnrs_db(image: ArrayLike, photograph: ArrayLike, used: Used) -> tuple[float, float]:
    """PSNR in dB of an image (H,W,3) and of its colours corrected to the photograph's."""
    return psnr_db(image, photograph, used), psnr_db(correct_colors(image, photograph, used), photograph, used)


def _groups(rows: Sequence[TrainedRow]) -> dict[tuple[str, float], list[TrainedRow]]:
    groups: dict[tuple[str, float], list[TrainedRow]] = {}
    for row in rows:
        groups.setdefault((row.variant, row.budget_s), []).append(row)
    return groups


def _alignment_metrics(split: Split) -> list[Metric]:
    """How well the scene's cameras lie on those that the views off the path came with."""
    if (views := split.off_path) is None:
        return []
    figures = {"center_residual": (views.center_percent, "% of extent"), "rotation_residual": (views.rotation_deg, "deg")}
    key = f"train.{split.source.name}.off_path"
    return [Metric(key=f"{key}.{name}", value=value, unit=unit, direction="info") for name, (value, unit) in figures.items()]


def _row_metrics(scene: str, rows: Sequence[TrainedRow]) -> list[Metric]:
    key = f"train.{scene}.{_key(rows[0].variant)}.{rows[0].budget_s:g}s"
    means = {name: float(np.mean([getattr(row, name) for row in rows])) for name in ("cpu_s", "num_gaussians", "num_steps")}
    # Over images, as in the differences: splits may hold out different numbers.
    means |= {f"mean_{name}": float(_by_seed_and_image(rows, name).mean()) for name in ("psnr_db", "psnr_cc_db")}
    off_path = [row.off_path for row in rows if row.off_path is not None]
    flips = [value for row in rows for value in row.flip if value is not None]
    has_flip = len(flips) == sum(len(row.psnr_db) for row in rows)
    return [
        *([Metric(key=f"{key}.flip", value=float(np.mean(flips)), unit="1", direction="lower")] if has_flip else ()),
        *(off_path_metrics(key, off_path) if off_path else ()),
        Metric(key=f"{key}.psnr_db", value=means["mean_psnr_db"], unit="dB", direction="higher"),
        Metric(key=f"{key}.psnr_cc_db", value=means["mean_psnr_cc_db"], unit="dB", direction="higher"),
        Metric(key=f"{key}.cpu_s", value=means["cpu_s"], unit="s", direction="info"),
        Metric(key=f"{key}.num_gaussians", value=means["num_gaussians"], unit="1", direction="info"),
        Metric(key=f"{key}.num_steps", value=means["num_steps"], unit="1", direction="info"),
    ]


def _difference_metrics(key: str, rows: Sequence[TrainedRow], one: tuple[str, float], compared: tuple[str, float]) -> list[Metric]:
    groups = _groups(rows)
    metrics = []
    for figure, mark in (("psnr_db", ""), ("psnr_cc_db", "cc_")):
        difference = paired_bootstrap(_by_seed_and_image(groups[one], figure), _by_seed_and_image(groups[compared], figure))
        bounds = {"mean_db": difference.mean, "at_least_db": difference.at_least, "low_db": difference.low, "high_db": difference.high}
        metrics += [Metric(key=f"{key}.{mark}{name}", value=value, unit="dB", direction="info") for name, value in bounds.items()]
    return metrics


def _by_seed_and_image(rows: Sequence[TrainedRow], figure: str) -> FloatArray:
    """A figure (S,I) per seed, over the held-out images of all splits one after the other."""
    seeds = sorted({row.seed for row in rows})
    of_seed = [sorted((row for row in rows if row.seed == seed), key=lambda row: row.split) for seed in seeds]
    return np.array([np.concatenate([getattr(row, figure) for row in rows_of_seed]) for rows_of_seed in of_seed])


def _key(variant: str) -> str:
    return variant.replace(" ", "_").replace(".", "_")
