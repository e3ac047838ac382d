"""Rules of a cleaning against plain loops, their file against strangers, and undo to the last Gaussian."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.path import Path as Outline

from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.geometry.cleaning import (
    Cleaning,
    OpacityStep,
    PolygonStep,
    RegionsStep,
    SizeStep,
    SupportStep,
    Surroundings,
    box_step,
    clean,
    keeps,
    keeps_land,
    keeps_places,
)
from radiant_core.geometry.cleaning_file import cleaning_path, load_cleaning, save_cleaning
from radiant_core.geometry.support import Support
from radiant_core.splats import Splats

SQUARE = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))
EVERY_STEP = (
    PolygonStep(corners=SQUARE, keep="outside", low=-2.0, high=5.5),
    RegionsStep(margin=2.0),
    SupportStep(num_views=3, parallax_deg=4.0),
    OpacityStep(at_least=0.05),
    SizeStep(at_most=3.0),
)


def splats_of(count: int, seed: int = 0) -> Splats:
    rng = np.random.default_rng(seed)
    return Splats(
        means=rng.uniform(-20, 20, (count, 3)),
        quats=np.tile([1.0, 0, 0, 0], (count, 1)),
        log_scales=rng.normal(0, 1.5, (count, 3)),
        logit_opacities=rng.normal(0, 3, count),
        sh0=np.zeros((count, 1, 3)),
        shN=np.zeros((count, 0, 3)),
    )


def test_a_polygon_keeps_what_another_library_says_is_inside_of_it() -> None:
    star = tuple((float(r * np.cos(a)), float(r * np.sin(a))) for r, a in zip([15, 5] * 5, np.linspace(0, 2 * np.pi, 11)[:-1], strict=True))
    splats = splats_of(5000)
    inside = Outline(star).contains_points(splats.means[:, :2].astype(np.float64))
    assert 0 < inside.sum() < 5000
    np.testing.assert_array_equal(keeps(PolygonStep(corners=star), splats), inside)
    heights = (splats.means[:, 2] >= -3) & (splats.means[:, 2] <= 4)
    between = PolygonStep(corners=star, low=-3.0, high=4.0)
    np.testing.assert_array_equal(keeps(between, splats), inside & heights)
    np.testing.assert_array_equal(keeps(PolygonStep(corners=star, keep="outside", low=-3.0, high=4.0), splats), ~(inside & heights))


def test_a_box_is_a_polygon_with_heights() -> None:
    splats = splats_of(2000)
    box = np.array([[-5.0, -4, -3], [6, 7, 8.0]])
    expected = ((splats.means >= box[0]) & (splats.means <= box[1])).all(axis=1)
    np.testing.assert_array_equal(keeps(box_step(box), splats), expected)


def test_regions_are_kept_with_their_margin_to_the_nearest_side() -> None:
    splats = splats_of(3000)
    around = Surroundings(regions=(np.array(SQUARE), np.array(SQUARE) + np.array([10.0, 0.0])))
    away = np.maximum(np.maximum([0.0, 0.0] - splats.means[:, :2], splats.means[:, :2] - (20.0, 10.0)), 0)
    distance = np.hypot(*away.T)
    kept = keeps(RegionsStep(margin=2.0), splats, around)
    # A buffer's quarter circles are polygons of 16 sides: short of the circle by less than 0.5 %.
    sure = np.abs(distance - 2.0) > 0.01
    np.testing.assert_array_equal(kept[sure], (distance <= 2.0)[sure])


def test_opacity_and_size_keep_what_is_at_the_threshold() -> None:
    splats = splats_of(4)
    stored = np.array([0.0, -1e-6, 1e-6, -np.log(3)], np.float32)
    splats = Splats(**{**splats.arrays(), "logit_opacities": stored, "log_scales": np.log([[2.0] * 3, [2.1] * 3, [1.0] * 3, [1, 1, 9]])})
    assert keeps(OpacityStep(at_least=0.5), splats).tolist() == [True, False, True, False]
    assert keeps(SizeStep(at_most=2.0001), splats).tolist() == [True, False, True, False]


def test_a_floater_as_wide_as_the_town_goes_by_its_size_alone() -> None:
    splats = splats_of(1000)
    wide = splats.log_scales.copy()
    wide[17] = np.log(500.0)
    result = clean(Splats(**{**splats.arrays(), "log_scales": wide}), Cleaning(steps=(SizeStep(at_most=200.0),)))
    assert result.removed == (1,) and not result.kept[17]


def test_support_keeps_the_background_and_what_enough_photographs_show() -> None:
    splats = splats_of(300)
    support = Support(num_views=np.arange(300) % 5, parallax_deg=np.full(300, 3.0), shown_px=np.ones(300))
    around = Surroundings(support=lambda: support)
    np.testing.assert_array_equal(keeps(SupportStep(num_views=3, parallax_deg=2.0), splats, around), np.arange(300) % 5 >= 3)
    assert not keeps(SupportStep(num_views=1, parallax_deg=4.0), splats, around).any()
    with pytest.raises(BadInput, match="measure it again"):
        keeps(SupportStep(), splats_of(299), around)
    with pytest.raises(BadInput, match="a model alone has no cameras"):
        keeps(SupportStep(), splats)
    with pytest.raises(BadInput, match="without a plan"):
        keeps(RegionsStep(), splats)


def test_steps_count_what_they_alone_leave_out_and_undo_brings_it_back() -> None:
    splats = splats_of(4000)
    cleaning = Cleaning().add(SizeStep(at_most=3.0)).add(OpacityStep(at_least=0.5), PolygonStep(corners=SQUARE))
    result = clean(splats, cleaning)
    assert sum(result.removed) == result.num_left_out == 4000 - result.kept.sum()
    apart = [int((~keeps(step, splats)).sum()) for step in cleaning.steps]
    assert result.removed[0] == apart[0] and all(own <= alone for own, alone in zip(result.removed, apart, strict=True))
    assert cleaning.undo().redo() == cleaning
    assert cleaning.undo(9).steps == () and cleaning.undo(9).redo().redo().redo() == cleaning
    assert clean(splats, cleaning.undo(3)).kept.all()
    assert cleaning.undo().add(SizeStep(at_most=1.0)).undone == ()
    assert Cleaning().undo() == Cleaning() and Cleaning().redo() == Cleaning()


def test_polygons_and_regions_hold_for_places_and_land_too() -> None:
    places = np.array([[0.5, 0.5, 1.0], [0.5, 0.5, 9.0], [5.0, 5.0, 1.0]])
    unit = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    region = (np.array([[-1.0, -1], [3, -1], [3, 3], [-1, 3]]),)
    about_gaussians = (OpacityStep(at_least=0.5), SizeStep(at_most=1.0), SupportStep())
    for step, on_places, on_land in (
        (PolygonStep(corners=unit), [True, True, False], [True, True, False]),
        (PolygonStep(corners=unit, high=5.0), [True, False, False], [True, True, False]),
        (PolygonStep(corners=unit, keep="outside"), [False, False, True], [False, False, True]),
        # A tree over the ground that stays.
        (PolygonStep(corners=unit, low=5.0, keep="outside"), [True, False, True], [True, True, True]),
        (RegionsStep(), [True, True, False], [True, True, False]),
        (RegionsStep(margin=4.0), [True, True, True], [True, True, True]),
    ):
        cleaning = Cleaning(steps=(*about_gaussians, step))
        assert keeps_places(cleaning, places, region).tolist() == on_places
        assert keeps_land(cleaning, places[:, :2], region).tolist() == on_land
    with pytest.raises(BadInput, match="without a plan"):
        keeps_places(Cleaning(steps=(RegionsStep(),)), places, ())
    assert keeps_places(Cleaning(steps=(RegionsStep(),)), np.zeros((0, 3)), region).shape == (0,)


def test_an_empty_model_is_cleaned_to_nothing() -> None:
    steps = (OpacityStep(at_least=0.5), SizeStep(at_most=1.0), PolygonStep(corners=SQUARE))
    assert clean(splats_of(0), Cleaning(steps=steps)).removed == (0, 0, 0)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: PolygonStep(corners=((0, 0), (1, 1))), "2 corners"),
        (lambda: PolygonStep(corners=((0, 0), (1, 1), (1, 0), (0, 1))), "cross"),
        (lambda: PolygonStep(corners=((0, 0), (1, 1), (2, 2))), "no area"),
        (lambda: PolygonStep(corners=((0, 0), (1, 0), (np.nan, 1))), "finite"),
        (lambda: PolygonStep(corners=SQUARE, low=3.0, high=3.0), "hold nothing"),
        (lambda: RegionsStep(margin=-1.0), "0 or more"),
        (lambda: RegionsStep(margin=float("nan")), "0 or more"),
        (lambda: SupportStep(num_views=0), "1 or more"),
        (lambda: OpacityStep(at_least=1.0), "less than 1"),
        (lambda: SizeStep(at_most=0.0), "more than 0"),
    ],
)
def test_a_rule_without_sense_is_refused_in_one_sentence(make, sentence: str) -> None:
    with pytest.raises(BadInput, match=sentence):
        make()


def test_a_file_holds_what_was_saved_in_it(tmp_path: Path) -> None:
    cleaning = Cleaning(steps=EVERY_STEP, undone=EVERY_STEP[:2])
    save_cleaning(tmp_path / "cleaning.json", cleaning)
    assert load_cleaning(tmp_path / "cleaning.json") == cleaning
    assert load_cleaning(tmp_path / "none.json") == Cleaning()
    assert cleaning_path(tmp_path) == tmp_path / "cleaning.json"
    assert cleaning_path(tmp_path / "a.ply") == tmp_path / "a.cleaning.json"


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"version": 2}, "version is 2"),
        ({"schema": "radiant.edits"}, "schema"),
        ({"steps": [{"kind": "brush"}]}, "brush"),
        ({"steps": [{"kind": "size", "at_most": "3"}]}, "at_most"),
        ({"steps": [{"kind": "size", "at_most": -3.0}]}, "more than 0"),
        ({"steps": [{"kind": "size", "at_most": 3.0, "at_least": 1.0}]}, "at_least"),
        ({"steps": [{"kind": "polygon", "corners": [[0, 0], [1, 0]]}]}, "2 corners"),
        ({"more": 1}, "more"),
    ],
)
def test_a_file_that_is_no_cleaning_is_refused_in_one_sentence(change: dict[str, object], sentence: str, tmp_path: Path) -> None:
    path = tmp_path / "cleaning.json"
    save_cleaning(path, Cleaning(steps=EVERY_STEP))
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(StoreDamaged, match=sentence) as caught:
        load_cleaning(path)
    assert "\n" not in str(caught.value)


def test_mutated_files_are_read_or_refused_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "cleaning.json"
    save_cleaning(path, Cleaning(steps=EVERY_STEP))
    whole, rng = path.read_bytes(), np.random.default_rng(5)
    for _ in range(300):
        data = bytearray(whole)
        for place in rng.integers(0, len(data), rng.integers(1, 6)):
            data[place] = rng.integers(0, 256)
        path.write_bytes(bytes(data[: rng.integers(1, len(data) + 1)]))
        try:
            load_cleaning(path)
        except StoreDamaged:
            continue
