"""Thinning after growth: when rounds begin and end, which Gaussians stay, and that what is left still shows the photographs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from radiant_core.errors import BadInput
from radiant_core.render.contract import SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.splats import concatenate_splats
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.densify.policies import Adc
from radiant_core.train.densify.thinning import Thinning, rows_that_stay, squashed
from radiant_core.train.needs import fit_to_cameras
from radiant_core.train.trainer import FitOptions, NoCheckpoints, Training, fit_splats
from tests.core.scenes import cameras_above, ground_splats
from tests.core.train.test_density import CAMERAS, photographs


def rounds_of(num_steps: int, num_views: int, every: int = 100) -> list[int]:
    """The steps after which Gaussians are left out, as `AdaptiveDensity` asks."""
    thinning, steps = Thinning(share=0.5, until_step=15_000, schedule_steps=30_000, num_views=num_views), []
    for step in range(1, num_steps + 1):
        schedule_step = step * 30_000 / num_steps
        if schedule_step < 15_000 or thinning.begins(schedule_step) or not thinning.is_gathering:
            continue
        thinning.num_gathered += 1
        if step % every == 0 and thinning.has_enough(schedule_step) and thinning.ends(schedule_step):
            steps.append(step)
    return steps


@pytest.mark.parametrize(
    ("num_steps", "num_views", "steps"),
    [
        (1_500, 40, [900, 1_000]),
        (1_500, 60, [900, 1_100]),
        (1_500, 900, [900, 1_100]),  # a tenth of the run, not the epoch
        (1_500, 20, [800, 1_000]),
        (500, 12, [300, 400]),
        (200, 12, []),  # too late to be mended
    ],
)
def test_a_round_gathers_every_view_and_ends_where_edits_are_looked_for(num_steps: int, num_views: int, steps: list[int]) -> None:
    assert rounds_of(num_steps, num_views) == steps


def test_the_share_is_that_of_all_rounds() -> None:
    assert Thinning(share=0.64, until_step=1, schedule_steps=2, num_views=1).share_of_round == pytest.approx(0.8)
    none = Thinning(share=1.0, until_step=1, schedule_steps=2, num_views=1)
    assert not none.begins(1.5) and not none.is_gathering


def test_the_lowest_go_and_what_no_view_sees_stays() -> None:
    scores, view_counts = np.array([5.0, 1.0, 0.0, 4.0, 2.0, 3.0]), np.array([2, 1, 0, 3, 1, 1])
    assert rows_that_stay(scores, view_counts, 0.5).tolist() == [0, 2, 3]
    # Those that no view sees take no place of others.
    many = np.concatenate([view_counts, np.zeros(50, np.int64)])
    assert rows_that_stay(np.concatenate([scores, np.zeros(50)]), many, 0.5)[:4].tolist() == [0, 2, 3, 6]
    assert rows_that_stay(scores[3:], np.zeros(3, np.int64), 0.1).tolist() == [0, 1, 2]
    assert rows_that_stay(np.zeros(0), np.zeros(0, np.int64), 0.5).tolist() == []


def test_much_of_one_view_counts_before_little_of_many() -> None:
    assert squashed(np.array([8.0])) > 10 * squashed(np.array([0.8]))
    assert squashed(np.array([0.0])) == 0 and squashed(np.array([1e30])) <= 1
    assert np.all(np.diff(squashed(np.geomspace(0.01, 1e4, 50))) > 0)


def test_few_photographs_keep_all_and_a_decision_says_which_case_it_is() -> None:
    config = train_preset("default")
    for count, share, row in ((35, 1.0, "few-photographs-whole"), (36, 0.75, "thinned"), (300, 0.75, "thinned")):
        fitted, decisions = fit_to_cameras(config, cameras_above([(0.1 * view, 0.0) for view in range(count)]))
        assert isinstance(fitted.density, Adc) and fitted.density.thin_to == share
        (decision,) = [decision for decision in decisions if decision.topic == "Gaussians after growth"]
        assert decision.row == row and decision.changes_nothing == (share == 1)
    assert not [d for d in fit_to_cameras(train_preset("standard"), CAMERAS)[1] if d.topic == "Gaussians after growth"]


@pytest.mark.parametrize("share", [0.0, -1.0, 1.1, float("nan")])
def test_a_share_is_above_0_and_at_most_1(share: float) -> None:
    with pytest.raises(BadInput, match="thin_to"):
        Adc(thin_to=share)


def config_of(thin_to: float) -> TrainConfig:
    density = Adc(kind="planned", every=20, min_gradient=0.0, reset_opacity_every=10**9, thin_to=thin_to)
    return replace(train_preset("draft"), num_steps=300, max_num_splats=400, start_scale=1.0, density=density)


def test_half_of_the_gaussians_show_almost_the_same_and_hidden_ones_go_first() -> None:
    views, initial = photographs(), ground_splats(60)
    # Behind the ground nothing is seen of them, though they lie within the pictures.
    hidden = replace(initial, means=initial.means - np.array([0, 0, 3], np.float32))
    fits = [fit_splats(concatenate_splats([initial, hidden]), views, config_of(share)) for share in (1.0, 0.5)]
    whole, thinned = (fit.splats for fit in fits)
    assert fits[1].density is not None and fits[1].density.num_thinned > 0.4 * len(whole)
    assert 0.4 * len(whole) < len(thinned) < 0.65 * len(whole)
    assert fits[1].last_loss < 1.25 * fits[0].last_loss
    below = [float((splats.means[:, 2] < -1.5).mean()) for splats in (whole, thinned)]
    assert below[1] < 0.7 * below[0]


def test_a_training_that_was_stopped_while_a_round_gathers_ends_in_the_same_bits() -> None:
    views, initial, config = photographs(), ground_splats(60), config_of(0.5)
    options = FitOptions(checkpoints=NoCheckpoints())
    whole = Training(initial, views, config, options)
    while whole.step < 155:
        whole.take_step()
    state = whole.state()
    assert state.arrays["density.thinning"].tolist() == [1, 0, 5]
    resumed = Training(initial, views, config, options)
    resumed.restore(state)
    for training in (whole, resumed):
        while not training.is_done:
            training.take_step()
    for name, array in whole.result().splats.arrays().items():
        np.testing.assert_array_equal(array, resumed.result().splats.arrays()[name])


def test_scores_are_what_renderings_show() -> None:
    splats = SplatTensors.from_splats(ground_splats(40))
    splats.sh0.requires_grad_()
    training = Training(ground_splats(40), photographs(), config_of(0.5), FitOptions())
    while not training._parts[-1].wants_weights(training._moment()):
        training.take_step()
    density = training._parts[-1]
    before, splats = density.statistics.sums.copy(), training._splats  # pyright: ignore
    assert not before.any()
    moment = training._moment()
    training.take_step()
    one = slice(moment.view, moment.view + 1)
    output = rasterize(
        replace(splats, **{name: tensor.detach().requires_grad_() for name, tensor in splats.tensors().items()}),
        torch.tensor(CAMERAS.cam_from_world[one]), torch.tensor(CAMERAS.Ks[one]), *CAMERAS.sizes_wh[0].tolist(), sh_degree=0, weights=True,
    )  # fmt: skip
    output.images.sum().backward()
    assert output.weights is not None
    # One step of Adam lies between the two.
    np.testing.assert_allclose(density.statistics.sums, squashed(output.weights[0].numpy()), rtol=0.3, atol=0.02)  # pyright: ignore
