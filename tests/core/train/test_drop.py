"""Gaussians left out at random: which, how opaque the others become, and what gradients reach."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from radiant_core.regimes import FEW_PHOTOGRAPHS
from radiant_core.render.contract import SplatTensors
from radiant_core.train.config import TrainConfig, train_preset, with_settings
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.drop import DROPPED_LOGIT, DroppedGaussians
from radiant_core.train.needs import fit_to_views
from radiant_core.train.parts import Moment
from radiant_core.train.trainer import FitOptions, Training, fit_splats
from tests.core.scenes import ground_splats
from tests.core.train.test_needs import scene_of
from tests.core.train.test_training_state import photographs, start


def at(step: int, progress: float) -> Moment:
    return Moment(step=step, view=0, progress=progress, schedule_step=0.0)


def test_a_share_is_left_out_that_grows_over_the_run_and_the_rest_covers_as_much() -> None:
    splats = SplatTensors.from_splats(ground_splats(4000))
    part = DroppedGaussians(0.4, seed=3)
    assert part.before_render(at(1, 0.0), splats) is splats
    shown = part.before_render(at(7, 0.5), splats)
    dropped = shown.logit_opacities == DROPPED_LOGIT
    # 4,000 draws: three standard deviations.
    assert abs(float(dropped.double().mean()) - 0.2) < 3 * np.sqrt(0.16 / 4000)
    expected = (torch.sigmoid(splats.logit_opacities.double()) / 0.8).clamp(1e-6, 0.999)
    torch.testing.assert_close(torch.sigmoid(shown.logit_opacities.double())[~dropped], expected[~dropped], rtol=1e-5, atol=1e-6)
    again, other = part.before_render(at(7, 0.5), splats), part.before_render(at(8, 0.5), splats)
    assert torch.equal(again.logit_opacities, shown.logit_opacities) and not torch.equal(other.logit_opacities, shown.logit_opacities)


@pytest.mark.parametrize("logit", [-1e30, -88.0, 88.0, 1e30])
def test_saturated_opacities_stay_finite_and_so_do_their_gradients(logit: float) -> None:
    model = ground_splats(50)
    splats = SplatTensors.from_splats(replace(model, logit_opacities=np.full_like(model.logit_opacities, logit)))
    splats.logit_opacities.requires_grad_()
    shown = DroppedGaussians(0.5, seed=0).before_render(at(3, 0.9), splats).logit_opacities
    shown.sum().backward()
    assert bool(shown.isfinite().all()) and splats.logit_opacities.grad is not None and bool(splats.logit_opacities.grad.isfinite().all())


def test_few_photographs_decide_and_a_wish_is_followed() -> None:
    few, many = scene_of(FEW_PHOTOGRAPHS - 1)[1], scene_of(FEW_PHOTOGRAPHS)[1]
    auto = TrainConfig(drop_gaussians="auto", density=NoDensification())
    config, (decision,) = fit_to_views(auto, few)
    assert config.drop_gaussians == "always" and decision.choice == "up to 20% at each step" and decision.figure == FEW_PHOTOGRAPHS - 1
    config, (decision,) = fit_to_views(auto, many)
    assert config.drop_gaussians == "none" and decision.changes_nothing
    for wish in ("none", "always"):
        assert fit_to_views(with_settings(auto, {"drop_gaussians": wish}), few)[0].drop_gaussians == wish
    assert train_preset("default").drop_gaussians == "auto" and train_preset("paper").drop_gaussians == "none"


def test_a_resumed_training_goes_on_with_the_same_bits() -> None:
    config = replace(train_preset("draft"), num_steps=30, drop_gaussians="always", max_num_splats=80)
    whole = fit_splats(start(), photographs(), config)
    begun = Training(start(), photographs(), config, FitOptions())
    for _ in range(17):
        begun.take_step()
    resumed = Training(start(), photographs(), config, FitOptions())
    resumed.restore(begun.state())
    while not resumed.is_done:
        resumed.take_step()
    for name, array in whole.splats.arrays().items():
        np.testing.assert_array_equal(array, resumed.result().splats.arrays()[name], err_msg=name)
    plain = fit_splats(start(), photographs(), replace(config, drop_gaussians="none"))
    assert not np.array_equal(plain.splats.means, whole.splats.means)
