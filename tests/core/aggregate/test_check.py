"""Joined against cut, on the models' own pictures: the better of both is kept and said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.aggregate import join
from radiant_core.aggregate.config import Join, aggregate_preset
from radiant_core.aggregate.join import NUM_COMPARED, Check, Joined, cut_at_borders, join_models, most_contested
from radiant_core.aggregate.retrain import Retrained
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.hierarchy.decisions import join_decisions
from radiant_core.plan.regions.claims import claims_of_cells
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.trainer import FitOptions
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats

NUM_VIEWS = 16
CLAIMS = claims_of_cells(np.array([[-2.0, 0.0], [2.0, 0.0]]), np.zeros(2))
TRAIN = replace(train_preset("draft"), long_side_px=48)


def teachers(num_views: int = NUM_VIEWS) -> list[Teacher]:
    """Two halves of a ground, each grey beyond the middle, with so many views together."""
    truth, found = ground_splats(), []
    for sign in (-1, 1):
        sh0 = np.where((sign * truth.means[:, 0] > -1)[:, None, None], truth.sh0, 0)
        places = [(2.0 * sign, float(y)) for y in np.linspace(-1.5, 1.5, num_views // 2)]
        found.append(Teacher(splats=replace(truth, sh0=sh0), cameras=cameras_above(places)))
    return found


def joined(num_views: int = NUM_VIEWS, num_tiles: int = 1, **settings: object) -> Joined:
    config = Join(**settings)  # type: ignore[arg-type]
    return join_models(teachers(num_views), TRAIN, config, FitOptions(backend="native"), CLAIMS, num_tiles)


def ruin(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make retraining return a model of one colour."""
    whole = join.retrain_by_tiles

    def ruined(moving: Splats, views: TrainingViews, train: TrainConfig, *others: object) -> Retrained:
        made = whole(moving, views, train, *others)  # type: ignore[arg-type]
        grey = replace(made.splats, sh0=np.zeros_like(made.splats.sh0))
        return replace(made, trained=replace(made.trained, splats=grey))

    monkeypatch.setattr(join, "retrain_by_tiles", ruined)


@pytest.mark.parametrize("num_tiles", [1, 2])
def test_a_joined_model_that_is_worse_is_not_kept_and_the_decision_says_so(num_tiles: int, monkeypatch: pytest.MonkeyPatch) -> None:
    ruin(monkeypatch)
    result = joined(num_tiles=num_tiles)
    assert result.check is not None and not result.check.keeps_joined and result.trained.num_steps > 0
    cut = cut_at_borders(teachers(), CLAIMS).splats
    for name, array in result.splats.arrays().items():
        np.testing.assert_array_equal(array, cut.arrays()[name], err_msg=name)
    (decision,) = (one for one in join_decisions("edges/a", Join(), 2, result) if one.topic == "joined or cut")
    assert decision.choice == "the cut model is kept" and decision.unit == "dB over the joined one" and not decision.changes_nothing
    assert result.check.cut_db > result.check.joined_db + 3 and decision.figure == pytest.approx(
        result.check.cut_db - result.check.joined_db
    )
    assert f"{result.check.cut_db:.2f} dB in {NUM_COMPARED} of the models' own pictures" in decision.reason


def test_a_joined_model_that_is_better_is_kept_and_the_decision_says_by_how_much() -> None:
    result = joined()
    assert result.check is not None and result.check.keeps_joined
    (decision,) = (one for one in join_decisions("cloud", Join(), 2, result) if one.topic == "joined or cut")
    assert decision.choice == "the joined model is kept" and decision.unit == "dB over the cut one" and decision.changes_nothing
    assert result.check.joined_db > result.check.cut_db and decision.figure == pytest.approx(result.check.joined_db - result.check.cut_db)


@pytest.mark.parametrize("num_views", [2, 3 * NUM_COMPARED])
def test_every_view_is_shown_and_some_are_compared(num_views: int) -> None:
    result = joined(num_views, epochs=1)
    assert result.trained.num_steps == num_views
    assert result.check is not None and result.check.num_views == min(NUM_COMPARED, num_views)
    assert len([one for one in join_decisions("cloud", Join(), 2, result) if one.topic == "joined or cut"]) == 1


def test_views_that_show_little_of_what_two_models_know_decide_nothing() -> None:
    """In those a cut is its teacher's own picture to the bit, and any retrained model is worse."""
    shares = np.random.default_rng(0).permutation(40) / 40
    chosen = most_contested(shares)
    assert len(chosen) == NUM_COMPARED and (np.diff(chosen) > 0).all() and shares[chosen].min() >= 0.5
    assert shares[chosen].max() > 0.9 and np.ptp(shares[chosen]) > 0.4, "and not the most alone"
    np.testing.assert_array_equal(most_contested(shares[:5]), np.arange(5))
    np.testing.assert_array_equal(most_contested(np.ones(9)), np.arange(8))


def test_the_figures_are_of_all_pixels_so_that_a_view_that_a_cut_leaves_alone_weighs_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """A view 60 dB well does not outweigh three of 20: a mean in dB would be 30."""
    views_db = iter([[25.0], [30.0] * 4, [60.0, 20.0, 20.0, 20.0]])
    monkeypatch.setattr(join, "_psnr_db", lambda *_: next(views_db))
    result = joined(16, epochs=1)
    assert result.check is not None and result.check.joined_db == pytest.approx(30)
    assert result.check.cut_db == pytest.approx(20 + 10 * np.log10(4 / 3), abs=1e-3)


def test_equal_figures_keep_the_joined_one() -> None:
    assert Check(num_views=1, joined_db=30.0, cut_db=30.0).keeps_joined
    assert not Check(num_views=1, joined_db=29.9, cut_db=30.0).keeps_joined


def test_the_paper_compares_nothing() -> None:
    result = join_models(teachers(), TRAIN, replace(aggregate_preset("paper").cloud, epochs=1), FitOptions(backend="native"), CLAIMS)
    assert result.check is None and result.trained.num_steps == NUM_VIEWS
