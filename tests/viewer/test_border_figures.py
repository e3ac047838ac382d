"""Of a border only what was photographed counts: a made-up town with a rim that no camera saw."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.cameras import Cameras
from radiant_core.evaluate.observed_ground import observed_coverage
from radiant_core.io.run_store import write_json
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.splats import SH_C0, Splats
from radiant_viewer.layers.palette import heat_colors
from radiant_viewer.runs.border_figures import BorderFigures, border_figures
from radiant_viewer.runs.run_layers import figures_layer
from radiant_viewer.runs.seam_findings import excess_text, proven_excess_db, seam_findings, verdict_text
from radiant_viewer.runs.seam_tour import seam_stops
from tests.viewer.made_up_run import Town, made_up_town

TRUE_LEVELS, FALSE_LEVELS = 20.0, 120.0
RIM_X_M = 75.0
"""East of it nobody took photographs, and the model steps by what nobody saw."""
FLOWN_TO_X_M = 45.0


def flown_over_the_west() -> Town:
    """ "harbour" is brighter by a true step, and by a false one where no camera looked."""
    town = made_up_town(step_levels=TRUE_LEVELS)
    x, y = town.splats.means[:, 0], town.splats.means[:, 1]
    harbour = ((np.stack([x, y], axis=1)[:, None] - town.cloud_plan.sites) ** 2).sum(axis=2).argmin(axis=1) == 1
    sh0 = town.splats.sh0 + np.where((x > RIM_X_M) & harbour, FALSE_LEVELS / 255 / SH_C0, 0.0)[:, None, None].astype(np.float32)
    west = np.flatnonzero(town.scene.cameras.centers[:, 0] <= FLOWN_TO_X_M)
    scene = replace(town.scene, cameras=town.scene.cameras.select(west))
    return replace(town, scene=scene, splats=replace(town.splats, sh0=sh0))


def to_the_rim(town: Town) -> BorderFigures:
    """The border of "harbour" and "quarry", which ends at the rim in the east."""
    found = [one for one in border_figures(town.scene, town.cloud_plan, town.splats) if one.names == ("harbour", "quarry")]
    assert max(found[0].border.ends[:, 0]) > 110
    return found[0]


def test_the_worst_place_is_where_photographs_are_and_not_at_a_false_step_beyond_them() -> None:
    town = flown_over_the_west()
    figures = to_the_rim(town)
    assert figures.has_verdict and figures.has_step
    assert figures.step_levels == pytest.approx(TRUE_LEVELS, abs=4)
    assert 0.3 * figures.border.length_m < figures.observed_length < 0.9 * figures.border.length_m
    stop = next(stop for stop in seam_stops(town.scene, town.cloud_plan, town.splats) if stop.figures.names == figures.names)
    assert stop.worst[0] < RIM_X_M
    assert stop.worst_levels == pytest.approx(TRUE_LEVELS, abs=6)
    assert figures.observed_ends[:, 0].max() < RIM_X_M + 20 < figures.border.ends[:, 0].max()


def test_the_false_step_is_there_and_would_be_the_worst_if_all_had_been_photographed() -> None:
    town = flown_over_the_west()
    seen = replace(town, scene=made_up_town().scene)
    figures = to_the_rim(seen)
    assert figures.worst is not None
    assert figures.levels[figures.worst] > 3 * TRUE_LEVELS
    assert figures.ends[figures.worst].mean(axis=0)[0] > 50


def without_cameras(scene: SfmScene) -> SfmScene:
    return replace(scene, cameras=scene.cameras.select(np.zeros(0, np.int64)))


def turned_up(scene: SfmScene) -> SfmScene:
    """Cameras that look at the sky, as with a wrong up."""
    turn = np.diag([1.0, -1.0, -1.0, 1.0])
    cameras = scene.cameras
    poses = np.array([turn @ pose for pose in cameras.cam_from_world])
    return replace(scene, cameras=Cameras(names=cameras.names, Ks=cameras.Ks, cam_from_world=poses, sizes_wh=cameras.sizes_wh))


@pytest.mark.parametrize("unseen", [without_cameras, turned_up])
def test_without_photographs_of_a_border_there_is_no_verdict(unseen: Callable[[SfmScene], SfmScene]) -> None:
    town = made_up_town(step_levels=60)
    scene = unseen(town.scene)
    figures = border_figures(scene, town.cloud_plan, town.splats)
    assert [one.has_verdict for one in figures] == [False] * 3
    assert all(one.worst is None and np.isnan(one.step_levels) and one.observed_length == 0 for one in figures)
    findings = seam_findings(scene, town.cloud_plan, town.splats)
    assert not any(finding.has_seam for finding in findings)
    text = verdict_text(findings, "m")
    assert text.startswith("No verdict") and "levels" not in text
    stops = seam_stops(scene, town.cloud_plan, town.splats)
    np.testing.assert_allclose(stops[0].worst, stops[0].ends.mean(axis=0))


def test_the_caption_gives_the_step_of_the_brightest_piece_and_of_the_whole_border() -> None:
    town = made_up_town(step_levels=60)
    findings = seam_findings(town.scene, town.cloud_plan, town.splats)
    layer = figures_layer(town.scene, town.cloud_plan, [finding.figures for finding in findings])
    form = r"largest over a border: .*, ([\d.]+) levels beside [\d.]+ of texture; over a piece: up to ([\d.]+)"
    found = re.search(form, verdict_text(findings, "m"))
    assert found is not None and layer.heat is not None
    whole, piece = (float(group) for group in found.groups())
    levels = np.concatenate([finding.figures.levels_above_texture for finding in findings])
    assert piece == pytest.approx(np.nanmax(levels), abs=0.05) and whole <= piece <= layer.heat.high
    brightest = layer.segment_colors[int(np.nanargmax(levels))]
    np.testing.assert_array_equal(brightest, heat_colors(np.array([np.nanmax(levels)]), layer.heat.low, layer.heat.high)[0])


def test_nothing_found_says_how_little_was_looked_at_and_what_could_not_be_told() -> None:
    town = flown_over_the_west()
    plain = made_up_town()
    text = verdict_text(seam_findings(town.scene, plain.cloud_plan, plain.splats), "m")
    assert text.startswith("No step of 10 levels of 255 or more could be told from texture; observed: ")
    found = re.search(r"observed: ([\d.]+) m of ([\d.]+) m", text)
    assert found is not None, text
    observed, total = (float(group) for group in found.groups())
    figures = border_figures(town.scene, plain.cloud_plan, plain.splats)
    assert total == pytest.approx(sum(one.border.length_m for one in figures), rel=1e-2)
    assert observed == pytest.approx(sum(one.observed_length for one in figures if one.has_verdict), rel=1e-2)
    assert observed < 0.8 * total


def checkered(splats: Splats, levels: float) -> Splats:
    """Stripes of 28 m along the borders' normals, so strong that a step of 20 levels drowns."""
    waves = np.sin(2 * np.pi * splats.means[:, :1] / 28) + np.sin(2 * np.pi * splats.means[:, 1:2] / 28)
    return replace(splats, sh0=splats.sh0 + (waves * levels / 255 / SH_C0)[:, None].astype(np.float32))


def test_a_step_that_drowns_in_texture_is_not_told() -> None:
    town = made_up_town(step_levels=15)
    clear, drowned = (
        {one.names: one for one in border_figures(town.scene, town.cloud_plan, splats)}
        for splats in (town.splats, checkered(town.splats, 60))
    )
    names = ("north", "harbour")
    assert clear[names].has_step and clear[names].detectable_levels == 10
    assert drowned[names].detectable_levels > clear[names].step_levels
    assert not drowned[names].has_step and str(math.ceil(drowned[names].detectable_levels)) in drowned[names].verdict


def test_the_shares_are_those_of_the_images_that_show_a_place() -> None:
    town = made_up_town()
    centers = town.scene.cameras.centers
    # From 60 m above a camera sees 38.4 m to either side: the last one of its row alone sees 30 m
    # beyond itself.
    east = float(centers[:, 0].max())
    places: FloatArray = np.array([[0.0, 0.0], [east + 8, 0.0], [east + 30, 0.0], [400.0, 0.0]])
    middle, rim, seen_once, far = observed_coverage(places, town.scene, 10.0)
    assert middle > 0.8
    assert 0 < rim < middle
    assert seen_once == far == 0
    # Images show the middle, and no two of them agreed on a point near it.
    around = town.scene.points[np.linalg.norm(town.scene.points[:, :2], axis=1) > 10.0]
    bare = replace(town.scene, points=around, colors=town.scene.colors[: len(around)])
    assert observed_coverage(places[:1], bare, 10.0) == 0 < observed_coverage(places[:1], bare, 15.0)
    assert observed_coverage(np.zeros((0, 2)), town.scene, 10.0).shape == (0,)


def test_what_photographs_show_beyond_borders_is_told_where_it_was_measured(tmp_path: Path) -> None:
    assert excess_text(tmp_path) == ""
    write_json(tmp_path / "metrics.json", {"images": []})
    assert excess_text(tmp_path) == ""
    write_json(tmp_path / "metrics.json", {"seam_excess_db": 2.04, "seam_found": True})
    assert excess_text(tmp_path) == "Photographs show the ground beyond borders +2.04 dB worse: a seam."


def test_a_seam_that_photographs_show_is_found_without_a_step(tmp_path: Path) -> None:
    town = made_up_town()
    assert proven_excess_db(tmp_path) == {}
    rows = [
        {"between": ["harbour", "north"], "seam_excess_db": 1.5, "seam_found": True},
        {"between": ["harbour", "south"], "seam_excess_db": 0.1, "seam_found": False},
        {"between": ["north", "south"], "seam_excess_db": None, "seam_found": None},
    ]
    write_json(tmp_path / "metrics.json", {"borders": rows})
    proven = proven_excess_db(tmp_path)
    assert proven == {frozenset({"north", "harbour"}): 1.5}
    findings = seam_findings(town.scene, town.cloud_plan, town.splats, proven)
    assert {finding.figures.names: finding.excess_db for finding in findings if finding.has_seam} == {("north", "harbour"): 1.5}
    assert verdict_text(findings, "m").startswith("Seam found at 1 of 3 borders")
    hidden = seam_findings(without_cameras(town.scene), town.cloud_plan, town.splats, proven)
    assert verdict_text(hidden, "m") == "Photographs show a seam at 1 of 3 borders"
