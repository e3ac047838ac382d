"""Benchmark of defaults: every helper of a training on every kind of scene. Once per change of a
default.

    for each kind, number of photographs and seed: the preset as it is, without each helper in turn,
    and plain, without all of them; as many steps each, scored on every eighth photograph
    plain once more, with as many steps as take the CPU seconds of the preset

    gain of a helper = PSNR of the preset − PSNR without it, paired over seeds and images

What the preset lets photographs choose is chosen once, with all helpers, and then set for those
without one: trials are not repeated, and the CPU seconds of the preset alone have them in. Where a
helper decides by itself that it has nothing to do, the training without it is the same, and its
steps are not taken a second time: its gain is 0 unless the score differs. Rows lie in OUT/rows as
soon as they are measured, so an interrupted matrix goes on where it was.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from radiant_app.bench.kind_scenes import KINDS, make_scene
from radiant_app.bench.kind_statistics import FORCED, STATISTICS, Case, statistics_of, statistics_tables
from radiant_app.bench.options import BenchOptions
from radiant_app.bench.train import Source, Split, TrainBench, score_model, split_source
from radiant_app.commands.steps import stage_bar
from radiant_app.events import StageProgress
from radiant_app.report.progress import terminal_display
from radiant_core import __version__
from radiant_core.errors import BadInput
from radiant_core.evaluate.bootstrap import PairedDifference, paired_bootstrap
from radiant_core.evaluate.metric import Metric
from radiant_core.hierarchy.device import PreparedTraining, fit_prepared, prepare_training
from radiant_core.hierarchy.messages import DeviceTask
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.io.records import load_splats, save_splats
from radiant_core.io.run_store import content_key, read_json, write_atomic, write_json
from radiant_core.light.captures import read_captures
from radiant_core.numerics import FloatArray
from radiant_core.render.rasterize import resolve_backend
from radiant_core.sfm.reconstruct import scene_from_colmap
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.train.checkpoint import training_key
from radiant_core.train.config import TrainConfig, train_preset, with_settings
from radiant_core.train.extent import working_extent
from radiant_core.train.needs import PIXELS_PER_SPLAT, Overrides, fit_to_backend
from radiant_core.train.photographs import load_training_views
from radiant_core.train.views import TrainingViews

HELPERS: Mapping[str, Mapping[str, Any]] = {
    "fill-in points": {"fill_in": False},
    "light": {"light": "none"},
    "sky": {"sky": False},
    "limit of extent": {"max_extent_per_distance": None},
    "limit of sizes": {"max_scale_per_distance": None},
    "limit of needles": {"max_elongation": None},
    "skipped images": {"skip_images": "none"},
    "few: left out at random": {"drop_gaussians": "none"},
    "few: more Gaussians": {"density.pixels_per_splat": PIXELS_PER_SPLAT},
    "settling rates": {"settle_epochs": None},
    "small pictures first": {"start_scale": 1.0},
}
"""Each helper of the preset, and the settings that switch it off."""
ADDED: Mapping[str, Mapping[str, Any]] = {
    "dense points": {"dense_points": "always"},
    "fill-in points always": {"fill_in": True},
    "light always": {"light": "always"},
    "left out at random always": {"drop_gaussians": "always"},
}
"""What the preset does not do, or where it decides against it, and the settings that force it."""
DEFAULT, PLAIN, PLAIN_LONGER = "default", "plain", "plain, equal time"
MOST_TIMES_LONGER = 4.0
NUMBERS = (30, 90)
QUICK: Mapping[str, Any] = {"kinds": ("turntable", "clouds"), "numbers": (24,), "long_side_px": 128, "num_steps": 200}
MARGIN_DB = 0.1
"""By so much the default may be behind plain."""
_PREPARED_ONLY = {"fill_in": False, "light": "none", "sky": False, "skip_images": "none", "dense_points": "none"}
"""Settings that no step of a training reads, once its first Gaussians and its views are there."""


@dataclass(frozen=True, kw_only=True)
class KindsBench:
    """What to measure."""

    out: Path
    """Folder of scenes, rows and the tables kinds.json and kinds.md."""
    kinds: tuple[str, ...] = tuple(KINDS)
    numbers: tuple[int, ...] = NUMBERS
    """Photographs of each scene, an eighth of which is held out."""
    helpers: tuple[str, ...] = tuple(HELPERS)
    """Those of `HELPERS` and `ADDED` that are measured."""
    seeds: tuple[int, ...] = (0,)
    long_side_px: int = 160
    num_steps: int = 720

    def __post_init__(self) -> None:
        for given, known, what in ((self.kinds, KINDS, "kind of scene"), (self.helpers, {**HELPERS, **ADDED}, "helper")):
            if unknown := [name for name in given if name not in known]:
                raise BadInput(f"{what} {unknown[0]!r} is unknown: use {', '.join(known)}.")
        if min(self.numbers) < 9:
            raise BadInput(f"{min(self.numbers)} photographs are asked for, of which at most 1 is held out: ask for 9 or more.")

    @property
    def default(self) -> TrainConfig:
        """The preset at this size and length."""
        overrides = Overrides(long_side_px=self.long_side_px, num_steps=self.num_steps)
        return fit_to_backend(train_preset(DEFAULT), resolve_backend("auto"), overrides)[0]

    @property
    def changes(self) -> Mapping[str, Mapping[str, Any]]:
        """What the arms of single helpers change in the default, by the helper."""
        return {name: {**HELPERS, **ADDED}[name] for name in self.helpers}

    @property
    def without_all(self) -> Mapping[str, Any]:
        """What plain changes in the default."""
        return {path: value for change in HELPERS.values() for path, value in change.items()}


@dataclass(frozen=True, kw_only=True)
class KindRow:
    """One trained model. Per held-out image psnr_db and, after a correction of colours,
    psnr_cc_db."""

    kind: str
    num_photographs: int
    arm: str
    """A helper that is changed, `DEFAULT`, `PLAIN` or `PLAIN_LONGER`."""
    seed: int
    cpu_s: float
    """Preparing and training, in which trials count."""
    num_steps: int
    num_gaussians: int
    psnr_db: tuple[float, ...]
    psnr_cc_db: tuple[float, ...]
    steps: str = ""
    """Hash of all that decides the bits of its steps."""
    choices: Mapping[str, str] = field(default_factory=dict)
    """What was decided, by topic."""
    chosen: Mapping[str, Any] = field(default_factory=dict)
    """The values of settings that were "auto"."""
    statistics: Mapping[str, float] = field(default_factory=dict)
    """Of the default's photographs, by name (`kind_statistics.py`)."""

    @property
    def scene(self) -> str:
        """Kind and number."""
        return f"{self.kind}-{self.num_photographs}"


@dataclass(frozen=True, kw_only=True)
class Gain:
    """What a helper gains on one scene, or the default over plain and over plain in equal time."""

    kind: str
    num_photographs: int
    helper: str
    psnr_db: PairedDifference
    psnr_cc_db: PairedDifference
    cpu_s: float
    """CPU seconds that it costs."""
    acts: bool
    """Whether any step of a training differs by it."""


def bench_kinds(bench: KindsBench) -> tuple[list[KindRow], list[Metric]]:
    """Measure what is missing of the matrix, write its tables into `out`, and return its rows and
    metrics `kinds.<kind>-<photographs>.<…>`."""
    scenes = list(product(bench.kinds, bench.numbers))
    display, total = terminal_display(), len(scenes) * len(bench.seeds) * (3 + len(bench.changes))
    rows: list[KindRow] = []
    with stage_bar(display, "kinds"):
        for kind, number in scenes:
            for row in _rows_of_scene(bench, kind, number):
                rows.append(row)
                note = f"{row.scene}, {row.arm}: {np.mean(row.psnr_db):.2f} dB"
                display(StageProgress(stage="kinds", done=len(rows), total=total, note=note))
                write_tables(bench, rows)
    return rows, _metrics(rows)


def _rows_of_scene(bench: KindsBench, kind: str, number: int) -> Iterator[KindRow]:
    with TemporaryDirectory(prefix="radiant-bench-kinds-") as work:
        cell = _Cell(bench=bench, kind=kind, number=number, work=Path(work))
        for seed in bench.seeds:
            default = replace(bench.default, seed=seed)
            yield (first := cell.row(DEFAULT, default))
            yield (bare := cell.row(PLAIN, plain := with_settings(default, bench.without_all)))
            longer = round(plain.num_steps * min(MOST_TIMES_LONGER, max(1.0, first.cpu_s / bare.cpu_s)))
            yield cell.row(PLAIN_LONGER, replace(plain, num_steps=longer))
            for arm, change in bench.changes.items():
                yield cell.row(arm, with_settings(default, {**first.chosen, **change}))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Cell:
    """One scene, loaded where something of it is measured."""

    bench: KindsBench
    kind: str
    number: int
    work: Path

    @cached_property
    def split(self) -> Split:
        """What is trained on and what is held out."""
        project = make_scene(self.bench.out, self.kind, self.number, self.bench.long_side_px)
        images = project / "images"
        result = scene_from_colmap(project / "sparse" / "0", images, self.work, lambda progress: None, None, Placement())
        source = Source(
            name=f"{self.kind}-{self.number}",
            scene=result.scene,
            images=result.undistorted_folder,
            masks=None,
            captures=read_captures(images, result.scene.cameras.names),
        )
        return split_source(source, "interleaved", 0, TrainBench(scene=project))

    @cached_property
    def views(self) -> TrainingViews:
        """The photographs that are trained on."""
        return load_training_views(self.split.source.images, self.split.training.cameras.scaled(self.bench.long_side_px))

    def row(self, arm: str, config: TrainConfig) -> KindRow:
        """The row of an arm, measured where it is not there yet."""
        key = content_key(__version__, asdict(config))[:16]
        record = self.bench.out / "rows" / f"{self.kind}-{self.number}-{_key(arm)}-{config.seed}-{key}.json"
        if not record.is_file():
            row = self._measure(arm, config)
            record.parent.mkdir(parents=True, exist_ok=True)
            write_json(record, asdict(row))
        own = read_json(record)
        return KindRow(**{**own, "psnr_db": tuple(own["psnr_db"]), "psnr_cc_db": tuple(own["psnr_cc_db"])})

    def _measure(self, arm: str, config: TrainConfig) -> KindRow:
        recorder, task = Recorder(stage="train"), DeviceTask(scene=self.split.training, train=config, backend=resolve_backend("auto"))
        views, begun_s = self.views, time.process_time()
        prepared = prepare_training(task, views, recorder)
        steps = _key_of_steps(prepared)
        # The default's model is kept for those of other arms that are the same.
        model, num_steps = self.bench.out / "models" / f"{steps}.safetensors", prepared.config.num_steps
        if arm != DEFAULT and model.is_file():
            splats = load_splats(model)
        else:
            result = fit_prepared(prepared, recorder)
            splats, num_steps = result.splats, result.num_steps
        cpu_s = time.process_time() - begun_s
        if arm == DEFAULT:
            model.parent.mkdir(parents=True, exist_ok=True)
            save_splats(model, splats)
        figures = score_model(self.split, prepared, splats)
        statistics = statistics_of(self.split.training, views) if arm == DEFAULT else {}
        return KindRow(
            kind=self.kind,
            num_photographs=self.number,
            arm=arm,
            seed=config.seed,
            cpu_s=cpu_s,
            num_steps=num_steps,
            num_gaussians=len(splats),
            psnr_db=figures.psnr_db,
            psnr_cc_db=figures.psnr_cc_db,
            steps=steps,
            statistics=statistics,
            choices={decision.topic: decision.choice for decision in recorder.decisions},
            chosen={
                each.name: value
                for each in fields(TrainConfig)
                if getattr(config, each.name) == "auto" and (value := getattr(prepared.config, each.name)) != "auto"
            },
        )


def _key_of_steps(prepared: PreparedTraining) -> str:
    """Hash of all that decides the bits of a prepared training, whatever settings led there."""
    config = prepared.config
    extent = working_extent(prepared.views.cameras, prepared.initial, config.max_extent_per_distance)
    config = with_settings(config, {**_PREPARED_ONLY, "max_extent_per_distance": None})
    if hasattr(config.density, "pixels_per_splat"):
        config = with_settings(config, {"density.pixels_per_splat": None})
    return content_key(training_key(prepared.initial, prepared.views, config, prepared.options), extent)[:16]


def gains_of(rows: Sequence[KindRow]) -> list[Gain]:
    """What every helper gains on every scene whose default was measured with the same seeds."""
    return [
        Gain(
            kind=pair.with_it[0].kind,
            num_photographs=pair.with_it[0].num_photographs,
            helper=pair.helper,
            psnr_db=_difference([pair], "psnr_db"),
            psnr_cc_db=_difference([pair], "psnr_cc_db"),
            cpu_s=float(np.mean([a.cpu_s - b.cpu_s for a, b in zip(pair.with_it, pair.without, strict=True)])),
            acts=pair.acts,
        )
        for pair in _pairs(rows)
    ]


@dataclass(frozen=True, kw_only=True)
class _Pair:
    """Rows of one scene with a helper and without it, seed by seed."""

    helper: str
    with_it: list[KindRow]
    without: list[KindRow]

    @property
    def acts(self) -> bool:
        """Whether any step differs."""
        return any(a.steps != b.steps for a, b in zip(self.with_it, self.without, strict=True))


def _pairs(rows: Sequence[KindRow]) -> Iterator[_Pair]:
    groups: dict[tuple[str, str], dict[int, KindRow]] = {}
    for row in rows:
        groups.setdefault((row.scene, row.arm), {})[row.seed] = row
    for (scene, arm), own in groups.items():
        default = groups.get((scene, DEFAULT), {})
        seeds = sorted(own.keys() & default.keys())
        if arm != DEFAULT and seeds:
            sides = [default[seed] for seed in seeds], [own[seed] for seed in seeds]
            with_it, without = sides[::-1] if arm in ADDED else sides
            yield _Pair(helper=arm, with_it=with_it, without=without)


def _difference(pairs: Sequence[_Pair], figure: str) -> PairedDifference:
    a, b = ([_by_seed_and_image(getattr(pair, side), figure) for pair in pairs] for side in ("with_it", "without"))
    return paired_bootstrap(a, b)


def _by_seed_and_image(rows: Sequence[KindRow], figure: str) -> FloatArray:
    return np.array([getattr(row, figure) for row in rows], np.float64)


def _metrics(rows: Sequence[KindRow]) -> list[Metric]:
    metrics = []
    for row in rows:
        if row.arm in (DEFAULT, PLAIN, PLAIN_LONGER) and row.seed == min(each.seed for each in rows):
            of_arm = [each for each in rows if (each.scene, each.arm) == (row.scene, row.arm)]
            for figure, unit in (("psnr_db", "dB"), ("psnr_cc_db", "dB"), ("cpu_s", "s"), ("num_gaussians", "1")):
                value = float(np.mean([np.mean(getattr(each, figure)) for each in of_arm]))
                metrics.append(Metric(key=f"kinds.{row.scene}.{row.arm}.{figure}", value=value, unit=unit, direction="info"))
    for gain in gains_of(rows):
        key = f"kinds.{gain.kind}-{gain.num_photographs}.gain.{_key(gain.helper)}"
        for mark, difference in (("", gain.psnr_db), ("cc_", gain.psnr_cc_db)):
            bounds = {"mean_db": difference.mean, "low_db": difference.low, "high_db": difference.high}
            metrics += [Metric(key=f"{key}.{mark}{name}", value=value, unit="dB", direction="info") for name, value in bounds.items()]
    return metrics


def _key(name: str) -> str:
    return name.replace(" ", "_").replace(":", "").replace(",", "")


def write_tables(bench: KindsBench, rows: Sequence[KindRow]) -> None:
    """OUT/kinds.json, all rows and gains, and OUT/kinds.md, the tables."""
    gains = gains_of(rows)
    settings = {"long_side_px": bench.long_side_px, "num_steps": bench.num_steps, "version": __version__}
    write_json(bench.out / "kinds.json", {**settings, "rows": [asdict(row) for row in rows], "gains": [_plain(gain) for gain in gains]})
    write_atomic(bench.out / "kinds.md", markdown(rows).encode())


def _plain(gain: Gain) -> dict[str, Any]:
    differences = {name: getattr(gain, name) for name in ("psnr_db", "psnr_cc_db")}
    bounds = {name: {"mean": each.mean, "low": each.low, "high": each.high} for name, each in differences.items()}
    return {**{name: getattr(gain, name) for name in ("kind", "num_photographs", "helper", "cpu_s", "acts")}, **bounds}


def markdown(rows: Sequence[KindRow]) -> str:
    """Tables: default and plain on every scene, what every helper gains on each and on all, and
    whether what decides about it was right."""
    gains = {(f"{gain.kind}-{gain.num_photographs}", gain.helper): gain for gain in gains_of(rows)}
    scenes = list(dict.fromkeys(row.scene for row in rows))
    helpers = [name for name in (*HELPERS, *ADDED) if any(helper == name for _, helper in gains)]
    lines = [
        _line("scene", "default", "plain", "default − plain", "corrected", "− plain, equal time", "CPU s", "Gaussians"),
        "|---" * 8 + "|",
    ]
    for scene in scenes:
        if (scene, PLAIN) in gains:
            both = [[row for row in rows if (row.scene, row.arm) == (scene, arm)] for arm in (DEFAULT, PLAIN)]
            means = [f"{np.mean([np.mean(row.psnr_db) for row in own]):.2f}" for own in both]
            costs = (
                " / ".join(f"{np.mean([row.cpu_s for row in own]):.1f}" for own in both),
                " / ".join(f"{np.mean([row.num_gaussians for row in own]):,.0f}" for own in both),
            )
            gain = gains[scene, PLAIN]
            longer = gains.get((scene, PLAIN_LONGER))
            in_time = "" if longer is None else _bounded(longer.psnr_db)
            lines.append(_line(scene, *means, _bounded(gain.psnr_db), _bounded(gain.psnr_cc_db), in_time, *costs))
    lines += ["", _line("scene", *helpers), "|---" * (len(helpers) + 1) + "|"]
    lines += [_line(scene, *(_gain_text(gains.get((scene, helper))) for helper in helpers)) for scene in scenes]
    lines += ["", *_summary(rows), "", *statistics_tables(cases_of(rows))]
    return "\n".join(lines) + "\n"


def _summary(rows: Sequence[KindRow]) -> list[str]:
    """A line for each helper: over all scenes, every one with equal weight, and its extremes."""
    lines = [_line("helper", "acts on", "gain", "most", "least"), "|---" * 5 + "|"]
    of_helper: dict[str, list[_Pair]] = {}
    for pair in _pairs(rows):
        of_helper.setdefault(pair.helper, []).append(pair)
    for helper, pairs in of_helper.items():
        means = sorted((_difference([pair], "psnr_db").mean, pair.with_it[0].scene) for pair in pairs)
        least, most = (f"{mean:+.2f}, {scene}" for mean, scene in (means[0], means[-1]))
        acting = f"{sum(pair.acts for pair in pairs)} of {len(pairs)}"
        lines.append(_line(helper, acting, _bounded(_difference(pairs, "psnr_db")), most, least))
    return lines


def cases_of(rows: Sequence[KindRow]) -> list[Case]:
    """The helpers that change a training, as the default decides about them by a statistic."""
    of_forced = {arm: helper for helper, arm in FORCED.items()}
    return [
        Case(
            helper=of_forced.get(pair.helper, pair.helper),
            scene=pair.with_it[0].scene,
            is_on=pair.helper not in of_forced,
            gain=_difference([pair], "psnr_db"),
            statistics=(pair.without if pair.helper in of_forced else pair.with_it)[0].statistics,
        )
        for pair in _pairs(rows)
        if pair.acts and of_forced.get(pair.helper, pair.helper) in STATISTICS
    ]


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


def _gain_text(gain: Gain | None) -> str:
    if gain is None:
        return ""
    if not gain.acts and gain.psnr_db.mean == 0:
        return "·"
    return _bounded(gain.psnr_db)


def _bounded(difference: PairedDifference) -> str:
    """Mean and bounds, bold where the bounds exclude 0."""
    text = f"{difference.mean:+.2f} ({difference.low:+.2f} … {difference.high:+.2f})"
    return f"**{text}**" if difference.low > 0 or difference.high < 0 else text


def bench_of(options: BenchOptions) -> KindsBench:
    """The benchmark that the options ask for; `quick` has two kinds, 24 photographs and few
    steps."""
    assert options.out is not None, "checked with the options"
    some = QUICK if options.quick else {}
    given = {
        "kinds": options.kinds,
        "numbers": None if options.num_photographs is None else (options.num_photographs,),
        "helpers": options.methods,
        "seeds": None if options.num_seeds is None else tuple(range(options.num_seeds)),
        "long_side_px": options.long_side_px,
        "num_steps": options.num_steps,
    }
    return KindsBench(out=options.out, **{**some, **{name: value for name, value in given.items() if value}})
