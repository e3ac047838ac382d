"""Benchmark of defaults: every helper of a training on every kind of scene. Once per change of a
default.

    for each kind, number of photographs and seed: the preset as it is, without each helper in turn,
    and plain, without all of them; as many steps each, scored on every eighth photograph
    plain once more, with as many steps as take the CPU seconds of the preset, whose steps and
    plain's are taken in turns, so that both are slowed alike by what else a machine does

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
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.kinds.rows import (
    ADDED,
    DEFAULT,
    HELPERS,
    PLAIN,
    PLAIN_LONGER,
    Gain,
    KindRow,
    cases_of,
    difference_of,
    gains_of,
    pairs_by_helper,
)
from benchmarks.kinds.scenes import KINDS, make_scene
from benchmarks.kinds.statistics import statistics_of, statistics_tables
from benchmarks.metric import Metric
from benchmarks.options import BenchOptions
from benchmarks.train import Source, Split, TrainBench, score_model, split_source
from radiant_app.commands.run.steps import stage_bar
from radiant_app.events import StageProgress
from radiant_app.report.progress import terminal_display
from radiant_core import __version__
from radiant_core.errors import BadInput
from radiant_core.evaluate.bootstrap import PairedDifference
from radiant_core.hierarchy.device import PreparedTraining, prepare_training, report_result
from radiant_core.hierarchy.messages import DeviceTask
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.io.records import load_splats, save_splats
from radiant_core.io.run_store import content_key, read_json, write_atomic, write_json
from radiant_core.light.captures import read_captures
from radiant_core.render.backends import resolve_backend
from radiant_core.sfm.reconstruct import scene_from_colmap
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.train.checkpoint import training_key
from radiant_core.train.config import TrainConfig, train_preset, with_settings
from radiant_core.train.extent import working_extent
from radiant_core.train.needs import Overrides, fit_to_backend
from radiant_core.train.photographs import load_training_views
from radiant_core.train.results import TrainResult
from radiant_core.train.trainer import Training
from radiant_core.train.views import TrainingViews

MOST_TIMES_LONGER = 4.0
STEPS_IN_TURN = 20
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
    splits: tuple[int, ...] = (0,)
    """Which eighths of a scene's photographs are held out, one after the other."""
    long_side_px: int = 160
    num_steps: int = 1_500

    def __post_init__(self) -> None:
        for names, choices, noun in ((self.kinds, KINDS, "kind of scene"), (self.helpers, {**HELPERS, **ADDED}, "helper")):
            if unknown := [name for name in names if name not in choices]:
                raise BadInput(f"{noun} {unknown[0]!r} is unknown: use {', '.join(choices)}.")
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


def bench_kinds(bench: KindsBench) -> tuple[list[KindRow], list[Metric]]:
    """Measure what is missing of the matrix, write its tables into `out`, and return its rows and
    metrics `kinds.<kind>-<photographs>.<…>`."""
    scenes = list(product(bench.kinds, bench.numbers))
    display, total = terminal_display(), len(scenes) * len(bench.splits) * len(bench.seeds) * (3 + len(bench.changes))
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
        cells = [_Cell(bench=bench, kind=kind, number=number, first=first, work=Path(work)) for first in bench.splits]
        for cell, seed in product(cells, bench.seeds):
            default = replace(bench.default, seed=seed)
            plain = with_settings(default, bench.without_all)
            yield from (both := cell.rows({DEFAULT: default, PLAIN: plain}))
            first, bare = both
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
    first: int
    """Which eighth is held out."""
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
        return split_source(source, "interleaved", self.first, TrainBench(scene=project))

    @cached_property
    def views(self) -> TrainingViews:
        """The photographs that are trained on."""
        return load_training_views(self.split.source.images, self.split.training.cameras.scaled(self.bench.long_side_px))

    def row(self, arm: str, config: TrainConfig) -> KindRow:
        """The row of an arm, measured where it is not there yet."""
        return self.rows({arm: config})[0]

    def rows(self, arms: Mapping[str, TrainConfig]) -> list[KindRow]:
        """The rows of arms, measured beside each other where one is not there yet."""
        records = {arm: self._record(arm, config) for arm, config in arms.items()}
        if not all(record.is_file() for record in records.values()):
            for row in self._measure(arms):
                records[row.arm].parent.mkdir(parents=True, exist_ok=True)
                write_json(records[row.arm], asdict(row))
        stored = [read_json(record) for record in records.values()]
        return [KindRow(**{**record, "psnr_db": tuple(record["psnr_db"]), "psnr_cc_db": tuple(record["psnr_cc_db"])}) for record in stored]

    def _record(self, arm: str, config: TrainConfig) -> Path:
        split = f"{self.first}-" if self.first else ""
        key = content_key(__version__, asdict(config))[:16]
        return self.bench.out / "rows" / f"{self.kind}-{self.number}-{_key(arm)}-{split}{config.seed}-{key}.json"

    def _measure(self, arms: Mapping[str, TrainConfig]) -> Iterator[KindRow]:
        views, prepared, seconds, recorders = self.views, dict[str, PreparedTraining](), dict[str, float](), dict[str, Recorder]()
        for arm, config in arms.items():
            begun_s, recorders[arm] = time.process_time(), Recorder(stage="train")
            task = DeviceTask(scene=self.split.training, train=config, backend=resolve_backend("auto"))
            prepared[arm] = prepare_training(task, views, recorders[arm])
            seconds[arm] = time.process_time() - begun_s
        # The default's model is kept for those of other arms that are the same.
        keys = {arm: _key_of_steps(training) for arm, training in prepared.items()}
        models = {arm: self.bench.out / "models" / f"{keys[arm]}.safetensors" for arm in arms}
        stored_models = {arm: load_splats(models[arm]) for arm in arms if arm != DEFAULT and len(arms) == 1 and models[arm].is_file()}
        trained = _train_beside({arm: training for arm, training in prepared.items() if arm not in stored_models}, seconds)
        for arm, config in arms.items():
            splats = stored_models[arm] if arm in stored_models else trained[arm].splats
            if arm in trained:
                report_result(prepared[arm].config, prepared[arm].initial, trained[arm], recorders[arm])
            if arm == DEFAULT:
                models[arm].parent.mkdir(parents=True, exist_ok=True)
                save_splats(models[arm], splats)
            figures = score_model(self.split, prepared[arm], splats)
            yield KindRow(
                kind=self.kind,
                num_photographs=self.number,
                arm=arm,
                seed=config.seed,
                split=self.first,
                cpu_s=seconds[arm],
                num_steps=prepared[arm].config.num_steps,
                num_gaussians=len(splats),
                psnr_db=figures.psnr_db,
                psnr_cc_db=figures.psnr_cc_db,
                steps=keys[arm],
                choices={decision.topic: decision.choice for decision in recorders[arm].decisions},
                chosen=_chosen(config, prepared[arm].config),
                statistics=statistics_of(self.split.training, views) if arm == DEFAULT else {},
            )


def _train_beside(prepared: Mapping[str, PreparedTraining], seconds: dict[str, float]) -> dict[str, TrainResult]:
    """The models of trainings that take their steps in turns, some at a time, so that what else a
    machine does slows them alike; adds the CPU seconds of each."""
    results, trainings = dict[str, TrainResult](), dict[str, Training]()
    for arm, prepared_arm in prepared.items():
        begun_s = time.process_time()
        trainings[arm] = Training(prepared_arm.initial, prepared_arm.views, prepared_arm.config, prepared_arm.options)
        seconds[arm] += time.process_time() - begun_s
    while len(results) < len(trainings):
        for arm, training in trainings.items():
            begun_s, until = time.process_time(), training.step + STEPS_IN_TURN
            while training.step < until and not training.is_done:
                training.take_step()
            if training.is_done and arm not in results:
                results[arm] = training.result()
            seconds[arm] += time.process_time() - begun_s
    return results


def _chosen(config: TrainConfig, prepared: TrainConfig) -> dict[str, Any]:
    """The values that settings which were "auto" have in a prepared training."""
    names = [field.name for field in fields(TrainConfig) if getattr(config, field.name) == "auto"]
    return {name: value for name in names if (value := getattr(prepared, name)) != "auto"}


def _key_of_steps(prepared: PreparedTraining) -> str:
    """Hash of all that decides the bits of a prepared training, whatever settings led there."""
    config = prepared.config
    extent = working_extent(prepared.views.cameras, prepared.initial, config.max_extent_per_distance)
    config = with_settings(config, {**_PREPARED_ONLY, "max_extent_per_distance": None})
    if hasattr(config.density, "pixels_per_splat"):
        config = with_settings(config, {"density.pixels_per_splat": None})
    return content_key(training_key(prepared.initial, prepared.views, config, prepared.options), extent)[:16]


def _metrics(rows: Sequence[KindRow]) -> list[Metric]:
    metrics, first = [], min((row.seed, row.split) for row in rows)
    for row in rows:
        if row.arm in (DEFAULT, PLAIN, PLAIN_LONGER) and (row.seed, row.split) == first:
            of_arm = [other_row for other_row in rows if (other_row.scene, other_row.arm) == (row.scene, row.arm)]
            for figure, unit in (("psnr_db", "dB"), ("psnr_cc_db", "dB"), ("cpu_s", "s"), ("num_gaussians", "1")):
                value = float(np.mean([np.mean(getattr(other_row, figure)) for other_row in of_arm]))
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
    bounds = {name: {"mean": difference.mean, "low": difference.low, "high": difference.high} for name, difference in differences.items()}
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
            means = [f"{np.mean([np.mean(row.psnr_db) for row in arm_rows]):.2f}" for arm_rows in both]
            costs = (
                " / ".join(f"{np.mean([row.cpu_s for row in arm_rows]):.1f}" for arm_rows in both),
                " / ".join(f"{np.mean([row.num_gaussians for row in arm_rows]):,.0f}" for arm_rows in both),
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
    for helper, pairs in pairs_by_helper(rows).items():
        means = sorted((difference_of([pair], "psnr_db").mean, pair.with_it[0].scene) for pair in pairs)
        least, most = (f"{mean:+.2f}, {scene}" for mean, scene in (means[0], means[-1]))
        acting = f"{sum(pair.acts for pair in pairs)} of {len(pairs)}"
        lines.append(_line(helper, acting, _bounded(difference_of(pairs, "psnr_db")), most, least))
    return lines


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
    overrides = {
        "kinds": options.kinds,
        "numbers": None if options.num_photographs is None else (options.num_photographs,),
        "helpers": options.methods,
        "seeds": None if options.num_seeds is None else tuple(range(options.num_seeds)),
        "splits": tuple(range(options.num_splits)),
        "long_side_px": options.long_side_px,
        "num_steps": options.num_steps,
    }
    return KindsBench(out=options.out, **{**some, **{name: value for name, value in overrides.items() if value}})
