"""The shipped finished runs: every view draws them, and only the planted seam is seen."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_core.choices import View
from radiant_viewer.layers.seam_layer import color_steps, seam_pieces
from radiant_viewer.runs.border_figures import seam_band_width
from radiant_viewer.runs.run_pictures import screenshot
from radiant_viewer.runs.run_view import load_run_view, require_splats

RUNS = sample_scenes_folder() / "runs"


@pytest.mark.parametrize("view", get_args(View))
def test_every_view_draws_the_tiny_run(view: str) -> None:
    image = screenshot(RUNS / "tiny", view)
    assert image.ndim == 3 and image.std() > 5, "a picture with something on it"


def border_step(run: Path) -> float:
    view = load_run_view(run)
    width = seam_band_width(view.cloud_plan)
    steps = color_steps(require_splats(view), seam_pieces(view.cloud_plan, width), width, pooled_widths=np.inf).levels
    assert np.isfinite(steps).all() and np.ptp(steps) < 1e-9, "two regions share one border, which has one figure"
    return float(steps[0])


def test_the_planted_seam_stands_out_by_its_height() -> None:
    plain, planted = border_step(RUNS / "tiny"), border_step(RUNS / "planted_seam")
    # 30 levels were planted, on top of what the scene's own colours step there.
    assert planted - plain == pytest.approx(30, abs=15), f"{plain:.1f} → {planted:.1f} levels"


def test_no_run_says_where_it_was_made() -> None:
    for manifest in RUNS.glob("*/manifest.json"):
        assert '"sample_scenes/hamlet/images"' in manifest.read_text()
        assert "/tmp/" not in manifest.read_text()
