"""The mean of the last steps: that of the models which those steps made, within the limits, over any interruption."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.render.contract import SplatTensors
from radiant_core.splats import TENSORS
from radiant_core.train.config import TrainConfig, with_settings
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.mean_model import MeanModel
from radiant_core.train.parts import Part
from radiant_core.train.trainer import FitOptions, Training, fit_splats
from radiant_core.train.validation import validation_psnr_db
from tests.core.train.test_training_state import CONFIG, photographs, start, stopped_after

AVERAGED = replace(CONFIG, average_from=0.5)


class Models(Part):
    """The models after each step, in float64."""

    name = "models"

    def __init__(self) -> None:
        self.after: list[dict[str, np.ndarray]] = []

    def after_step(self, step: int, progress: float, splats: SplatTensors) -> None:
        """Keep the model."""
        self.after.append({name: tensor.detach().numpy().astype(np.float64) for name, tensor in splats.tensors().items()})


def test_the_result_is_the_mean_of_the_models_of_the_last_steps() -> None:
    models, config = Models(), replace(AVERAGED, density=NoDensification(), max_elongation=None, max_scale_per_distance=None)
    result = fit_splats(start(), photographs(), config, FitOptions(parts=(models,)))
    # Half of 40 steps, counted from the one that reaches it.
    assert len(models.after) == 40
    for name, array in result.splats.arrays().items():
        expected = np.mean([model[name] for model in models.after[19:]], axis=0)
        np.testing.assert_allclose(array, expected, rtol=3e-6, atol=3e-7, err_msg=name)
        assert name == "shN" or not np.array_equal(array, models.after[-1][name].astype(np.float32))


@pytest.mark.parametrize("kind", ["none", "adc", "planned", "mcmc"])
@pytest.mark.parametrize("stop_at", [3, 20, 31, 39])
def test_a_run_stopped_anywhere_has_the_same_mean(kind: str, stop_at: int) -> None:
    config = with_settings(AVERAGED, {"density.kind": kind})
    whole = fit_splats(start(), photographs(), config)
    fresh = Training(start(), photographs(), config, FitOptions())
    fresh.restore(stopped_after(stop_at, config, FitOptions()).state())
    while not fresh.is_done:
        fresh.take_step()
    for name, array in fresh.result().splats.arrays().items():
        np.testing.assert_array_equal(array, whole.splats.arrays()[name], err_msg=name)


def test_where_gaussians_are_added_the_mean_begins_anew() -> None:
    models = Models()
    result = fit_splats(
        start(), photographs(), replace(AVERAGED, max_elongation=None, max_scale_per_distance=None), FitOptions(parts=(models,))
    )
    alike = [model for model in models.after if len(model["means"]) == len(models.after[-1]["means"])]
    assert len(alike) < 21
    by_place = {tuple(place) for place in np.round(np.mean([model["means"] for model in alike], axis=0), 4)}
    assert {tuple(place) for place in np.round(result.splats.means.astype(np.float64), 4)} <= by_place


def test_what_is_held_keeps_its_bits_and_what_stands_still_too() -> None:
    frozen = np.arange(40) < 15
    config = replace(AVERAGED, density=NoDensification())
    result = fit_splats(start(), photographs(), config, FitOptions(frozen=frozen))
    for name, array in start().arrays().items():
        np.testing.assert_array_equal(result.splats.arrays()[name][:15], array[:15], err_msg=name)
    # Far from the origin, where a sum of float32 would round.
    far = replace(start(), means=start().means + np.float32(123_456.7))
    mean = MeanModel(0.0)
    for step in range(77):
        mean.after_step(step, 0.5, SplatTensors.from_splats(far))
    for name in TENSORS:
        np.testing.assert_array_equal(getattr(mean.last(SplatTensors.from_splats(start())), name).numpy(), far.arrays()[name], err_msg=name)


def test_axes_of_the_mean_are_within_the_limits_and_a_look_of_a_running_training_changes_nothing() -> None:
    limits = {"max_elongation": 1.5, "max_scale_per_distance": 0.01}
    config = replace(AVERAGED, density=NoDensification(), **limits)
    training = stopped_after(30, config, FitOptions())
    before = training.state()
    training.result()
    after = training.state()
    for name, array in before.arrays.items():
        np.testing.assert_array_equal(array, after.arrays[name], err_msg=name)
    axes = np.sort(np.exp(fit_splats(start(), photographs(), config).splats.log_scales), axis=1)
    assert np.all(axes[:, 2] <= 1.5 * axes[:, 1] * (1 + 1e-5))


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan")])
def test_another_share_is_refused(share: float) -> None:
    with pytest.raises(BadInput, match="average_from is"):
        TrainConfig(average_from=share)


def test_where_views_choose_they_see_the_mean_last() -> None:
    views, models = photographs(), Models()
    config = replace(AVERAGED, density=NoDensification(), num_looks=1)
    options = FitOptions(validation=views.select([0, 3]), parts=(models,))
    result = fit_splats(start(), views, config, options)
    expected = np.mean([model["means"] for model in models.after[19:]], axis=0)
    np.testing.assert_allclose(result.splats.means, expected, rtol=3e-6, atol=1e-6)
    assert result.validation == ((40, pytest.approx(validation_psnr_db(result.splats, views.select([0, 3]), "native"))),)
