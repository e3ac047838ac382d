"""Fed3DGS: its six steps, what it may change, and whether it joins two halves of a known model."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.rivals import fed3dgs as module
from benchmarks.rivals.fed3dgs import Fed3dgsConfig, fed3dgs, fed3dgs_merge, overlaps
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import SH_C0, Splats, concatenate_splats
from radiant_core.train.results import TrainProgress
from radiant_core.train.trainer import FitOptions
from tests.core.scenes import cameras_above, ground_splats

WEST, EAST = cameras_above([(-2, -1), (-2, 1), (-1, 0)]), cameras_above([(2, -1), (2, 1), (1, 0)])
NOWHERE = cameras_above([(100, 0)])
FEW = Fed3dgsConfig(min_num_steps=30)
OPTIONS = FitOptions()
DROP_LOGIT = np.float32(np.log(0.005 / 0.995))


def halves() -> tuple[Splats, Splats]:
    """Two models of one ground, each right to 1 m beyond the middle and wrong haze from there."""
    truth = ground_splats()
    parts = []
    for sign in (-1, 1):
        knows = sign * truth.means[:, 0] > -1
        jitter = np.random.default_rng(5 + sign).normal(0, 0.01, truth.means.shape)
        parts.append(
            replace(
                truth,
                means=truth.means + jitter,
                sh0=np.where(knows[:, None, None], truth.sh0, 0.3 / SH_C0),
                logit_opacities=np.where(knows, truth.logit_opacities, -0.5),
            )
        )
    return parts[0], parts[1]


def mean_psnr_db(model: Splats) -> float:
    """Against the whole model, at all cameras and between them."""
    cameras = cameras_above([(-2, -1), (-2, 1), (2, -1), (2, 1), (0, 0), (-0.7, 0.8), (0.7, -0.8)])
    pairs = zip(render_views(model, cameras), render_views(ground_splats(), cameras), strict=True)
    return float(np.mean([psnr_db(one.image, whole.image) for one, whole in pairs]))


class TestTwoHalves:
    def test_it_approaches_the_whole_and_beats_concatenation_and_either_half(self) -> None:
        west, east = halves()
        merged = fed3dgs([west, east], [WEST, EAST], Fed3dgsConfig(min_num_steps=400), OPTIONS)
        before = mean_psnr_db(concatenate_splats([west, east]))
        after = mean_psnr_db(merged.splats)
        assert after > before + 2 and after > max(mean_psnr_db(west), mean_psnr_db(east)) + 2, (before, after)
        assert merged.num_steps == 400 and merged.num_training_pixels == 400 * 48 * 36 and not merged.refused
        assert len(merged.splats) + merged.num_dropped == len(west) + len(east) and merged.num_dropped > 0

    def test_it_is_the_same_every_time_and_another_with_another_seed(self) -> None:
        west, east = halves()
        one, again, other = (fed3dgs([west, east], [WEST, EAST], replace(FEW, seed=seed), OPTIONS) for seed in (0, 0, 1))
        np.testing.assert_array_equal(one.splats.logit_opacities, again.splats.logit_opacities)
        assert len(other.splats) != len(one.splats) or (other.splats.logit_opacities != one.splats.logit_opacities).any()

    def test_only_opacities_change_and_only_in_the_clients_frusta(self) -> None:
        # The client's frusta end 1.3 · 24 / 43.2 · 6.3 m west of x = 1 m, at -3.55 m. Beyond, some
        # of the global model is in the targets of the others' cameras, and some, 20 m off, in none.
        west, east = halves()
        far = replace(west, means=west.means - np.float32([20, 0, 0]), logit_opacities=np.full(len(west), -6.0))
        before, local = concatenate_splats([far, west]), east.select(east.means[:, 0] > -1)
        merged = fed3dgs_merge(before, local, EAST, WEST, FEW, OPTIONS).splats
        beyond, kept = before.select(before.means[:, 0] < -3.6), merged.means[:, 0] < -3.6
        assert WEST.any_sees(beyond.means).sum() >= 5
        np.testing.assert_array_equal(merged.select(kept).means, beyond.means)
        np.testing.assert_array_equal(merged.select(kept).logit_opacities, beyond.logit_opacities)
        assert (merged.logit_opacities[~kept & (merged.means[:, 0] > -3)] > DROP_LOGIT).all()

        def shapes_of(model: Splats) -> set[tuple[float, ...]]:
            rows = np.concatenate([model.means, model.quats, model.log_scales, model.sh0[:, 0]], axis=1)
            return {tuple(row) for row in rows.tolist()}

        assert shapes_of(merged) <= shapes_of(concatenate_splats([before, local]))

    def test_steps_follow_epochs_and_limits(self) -> None:
        assert Fed3dgsConfig().num_steps(300) == 1500 and Fed3dgsConfig().num_steps(20) == 1000
        assert Fed3dgsConfig(max_num_steps=7).num_steps(300) == 7
        west, east = halves()
        reports: list[TrainProgress] = []
        options = FitOptions(report=reports.append, report_every_s=0.0)
        result = fed3dgs([west, east], [WEST, EAST], Fed3dgsConfig(num_epochs=2, min_num_steps=1), options)
        assert result.num_steps == 2 * (3 + 3) == len(reports) == reports[-1].step


class TestSteps:
    def test_frusta_end_at_the_limits_of_ndc_and_depth(self) -> None:
        # Straight down from 6 m, 48 px of 43.2 px focal length: |ndc| 1.3 is x = 1.3 · 24 / 43.2 ·
        # 6 = 4.333 m.
        xs = [4.32, 4.35, 0.0, 0.0, 0.0]
        # The last three: behind, and on both sides of far = 20 m.
        zs = [0.0, 0.0, 6.1, -13.9, -14.1]
        model = replace(ground_splats(5), means=np.column_stack([xs, np.zeros(5), zs]))
        seen = module._in_frusta(model, cameras_above([(0, 0)]), 20.0, Fed3dgsConfig())
        assert seen.tolist() == [True, False, False, True, False]

    def test_far_is_five_median_depths_of_what_the_client_sees(self) -> None:
        model = replace(ground_splats(3), means=np.array([[0, 0, 4.0], [0, 0, 3.0], [0, 0, 1.0]]))
        assert module._far_m(model, cameras_above([(0, 0)]), Fed3dgsConfig()) == pytest.approx(15.0)
        assert module._far_m(model, NOWHERE, Fed3dgsConfig()) == np.inf

    def test_near_means_within_the_median_squared_distance(self) -> None:
        # Neighbours of the local ones are 1, 1, 2 and 6 m off: ε = median(1, 1, 4, 36) = 2.5 m².
        local = replace(ground_splats(4), means=np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0], [9, 0, 0]]))
        tried = replace(ground_splats(2), means=np.array([[0, 1.58, 0], [0, 1.59, 0]]))
        assert module._near_local(tried, local).tolist() == [True, False]
        assert not module._near_local(tried, local.select([0])).any()

    def test_targets_are_drawn_as_often_as_they_see_the_client(self) -> None:
        west, east = halves()
        local = east.select(east.means[:, 0] > 0)
        many = cameras_above([(1.0 + 0.01 * index, 0) for index in range(400)], size_wh=(12, 9))
        others = cameras_above([(-2.0, 0), (0.0, 0), (100.0, 0)])
        views = module._targets(west, local, many, others, Fed3dgsConfig(), "auto")
        assert len(views) == 800 and views.weights is None
        places = views.cameras.centers[400:, 0].round(6)
        counts = np.array([others.select([index]).any_sees(local.means).sum() for index in range(3)])
        drawn = np.array([(places == x).sum() for x in (-2.0, 0.0, 100.0)])
        share = counts / counts.sum()
        assert drawn[2] == 0 == counts[2] and 0.05 < share[0] < 0.45
        # Four standard errors of a share over 400 draws.
        assert abs(drawn[0] / 400 - share[0]) <= 4 * np.sqrt(share[0] * (1 - share[0]) / 400)
        whose = [next(iter(render_views(model, views.cameras.select([index])))).image_bytes for model, index in ((local, 3), (west, 799))]
        np.testing.assert_array_equal(views.images[3], whose[0])
        np.testing.assert_array_equal(views.images[799], whose[1])

    def test_opacities_begin_faded_where_the_client_is(self, monkeypatch: pytest.MonkeyPatch) -> None:
        begun: list[tuple[Splats, Any]] = []

        def unfitted(merged: Splats, trained: Any, *rest: Any) -> Splats:
            begun.append((merged, trained))
            return merged

        monkeypatch.setattr(module, "_fit_opacities", unfitted)
        west, east = halves()
        local = east.select(east.means[:, 0] > 0)
        result = fed3dgs_merge(west, local, EAST, WEST, FEW, OPTIONS)
        merged, trained = begun[0]
        faded = merged.logit_opacities <= DROP_LOGIT
        assert faded[len(west) :].all() and trained[len(west) :].all()
        of_global = faded[: len(west)]
        # Faded: only what is trained and near the client, which has nothing more than a spacing
        # west of the middle.
        assert of_global.any() and (west.means[of_global, 0] > -0.6).all() and not (of_global & ~trained[: len(west)]).any()
        np.testing.assert_array_equal(merged.logit_opacities[: len(west)][~of_global], west.logit_opacities[~of_global])
        # Nothing was learnt, so all that was faded goes, and no other.
        assert len(result.splats) == (~faded).sum() and result.num_dropped == faded.sum()

    def test_entropy_is_that_of_the_formula_with_its_gradient(self) -> None:
        logits = torch.tensor([-20.0, -5.3, -0.4, 0.0, 3.0, 20.0], dtype=torch.float64, requires_grad=True)
        entropy = module._mean_entropy(logits)
        entropy.backward()
        o = 1 / (1 + np.exp(-logits.detach().numpy()))
        expected = -o * np.log(o) - (1 - o) * np.log1p(-o)
        assert float(entropy.detach()) == pytest.approx(expected.mean(), rel=1e-9)
        assert logits.grad is not None
        # dH/dl = −l o (1 − o).
        np.testing.assert_allclose(logits.grad.numpy(), -logits.detach().numpy() * o * (1 - o) / 6, atol=1e-12)

    def test_entropy_makes_opacities_more_decided(self) -> None:
        west, east = halves()
        spread = []
        for weight in (0.0, 10.0):
            config = Fed3dgsConfig(min_num_steps=100, entropy_weight=weight)
            opacities = 1 / (1 + np.exp(-fed3dgs([west, east], [WEST, EAST], config, OPTIONS).splats.logit_opacities))
            spread.append(float((opacities * (1 - opacities)).mean()))
        assert spread[1] < 0.8 * spread[0]


class TestClients:
    def test_the_first_client_is_the_global_model(self) -> None:
        west, _ = halves()
        for none in (None, west.select(np.zeros(len(west), bool))):
            result = fed3dgs_merge(none, west, WEST, WEST.select([]), FEW, OPTIONS)
            assert result.splats is west and result.num_steps == 0 == result.num_training_pixels
        lone = fed3dgs([west], [WEST], FEW, OPTIONS)
        assert lone.splats is west and lone.merged == (0,)

    def test_a_client_far_away_is_refused_and_named(self) -> None:
        west, east = halves()
        away = replace(west, means=west.means + np.float32([100, 0, 0]))
        assert not overlaps(west, away, NOWHERE, FEW)
        result = fed3dgs([west, away, east], [WEST, NOWHERE, EAST], FEW, OPTIONS)
        assert result.merged == (0, 2) and result.refused == (1,) and result.splats.means[:, 0].max() < 50 and result.num_steps == 30
        with pytest.raises(BadInput, match="no overlap"):
            fed3dgs_merge(west, away, NOWHERE, WEST, FEW, OPTIONS)

    def test_a_client_waits_for_its_neighbour(self) -> None:
        middle = ground_splats()
        west, east = (replace(middle, means=middle.means + np.float32([x, 0, 0])) for x in (-9, 9))
        bridge = replace(middle, means=middle.means * np.float32([1.6, 1, 1]))
        cameras = [cameras_above([(x, -1), (x, 1)]) for x in (-8, 8)]
        result = fed3dgs([west, east, bridge], [*cameras, cameras_above([(-3, 0), (3, 0)])], FEW, OPTIONS)
        assert not overlaps(west, east, cameras[1], FEW)
        assert result.merged == (0, 2, 1) and not result.refused and result.num_steps == 60
        assert result.splats.means[:, 0].min() < -9 and result.splats.means[:, 0].max() > 9

    def test_clients_may_share_photographs(self) -> None:
        west, east = halves()
        assert fed3dgs([west, east], [WEST, WEST], FEW, OPTIONS).num_steps == 30

    def test_harmonics_of_another_degree_are_padded(self) -> None:
        west, east = halves()
        rich = replace(east, shN=np.zeros((len(east), 3, 3)))
        assert fed3dgs([west, rich], [WEST, EAST], FEW, OPTIONS).splats.sh_degree == 1

    def test_empty_missing_and_poisoned_input_is_refused(self) -> None:
        west, east = halves()
        nothing, no_camera = east.select(np.zeros(len(east), bool)), EAST.select([])
        with pytest.raises(BadInput, match="client 1 has 0 Gaussians and 3 cameras"):
            fed3dgs([west, nothing], [WEST, EAST], FEW, OPTIONS)
        with pytest.raises(BadInput, match="the client has 300 Gaussians and 0 cameras"):
            fed3dgs_merge(west, east, no_camera, WEST, FEW, OPTIONS)
        with pytest.raises(BadInput, match="0 models with 0 sets"):
            fed3dgs([], [], FEW, OPTIONS)
        with pytest.raises(BadInput, match="means has 1 values that are not finite"):
            replace(east, means=np.where(np.arange(900).reshape(300, 3) == 7, np.nan, east.means))
        for poison in ({"opacities_lr": np.nan}, {"min_opacity": 0.7}, {"num_epochs": 0}, {"entropy_weight": -1.0}, {"far_factor": 0.0}):
            with pytest.raises(BadInput, match="Fed3DGS was given"):
                Fed3dgsConfig(**poison)

    def test_a_huge_opacity_and_a_huge_scale_leave_finite_numbers(self) -> None:
        west, east = halves()
        huge = replace(east, logit_opacities=np.full(len(east), 80.0), log_scales=np.where(east.means > 3.5, 9.0, east.log_scales))
        merged = fed3dgs([west, huge], [WEST, EAST], FEW, OPTIONS).splats
        assert np.isfinite(merged.logit_opacities).all()


def test_cameras_keep_their_order_under_new_names() -> None:
    twice: Cameras = module._number_cameras([WEST, EAST, WEST])
    np.testing.assert_array_equal(twice.centers, np.concatenate([WEST.centers, EAST.centers, WEST.centers]))
