"""Benchmark of the borders' forecast: what it said of each border of finished runs, beside what came out there.

A border's measured loss is the PSNR of its regions' interior less that of the border's band, over all held-out photographs. Content differs
between the two by more than seams do, so with a `baseline`, a model of all photographs in the same frame
(`baseline.ply` beside the runs), the loss is that of the run less
that of the baseline at the same pixels. Band pixels are those whose ground, by the baseline's depth, else the run's own, lies in the
band, each given to the nearest border. The rank correlation over all borders says what the forecast is worth. Runs with shared frames only;
seconds a run, for its held-out views are rendered anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr  # pyright: ignore[reportMissingTypeStubs]

from radiant_app.report.progress import tracked
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db_of_mse
from radiant_core.evaluate.metric import Metric
from radiant_core.evaluate.split import held_out_mask
from radiant_core.io.photos.listing import load_photograph
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_cameras, load_plan, load_scene
from radiant_core.numerics import FloatArray
from radiant_core.plan.borders.borders import Border, shared_borders
from radiant_core.plan.borders.footprints import ground_footprints, views_of_cameras
from radiant_core.plan.borders.forecast import BorderForecast, forecast_borders
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.power_diagram import assign
from radiant_core.render.rendered_view import RenderedView, render_views

MIN_BORDER_PIXELS = 2000
"""A border with fewer held-out pixels in its band has no figure."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredBorder:
    """A border's forecast and what came out: PSNR of its band and of the interior of its two regions, in dB."""

    run: str
    forecast: BorderForecast
    band_psnr_db: float
    interior_psnr_db: float
    num_pixels: int
    baseline_loss_db: float = 0.0
    """Interior less band of the baseline at the same pixels, 0 without one."""
    baseline_band_psnr_db: float | None = None
    """PSNR of the baseline in the band."""

    @property
    def loss_db(self) -> float:
        """Interior less band, beyond that of the baseline."""
        return self.interior_psnr_db - self.band_psnr_db - self.baseline_loss_db


def bench_borders(folder: Path, baseline: Path | None = None) -> list[Metric]:
    """`borders.<run>.<edge>-<edge>.…` of a finished run, or of all in a folder of runs, and the rank correlations over all of them."""
    runs = [folder] if (folder / "manifest.json").is_file() else sorted(path.parent for path in folder.glob("*/manifest.json"))
    if not runs:
        raise BadInput(f"{folder} is no finished run and holds none: give the folder of a run, or one whose folders are runs.")
    rows = [row for run in tracked(runs, "bench borders") for row in measured_borders(run, baseline)]
    return [*(metric for row in rows for metric in _metrics(row)), *correlations(rows)]


def measured_borders(run: Path, baseline: Path | None = None) -> list[MeasuredBorder]:
    """Every border of a finished run that enough held-out pixels show."""
    plan, _ = load_plan(run / "plan.json")
    scene = load_scene(run / "sfm" / "scene.safetensors")
    training = scene.cameras.select(np.flatnonzero(~held_out_mask(scene.cameras.names)))
    views = views_of_cameras(training, float(np.median(scene.points[:, 2])))
    forecasts = forecast_borders(plan, views, ground_footprints(views))
    borders = shared_borders(plan)
    half_band_m = forecasts[0].half_band_m if forecasts else 1.0
    models = [run / "scene.ply"] if baseline is None else [run / "scene.ply", baseline]
    squared = _squared_errors(run, models, plan, borders, half_band_m)
    rows: list[MeasuredBorder] = []
    for index, (border, forecast) in enumerate(zip(borders, forecasts, strict=True)):
        band, inner = squared[len(plan.edge_ids) + index], squared[[border.first, border.second]].sum(axis=0)
        if band[-1] < MIN_BORDER_PIXELS or inner[-1] == 0:
            continue
        band_db, inner_db = ([psnr_db_of_mse(value / part[-1]) for value in part[:-1].tolist()] for part in (band, inner))
        rows.append(
            MeasuredBorder(
                run=run.name,
                forecast=forecast,
                band_psnr_db=band_db[0],
                interior_psnr_db=inner_db[0],
                num_pixels=int(band[-1]),
                baseline_loss_db=inner_db[1] - band_db[1] if baseline is not None else 0.0,
                baseline_band_psnr_db=band_db[1] if baseline is not None else None,
            )
        )
    return rows


def correlations(rows: Sequence[MeasuredBorder]) -> list[Metric]:
    """Spearman's rank correlation of each term of the forecast with what was measured, over all borders; −1 is a perfect forecast.

    Measured: the loss, and with a baseline how far the run is behind it in the band.
    """
    metrics = [Metric(key="borders.all.num_borders", value=len(rows), unit="1", direction="info")]
    if len(rows) < 4:
        return metrics
    measured = {"loss": [row.loss_db for row in rows]}
    behind = [row.baseline_band_psnr_db - row.band_psnr_db for row in rows if row.baseline_band_psnr_db is not None]
    if len(behind) == len(rows):
        measured["behind_baseline"] = behind
    terms = {
        "coverage": [row.forecast.coverage for row in rows],
        "support": [min(row.forecast.support) for row in rows],
        "images": [min(row.forecast.num_images) for row in rows],
    }
    for (name, values), (what, losses) in product(terms.items(), measured.items()):
        value = _rank_correlation(values, losses)
        metrics.append(Metric(key=f"borders.all.rank_correlation_of_{name}_with_{what}", value=value, unit="1", direction="info"))
    return metrics


def _rank_correlation(one: Sequence[float], other: Sequence[float]) -> float:
    result: Any = spearmanr(one, other)
    return float(result.statistic)


def _squared_errors(run: Path, models: Sequence[Path], plan: CloudPlan, borders: Sequence[Border], half_band_m: float) -> FloatArray:
    """(E + B, M + 1): squared error of each model and pixels of each region's interior and each border's band, over held-out photographs.

    The last model says where the ground is.
    """
    cameras = load_cameras(run / "evaluation" / "cameras.safetensors")
    sums = np.zeros((len(plan.edge_ids) + len(borders), len(models) + 1))
    rendered = zip(*(render_views(load_ply(model), cameras) for model in models), strict=True)
    for index, views in enumerate(rendered):
        height, width = views[0].image.shape[:2]
        photograph = load_photograph(run / "evaluation" / "photos" / views[0].name, (width, height))
        ground = _ground(views[-1], cameras, index)
        shown = np.isfinite(ground[..., 0])
        part = _parts(ground[shown], plan, borders, half_band_m)
        for column, view in enumerate(views):
            errors = ((view.image - photograph) ** 2).mean(axis=2)[shown]
            sums[:, column] += np.bincount(part, weights=errors, minlength=len(sums))
        sums[:, -1] += np.bincount(part, minlength=len(sums))
    return sums


def _parts(spots: FloatArray, plan: CloudPlan, borders: Sequence[Border], half_band_m: float) -> NDArray[np.int64]:
    """For each spot (K,2) its region, or E and more for the nearest border in whose band it lies."""
    region = assign(spots, plan.sites, plan.weights)
    part, nearest_m = region.copy(), np.full(len(spots), np.inf)
    for index, border in enumerate(borders):
        away_m = border.distances_m(spots)
        nearer = np.isin(region, (border.first, border.second)) & (away_m <= half_band_m) & (away_m < nearest_m)
        part[nearer], nearest_m[nearer] = len(plan.edge_ids) + index, away_m[nearer]
    return part


def _ground(view: RenderedView, cameras: Cameras, index: int) -> FloatArray:
    """The ground (H,W,2) under the pixels of a view, NaN where there is none."""
    width, height = cameras.sizes_wh[index].tolist()
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    depth = np.where(np.isfinite(view.depth) & (view.depth > 0), view.depth, np.nan)
    in_camera = np.stack([columns, rows, np.ones_like(rows)], axis=2) @ np.linalg.inv(cameras.Ks[index]).T * depth[..., None]
    in_world: FloatArray = (in_camera - cameras.cam_from_world[index, :3, 3]) @ cameras.cam_from_world[index, :3, :3]
    return in_world[..., :2]


def _metrics(row: MeasuredBorder) -> list[Metric]:
    forecast = row.forecast
    key = f"borders.{row.run}.{'-'.join(forecast.edge_ids)}"
    return [
        Metric(key=f"{key}.loss_db", value=row.loss_db, unit="dB", direction="lower"),
        Metric(key=f"{key}.band_psnr_db", value=row.band_psnr_db, unit="dB", direction="higher"),
        Metric(key=f"{key}.coverage", value=forecast.coverage, unit="1", direction="info"),
        Metric(key=f"{key}.support", value=min(forecast.support), unit="1", direction="info"),
        Metric(key=f"{key}.images", value=min(forecast.num_images), unit="1", direction="info"),
        Metric(key=f"{key}.forward_overlap", value=forecast.forward_overlap or 0.0, unit="1", direction="info"),
        Metric(key=f"{key}.side_overlap", value=forecast.side_overlap or 0.0, unit="1", direction="info"),
        Metric(key=f"{key}.num_pixels", value=row.num_pixels, unit="1", direction="info"),
    ]
