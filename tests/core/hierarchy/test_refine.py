"""Refining a joined scene: devices' photographs speak, nothing is added, light and memory are kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.aggregate.averaging import admit_refinement, join_refinements, refine_scene, refinement_problem
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.evaluate.shown_pixels import count_shown_photographs
from radiant_core.hierarchy.codec import load_refinement, passed_refinement, save_refinement
from radiant_core.hierarchy.messages import RefineTask
from radiant_core.hierarchy.refine import refine_device
from radiant_core.hierarchy.refining_plan import refining_steps
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from radiant_core.train.config import train_preset
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats

TRUTH = ground_splats(1500)
BLURRED = replace(TRUTH, sh0=TRUTH.sh0 + np.random.default_rng(0).normal(0, 0.3, TRUTH.sh0.shape).astype(np.float32))
CAMERAS = [cameras_above([(x, y) for y in (-1.0, 0.0, 1.0)], size_wh=(64, 48)) for x in (-2.0, 2.0)]
TASK = RefineTask(train=replace(train_preset("draft"), long_side_px=64), backend="native", epochs=4)


def photographs(cameras_of: int, gain: float = 1.0) -> TrainingViews:
    cameras = CAMERAS[cameras_of]
    images = [np.clip(view.image * 255 * gain, 0, 255).round().astype(np.uint8) for view in render_views(TRUTH, cameras, "native")]
    return TrainingViews(cameras=cameras, images=tuple(images))


def error_db(scene: Splats) -> float:
    shown = [view.image for cameras in CAMERAS for view in render_views(scene, cameras, "native")]
    taken = [image / 255 for which in (0, 1) for image in photographs(which).images]
    return float(np.mean([psnr_db(render, photograph) for render, photograph in zip(shown, taken, strict=True)]))


def test_a_blurred_scene_gains_from_photographs_of_two_devices_and_keeps_its_rows() -> None:
    refinements = [refine_device(TASK, BLURRED, photographs(which), Recorder()) for which in (0, 1)]
    for one in refinements:
        assert refinement_problem(one, BLURRED, num_dealt=3) is None
        assert 0 < len(one.rows) < len(BLURRED) and one.splats.sh_degree == BLURRED.sh_degree
    passed = [passed_refinement(one, "float16", BLURRED) for one in refinements]
    kept = [one for one in passed if not isinstance(one, str)]
    assert len(kept) == 2
    admitted = [
        admit_refinement(one, BLURRED, count_shown_photographs(BLURRED, CAMERAS[which], "native")) for which, one in enumerate(kept)
    ]
    refined = refine_scene(BLURRED, [join_refinements(admitted, BLURRED)])
    assert len(refined) == len(BLURRED)
    assert error_db(refined) > error_db(BLURRED) + 1.0
    seen = np.union1d(refinements[0].rows, refinements[1].rows)
    others = np.setdiff1d(np.arange(len(BLURRED)), seen)
    np.testing.assert_array_equal(refined.sh0[others], BLURRED.sh0[others])
    again = refine_device(TASK, BLURRED, photographs(0), Recorder())
    np.testing.assert_array_equal(again.splats.means, refinements[0].splats.means)


def test_a_device_whose_photographs_are_darker_does_not_darken_the_scene() -> None:
    reporter = Recorder()
    refinement = refine_device(TASK, BLURRED, photographs(0, gain=0.7), reporter)
    (decision,) = reporter.decisions
    assert decision.topic == "light of the photographs" and decision.figure == pytest.approx(100 * (1 / 0.7 - 1), abs=8)
    lit = refine_scene(BLURRED, [refinement])
    assert error_db(lit) > error_db(BLURRED) + 0.3


def test_too_little_memory_or_nothing_in_sight_refines_nothing_and_says_so() -> None:
    reporter = Recorder()
    nothing = refine_device(replace(TASK, memory_bytes=1e6), BLURRED, photographs(0), reporter)
    assert not len(nothing.rows) and [decision.topic for decision in reporter.decisions] == ["refinement"]
    (warning,) = reporter.warnings
    assert "memory_gb of the device allows 0.00" in warning and "Raise that memory_gb in the system file of the next run" in warning
    away = replace(BLURRED, means=BLURRED.means + np.float32(1e4))
    assert not len(refine_device(TASK, away, photographs(0), Recorder()).rows)
    same = refine_scene(BLURRED, [nothing])
    assert all((same.arrays()[name] == array).all() for name, array in BLURRED.arrays().items())


def test_an_empty_refinement_and_a_broken_file_arrive_as_what_they_are(tmp_path: Path) -> None:
    nothing = refine_device(replace(TASK, memory_bytes=1e6), BLURRED, photographs(0), Recorder())
    save_refinement(tmp_path, nothing, BLURRED, "spz", lambda message: None)
    arrived = load_refinement(tmp_path, BLURRED)
    assert not isinstance(arrived, str) and not len(arrived.rows)
    other = load_refinement(tmp_path, replace(BLURRED, sh0=BLURRED.sh0 + 1))
    assert isinstance(other, str) and "another scene than the one that was sent" in other
    (tmp_path / "rows.safetensors").write_bytes(b"no arrays")
    assert isinstance(load_refinement(tmp_path, BLURRED), str)
    (tmp_path / "rows.safetensors").unlink()
    assert isinstance(load_refinement(tmp_path, BLURRED), str)


def test_devices_with_many_photographs_show_each_at_least_once_and_drift_no_further() -> None:
    """Up to 200 steps in a round were measured to gain (docs/experiments/aggregation.md)."""
    assert [refining_steps(8, views) for views in (1, 13, 25, 26, 88, 199, 201)] == [8, 104, 200, 200, 200, 200, 201]
    assert refining_steps(1, 500) == 500


def test_a_refinement_of_an_earlier_round_is_none_of_this_one(tmp_path: Path) -> None:
    """Whoever sends what it sent before: the scene that it refines stands in it."""
    first = refine_device(TASK, BLURRED, photographs(0), Recorder())
    save_refinement(tmp_path, first, BLURRED, "float16", lambda message: None)
    assert not isinstance(load_refinement(tmp_path, BLURRED), str)
    second_start = refine_scene(BLURRED, [first])
    assert load_refinement(tmp_path, second_start) == "it refines another scene than the one that was sent: run that node again."
