"""Every view against its baseline, and the seam view against the truth: a planted seam is seen and found, an unplanted one is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiant_viewer.pictures.images import Image
from radiant_viewer.runs.run_pictures import seams_picture, splats_picture
from radiant_viewer.runs.seam_findings import seam_findings
from tests.offscreen.pictures import SIZE_WH, VIEWS, baseline, picture
from tests.viewer.made_up_run import Town, made_up_town, save_run

MEAN_LEVELS, MAX_SHARE, FAR_LEVELS = 1.5, 0.02, 40
"""Budget of a picture: mean difference in levels of 255, and the share of pixels that differ by
more than so many; other fonts, other versions of Mesa and other vector units round differently at
edges, by less than this; a missing layer or label by more."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("views") / "run"
    save_run(folder, made_up_town(step_levels=40))
    return folder


def problem(image: Image, expected: Image) -> str | None:
    """How a picture fails its budget, or None."""
    if image.shape != expected.shape:
        return f"size {image.shape}, expected {expected.shape}"
    difference = np.abs(image.astype(int) - expected).max(axis=2)
    far = float((difference > FAR_LEVELS).mean())
    return None if difference.mean() <= MEAN_LEVELS and far <= MAX_SHARE else f"mean {difference.mean():.2f} levels, {far:.1%} far off"


@pytest.mark.parametrize("view", VIEWS)
def test_a_view_looks_as_it_did(run: Path, view: str) -> None:
    assert problem(picture(run, view), baseline(view)) is None, "look at it; python -m tests.offscreen.pictures renews the baselines"


def test_the_budget_notices_what_is_missing() -> None:
    for view in ("regions", "seams"):
        image = baseline(view).copy()
        rows, columns = slice(40, 60), slice(40, 75)
        image[rows, columns] = 255
        assert problem(image, baseline(view)) is not None


def seams_of(town: Town) -> Image:
    # Large enough that labels do not lie on the borders.
    return seams_picture(town.scene, town.cloud_plan, town.splats, (2 * SIZE_WH[0], 2 * SIZE_WH[1]))


def test_a_planted_seam_is_found_at_its_borders_and_no_unplanted_one_anywhere() -> None:
    plain, planted = made_up_town(), made_up_town(step_levels=40)
    assert [finding.has_seam for finding in seam_findings(plain.scene, plain.cloud_plan, plain.splats)] == [False] * 3
    findings = seam_findings(planted.scene, planted.cloud_plan, planted.splats)
    # "harbour", region 1, is brighter: its two borders step, the third does not.
    assert [1 in (finding.figures.border.first, finding.figures.border.second) for finding in findings] == [True, True, False]
    assert [finding.has_seam for finding in findings] == [True, True, False]
    assert [finding.figures.step_levels for finding in findings[:2]] == pytest.approx([40, 40], abs=6)
    # The upper third of viridis, green to yellow, marks what is strong: without a seam it stands in
    # the colour bar alone.
    bar, with_seam = (int(is_strong(seams_of(town)).sum()) for town in (plain, planted))
    assert with_seam > bar + 1200


def is_strong(image: Image) -> np.ndarray:
    """Pixels (H,W) in colours of viridis' upper third, which the town's lawn has not."""
    red, green, blue = (image[..., channel].astype(int) for channel in range(3))
    return (green > 190) & (green - blue > 80) & (red < 255)


def test_the_model_is_drawn_without_jitter_far_from_its_origin() -> None:
    pictures = []
    for shift in ((0.0, 0.0), (8192.0, 16384.0)):
        town = made_up_town(shift)
        image = splats_picture(town.scene, town.cloud_plan, town.splats, SIZE_WH)
        # The title line and the legend are text; the drawing is left of the legend.
        pictures.append(image[70:, : SIZE_WH[0] - 310].astype(int))
    # Means are float32: 16 km from the origin they have steps of 2 mm.
    assert (np.abs(pictures[0] - pictures[1]).max(axis=2) > 16).mean() < 1e-3
