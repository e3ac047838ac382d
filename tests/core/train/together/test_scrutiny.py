"""Gradients that no photographs cause are refused; honest ones never."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from radiant_core.render.contract import SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.train.config import TrainConfig
from radiant_core.train.densify.policies import NoDensification
from radiant_core.train.losses import weighted_loss
from radiant_core.train.together.codec import encode_gradients
from radiant_core.train.together.gradients import Layout, StepGradients
from radiant_core.train.together.roles import Inbox
from radiant_core.train.together.scrutiny import (
    MAX_COLOR,
    SAMPLE,
    STEADY_STEPS,
    Scrutiny,
    check_shape,
    pixel_limit,
    tensor_lengths,
    tensor_names,
    view_limits,
)
from tests.core.scenes import cameras_above, ground_splats

SHAPES = {"means": (3,), "quats": (4,), "log_scales": (3,), "logit_opacities": (), "sh0": (1, 3), "shN": (3, 3)}
LAYOUT = Layout(shapes=SHAPES)
CONFIG = TrainConfig(density=NoDensification(), long_side_px=128)
NUM_SPLATS = 2_000


def step_of(num_senders: int, step: int, *, agree: float = 0.3, size: float = 1e-3) -> dict[str, StepGradients]:
    """Senders that show most of a model, whose gradients have `agree` of a direction in common."""
    rng = np.random.default_rng((7, step))
    common = rng.standard_normal((NUM_SPLATS, LAYOUT.num_columns))
    sent = {}
    for number in range(num_senders):
        rows = np.flatnonzero(rng.random(NUM_SPLATS) < 0.7)
        values = size * rng.uniform(0.6, 1.6) * (agree * common[rows] + rng.standard_normal((len(rows), LAYOUT.num_columns)))
        values[:, LAYOUT.growth] = np.abs(values[:, LAYOUT.growth])
        sent[f"d{number}"] = StepGradients(
            num_views=1, loss=0.2, rows=rows, values=values.astype(np.float32), view_counts=np.ones(len(rows), np.uint16)
        )
    return sent


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize("ssim_weight", [0.0, 0.2, 1.0])
def test_no_picture_has_a_larger_gradient_than_the_limit(ssim_weight: float, weighted: bool) -> None:
    rng = np.random.default_rng(3)
    shape = (24, 32, 3)
    pictures = [np.zeros(shape), np.ones(shape), np.full(shape, 0.01), rng.random(shape), 0.02 * rng.random(shape), 4 * rng.random(shape)]
    pictures.append(np.tile(np.indices(shape[:2]).sum(0)[..., None] % 2, 3).astype(float))
    weights = torch.from_numpy((rng.random(shape[:2]) < 0.5).astype(float)) if weighted else None
    largest = 0.0
    for image in pictures:
        for target in pictures[:-2]:
            rendered = torch.tensor(image, requires_grad=True)
            weighted_loss(rendered, torch.tensor(target), weights, ssim_weight).backward()
            assert rendered.grad is not None
            largest = max(largest, float(rendered.grad.abs().sum()))
    assert largest <= pixel_limit(ssim_weight) + 1e-9
    # It is no idle limit: a black picture of a dark grey photograph reaches what the mean may cause.
    assert largest > 0.6 * (1 - ssim_weight + ssim_weight * 100)


@pytest.mark.parametrize("darkness", [1.0, 0.02])
def test_no_view_of_a_model_is_beyond_the_limits(darkness: float) -> None:
    splats = SplatTensors.from_splats(ground_splats(120), torch.float64)
    splats = replace(splats, sh0=darkness * (splats.sh0 + 1.77) - 1.77, shN=torch.zeros(120, 15, 3, dtype=torch.float64))
    leaves = {name: tensor.requires_grad_() for name, tensor in ((n, t.detach().clone()) for n, t in splats.tensors().items())}
    camera = cameras_above([(0.0, 0.0)])
    viewmats, Ks = torch.tensor(camera.cam_from_world), torch.tensor(camera.Ks)
    output = rasterize(replace(splats, **leaves), viewmats, Ks, 48, 36, sh_degree=3, backend="reference")
    output.means2d.retain_grad()
    weighted_loss(output.images[0], torch.full((36, 48, 3), 0.01, dtype=torch.float64), None, 0.2).backward()
    config = replace(CONFIG, sh_degree=3, long_side_px=48)
    layout = Layout.of(splats, tuple(leaves))
    limits = dict(zip(tensor_names(layout), view_limits(config, layout), strict=True))
    for name, tensor in leaves.items():
        assert tensor.grad is not None
        assert float(tensor.grad.abs().sum()) <= limits[name], name
    assert output.means2d.grad is not None
    growth = output.means2d.grad[0] * torch.tensor([24.0, 18.0])
    assert float(growth.norm(dim=1).sum()) <= limits["growth"]
    assert math.isinf(limits["means"])
    assert limits["logit_opacities"] == pytest.approx(MAX_COLOR * pixel_limit(0.2))


@pytest.mark.parametrize("rows", [0, 1, 63, 64, 1_000])
def test_lengths_are_those_of_the_columns(rows: int) -> None:
    values = np.random.default_rng(1).standard_normal((rows, LAYOUT.num_columns)).astype(np.float32)
    plain = [np.linalg.norm(values[:, columns].astype(float)) for columns in LAYOUT.columns.values()]
    plain.append(np.linalg.norm(values[:, LAYOUT.growth].astype(float)))
    np.testing.assert_allclose(tensor_lengths(values, LAYOUT), plain, rtol=1e-5)  # float32 sums


def test_honest_senders_are_never_refused() -> None:
    scrutiny = Scrutiny(config=CONFIG)
    for step in range(120):
        sent = step_of(6, step, agree=0.3 / (1 + step / 20), size=1e-3 / (1 + step / 50))
        assert scrutiny.refuse(step, sent, NUM_SPLATS, LAYOUT) == {}


POISON = {
    "a million times": (lambda g: replace(g, values=1e6 * g.values), "a photograph causes at most"),
    "ten times": (lambda g: replace(g, values=np.float32(10) * g.values), "usual are"),
    "nothing": (lambda g: replace(g, values=0 * g.values), "usual are"),
    "a thousandfold growth": (lambda g: replace(g, values=np.where(np.arange(24) == LAYOUT.growth, 1e3, 1) * g.values), "growth are"),
    "negative growth": (lambda g: replace(g, values=np.where(np.arange(24) == LAYOUT.growth, -1, 1) * g.values), "expected a length"),
    "seen nowhere": (lambda g: replace(g, view_counts=0 * g.view_counts), "counted in no view"),
    "some seen nowhere": (lambda g: replace(g, view_counts=np.where(g.rows == g.rows[0], 0, g.view_counts)), "counted in no view"),
    "a loss too large": (lambda g: replace(g, loss=1e9), "the loss of 1 views is 1e"),
    "a loss below zero": (lambda g: replace(g, loss=-0.1), "the loss of 1 views is -0.1"),
}


@pytest.mark.parametrize("name", POISON)
def test_poison_is_refused_by_name_in_the_first_step(name: str) -> None:
    change, reason = POISON[name]
    sent = step_of(6, 0)
    reasons = Scrutiny(config=CONFIG).refuse(0, {**sent, "d2": change(sent["d2"]), "d5": change(sent["d5"])}, NUM_SPLATS, LAYOUT)
    assert set(reasons) == {"d2", "d5"}
    assert reason in reasons["d2"]


@pytest.mark.parametrize("kind", ["flipped", "noise", "other rows"])
def test_who_contradicts_the_others_is_left_out_for_good(kind: str) -> None:
    scrutiny, rng, refused_at = Scrutiny(config=CONFIG), np.random.default_rng(5), {}
    for step in range(60):
        sent = step_of(6, step, agree=0.5)
        for name in ("d1", "d4"):
            values = sent[name].values.copy()
            gradient = values[:, : LAYOUT.growth]
            if kind == "flipped":
                gradient *= -1
            elif kind == "noise":
                gradient[:] = rng.standard_normal(gradient.shape) * gradient.std()
            else:
                gradient[:] = gradient[rng.permutation(len(gradient))]
            sent[name] = replace(sent[name], values=values)
        for name in scrutiny.refuse(step, sent, NUM_SPLATS, LAYOUT):
            refused_at.setdefault(name, step)
    assert set(refused_at) == {"d1", "d4"} == set(scrutiny.left_out)
    assert max(refused_at.values()) < 40
    assert f"left out from step {refused_at['d1'] + 1} on" in scrutiny.left_out["d1"]


def flipped(gradients: StepGradients, step: int) -> StepGradients:
    signs = np.where(np.arange(LAYOUT.num_columns) < LAYOUT.growth, -1, 1).astype(np.float32)
    return replace(gradients, values=signs * gradients.values)


def noise(gradients: StepGradients, step: int) -> StepGradients:
    drawn = np.random.default_rng((9, step)).standard_normal(gradients.values.shape) * gradients.values.std()
    drawn[:, LAYOUT.growth] = gradients.values[:, LAYOUT.growth]
    return replace(gradients, values=drawn.astype(np.float32))


def long(gradients: StepGradients, step: int) -> StepGradients:
    return replace(gradients, values=np.float32(20) * gradients.values)


def growing(gradients: StepGradients, step: int) -> StepGradients:
    factors = np.where(np.arange(LAYOUT.num_columns) == LAYOUT.growth, 50, 1).astype(np.float32)
    return replace(gradients, values=factors * gradients.values)


@pytest.mark.parametrize(
    ("lie", "words"), [(flipped, "mean cosine"), (noise, "mean cosine"), (long, "d0's gradients are 0.0"), (growing, "growth are 0.0")]
)
def test_two_senders_that_contradict_each_other_both_count_and_are_both_named_once(
    lie: Callable[[StepGradients, int], StepGradients], words: str
) -> None:
    scrutiny, warned = Scrutiny(config=CONFIG), list[str]()
    for step in range(90):
        sent = step_of(2, step)
        assert scrutiny.refuse(step, {**sent, "d1": lie(sent["d1"], step)}, NUM_SPLATS, LAYOUT) == {}
        warned += scrutiny.take_warnings()
        if step == 70:
            # One that begins anew says nothing twice.
            state, scrutiny = scrutiny.state(), Scrutiny(config=CONFIG)
            scrutiny.restore(json.loads(json.dumps(state)))
    assert len(warned) == 1 and warned[0].startswith("d0 and d1 contradict each other from step ")
    assert words in warned[0] and "all of them count" in warned[0]


def test_two_honest_senders_do_not_contradict_each_other() -> None:
    scrutiny = Scrutiny(config=CONFIG)
    for step in range(120):
        sent = step_of(2, step, agree=0.3 / (1 + step / 60), size=1e-3 / (1 + step / 50))
        assert scrutiny.refuse(step, sent, NUM_SPLATS, LAYOUT) == {}
    assert scrutiny.take_warnings() == [] and scrutiny.ties == {}


def test_two_of_four_that_lie_alike_are_no_majority_and_all_are_named() -> None:
    scrutiny = Scrutiny(config=CONFIG)
    for step in range(60):
        sent = step_of(4, step, agree=0.8)
        sent |= {name: flipped(sent[name], step) for name in ("d1", "d3")}
        assert scrutiny.refuse(step, sent, NUM_SPLATS, LAYOUT) == {}
    (warning,) = scrutiny.take_warnings()
    assert warning.startswith("d0, d1, d2 and d3 contradict each other") and scrutiny.left_out == {}


def test_a_view_of_nothing_is_refused_and_its_sender_counts_again() -> None:
    scrutiny = Scrutiny(config=CONFIG)
    for step in range(40):
        sent = step_of(4, step)
        if step == 3:
            sent["d2"] = replace(StepGradients.nothing(LAYOUT), num_views=1, loss=0.2)
        assert set(scrutiny.refuse(step, sent, NUM_SPLATS, LAYOUT)) == ({"d2"} if step == 3 else set())


def test_a_restored_scrutiny_decides_as_the_one_that_went_on() -> None:
    whole, first = Scrutiny(config=CONFIG, secret=9), Scrutiny(config=CONFIG, secret=9)

    def sent(step: int) -> dict[str, StepGradients]:
        made = step_of(4, step)
        made["d3"] = replace(made["d3"], values=np.where(np.arange(24) < LAYOUT.growth, -1, 1).astype(np.float32) * made["d3"].values)
        return made

    one = [whole.refuse(step, sent(step), NUM_SPLATS, LAYOUT) for step in range(40)]
    two = [first.refuse(step, sent(step), NUM_SPLATS, LAYOUT) for step in range(10)]
    second = Scrutiny(config=CONFIG)
    second.restore(json.loads(json.dumps(first.state())))
    two += [second.refuse(step, sent(step), NUM_SPLATS, LAYOUT) for step in range(10, 40)]
    assert one == two
    assert "d3" in whole.left_out
    assert second.state() == whole.state()


def test_who_is_always_much_longer_is_left_out() -> None:
    scrutiny, reasons = Scrutiny(config=CONFIG), {}
    for step in range(STEADY_STEPS + 1):
        sent = step_of(4, step)
        sent["d2"] = replace(sent["d2"], values=np.float32(6) * sent["d2"].values)
        reasons = scrutiny.refuse(step, sent, NUM_SPLATS, LAYOUT)
    assert set(reasons) == {"d2"}
    assert "times as long as those of others" in scrutiny.left_out["d2"]


def test_a_change_of_size_for_all_is_no_poison() -> None:
    scrutiny = Scrutiny(config=CONFIG)
    for step in range(40):
        factor = np.float32(1 if step < 20 else 30)
        sent = {name: replace(each, values=factor * each.values) for name, each in step_of(6, step, size=1e-4).items()}
        assert scrutiny.refuse(step, sent, NUM_SPLATS, LAYOUT) == {}


def test_an_inbox_counts_what_it_refuses_and_why() -> None:
    inbox = Inbox(most_views={f"d{number}": 1 for number in range(4)}, scrutiny=Scrutiny(config=CONFIG))
    for step in range(3):
        sent = step_of(4, step)
        sent["d1"] = replace(sent["d1"], values=np.float32(1e6) * sent["d1"].values)
        sent["d3"] = replace(sent["d3"], values=np.full_like(sent["d3"].values, np.inf))
        messages = {name: encode_gradients(each, step, NUM_SPLATS, LAYOUT, "float32") for name, each in sent.items()}
        usable = inbox.read(messages, step, NUM_SPLATS, LAYOUT)
        assert [len(each.rows) for each in usable] == [len(sent["d0"].rows), len(sent["d2"].rows)]
    assert {name: refused.count for name, refused in inbox.refused.items()} == {"d1": 3, "d3": 3}
    assert inbox.refused["d3"].first.startswith("step 1: gradients of step 1 are not finite")
    assert "a photograph causes at most" in inbox.refused["d1"].first


def test_the_shape_of_a_message_of_no_gaussian_is_fine() -> None:
    nothing = replace(StepGradients.nothing(LAYOUT), num_views=1, loss=0.3)
    assert check_shape(nothing, CONFIG, LAYOUT) is None
    assert SAMPLE > 1
