"""A run of training as something that stops and goes on: the same bits, schedules by time, steps
that are not taken, the best model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from radiant_core.aggregate.synthetic_views import synthetic_views
from radiant_core.errors import BadInput, StageFailed
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig, train_preset, with_settings
from radiant_core.train.densify.policies import Adc, DensityCounts, NoDensification
from radiant_core.train.results import TrainState
from radiant_core.train.trainer import (
    MAX_FAILURES,
    MIN_SETTLED_SHARE,
    FitOptions,
    Steps,
    Training,
    fit_splats,
    settled_rate_share,
)
from radiant_core.train.validation import validation_psnr_db
from radiant_core.train.view_loss import view_of_step
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats

CAMERAS = cameras_above([(x, y) for x in (-2.0, 0.0, 2.0) for y in (-1.5, 1.5)])
GROWING = Adc(kind="planned", from_step=2_000, until_step=25_000, every=5, reset_opacity_every=1_000_000)
CONFIG = replace(
    train_preset("draft"),
    num_steps=40,
    sh_degree=1,
    density=GROWING,
    max_num_splats=80,
    start_scale=0.5,
)


def photographs() -> TrainingViews:
    truth = ground_splats(400)
    colors = np.random.default_rng(5).uniform(-1.5, 1.5, truth.sh0.shape).astype(np.float32)
    views = synthetic_views(replace(truth, sh0=colors), CAMERAS)
    return TrainingViews(cameras=views.cameras, images=views.images)


def start() -> Splats:
    return ground_splats(40)


def stopped_after(num_steps: int, config: TrainConfig, options: FitOptions) -> Training:
    training = Training(start(), photographs(), config, options)
    for _ in range(num_steps):
        training.take_step()
    return training


@pytest.mark.parametrize("kind", ["none", "adc", "planned", "mcmc"])
@pytest.mark.parametrize("stop_at", [1, 13, 16, 39])
def test_a_run_stopped_anywhere_goes_on_with_the_same_bits(kind, stop_at: int, monkeypatch: pytest.MonkeyPatch) -> None:
    views = photographs()
    monkeypatch.setattr("radiant_core.train.trainer.MIN_STEADY_STEPS", 1)
    config = with_settings(CONFIG, {"density.kind": kind, "settle_epochs": 1})
    options = FitOptions(validation=views.select([0, 3]))
    whole = fit_splats(start(), views, config, options)
    state = stopped_after(stop_at, config, options).state()
    fresh = Training(start(), views, config, options)
    fresh.restore(state)
    while not fresh.is_done:
        fresh.take_step()
    resumed = fresh.result()
    for name, array in whole.splats.arrays().items():
        np.testing.assert_array_equal(array, resumed.splats.arrays()[name], err_msg=name)
    assert (whole.density, whole.validation, whole.best_step) == (resumed.density, resumed.validation, resumed.best_step)
    assert (whole.first_loss, whole.last_loss) == (resumed.first_loss, resumed.last_loss)
    if kind != "none":
        assert whole.density != DensityCounts() and len(whole.splats) > 40


def test_a_state_is_a_copy_that_later_steps_leave_alone() -> None:
    training = stopped_after(4, replace(CONFIG, density=replace(GROWING, kind="adc")), FitOptions())
    state = training.state()
    before = {name: array.copy() for name, array in state.arrays.items()}
    training.take_step()
    for name, array in before.items():
        np.testing.assert_array_equal(array, state.arrays[name], err_msg=name)


def test_the_arrays_of_a_state_keep_their_names_so_that_older_checkpoints_are_read() -> None:
    views = photographs()
    state = stopped_after(30, CONFIG, FitOptions(validation=views.select([0]))).state()
    splats = {"means", "quats", "log_scales", "logit_opacities", "sh0", "shN"}
    parts = {
        "splats": splats,
        # These Gaussians have no higher harmonics: nothing to optimise in shN.
        "adam": {"row_steps"} | {f"{name}.{moment}" for name in splats - {"shN"} for moment in ("first", "second")},
        "density": {"sums", "seen", "radii_px", "num_first", "last_reset", "thinning"},
        "best": splats,
    }
    assert set(state.arrays) == {"losses", *(f"{part}.{name}" for part, names in parts.items() for name in names)}
    assert {"density", "best"} < set(state.numbers) and set(state.numbers["best"]) == {"step", "looks"}


def test_a_state_of_another_run_is_refused() -> None:
    state = stopped_after(3, replace(CONFIG, density=NoDensification()), FitOptions()).state()
    other = Training(start(), photographs(), CONFIG, FitOptions())
    with pytest.raises(BadInput, match=r"of another run"):
        other.restore(state)
    with pytest.raises(BadInput, match="of another run"):
        Training(start(), photographs(), CONFIG, FitOptions()).restore(TrainState(arrays={}, numbers={}))


def test_time_ends_a_run_and_drives_its_schedules() -> None:
    ticks = iter(range(10**6))
    # The clock advances by one at every look: at the start, by the progress and by the report.
    options = FitOptions(clock=lambda: float(next(ticks)))
    density = replace(GROWING, kind="adc", reset_opacity_every=10_000)
    config = replace(CONFIG, num_steps=10**6, schedule_steps=30_000, budget_s=400.0, density=density)
    result = fit_splats(start(), photographs(), config, options)
    assert 20 < result.num_steps < 400 and 400 <= result.seconds < 420
    assert result.density.num_resets == 2 and result.density.num_split > 0


def test_what_comes_first_of_steps_and_time_ends_a_run() -> None:
    ticks = iter(range(10**6))
    options = FitOptions(clock=lambda: float(next(ticks)))
    assert fit_splats(start(), photographs(), replace(CONFIG, num_steps=7, budget_s=1e6), options).num_steps == 7


def test_the_rates_of_a_long_run_fall_and_those_of_a_short_one_do_not() -> None:
    def shares(num_steps: int, num_views: int, epochs: int | None = 12) -> list[float]:
        return [settled_rate_share(step, step / num_steps, num_views, epochs) for step in range(num_steps)]

    assert set(shares(600, 10)) == set(shares(1_100, 100)) == set(shares(3_000, 10, None)) == {1.0}
    long, longer = shares(1_500, 40), shares(6_000, 40)
    assert long[-1] == pytest.approx(700 / 1_500, rel=2e-3) and longer[-1] == pytest.approx(700 / 6_000, rel=2e-3)
    assert shares(6_000, 100)[-1] == pytest.approx(1_200 / 6_000, rel=2e-3)
    # (T / N)^½ of the run passes before they fall.
    assert [max(np.flatnonzero(np.array(run) == 1)) for run in (long, longer)] == pytest.approx([1_025, 2_049], abs=1)
    assert all((np.diff(run) <= 0).all() for run in (long, longer))
    assert (
        settled_rate_share(5, 0.0, 10, 12) == settled_rate_share(0, 0.0, 10, 12) == 1.0
        and settled_rate_share(10_000, 3.0, 10, 12) == MIN_SETTLED_SHARE
    )
    assert settled_rate_share(6_900, 0.99, 10, 12) > MIN_SETTLED_SHARE == shares(30_000, 10)[-1]


def test_settling_leaves_the_centres_their_own_schedule(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("radiant_core.train.trainer.MIN_STEADY_STEPS", 1)
    taken: list[tuple[str, float]] = []
    monkeypatch.setattr("radiant_core.train.trainer.SelectiveAdam.set_rate", lambda self, name, rate: taken.append((name, rate)))
    config = replace(CONFIG, density=NoDensification(), settle_epochs=1)
    fit_splats(start(), photographs(), config, FitOptions(steps=Steps(end=0.5)))
    first, last, progress = dict(reversed(taken)), dict(taken), 39 / 40
    assert last["sh0"] == pytest.approx(config.sh0_lr * 0.5**progress * 6 / (39 * progress))
    assert last["means"] / first["means"] == pytest.approx(config.means_lr_end**progress)


def test_training_begins_with_small_images_and_ends_with_whole_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    from radiant_core.render.rasterize import rasterize

    sizes = []

    def spy(splats, viewmats, Ks, width, height, **options):
        sizes.append((width, height))
        return rasterize(splats, viewmats, Ks, width, height, **options)

    monkeypatch.setattr("radiant_core.train.view_loss.rasterize", spy)
    fit_splats(start(), photographs(), replace(CONFIG, num_steps=10))
    assert sizes == [(24, 18)] * 4 + [(48, 36)] * 6


def test_a_step_that_is_not_finite_is_not_taken_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    from radiant_core.train.native_loss import target_loss

    calls = []

    def poisoned(image, statistics, weights, ssim_weight):
        calls.append(None)
        loss = target_loss(image, statistics, weights, ssim_weight)
        # An infinite gradient in one step, an infinite loss in another.
        return loss * torch.tensor({3: float("inf"), 5: 0.0}.get(len(calls), 1.0)) + (torch.inf if len(calls) == 5 else 0)

    monkeypatch.setattr("radiant_core.train.view_loss.target_loss", poisoned)
    training = Training(start(), photographs(), replace(CONFIG, num_steps=8, density=replace(GROWING, kind="adc")), FitOptions())
    for _ in range(2):
        training.take_step()
    before = training.state().arrays
    training.take_step()
    for name, array in training.state().arrays.items():
        if name.split(".")[0] in ("splats", "adam"):
            np.testing.assert_array_equal(array, before[name], err_msg=name)
    while not training.is_done:
        training.take_step()
    result = training.result()
    assert result.num_rolled_back == 2 and result.num_steps == 8
    assert all(np.isfinite(array).all() for array in result.splats.arrays().values()) and np.isfinite(result.last_loss)


def test_training_gives_up_after_many_steps_that_are_not_finite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("radiant_core.train.view_loss.target_loss", lambda image, *rest: image.sum() * torch.inf)
    with pytest.raises(StageFailed, match=f"{MAX_FAILURES} steps in a row could not be taken.*the loss became"):
        fit_splats(start(), photographs(), replace(CONFIG, num_steps=100))


def test_the_best_model_by_validation_is_returned_not_the_last() -> None:
    views = photographs()
    validation = views.select([5])
    # Two photographs alone, learnt by heart at high rates: the view between them gets worse in the
    # end.
    config = replace(CONFIG, num_steps=60, start_scale=1.0, means_lr=5e-2, scales_lr=0.1, num_looks=5, means_lr_end=1.0)
    result = fit_splats(start(), views.select([0, 1]), config, FitOptions(validation=validation))
    figures = dict(result.validation)
    assert [step for step, _ in result.validation] == [36, 42, 48, 54, 60]
    assert result.best_step == max(figures, key=lambda step: figures[step])
    assert validation_psnr_db(result.splats, validation, "auto") == pytest.approx(figures[result.best_step], abs=1e-6)


def test_every_view_comes_once_per_epoch_in_new_orders() -> None:
    epochs = [[view_of_step(epoch * 7 + place, 7, seed=3) for place in range(7)] for epoch in range(4)]
    assert all(sorted(epoch) == list(range(7)) for epoch in epochs)
    assert len({tuple(epoch) for epoch in epochs}) == 4


def test_a_short_run_of_which_no_step_could_be_taken_fails_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("radiant_core.train.view_loss.target_loss", lambda image, *rest: image.sum() * torch.inf)
    with pytest.raises(StageFailed, match="none of 5 steps could be taken"):
        fit_splats(start(), photographs(), replace(CONFIG, num_steps=5))
