"""Density control: every edit against plain numpy, its schedule, its limits, hostile models, and
that it explains detail."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from radiant_core.aggregate.synthetic_views import synthetic_views
from radiant_core.errors import BadInput
from radiant_core.render.contract import SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.splats import Splats, morton_order
from radiant_core.train.config import TrainConfig, train_preset, with_settings
from radiant_core.train.densify import density
from radiant_core.train.densify.density import (
    AdaptiveDensity,
    DensityRules,
    density_edit,
    reset_opacities,
    select_growing,
    select_prunable,
    split_offsets,
)
from radiant_core.train.densify.policies import Adc, DensityCounts, NoDensification
from radiant_core.train.optimizer import SelectiveAdam
from radiant_core.train.parts import Moment
from radiant_core.train.trainer import fit_splats
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats

EXTENT = 10.0
SMALL, LARGE, HUGE = 0.05, 0.5, 5.0  # below 1 % of the extent, above it, above 10 %
RULES = DensityRules(min_gradient=2e-4, extent=EXTENT, max_num_splats=1000, prune_large=True)
CAMERAS = cameras_above([(x, y) for x in (-2.0, 0.0, 2.0) for y in (-1.5, 1.5)])


def model(scales: list[float], opacities: list[float] | None = None) -> dict[str, np.ndarray]:
    count = len(scales)
    rng = np.random.default_rng(3)
    opacities = [0.5] * count if opacities is None else opacities
    return {
        "means": rng.uniform(-5, 5, (count, 3)).astype(np.float32),
        "quats": rng.normal(size=(count, 4)).astype(np.float32),
        "log_scales": np.log(np.outer(scales, [1.0, 0.5, 0.25])).astype(np.float32),
        "logit_opacities": np.log(np.array(opacities) / (1 - np.array(opacities))).astype(np.float32),
    }


def edited(arrays: dict[str, np.ndarray], gradients: list[float], rules: DensityRules = RULES, radii: list[float] | None = None):
    radii_px = np.zeros(len(gradients)) if radii is None else np.array(radii)
    return density_edit(arrays, np.array(gradients), radii_px, rules, np.random.default_rng(0))


class TestEdit:
    def test_a_small_one_is_cloned_a_large_one_split_and_the_rest_stays(self) -> None:
        arrays = model([SMALL, LARGE, SMALL, LARGE])
        edit = edited(arrays, [1e-3, 1e-3, 1e-4, 0.0])
        assert edit.counts == DensityCounts(num_cloned=1, num_split=1)
        # Rows 0 twice (itself and a clone), 1 twice (two children), 2 and 3 as they were.
        assert sorted(edit.rows.tolist()) == [0, 0, 1, 1, 2, 3]
        assert sorted(edit.rows[edit.fresh].tolist()) == [0, 1, 1]
        for row in (0, 2, 3):
            np.testing.assert_array_equal(edit.means[edit.rows == row], np.tile(arrays["means"][row], ((edit.rows == row).sum(), 1)))
        children = edit.rows == 1
        np.testing.assert_allclose(edit.log_scales[children], np.tile(arrays["log_scales"][1] - math.log(1.6), (2, 1)), rtol=1e-6)
        assert (edit.means[children] != arrays["means"][1]).any(axis=1).all()
        np.testing.assert_array_equal(edit.log_scales[~children], arrays["log_scales"][edit.rows[~children]])

    def test_the_result_is_in_morton_order(self) -> None:
        edit = edited(model([SMALL] * 60), [1e-3] * 60)
        np.testing.assert_array_equal(morton_order(edit.means), np.arange(120))

    def test_the_transparent_the_large_and_the_wide_on_screen_are_pruned(self) -> None:
        arrays = model([SMALL, SMALL, HUGE, SMALL, SMALL], [0.0049, 0.0051, 0.9, 0.9, 0.9])
        rules = replace(RULES, prune_radius_px=20.0)
        edit = edited(arrays, [0.0] * 5, rules, [0, 0, 0, 20.5, 19.5])
        assert sorted(edit.rows.tolist()) == [1, 4]
        assert edit.counts == DensityCounts(num_pruned_transparent=1, num_pruned_large=2)
        early = edited(arrays, [0.0] * 5, replace(rules, prune_large=False), [0, 0, 0, 20.5, 19.5])
        assert sorted(early.rows.tolist()) == [1, 2, 3, 4]

    def test_children_of_a_wide_one_were_not_seen_wide_yet(self) -> None:
        edit = edited(model([LARGE]), [1.0], replace(RULES, prune_radius_px=20.0), [500.0])
        assert len(edit.rows) == 2 and edit.counts.num_pruned_large == 0

    def test_all_prunable_leaves_the_most_opaque(self) -> None:
        edit = edited(model([HUGE] * 4, [0.1, 0.3, 0.2, 0.001]), [0.0] * 4)
        assert edit.rows.tolist() == [1] and edit.counts.num_pruned_transparent + edit.counts.num_pruned_large == 3

    def test_an_empty_model_stays_empty(self) -> None:
        edit = edited(model([]), [])
        assert edit.means.shape == (0, 3) and edit.counts == DensityCounts()

    def test_equal_seeds_give_equal_bits_and_others_do_not(self) -> None:
        arrays, gradients = model([LARGE] * 9), np.ones(9)
        runs = [density_edit(arrays, gradients, np.zeros(9), RULES, np.random.default_rng(seed)).means for seed in (1, 1, 2)]
        np.testing.assert_array_equal(runs[0], runs[1])
        assert (runs[0] != runs[2]).any()

    def test_poison_never_grows_and_never_leaves_float32(self) -> None:
        arrays = model([LARGE, LARGE, LARGE])
        arrays["quats"][0] = 0
        arrays["log_scales"][1] = 200.0
        arrays["log_scales"][2] = -200.0
        edit = edited(arrays, [1.0, 1.0, np.nan], replace(RULES, prune_large=False))
        assert np.isfinite(edit.means).all() and np.isfinite(edit.log_scales).all()
        assert edit.rows.tolist().count(2) == 1


class TestGrowing:
    def test_the_limit_gives_room_to_the_strongest(self) -> None:
        gradients = np.array([3e-4, 9e-4, 1e-4, 5e-4, 7e-4])
        sizes = np.log(np.array([SMALL, LARGE, SMALL, SMALL, LARGE]))
        clone, split, refused = select_growing(gradients, sizes, replace(RULES, max_num_splats=8))
        assert (np.flatnonzero(clone).tolist(), np.flatnonzero(split).tolist(), refused) == ([3], [1, 4], 1)

    def test_ranks_say_who_gets_the_room_and_gradients_who_may_grow(self) -> None:
        gradients, sums = np.array([3e-4, 9e-4, 1e-4, 5e-4]), np.array([9e-3, 1e-3, 5e-2, np.nan])
        clone, split, refused = select_growing(gradients, np.full(4, np.log(SMALL)), replace(RULES, max_num_splats=5), sums)
        assert (np.flatnonzero(clone).tolist(), split.any(), refused) == ([0], False, 2)

    @pytest.mark.parametrize("limit", [1, 5])
    def test_a_full_model_grows_by_nothing(self, limit: int) -> None:
        clone, split, refused = select_growing(np.ones(5), np.zeros(5), replace(RULES, max_num_splats=limit))
        assert not clone.any() and not split.any() and refused == 5

    def test_exact_thresholds_belong_to_growing_and_to_cloning(self) -> None:
        clone, split, _ = select_growing(np.array([2e-4, 2e-4 * (1 - 1e-12)]), np.log([0.1 * (1 - 1e-12), 0.1]), RULES)
        assert clone.tolist() == [True, False] and not split.any()


def test_children_are_drawn_from_their_parent() -> None:
    quat = np.array([[0.9, 0.1, -0.3, 0.2]], np.float32)
    log_scales = np.log(np.array([[3.0, 1.0, 0.2]])).astype(np.float32)
    count = 40_000
    offsets = split_offsets(np.repeat(quat, count, axis=0), np.repeat(log_scales, count, axis=0), np.random.default_rng(0))
    turn = Rotation.from_quat(quat[0], scalar_first=True).as_matrix()
    expected = turn @ np.diag([9.0, 1.0, 0.04]) @ turn.T
    assert offsets.shape == (2 * count, 3)
    # 80,000 draws: a variance is off by 1 / √40,000 = 0.5 % of the largest, four times that is
    # never seen by chance.
    np.testing.assert_allclose(np.cov(offsets.T.astype(np.float64)), expected, atol=0.02 * 9)
    np.testing.assert_allclose(offsets.mean(0), 0, atol=4 * 3 / math.sqrt(2 * count))


def moment(step: int, schedule_step: float) -> Moment:
    return Moment(step=step, view=0, progress=0.5, schedule_step=schedule_step)


class TestSchedule:
    def policy(self, splats: SplatTensors, **fields) -> AdaptiveDensity:
        return AdaptiveDensity(Adc(**fields), train_preset("paper"), EXTENT, splats, num_views=1)

    def test_the_paper_edits_after_step_500_every_100_until_15000_and_resets_every_3000(self, monkeypatch: pytest.MonkeyPatch) -> None:
        splats = SplatTensors.from_splats(ground_splats(5))
        optimizer = SelectiveAdam({}, {})
        policy = self.policy(splats)
        edits, resets = [], []
        monkeypatch.setattr(policy, "_edit", lambda moment, splats, optimizer: edits.append(moment.step) or splats)
        for step in range(1, 20_001):
            before = policy.counts.num_resets
            policy.after_update(moment(step, float(step)), splats, optimizer)
            resets += [step] if policy.counts.num_resets > before else []
        assert edits == list(range(600, 15_000, 100))
        assert resets == [3_000, 6_000, 9_000, 12_000]

    def test_milestones_of_standard_scale_with_the_run_the_interval_does_not(self, monkeypatch: pytest.MonkeyPatch) -> None:
        splats = SplatTensors.from_splats(ground_splats(5))
        config = replace(train_preset("standard"), num_steps=3_000)
        policy = AdaptiveDensity(Adc(), config, EXTENT, splats, num_views=1)
        optimizer = SelectiveAdam({}, {})
        edits, resets = [], []
        monkeypatch.setattr(policy, "_edit", lambda moment, splats, optimizer: edits.append(moment.step) or splats)
        for step in range(1, config.num_steps + 1):
            before = policy.counts.num_resets
            policy.after_update(moment(step, step * 10.0), splats, optimizer)
            resets += [step] if policy.counts.num_resets > before else []
        assert edits == list(range(100, 1_500, 100)) and resets == [300, 600, 900, 1_200]

    def test_statistics_are_means_over_the_steps_that_saw_a_gaussian_in_gsplats_units(self) -> None:
        splats = SplatTensors.from_splats(ground_splats(40))
        for tensor in splats.tensors().values():
            tensor.requires_grad_()
        policy = self.policy(splats, prune_radius_px=20.0)
        sums, seen = np.zeros(40), np.zeros(40)
        widest = np.zeros(40)
        for step, view in enumerate((0, 3, 5), 1):
            one = slice(view, view + 1)
            output = rasterize(
                splats, torch.tensor(CAMERAS.cam_from_world[one]), torch.tensor(CAMERAS.Ks[one]), 48, 36, sh_degree=0, backend="reference"
            )
            output.means2d.retain_grad()
            policy.before_backward(moment(step, float(step)), output)
            (output.images * torch.arange(36)[None, :, None, None] / 36).mean().backward()
            assert output.means2d.grad is not None
            sums += np.linalg.norm(output.means2d.grad[0].numpy() * [24.0, 18.0], axis=1)
            seen += output.radii_px[0].numpy() > 0
            widest = np.maximum(widest, output.radii_px[0].numpy())
        assert seen.min() < 3 <= seen.max() and sums.max() > 0
        np.testing.assert_allclose(policy.statistics.sums, sums, rtol=1e-5, atol=1e-12)
        np.testing.assert_array_equal(policy.statistics.view_counts, seen)
        np.testing.assert_array_equal(policy.statistics.radii_px, widest.astype(np.float32))

    def test_absolute_statistics_are_those_of_the_pixels_and_poison_is_not_remembered(self) -> None:
        splats = SplatTensors.from_splats(ground_splats(40))
        for tensor in splats.tensors().values():
            tensor.requires_grad_()
        policy = self.policy(splats, gradient="absolute")
        assert policy.wants_absgrad(moment(1, 14_999.0)) and not policy.wants_absgrad(moment(1, 15_000.0))
        assert not self.policy(splats).wants_absgrad(moment(1, 1.0))
        sums = np.zeros(40)
        for step, factor in enumerate((1.0, -0.5, math.inf), 1):
            output = rasterize(
                splats, torch.tensor(CAMERAS.cam_from_world[:1]), torch.tensor(CAMERAS.Ks[:1]), 48, 36, sh_degree=0, absgrad=True
            )
            policy.before_backward(moment(step, float(step)), output)
            (factor * output.images * torch.arange(36)[None, :, None, None] / 36).mean().backward()
            assert output.absgrad is not None
            if factor < math.inf:
                sums += np.linalg.norm(output.absgrad[0].numpy() * [24.0, 18.0], axis=1)
        assert sums.max() > 0
        np.testing.assert_allclose(policy.statistics.sums, sums, rtol=1e-5, atol=1e-12)

    def test_on_a_gpu_poison_is_not_remembered_either(self) -> None:
        lengths = [1.0, math.nan, 2.0, math.inf, 0.0]
        for array in (np.array(lengths, np.float32), torch.tensor(lengths)):
            density._zero_not_finite(array)
            assert array.tolist() == [1.0, 0.0, 2.0, 0.0, 0.0]

    def test_a_rendering_without_absolute_gradients_is_a_mistake_of_the_caller(self) -> None:
        splats = SplatTensors.from_splats(ground_splats(4))
        splats.means.requires_grad_()
        output = rasterize(splats, torch.tensor(CAMERAS.cam_from_world[:1]), torch.tensor(CAMERAS.Ks[:1]), 48, 36, sh_degree=0)
        with pytest.raises(ValueError, match="absgrad=True"):
            self.policy(splats, gradient="absolute").before_backward(moment(1, 1.0), output)


def test_a_reset_lowers_opacities_and_forgets_their_moments_only() -> None:
    splats = SplatTensors.from_splats(ground_splats(6))
    splats.logit_opacities[0] = -9.0
    optimizer = SelectiveAdam({"means": splats.means, "logit_opacities": splats.logit_opacities}, {"means": 0.1, "logit_opacities": 0.1})
    for tensor in (splats.means, splats.logit_opacities):
        tensor.grad = torch.ones_like(tensor)
    optimizer.step()
    reset_opacities(splats, optimizer)
    opacities = splats.logit_opacities.detach().sigmoid()
    assert opacities[0] < 0.001
    torch.testing.assert_close(opacities[1:], torch.full((5,), density.RESET_OPACITY))
    assert all(not moments.any() for moments in optimizer.moments("logit_opacities"))
    assert all(moments.any() for moments in optimizer.moments("means"))


def photographs(count: int = 400) -> TrainingViews:
    """Ground of so many Gaussians, each of a colour of its own: detail that a few cannot show."""
    truth = ground_splats(count)
    colors = np.random.default_rng(5).uniform(-1.5, 1.5, truth.sh0.shape).astype(np.float32)
    views = synthetic_views(replace(truth, sh0=colors), CAMERAS)
    return TrainingViews(cameras=views.cameras, images=views.images)


def few_splats() -> Splats:
    return ground_splats(40)


# No reset, after which what is larger than a tenth of these few cameras' extent would be pruned:
# all of it.
EDITS = Adc(from_step=2_000, until_step=20_000, every=20, reset_opacity_every=1_000_000)
ADC = replace(
    train_preset("standard"),
    num_steps=300,
    sh_degree=0,
    density=EDITS,
    long_side_px=48,
)


def test_unexplained_detail_is_learnt_better_with_density_control_than_without() -> None:
    views = photographs()
    without = fit_splats(few_splats(), views, replace(ADC, density=NoDensification()))
    with_adc = fit_splats(few_splats(), views, ADC)
    assert without.density == DensityCounts() and len(without.splats) == 40
    assert len(with_adc.splats) > 100
    assert with_adc.last_loss < 0.8 * without.last_loss, f"{without.last_loss:.4f} → {with_adc.last_loss:.4f}"


def test_a_run_with_edits_repeats_to_the_bit_and_counts_add_up() -> None:
    views, config = photographs(), replace(ADC, num_steps=120)
    first, second = fit_splats(few_splats(), views, config), fit_splats(few_splats(), views, config)
    for name, array in first.splats.arrays().items():
        np.testing.assert_array_equal(array, second.splats.arrays()[name])
    counts = first.density
    grown = counts.num_cloned + counts.num_split - counts.num_pruned_transparent - counts.num_pruned_large
    assert len(first.splats) == 40 + grown != 40


def test_absolute_gradients_choose_other_gaussians_by_their_own_threshold_and_repeat_to_the_bit() -> None:
    views = photographs()
    runs = {
        key: fit_splats(few_splats(), views, replace(ADC, num_steps=120, density=replace(EDITS, gradient=gradient, min_absolute=least)))
        for key, gradient, least in (
            ("mean", "mean", 8e-4),
            ("abs", "absolute", 8e-4),
            ("again", "absolute", 8e-4),
            ("none", "absolute", 1e9),
        )
    }
    for name, array in runs["abs"].splats.arrays().items():
        np.testing.assert_array_equal(array, runs["again"].splats.arrays()[name])
    assert len(runs["abs"].splats) > 40 and runs["none"].density.num_cloned == runs["none"].density.num_split == 0
    assert runs["abs"].density != runs["mean"].density


@pytest.mark.parametrize("adam", ["visible", "dense"])
def test_the_limit_of_gaussians_holds_in_a_run(adam) -> None:
    result = fit_splats(few_splats(), photographs(), replace(ADC, num_steps=120, max_num_splats=45, adam=adam))
    assert len(result.splats) <= 45 and result.density.num_refused > 0


@pytest.mark.parametrize("value", [0, 255])
def test_flat_photographs_and_one_gaussian_end_in_a_finite_model(value: int) -> None:
    images = tuple(np.full((36, 48, 3), value, np.uint8) for _ in CAMERAS.names)
    density = replace(EDITS, reset_opacity_every=1_500, min_gradient=0.0)
    config = replace(ADC, num_steps=60, density=density, max_num_splats=50)
    result = fit_splats(few_splats().select([0]), TrainingViews(cameras=CAMERAS, images=images), config)
    assert 1 <= len(result.splats) <= 50 and np.isfinite(result.last_loss) and result.density.num_resets > 0


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"kind": "grow"}, "kind is 'grow', expected one of adc, planned"),
        ({"every": 0}, "every is 0"),
        ({"min_gradient": math.nan}, "min_gradient is nan"),
        ({"gradient": "signed"}, "gradient is 'signed', expected one of mean, absolute"),
        ({"min_absolute": -1e-4}, "min_absolute is -0.0001"),
        ({"prune_radius_px": 0.0}, "prune_radius_px is 0.0"),
        ({"means_lr_end": 0.0}, "means_lr_end is 0.0"),
        ({"schedule_steps": 0}, "schedule_steps is 0"),
    ],
)
def test_a_schedule_that_makes_no_sense_is_refused(fields: dict, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        TrainConfig(**fields) if hasattr(TrainConfig(), next(iter(fields))) else Adc(**fields)


def test_the_paper_preset_has_the_papers_numbers_and_standard_those_of_3dgs() -> None:
    paper, standard = train_preset("paper"), train_preset("standard")
    for config in (paper, standard):
        assert config.density == Adc(kind="adc", from_step=500, until_step=15_000, every=100, reset_opacity_every=3_000) == Adc()
        assert (config.adam, config.sky, config.fill_in, config.max_scale_per_distance) == ("dense", False, False, None)
    assert (paper.num_steps, paper.schedule_steps, standard.num_steps, standard.schedule_steps) == (20_000, 20_000, 30_000, 30_000)
    # 3DGS lowers the centres' rate to a hundredth at 30,000 steps, two thirds of which the paper
    # takes.
    assert paper.means_lr_end == pytest.approx(0.01 ** (20_000 / 30_000)) and standard.means_lr_end == 0.01
    for name in ("draft", "default"):
        config = train_preset(name)
        assert config.density.kind == "planned" and config.adam == "dense" and config.fill_in and config.sky and config.start_scale == 0.5


def test_less_opaque_gaussians_than_the_policy_allows_are_pruned_and_resets_may_not_prune_all() -> None:
    logits = np.array([-np.inf, np.log(0.09 / 0.91), np.log(0.11 / 0.89), 20.0])
    transparent, _ = select_prunable(logits, np.full(4, -9.0), np.zeros(4), replace(RULES, min_opacity=0.1))
    assert transparent.tolist() == [True, True, False, False]
    nothing, _ = select_prunable(logits, np.full(4, -9.0), np.zeros(4), replace(RULES, min_opacity=0.0))
    assert not nothing.any()
    for wrong in (-0.1, 1.0, math.nan, math.inf):
        with pytest.raises(BadInput, match="min_opacity"):
            Adc(min_opacity=wrong)
    with pytest.raises(BadInput, match="all would be pruned"):
        Adc(min_opacity=0.1).require_resettable()
    with pytest.raises(BadInput, match="all would be pruned"):
        with_settings(train_preset("default"), {"density.reset_opacity_every": 3_000})
    Adc(min_opacity=0.1, reset_opacity_every=15_000).require_resettable()
