"""Densification as sampling: shared places against quadrature, growth by the schedule, the limit,
relocation, wandering, poison."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import quad

from radiant_core.render.contract import SplatTensors
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.density import MIN_OPACITY
from radiant_core.train.densify.mcmc import RelocatedDensity, share_place, wander
from radiant_core.train.densify.policies import Mcmc
from radiant_core.train.optimizer import SelectiveAdam
from radiant_core.train.parts import Moment
from tests.core.scenes import ground_splats

POLICY = Mcmc()
CONFIG = TrainConfig(density=POLICY, max_num_splats=10_000)
DEAD_LOGIT = math.log(0.001 / 0.999)


def logit(opacity: float) -> float:
    return math.log(opacity / (1 - opacity))


def with_logits(splats: Splats, logits: np.ndarray) -> SplatTensors:
    return SplatTensors.from_splats(replace(splats, logit_opacities=logits.astype(np.float32)))


def optimizer_of(splats: SplatTensors) -> SelectiveAdam:
    tensors = splats.tensors()
    for tensor in tensors.values():
        tensor.requires_grad_()
    return SelectiveAdam(tensors, dict.fromkeys(tensors, 1e-3))


def moment(step: int, schedule_step: float) -> Moment:
    return Moment(step=step, view=0, progress=0.5, schedule_step=schedule_step)


def after_round(
    splats: SplatTensors, config: TrainConfig = CONFIG, step: int = 1_000, schedule_step: float = 1_000.0
) -> tuple[RelocatedDensity, SplatTensors]:
    policy = RelocatedDensity(POLICY, config)
    return policy, policy.after_update(moment(step, schedule_step), splats, optimizer_of(splats))


class TestSharedPlace:
    @pytest.mark.parametrize("num_copies", [2, 3, 7, 51])
    @pytest.mark.parametrize("opacity", [0.02, 0.3, 0.9, 0.99])
    def test_copies_in_one_place_hide_and_weigh_what_one_did(self, opacity: float, num_copies: int) -> None:
        sigma = 0.7
        logits, scales = share_place(np.array([logit(opacity)]), np.full((1, 3), math.log(sigma)), np.array([num_copies]))
        each, each_sigma = 1 / (1 + math.exp(-float(logits[0]))), math.exp(float(scales[0, 0]))
        if 1 - (1 - opacity) ** (1 / num_copies) < MIN_OPACITY:
            assert each == pytest.approx(MIN_OPACITY, rel=1e-5), "held where they still count as alive"
        else:
            assert 1 - (1 - each) ** num_copies == pytest.approx(opacity, rel=1e-5)
            # Along a line through the centre the composited profile keeps its integral.

            def profile(x: float) -> float:
                return 1 - (1 - each * math.exp(-0.5 * (x / each_sigma) ** 2)) ** num_copies

            hidden, _ = quad(profile, -30, 30, points=[0.0], limit=200)
            assert hidden == pytest.approx(opacity * sigma * math.sqrt(2 * math.pi), rel=2e-3)
        assert np.ptp(scales) == 0

    def test_one_alone_stays_as_it_is(self) -> None:
        logits, scales = share_place(np.array([logit(0.4), logit(0.9)]), np.log([[0.1, 0.2, 0.3], [1, 2, 3]]), np.array([1, 1]))
        np.testing.assert_allclose(logits, [logit(0.4), logit(0.9)], rtol=1e-5)
        np.testing.assert_allclose(scales, np.log([[0.1, 0.2, 0.3], [1, 2, 3]]), atol=1e-6)

    def test_poison_stays_finite(self) -> None:
        logits = np.array([1e30, -1e30, np.inf, -np.inf, 60.0], np.float32)
        new_logits, new_scales = share_place(logits, np.zeros((5, 3), np.float32), np.array([2, 2, 51, 10**9, 51]))
        assert np.isfinite(new_logits).all() and np.isfinite(new_scales).all()


class TestRounds:
    def test_growth_follows_the_schedule_not_the_number_of_rounds(self) -> None:
        splats = SplatTensors.from_splats(ground_splats(1_000))
        assert len(after_round(splats)[1]) == 1_050
        # A run of a twentieth of the steps has a twentieth of the rounds.
        grown = after_round(splats, step=100, schedule_step=2_000.0)[1]
        assert len(grown) == round(1_000 * 1.05**20)

    def test_a_short_run_ends_where_a_long_one_does(self) -> None:
        ending = Mcmc(until_step=3_000)
        sizes = []
        for ratio in (1, 5):
            policy, splats = RelocatedDensity(ending, CONFIG), SplatTensors.from_splats(ground_splats(300))
            for step in range(ending.every, ending.until_step // ratio, ending.every):
                splats = policy.after_update(moment(step, float(step * ratio)), splats, optimizer_of(splats))
            assert policy.counts.num_cloned == len(splats) - 300
            sizes.append(len(splats))
        # Rounds after steps 600 to 2,900 of the schedule, or after 1,000 to 2,500.
        np.testing.assert_allclose(sizes, [300 * 1.05**24, 300 * 1.05**20], rtol=0.05)

    def test_the_limit_is_reached_and_never_exceeded(self) -> None:
        splats = SplatTensors.from_splats(ground_splats(1_000))
        config = replace(CONFIG, max_num_splats=1_020)
        policy, grown = after_round(splats, config)
        assert len(grown) == 1_020 and policy.counts.num_cloned == 20
        assert len(after_round(grown, config)[1]) == 1_020
        assert len(after_round(splats, replace(CONFIG, max_num_splats=500), step=100, schedule_step=14_000.0)[1]) == 1_000

    def test_dead_ones_are_moved_onto_live_ones_and_begin_anew(self) -> None:
        base = ground_splats(200)
        logits = np.full(200, logit(0.6))
        logits[:50] = DEAD_LOGIT
        splats = with_logits(base, logits)
        policy, moved = after_round(splats, replace(CONFIG, max_num_splats=200))
        assert len(moved) == 200 and policy.counts.num_relocated == 50 and policy.counts.num_cloned == 0
        live = {tuple(row) for row in base.means[50:].tolist()}
        assert all(tuple(row) in live for row in moved.means.detach().numpy().tolist())
        assert (moved.logit_opacities.detach().numpy() > logit(0.005)).all()

    def test_a_model_without_a_live_one_is_left_alone(self) -> None:
        splats = with_logits(ground_splats(20), np.full(20, DEAD_LOGIT))
        assert after_round(splats)[1] is splats

    def test_nothing_is_edited_out_of_the_schedule(self) -> None:
        splats = SplatTensors.from_splats(ground_splats(30))
        for step, schedule_step in ((100, 100.0), (1_001, 1_001.0), (15_000, 15_000.0)):
            policy, same = after_round(splats, step=step, schedule_step=schedule_step)
            assert len(same) == 30 and policy.counts.num_cloned == 0


class TestWandering:
    def test_only_the_nearly_transparent_wander_and_by_their_own_shape(self) -> None:
        count = 4_000
        base = ground_splats(count)
        logits = np.full(count, logit(0.5))
        logits[: count // 2] = logit(0.001)
        scales = np.log(np.tile([0.2, 0.1, 0.001], (count, 1))).astype(np.float32)
        quats = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)).astype(np.float32)
        splats = with_logits(replace(base, log_scales=scales, quats=quats), logits)
        wander(splats, 1.0, np.random.default_rng(0))
        moved = splats.means.numpy() - base.means
        assert not moved[count // 2 :].any()
        spread = moved[: count // 2].std(axis=0)
        # Σ η: standard deviations go with the square of the axes.
        np.testing.assert_allclose(spread[:2] / spread[0], [1, 0.25], rtol=0.1)
        assert spread[2] < 1e-3 * spread[0] and abs(moved[: count // 2].mean(axis=0)).max() < 5 * spread[0] / math.sqrt(count / 2)

    def test_no_step_is_longer_than_the_longest_axis_and_poison_moves_nothing_to_infinity(self) -> None:
        base = ground_splats(100)
        splats = with_logits(replace(base, log_scales=np.full((100, 3), 2.0, np.float32)), np.full(100, -20.0))
        wander(splats, 1e12, np.random.default_rng(0))
        lengths = np.linalg.norm(splats.means.numpy() - base.means, axis=1)
        assert (lengths <= math.exp(2.0) * (1 + 1e-4)).all() and lengths.max() > 1
        before = splats.means.clone()
        wander(splats, 0.0, np.random.default_rng(0))
        wander(splats, float("nan"), np.random.default_rng(0))
        assert torch.equal(before, splats.means)
