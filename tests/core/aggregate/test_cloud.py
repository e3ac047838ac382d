"""The cloud's retraining: what it is predicted to take, when crop-merge takes its place, and
cameras that tell nothing of devices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.aggregate.cloud_choice import CloudNeeds, choose_at_cloud, cloud_needs
from radiant_core.aggregate.config import (
    AggregateConfig,
    Join,
    Refine,
    Trainings,
    aggregate_preset,
)
from radiant_core.aggregate.crop_merge import crop_merge
from radiant_core.aggregate.join import join_models
from radiant_core.aggregate.join_memory import JoinMemory, join_bytes, plan_join_memory
from radiant_core.aggregate.retrain import retraining_config
from radiant_core.aggregate.synthetic_views import Teacher
from radiant_core.aggregate.virtual_cameras import MAX_MOVE, MAX_TURN_DEG, virtual_cameras
from radiant_core.cameras import Cameras, concatenate_cameras
from radiant_core.errors import BadInput
from radiant_core.plan.system import Cloud
from radiant_core.regimes import ENOUGH_SHOWS, FEW_DEVICES, HARDLY_SHOWN, OFTEN_SHOWN, SHORT_SHOWS, SHORT_STEPS
from radiant_core.splats import Splats
from radiant_core.train.config import train_preset
from radiant_core.train.densify.policies import Adc, NoDensification
from radiant_core.train.trainer import FitOptions
from tests.core.scenes import cameras_above, ground_splats

PLACES = [(x, y) for x in (-2.0, -1.0, 0.0, 1.0, 2.0) for y in (-1.5, 0.0, 1.5)]
CAMERAS = cameras_above(PLACES)
MODEL = ground_splats()
NEEDS = CloudNeeds(num_cameras=40, memory_bytes=2e9, time_s=100.0)


def drawn(seed: int = 0, cameras: Cameras = CAMERAS) -> Cameras:
    return virtual_cameras(cameras, MODEL.means, np.random.default_rng(seed))


def at_once(models: list[Splats], views: list[Cameras], long_side_px: int) -> JoinMemory:
    """The memory of a join without a limit."""
    return plan_join_memory(models, views, long_side_px, np.inf)


class TestVirtualCameras:
    def test_each_stands_near_one_camera_and_looks_the_same_way(self) -> None:
        virtual = drawn()
        gaps = np.linalg.norm(virtual.centers[:, None] - CAMERAS.centers, axis=2)
        nearest = gaps.argmin(axis=1)
        assert sorted(nearest) == list(range(len(CAMERAS)))
        distances = [np.median(np.linalg.norm(MODEL.means - center, axis=1)) for center in CAMERAS.centers]
        assert (gaps.min(axis=1) <= MAX_MOVE * np.array(distances)[nearest] * (1 + 1e-9)).all()
        turns = virtual.cam_from_world[:, :3, :3] @ CAMERAS.cam_from_world[nearest, :3, :3].transpose(0, 2, 1)
        angles_deg = np.degrees(np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1) / 2, -1, 1)))
        assert (angles_deg <= MAX_TURN_DEG + 1e-6).all() and angles_deg.max() > 0.3

    def test_no_pose_name_or_order_of_a_device_is_left(self) -> None:
        virtual = drawn()
        assert not np.isclose(virtual.centers[:, None], CAMERAS.centers, atol=1e-6).all(axis=2).any()
        assert not set(virtual.names) & set(CAMERAS.names)
        order = np.linalg.norm(virtual.centers[:, None] - CAMERAS.centers, axis=2).argmin(axis=1)
        assert (order != np.arange(len(CAMERAS))).any()

    def test_the_optics_of_two_devices_become_one(self) -> None:
        wide = replace(
            cameras_above([(0.3, 0.2), (0.1, 0.9)], size_wh=(64, 48)), Ks=cameras_above([(0, 0), (0, 1)]).Ks * [[[0.5], [0.5], [1]]]
        )
        virtual = drawn(cameras=concatenate_cameras([CAMERAS, wide]))
        assert len(np.unique(virtual.Ks, axis=0)) == 1 and len(np.unique(virtual.sizes_wh, axis=0)) == 1

    def test_equal_seeds_give_equal_cameras_and_names_of_two_edges_differ(self) -> None:
        first, again, other = drawn(1), drawn(1), drawn(2)
        np.testing.assert_array_equal(first.cam_from_world, again.cam_from_world)
        assert first.names == again.names and not set(first.names) & set(other.names)
        concatenate_cameras([first, other])

    def test_one_camera_is_moved_too(self) -> None:
        one = CAMERAS.select([4])
        assert (drawn(cameras=one).centers != one.centers).all()

    def test_nothing_to_look_at_or_from_is_refused(self) -> None:
        with pytest.raises(BadInput, match="at least one of either"):
            virtual_cameras(CAMERAS.select([]), MODEL.means, np.random.default_rng(0))
        with pytest.raises(BadInput, match="model of 0 Gaussians"):
            virtual_cameras(CAMERAS, MODEL.means[:0], np.random.default_rng(0))


class TestChoice:
    def test_without_limits_the_cloud_retrains_and_says_its_memory(self) -> None:
        retrains, decision = choose_at_cloud(NEEDS, Cloud(), "cloud")
        assert retrains and decision.figure == 2.0 and decision.unit == "GB predicted"

    @pytest.mark.parametrize(
        ("cloud", "retrains", "figure", "told"),
        [
            (Cloud(memory_bytes=2e9), True, 2.0, "within the cloud's limit of 2 GB"),
            (Cloud(memory_bytes=1.9e9), False, 2.0, "exceeds the cloud's limit of 1.9 GB"),
            (Cloud(time_s=100), True, 100.0, "limit of 100 s"),
            (Cloud(time_s=99.0, memory_bytes=1e12), False, 100.0, "exceeds the cloud's limit of 99 s"),
            (Cloud(max_cameras=40), True, 40.0, "limit of 40 cameras"),
            (Cloud(max_cameras=39, time_s=1e9), False, 40.0, "exceeds the cloud's limit of 39 cameras"),
            (Cloud(max_cameras=0), False, 40.0, "exceeds the cloud's limit of 0 cameras"),
        ],
    )
    def test_the_figure_that_decides_is_told_both_ways(self, cloud: Cloud, retrains: bool, figure: float, told: str) -> None:
        chosen, decision = choose_at_cloud(NEEDS, cloud, "cloud")
        assert (chosen, decision.figure) == (retrains, figure) and told in decision.reason
        assert decision.choice.startswith("retraining" if retrains else "models are cut")

    def test_whose_limit_of_memory_it_is_is_told(self) -> None:
        _, decision = choose_at_cloud(NEEDS, Cloud(memory_bytes=1e9), "cloud", memory_of="80% of what is free")
        assert "2 GB, exceeds 80% of what is free of 1 GB" in decision.reason

    def test_a_time_limit_without_a_known_time_does_not_decide(self) -> None:
        assert choose_at_cloud(replace(NEEDS, time_s=None), Cloud(time_s=1.0), "cloud")[0]

    @pytest.mark.parametrize("limit", [-1.0, np.nan, np.inf])
    def test_a_limit_that_is_none_is_refused(self, limit: float) -> None:
        with pytest.raises(BadInput, match="cloud: time_s is"):
            Cloud(time_s=limit)


class TestNeeds:
    def test_they_follow_gaussians_pixels_and_the_edges_times(self) -> None:
        models = [ground_splats(100), ground_splats(300)]
        views = [CAMERAS.select([0, 1]), CAMERAS.select([2])]
        needs = cloud_needs(models, views, at_once(models, views, 24), [10.0, 30.0])
        assert needs.num_cameras == 3
        assert needs.time_s == pytest.approx(10 * 400 / 100 + 30 * 400 / 300)
        assert needs.memory_bytes == join_bytes(400, 400, 56, [24 * 18] * 3)
        larger = cloud_needs(models, views, at_once(models, views, 48), None)
        assert larger.memory_bytes > needs.memory_bytes and larger.time_s is None
        # A million Gaussians and photographs of 576 × 432 px: less than a laptop has, however many.
        assert join_bytes(1_000_000, 1_000_000, 92, [576 * 432] * 300) < 2e9

    def test_a_time_per_edge_is_demanded(self) -> None:
        with pytest.raises(BadInput, match="1 times for 2 edges"):
            cloud_needs([MODEL, MODEL], [CAMERAS, CAMERAS], at_once([MODEL], [CAMERAS], 48), [1.0])


class TestPaperAggregation:
    def test_the_preset_turns_every_skip_off(self) -> None:
        paper = aggregate_preset("paper")
        for join in (paper.edge, paper.cloud):
            assert (join.method, join.epochs, join.max_num_steps) == ("paper", 10, None)
            assert join.retrain_single and not join.weight_by_alpha
        assert aggregate_preset("default") == AggregateConfig()
        with pytest.raises(BadInput, match="default, paper"):
            aggregate_preset("papers")

    @pytest.mark.usefixtures("usual_rounds")
    def test_epochs_and_rounds_follow_from_how_long_how_many_devices_trained(self) -> None:
        ours, alone = AggregateConfig(), AggregateConfig(refine=Refine(epochs=0))
        asked = AggregateConfig(edge=Join(epochs=7), cloud=Join(epochs=0), refine=Refine(rounds=9))
        long, many, few = (10, 5), (2, 2), (1, 0)
        for shows, steps, num_devices, epochs, rounds in (
            (HARDLY_SHOWN - 0.1, 500, FEW_DEVICES, few, 5),
            (HARDLY_SHOWN - 0.1, 500, FEW_DEVICES + 1, many, 5),
            (HARDLY_SHOWN - 0.1, 1500, FEW_DEVICES, few, 5),
            (HARDLY_SHOWN, 500, FEW_DEVICES, few, 2),
            (HARDLY_SHOWN, 500, FEW_DEVICES + 1, many, 3),
            (SHORT_SHOWS - 0.1, SHORT_STEPS, FEW_DEVICES, few, 2),
            (SHORT_SHOWS, SHORT_STEPS - 1, FEW_DEVICES, few, 2),
            (ENOUGH_SHOWS, SHORT_STEPS - 1, FEW_DEVICES, few, 2),
            (OFTEN_SHOWN, SHORT_STEPS - 1, FEW_DEVICES, few, 2),
            (OFTEN_SHOWN, SHORT_STEPS, FEW_DEVICES, long, 1),
            (OFTEN_SHOWN, SHORT_STEPS - 1, FEW_DEVICES + 1, many, 1),
            (ENOUGH_SHOWS, SHORT_STEPS - 1, FEW_DEVICES + 1, many, 1),
            (SHORT_SHOWS, SHORT_STEPS, FEW_DEVICES, long, 3),
            (ENOUGH_SHOWS, SHORT_STEPS, FEW_DEVICES, long, 1),
            (float("inf"), float("inf"), FEW_DEVICES, long, 1),
        ):
            trainings = Trainings(num_devices=num_devices, photograph_shows=shows, num_steps=steps)
            joining = ours.joining_after(trainings)
            assert (joining.edge.epochs, joining.cloud.epochs) == ours.epochs_after(trainings) == epochs, trainings
            assert ours.refine.rounds_after(trainings) == rounds and asked.refine.rounds_after(trainings) == 9, trainings
            # Few steps over few photographs leave less to fit.
            of_few = epochs == few and shows >= OFTEN_SHOWN
            assert ours.refine.epochs_after(trainings) == (5 if of_few else 8), trainings
            assert Refine(epochs=3).epochs_after(trainings) == 3
            assert alone.refine.epochs_after(trainings) == 0 and ours.refine.is_asked_for and not alone.refine.is_asked_for
            assert asked.joining_after(trainings) == asked and alone.epochs_after(trainings) == long
            assert aggregate_preset("paper").joining_after(trainings) == aggregate_preset("paper")
        assert ours.epochs_after(None) == long

    @pytest.mark.parametrize(
        "given", [{"refine": Refine(epochs=0), "cloud": Join(epochs=0)}, {"edge": Join(epochs=0)}, {"edge": Join(method="crop_merge")}]
    )
    def test_no_epochs_without_devices_that_refine_are_refused(self, given: dict) -> None:
        with pytest.raises(BadInput, match=r"give 1 or more, or epochs of refining|edge\.epochs .* at least 1|the cloud's alone"):
            AggregateConfig(**given)
        with pytest.raises(BadInput, match="shows its views 0 times"):
            Join(method="paper", epochs=0)

    def test_it_retrains_at_the_rates_of_3dgs_however_devices_were_trained(self) -> None:
        device, plain = train_preset("default"), train_preset("standard")
        made = retraining_config(device, aggregate_preset("paper").cloud, MODEL, 7)
        names = ("means_lr", "scales_lr", "quats_lr", "opacities_lr", "sh0_lr")
        assert [getattr(made, name) for name in names] == [getattr(plain, name) for name in names]
        assert (made.num_steps, made.settle_epochs, made.density) == (70, None, NoDensification())
        ours = retraining_config(device, aggregate_preset("default").cloud, MODEL, 7)
        # Axes of a device move faster, since the mean of its last steps steadies them; a join ends with its last step.
        assert [getattr(ours, name) for name in names if name != "scales_lr"] == [
            getattr(device, name) for name in names if name != "scales_lr"
        ]
        assert ours.scales_lr == 4 * made.scales_lr < device.scales_lr and ours.average_from == 1 > device.average_from

    def test_all_gaussians_stay_a_lone_model_is_retrained_and_density_control_rests(self) -> None:
        train = replace(train_preset("paper"), long_side_px=48, density=Adc(from_step=0, every=1))
        paper = replace(aggregate_preset("paper").cloud, epochs=1)
        west, east = MODEL.select(MODEL.means[:, 0] < 1), MODEL.select(MODEL.means[:, 0] > -1)
        both = join_models(
            [Teacher(splats=west, cameras=CAMERAS.select([0, 1])), Teacher(splats=east, cameras=CAMERAS.select([13]))],
            train,
            paper,
            FitOptions(),
        ).trained
        assert both.num_steps == 3 and len(both.splats) == len(west) + len(east)
        lone = join_models([Teacher(splats=west, cameras=CAMERAS.select([0, 1]))], train, paper, FitOptions()).trained
        assert lone.num_steps == 2 and (lone.splats.means != west.means).any()

    def test_transparent_pixels_teach_black_without_weights(self) -> None:
        thin = replace(MODEL, logit_opacities=MODEL.logit_opacities - 4)
        train = replace(train_preset("draft"), long_side_px=48)
        losses = []
        for weigh in (True, False):
            config = replace(aggregate_preset("paper").cloud, epochs=1, weight_by_alpha=weigh)
            losses.append(join_models([Teacher(splats=thin, cameras=CAMERAS)], train, config, FitOptions()).trained.first_loss)
        assert losses[0] != losses[1]

    def test_a_plain_cut_keeps_nothing_outside_its_region(self) -> None:
        sites = np.array([[-2.0, 0.0], [2.0, 0.0]])
        blind = MODEL.select(MODEL.means[:, 0] > 2)
        merged = crop_merge([MODEL, blind], sites, np.zeros(2))
        assert len(merged) == (MODEL.means[:, 0] <= 0).sum() + len(blind)
