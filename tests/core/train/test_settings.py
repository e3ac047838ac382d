"""`TrainConfig` as a record and by paths: it comes back as it was, texts are read by type, what
does not fit is refused."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from typing import get_args

import pytest

from radiant_core.errors import BadInput
from radiant_core.hierarchy.codec import message_of, message_record
from radiant_core.train.config import Preset, TrainConfig, setting_types, train_preset, with_settings
from radiant_core.train.densify.policies import Adc, DensityKind, Mcmc, NoDensification

CONFIG = train_preset("default")


@pytest.mark.parametrize("preset", get_args(Preset))
@pytest.mark.parametrize("kind", get_args(DensityKind))
def test_a_configuration_comes_back_from_its_record(preset: str, kind: str) -> None:
    config = with_settings(train_preset(preset), {"density.kind": kind})
    record = json.loads(json.dumps(message_record(config)))
    assert record == asdict(config) and message_of(TrainConfig, record) == config


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"density": {"kind": "grow"}}, "density.*'none', 'adc', 'planned', 'mcmc'"),
        ({"density": {"kind": "adc", "every": "often"}}, "every.*valid integer"),
        ({"density": {"kind": "adc", "every": 0}}, "every is 0"),
        ({"num_steps": 0}, "num_steps is 0"),
    ],
)
def test_a_record_that_is_none_is_refused(change: dict, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        message_of(TrainConfig, message_record(CONFIG) | change)


def test_settings_reach_a_policys_knobs_by_path_and_have_their_type() -> None:
    config = with_settings(CONFIG, {"sh_degree": "2", "budget_s": "None", "sky": "false", "density.min_gradient": "3e-4"})
    assert config == replace(CONFIG, sh_degree=2, sky=False, density=replace(CONFIG.density, min_gradient=3e-4))
    assert with_settings(CONFIG, {"density.pixels_per_splat": None, "start_scale": 1}).density == replace(
        CONFIG.density, pixels_per_splat=None
    )


def test_another_policy_keeps_the_knobs_that_both_have() -> None:
    every = with_settings(CONFIG, {"density.every": "7", "density.kind": "mcmc"})
    assert every == replace(CONFIG, density=Mcmc(every=7))
    assert with_settings(CONFIG, {"density.kind": "adc"}).density == replace(CONFIG.density, kind="adc")
    assert with_settings(CONFIG, {"density.kind": "none"}).density == NoDensification()
    assert with_settings(replace(CONFIG, density=NoDensification()), {"density.kind": "planned"}).density == Adc(kind="planned")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"densify": "adc"}, "densify is no setting of training: .*density.kind"),
        ({"density": "adc"}, "density is no setting"),
        ({"density.kind": "mcmc", "density.min_gradient": "1"}, "density.min_gradient is no setting of 'mcmc'"),
        ({"density.every": "0"}, "every is 0"),
        ({"density.every": "often"}, "density.every is 'often': .*valid integer"),
        ({"density.min_gradient": "inf"}, "min_gradient is inf"),
        ({"means_lr": "nan"}, "means_lr is nan"),
        ({"scales_lr": "-1"}, "scales_lr is -1"),
        ({"sh_degree": "none"}, "sh_degree is 'none': .*valid integer"),
    ],
)
def test_what_is_no_setting_or_no_value_is_refused(settings: dict[str, str], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        with_settings(CONFIG, settings)


def test_every_field_of_the_configuration_is_a_setting() -> None:
    paths = {*(set(asdict(CONFIG)) - {"density"}), *(f"density.{name}" for name in asdict(CONFIG.density))}
    assert paths == set(setting_types())
