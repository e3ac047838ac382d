"""The rasterizer's benchmark: its scene is what it says, and every time has its error beside it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from benchmarks.raster import bench
from benchmarks.raster.drone_scene import SHARE_IN_FRUSTUM, SceneSize, drone_scene
from radiant_core.splats import morton_order

TINY = SceneSize(num_splats=2000, width=80, height=60)


def test_84_percent_stand_in_the_frustum() -> None:
    splats, cameras = drone_scene(TINY)
    inside = splats.means @ cameras.cam_from_world[0, :3, :3].T + cameras.cam_from_world[0, :3, 3]
    pixels = inside[:, :2] / inside[:, 2:] * cameras.Ks[0, 0, 0] + cameras.Ks[0, :2, 2]
    assert len(splats) == 2000
    assert ((pixels > 0) & (pixels < cameras.sizes_wh[0])).all(1).mean() == pytest.approx(SHARE_IN_FRUSTUM, abs=1e-3)


def test_morton_order_brings_neighbours_together_and_loses_none() -> None:
    splats, _ = drone_scene(TINY)
    ordered = splats.select(morton_order(splats.means))
    steps_m = [np.linalg.norm(np.diff(model.means, axis=0), axis=1).mean() for model in (splats, ordered)]
    assert steps_m[1] < 0.2 * steps_m[0]
    np.testing.assert_array_equal(np.sort(ordered.means[:, 0]), np.sort(splats.means[:, 0]))


def test_every_time_has_its_error_memory_and_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(bench.SIZES, "S", TINY)
    monkeypatch.setitem(bench.NUM_ROUNDS, "S", 1)
    metrics = {metric.key: metric.value for metric in bench.bench_raster(quick=True, threads=1)}
    for order in ("random", "morton"):
        key = f"raster.S.{order}.native"
        assert metrics[f"{key}.fwd_bwd_cpu_ms"] > 0 and metrics[f"{key}.pairs_per_s"] > 0
        assert metrics[f"{key}.image_max_error"] <= 1e-4 and metrics[f"{key}.grad_rel_error"] <= 1e-4
        assert metrics[f"{key}.image_rms_error"] <= 1e-5
        assert 0 < metrics[f"{key}.fma_peak_fraction"] < 1
        assert metrics[f"{key}.peak_rss_bytes"] > 0
        assert metrics[f"{key}.step_cpu_ms"] > 0 and metrics[f"{key}.step_loss_rel_error"] <= 1e-5
        assert f"{key}.thread_scaling" not in metrics
    assert metrics["raster.peak_fma_per_s"] > 1e8


def test_with_two_threads_the_gain_is_told_and_the_number_of_threads_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(bench.SIZES, "S", TINY)
    monkeypatch.setitem(bench.NUM_ROUNDS, "S", 1)
    monkeypatch.setattr(bench, "peak_rss_bytes", lambda *_: 1)
    before = torch.get_num_threads()
    metrics = {metric.key: metric.value for metric in bench.bench_raster(quick=True, threads=2)}
    assert torch.get_num_threads() == before
    assert metrics["raster.S.random.native.thread_scaling"] > 0
