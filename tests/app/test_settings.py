"""`--set NAME=VALUE`: typed by the settings themselves, forced in the decisions, refused in one sentence."""

from __future__ import annotations

import pytest

from radiant_app.cli.settings import settings_of
from radiant_core.errors import BadInput
from radiant_core.train.config import train_preset
from radiant_core.train.needs import Overrides, fit_to_backend


def test_values_have_the_type_of_their_setting() -> None:
    given = [
        "exposure=none",
        "start_scale=1",
        "sky=false",
        "sh-degree=2",
        "budget_s=none",
        "max_scale_per_distance=0.5",
        "density.kind = mcmc",
    ]
    assert settings_of(given) == {
        "exposure": "none", "start_scale": 1.0, "sky": False, "sh_degree": 2, "budget_s": None, "max_scale_per_distance": 0.5,
        "density.kind": "mcmc",
    }  # fmt: skip


def test_what_is_set_is_a_forced_decision() -> None:
    overrides = Overrides(settings=settings_of(["start_scale=1", "density.kind=none"]))
    config, decisions = fit_to_backend(train_preset("default"), "gsplat", overrides)
    assert (config.start_scale, config.density.kind) == (1.0, "none")
    assert {decision.topic: decision.forced for decision in decisions} == {"start_scale": True, "density.kind": True}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["colour=red"], "expected NAME=VALUE with one of .*sh_degree"),
        (["start_scale"], "expected NAME=VALUE"),
        (["start_scale=big"], "unable to parse"),
        (["density.kind=grow"], "'none', 'adc', 'planned' or 'mcmc'"),
        (["sh_degree=none"], "valid integer"),
        (["num_steps=5"], "use --steps"),
        (["sky=true", "sky=false"], "given twice"),
    ],
)
def test_what_is_no_setting_is_refused(given: list[str], said: str) -> None:
    with pytest.raises(BadInput, match=said):
        settings_of(given)


def test_a_value_out_of_range_is_refused_when_it_is_applied() -> None:
    with pytest.raises(BadInput, match=r"start_scale is 2\.0"):
        fit_to_backend(train_preset("default"), "gsplat", Overrides(settings=settings_of(["start_scale=2"])))
