"""F3DGS-style: means stay, attributes are averaged by who saw them, bytes are counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.rivals.f3dgs import ATTRIBUTES, F3dgsConfig, Local, average_attributes, f3dgs, fit_attributes
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig
from radiant_core.train.trainer import FitOptions
from radiant_core.train.views import TrainingViews
from tests.core.scenes import cameras_above, ground_splats

OPTIONS = FitOptions(backend="native")


def grey(splats: Splats) -> Splats:
    """A scaffold: the same places, without their colours."""
    return replace(splats, sh0=np.zeros_like(splats.sh0))


def clients() -> tuple[Splats, list[TrainingViews]]:
    truth = ground_splats()
    both = []
    for x in (-2.5, 2.5):
        cameras = cameras_above([(x, -1.0), (x, 1.0)], height_m=4.0, size_wh=(32, 24))
        images = tuple(np.rint(255 * np.clip(view.image, 0, 1)).astype(np.uint8) for view in render_views(truth, cameras))
        both.append(TrainingViews(cameras=cameras, images=images))
    return truth, both


def test_two_clients_colour_a_scaffold_that_keeps_its_places() -> None:
    truth, both = clients()
    scaffold, scores = grey(truth), []

    def score(number: int, splats: Splats) -> None:
        shown = [(view, image) for views in both for view, image in zip(render_views(splats, views.cameras), views.images, strict=True)]
        scores.append((number, float(np.mean([psnr_db(np.clip(view.image, 0, 1), image / 255) for view, image in shown]))))

    result = f3dgs(scaffold, both, TrainConfig(sh0_lr=5e-2), F3dgsConfig(num_rounds=3, num_steps=15), OPTIONS, score)
    assert np.array_equal(result.splats.means, scaffold.means) and [number for number, _ in scores] == [0, 1, 2]
    assert scores[2][1] > scores[0][1] > 10 and scores[2][1] > 20
    numbers = len(scaffold) * (4 + 3 + 1 + 3 + scaffold.shN.shape[1] * 3 + 1)
    assert result.sent_bytes_a_round == 2 * 4 * numbers and result.num_training_pixels == 3 * 2 * 15 * 32 * 24


def test_attributes_are_averaged_by_visibility() -> None:
    server = ground_splats(4)
    light, dark = (replace(server, sh0=np.full_like(server.sh0, value), quats=server.quats * sign) for value, sign in ((1, 1), (-1, -1)))
    sent = [
        Local(splats=splats, visible_steps=np.array(seen), num_pixels=0) for splats, seen in ((light, [3, 1, 0, 0]), (dark, [1, 1, 2, 0]))
    ]
    mean = average_attributes(server, sent)
    # A plain mean would give 0 everywhere.
    np.testing.assert_allclose(mean.sh0[:3, 0, 0], [0.5, 0, -1], atol=1e-6)
    assert np.array_equal(mean.sh0[3], server.sh0[3]) and np.array_equal(mean.means, server.means)
    # q and −q are one rotation: their mean is not 0.
    turned = np.abs((mean.quats * server.quats).sum(axis=1)) / np.linalg.norm(server.quats, axis=1)
    np.testing.assert_allclose(turned, np.where(np.arange(4) < 3, 1, np.linalg.norm(server.quats[3])), atol=1e-5)


def test_a_client_counts_the_steps_that_showed_a_gaussian() -> None:
    truth, both = clients()
    local = fit_attributes(grey(truth), both[0], TrainConfig(), 6, 0, OPTIONS)
    west, east = truth.means[:, 0] < -1.5, truth.means[:, 0] > 2
    assert local.visible_steps.max() == 6 and local.visible_steps[east].max() == 0 and local.visible_steps[west].mean() > 2
    unseen = local.visible_steps == 0
    for name in ATTRIBUTES:
        assert np.array_equal(local.splats.arrays()[name][unseen], grey(truth).arrays()[name][unseen])


def test_what_is_wrong_is_named() -> None:
    truth, _both = clients()
    with pytest.raises(BadInput, match="0 clients and 300 Gaussians"):
        f3dgs(truth, [], TrainConfig(), F3dgsConfig(), OPTIONS)
    with pytest.raises(BadInput, match="at least one round"):
        F3dgsConfig(num_rounds=0)
