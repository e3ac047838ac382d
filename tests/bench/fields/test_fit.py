"""Fitting: a field learns what photographs show, the same bits each time, and says when it cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from benchmarks.fields.field import make_field
from benchmarks.fields.fit import FitFieldConfig, FitFieldOptions, fit_field
from benchmarks.fields.poses import SharedMove
from benchmarks.fields.rays import PixelRays
from benchmarks.fields.render import render_image
from radiant_core.errors import BadInput, StageFailed
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.train.results import TrainProgress
from tests.bench.fields.floor import FIT, SIZES, bounds_of, floor_scene


def test_a_field_learns_a_floor_it_has_seen_and_a_view_it_has_not() -> None:
    scene, views = floor_scene(4)
    bounds = bounds_of(scene)
    pixels = PixelRays.of(views.select([index for index in range(16) if index != 5]), bounds)
    field = make_field(SIZES, 0)
    heard: list[TrainProgress] = []
    fit = fit_field(field, pixels, replace(FIT, num_steps=120), FitFieldOptions(report=heard.append, report_every_s=0))
    assert fit.num_steps == 120 == len(fit.losses) == len(heard) and fit.num_rays == 120 * 256
    assert np.mean(fit.losses[-10:]) < 0.1 * np.mean(fit.losses[:3])
    image = render_image(field, views.cameras, bounds, 5, FIT.sampling)
    assert psnr_db(image, views.images[5] / 255) > 20


def test_a_fit_is_the_same_bits_again() -> None:
    scene, views = floor_scene()
    pixels = PixelRays.of(views, bounds_of(scene))
    fields = [make_field(SIZES, 3), make_field(SIZES, 3), make_field(SIZES, 4)]
    losses = [fit_field(field, pixels, replace(FIT, num_steps=4)).losses for field in fields]
    assert losses[0] == losses[1] != losses[2]
    assert all(torch.equal(a, b) for a, b in zip(fields[0].parameters(), fields[1].parameters(), strict=True))


def test_poses_that_are_off_are_moved_back() -> None:
    right, views = floor_scene()
    bounds = bounds_of(right)
    field = make_field(SIZES, 0)
    fit_field(field, PixelRays.of(views, bounds), replace(FIT, num_steps=120))
    before = [parameter.clone() for parameter in field.parameters()]
    _, strayed = floor_scene(offset_m=0.3)
    move = SharedMove()
    options = FitFieldOptions(moved=move, extra_parameters=((move.values, 3e-3),))
    fit_field(field.requires_grad_(False), PixelRays.of(strayed, bounds), replace(FIT, num_steps=60), options)
    # The cameras are told to stand 0.3 m too far along x.
    assert float(move.values.detach()[3]) * bounds.radius_m == pytest.approx(-0.3, abs=0.1)
    assert all(torch.equal(old, new) for old, new in zip(before, field.parameters(), strict=True))


def test_what_cannot_be_fitted_is_named() -> None:
    scene, views = floor_scene()
    pixels = PixelRays.of(views, bounds_of(scene))
    field = make_field(SIZES, 0)
    with torch.no_grad():
        field.get_parameter("color.0.weight").fill_(torch.nan)
    with pytest.raises(StageFailed, match="the loss of the field is nan at step 0"):
        fit_field(field, pixels, FIT)
    for wrong in ({"num_steps": 0}, {"rate": float("nan")}, {"rate_end": 0}):
        with pytest.raises(BadInput, match="a field was given"):
            FitFieldConfig(**wrong)
