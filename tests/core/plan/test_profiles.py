"""Profiles: which training they hold for, and where a plan asks more of them than they know."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from radiant_core.errors import BadInput
from radiant_core.plan.profiles.cost_curves import CostCurve
from radiant_core.plan.profiles.curve_fit import fit_curve
from radiant_core.plan.profiles.profile import Profile, ProfileKey
from radiant_core.plan.profiles.profile_warnings import profile_warnings
from radiant_core.plan.system import Device, Edge, System

KEY = ProfileKey(preset="default", num_steps=1500, long_side_px=576, max_num_splats=200_000)
FITTED = fit_curve([10, 20, 50], [20.0, 30.0, 60.0])
MEASURED = Profile(
    name="mine.toml",
    kind="measured",
    machine="mine",
    source="a short run",
    key=KEY,
    init_s=FITTED,
    train_s=FITTED,
    model_bytes=FITTED,
    aggregate_s=FITTED,
)


def system(*profiles: Profile | None, edge_profile: Profile | None = None) -> System:
    curve = CostCurve(linear=1)
    devices = tuple(
        Device(id=f"d{index}", init_s=curve, train_s=curve, model_bytes=curve, uplink_bytes_per_s=1e6, profile=profile)
        for index, profile in enumerate(profiles)
    )
    edge = Edge(id="e", position=(0.0, 0.0), aggregate_s=curve, uplink_bytes_per_s=1e6, devices=devices, profile=edge_profile)
    return System(edges=(edge,))


@pytest.mark.parametrize(
    ("changed", "same"),
    [
        ({}, True),
        ({"long_side_px": 600}, True),
        ({"long_side_px": 640}, False),
        ({"preset": "draft"}, False),
        ({"num_steps": 1501}, False),
        ({"max_num_splats": None}, True),
        ({"max_num_splats": 20_000}, False),
        ({"aggregate_preset": "paper"}, True),
    ],
)
def test_curves_hold_for_the_same_training_alone(changed: dict[str, Any], same: bool) -> None:
    other = replace(KEY, **changed)
    assert KEY.matches_training(other) is same and other.matches_training(KEY) is same


def test_within_what_was_measured_nothing_is_warned_of() -> None:
    assert profile_warnings(system(MEASURED, None, edge_profile=MEASURED), [60, 40], KEY) == ()


def test_beyond_twice_the_range_the_prediction_is_said_to_be_extrapolated() -> None:
    warnings = profile_warnings(system(MEASURED, MEASURED, MEASURED, edge_profile=MEASURED), [101, 100, 250], KEY)
    assert len(warnings) == 2
    assert warnings[0].startswith("devices d0, d2 would get up to 250 photographs") and "50 at most" in warnings[0]
    assert warnings[1].startswith("edge e would get up to 451 photographs") and "extrapolated" in warnings[1]


def test_a_device_without_photographs_is_not_spoken_of() -> None:
    estimate = replace(MEASURED, name="gpu", kind="estimate", key=replace(KEY, preset="paper"))
    assert profile_warnings(system(MEASURED, estimate), [10, 0], KEY) == ()


def test_an_estimate_and_another_training_are_said_once_for_all_their_devices() -> None:
    estimate = replace(MEASURED, name="gpu", kind="estimate", machine="some GPU", key=replace(KEY, preset="standard", num_steps=30_000))
    found = profile_warnings(system(*[estimate] * 6), [10] * 6, KEY)
    assert len(found) == 2
    assert found[0].startswith("the times of devices d0, d1, d2, d3 and 2 more are estimates for some GPU")
    assert (
        "preset standard, 30,000 steps" in found[1]
        and "preset default, 1,500 steps at 576 px" in found[1]
        and "radiant machine profile" in found[1]
    )


def test_steps_that_were_multiplied_are_said() -> None:
    (warning,) = profile_warnings(system(replace(MEASURED, measured_steps=300)), [10], KEY)
    assert "measured over 300 steps and multiplied up to 1,500" in warning
    assert profile_warnings(system(replace(MEASURED, measured_steps=750)), [10], KEY) == ()


def test_another_aggregation_is_said_of_the_edge() -> None:
    (warning,) = profile_warnings(system(None, edge_profile=MEASURED), [10], replace(KEY, aggregate_preset="paper"))
    assert warning.startswith("the curves of edge e") and "default" in warning and "paper" in warning


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"kind": "guess"}, "kind is 'guess'"),
        ({"source": ""}, "neither machine nor source"),
        ({"memory_bytes": 0.0}, "memory is 0.0"),
        ({"memory_bytes": float("nan")}, "memory is nan"),
        ({"measured_steps": 1501}, "measured_steps is 1501"),
        ({"frames_s": 0.0}, "frames_s is 0.0, expected a positive number of seconds"),
        ({"frames_alone_s": float("inf")}, "frames_alone_s is inf"),
    ],
)
def test_what_is_no_profile_is_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        replace(MEASURED, **fields)


def test_what_is_no_training_is_refused() -> None:
    for fields in ({"num_steps": 0}, {"long_side_px": -1}, {"max_num_splats": 0}, {"preset": ""}):
        with pytest.raises(BadInput):
            replace(KEY, **fields)


@pytest.mark.parametrize("name", ["num_steps", "long_side_px", "max_num_splats"])
def test_a_training_has_one_of_everything_at_least(name: str) -> None:
    assert getattr(replace(KEY, **{name: 1}), name) == 1
    with pytest.raises(BadInput, match=f"{name} is 0, expected at least 1"):
        replace(KEY, **{name: 0})


def test_sizes_a_tenth_apart_train_alike_and_measured_steps_are_some_of_the_profiles() -> None:
    assert replace(KEY, long_side_px=1000).matches_training(replace(KEY, long_side_px=1100))
    assert not replace(KEY, long_side_px=1000).matches_training(replace(KEY, long_side_px=1101))
    for steps in (1, 1500):
        assert replace(MEASURED, measured_steps=steps).measured_steps == steps
    with pytest.raises(BadInput, match="measured_steps is 0, expected 1 to its 1500"):
        replace(MEASURED, measured_steps=0)


def test_every_warning_in_full() -> None:
    estimate = replace(MEASURED, name="gpu", kind="estimate", machine="some GPU")
    (one,) = profile_warnings(system(estimate), [10], KEY)
    assert one == "the times of device d0 are estimates for some GPU, never measured: run `radiant machine profile` there."
    scaled = replace(MEASURED, measured_steps=749)
    (two,) = profile_warnings(system(scaled), [10], KEY)
    assert two == (
        f"the times of device d0, profile {MEASURED.name!r}, were measured over 749 steps and multiplied up to 1,500: "
        "give `radiant machine profile` more --time for better ones."
    )
    assert len(profile_warnings(system(*[estimate] * 4), [10] * 4, KEY)) == 1
    assert "devices d0, d1, d2, d3 are" in profile_warnings(system(*[estimate] * 4), [10] * 4, KEY)[0]
    assert "devices d0, d1, d2, d3 and 1 more are" in profile_warnings(system(*[estimate] * 5), [10] * 5, KEY)[0]
    key = replace(KEY, max_num_splats=2_000_000)
    assert str(key) == "preset default, 1,500 steps at 576 px, at most 2,000,000 Gaussians"
    assert str(replace(KEY, max_num_splats=None)) == "preset default, 1,500 steps at 576 px"


def test_cameras_of_an_edge_are_those_of_its_own_devices() -> None:
    first = system(MEASURED, MEASURED, edge_profile=MEASURED).edges[0]
    second = replace(first, id="f", devices=tuple(replace(d, id=f"x{d.id}") for d in first.devices))
    both = System(edges=(first, second))
    assert profile_warnings(both, [50, 50, 50, 50], KEY) == ()
    (joined,) = profile_warnings(both, [50, 50, 51, 50], KEY)
    assert joined.startswith("edge f would get up to 101 photographs, profile") and "time of aggregation are extrapolated" in joined
    assert profile_warnings(both, [100, 0, 0, 100], KEY) == ()
