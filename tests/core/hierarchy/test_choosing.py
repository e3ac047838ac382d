"""Which version of a scene is kept: the best one in photographs that were in no training."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.hierarchy.choosing import BEST_DB, CUT, JOINED, REFINED, choose_version, in_order
from radiant_core.hierarchy.in_process import InProcessRun, keep_best
from radiant_core.hierarchy.messages import ONLY_FADED, SceneModel
from radiant_core.hierarchy.reporter import Recorder
from radiant_core.light.held_out import held_out_psnr_db
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from radiant_core.train.views import TrainingViews
from tests.core.light.plain_lights import no_lights
from tests.core.scenes import cameras_above, ground_splats

NAMES = [REFINED, JOINED, CUT]
TRUTH = ground_splats(600)
POISONED = replace(TRUTH, sh0=np.random.default_rng(0).normal(0, 1, TRUTH.sh0.shape).astype(np.float32))
DULL = replace(TRUTH, sh0=0.8 * TRUTH.sh0)
CAMERAS = cameras_above([(x, 0.0) for x in (-1.0, 0.0, 1.0)], size_wh=(64, 48))
VIEWS = TrainingViews(cameras=CAMERAS, images=tuple(view.image_bytes for view in render_views(TRUTH, CAMERAS, "native")))


def test_the_best_mean_over_all_machines_is_kept_and_the_decision_has_every_figure() -> None:
    one = {REFINED: [20.0, 22.0], JOINED: [21.0, 20.0], CUT: [30.0, 19.0]}
    other = {REFINED: [24.0], JOINED: [23.0], CUT: [20.0]}
    choice = choose_version(NAMES, [one, other])
    assert choice is not None and choice.version == CUT and not choice.keeps_usual
    assert choice.mean_db == {REFINED: 22.0, JOINED: pytest.approx(64 / 3), CUT: 23.0} and choice.num_photographs == 3
    decision = choice.decision("evaluation")
    assert decision.choice == "the cut scene is kept" and decision.figure == 1.0 and decision.unit == "dB over the refined one"
    assert not decision.changes_nothing and "favour the cut one" in decision.reason and "joined 21.33 dB" in decision.reason


def test_of_equal_versions_the_usual_one_is_kept_which_changes_nothing() -> None:
    nearly = choose_version([JOINED, CUT], [{CUT: [20.04], JOINED: [20.0]}])
    better = choose_version([JOINED, CUT], [{CUT: [20.06], JOINED: [20.0]}])
    assert nearly is not None and nearly.keeps_usual and better is not None and better.version == CUT
    choice = choose_version([JOINED, CUT], [{CUT: [20.0], JOINED: [20.0]}])
    assert choice is not None and choice.version == JOINED and choice.decision("evaluation").changes_nothing


def test_machines_that_hold_out_nothing_are_said_and_without_any_photograph_nothing_is_chosen() -> None:
    nothing: dict = {name: [] for name in NAMES}
    choice = choose_version(NAMES, [{REFINED: [20.0], JOINED: [21.0], CUT: [19.0]}, nothing])
    assert choice is not None and choice.version == JOINED
    assert "1 of 2 machines hold out none: of their land at most pictures of the models were compared" in choice.decision("s").reason
    assert choose_version(NAMES, [nothing, nothing]) is None and choose_version(NAMES, []) is None
    assert choose_version([JOINED], [{JOINED: [20.0]}]) is None


def test_no_figure_weighs_more_than_a_perfect_photograph() -> None:
    choice = choose_version([JOINED, CUT], [{JOINED: [30.0, 30.0], CUT: [1e308, -1e308]}])
    assert choice is not None and choice.mean_db[CUT] == BEST_DB / 2 and choice.version == JOINED


@pytest.mark.parametrize(
    "machine",
    [
        {JOINED: [20.0]},
        {JOINED: [20.0], REFINED: [20.0]},
        {JOINED: [20.0], CUT: [20.0, 21.0]},
        {JOINED: [20.0], CUT: [float("nan")]},
        {JOINED: [float("inf")], CUT: [20.0]},
    ],
)
def test_machines_that_compare_something_else_are_refused(machine: dict) -> None:
    with pytest.raises(BadInput, match="ask it again"):
        choose_version([JOINED, CUT], [{JOINED: [20.0], CUT: [20.0]}, machine])


def test_figures_are_those_of_the_scorer_masks_and_light_included() -> None:
    shown = [view.image for view in render_views(DULL, CAMERAS, "native")]
    plain = [psnr_db(render, photograph / 255) for render, photograph in zip(shown, VIEWS.images, strict=True)]
    assert held_out_psnr_db(DULL, VIEWS, "native") == plain
    assert held_out_psnr_db(DULL, VIEWS, "native", no_lights(CAMERAS)) == pytest.approx(plain)
    brighter = replace(no_lights(CAMERAS), log_gains=np.full((3, 3), 0.3))
    bright = replace(VIEWS, images=tuple(np.clip(image * np.exp(0.3), 0, 255).astype(np.uint8) for image in VIEWS.images))
    assert np.mean(held_out_psnr_db(TRUTH, bright, "native", brighter)) > np.mean(held_out_psnr_db(TRUTH, bright, "native")) + 10
    left = np.zeros((48, 64), np.uint8)
    left[:, :32] = 255
    spoiled = tuple(np.concatenate([image[:, :32], np.full_like(image[:, 32:], 255)], axis=1) for image in VIEWS.images)
    masked = held_out_psnr_db(TRUTH, TrainingViews(cameras=CAMERAS, images=spoiled, weights=(left,) * 3), "native")
    assert min(masked) > max(held_out_psnr_db(TRUTH, TrainingViews(cameras=CAMERAS, images=spoiled), "native")) + 20


def ended(joined: Splats, cut: Splats | None) -> InProcessRun:
    scene = SceneModel(splats=joined, cut=cut)
    return InProcessRun(scene=scene, edges={}, refinements={}, joined=scene)


def test_models_that_only_faded_are_cut_where_no_device_fits_them() -> None:
    faded = replace(ended(DULL, TRUTH).joined, summary={ONLY_FADED: 1})
    run = InProcessRun(scene=faded, edges={}, refinements={}, joined=faded)
    assert faded.only_faded and [*run.versions] == [CUT, JOINED]
    assert not replace(faded, summary={ONLY_FADED: 0}).only_faded and not replace(faded, cut=None).only_faded
    assert [*in_order(TRUTH, DULL, TRUTH, only_faded=True)] == [REFINED, JOINED, CUT]
    assert [*in_order(None, DULL, TRUTH, only_faded=False)] == [JOINED, CUT]


def test_a_poisoned_join_is_replaced_by_the_cut() -> None:
    reporter = Recorder(stage="evaluation")
    kept = keep_best(ended(POISONED, TRUTH), lambda splats: held_out_psnr_db(splats, VIEWS, "native"), reporter)
    assert kept.scene.splats is TRUTH and kept.choice is not None and kept.choice.version == CUT
    assert [decision.topic for decision in reporter.decisions] == ["refined, joined or cut"]


def test_a_better_join_stays_and_one_version_needs_no_choice() -> None:
    better = keep_best(ended(TRUTH, DULL), lambda splats: held_out_psnr_db(splats, VIEWS, "native"), Recorder())
    assert better.scene.splats is TRUTH and better.choice is not None and better.choice.keeps_usual
    alone = keep_best(ended(TRUTH, None), lambda splats: held_out_psnr_db(splats, VIEWS, "native"), Recorder())
    assert alone.scene.splats is TRUTH and alone.choice is None
