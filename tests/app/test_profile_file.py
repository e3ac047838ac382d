"""Curve files: what is written is read again, what is wrong gets one sentence, and the library says where each figure comes from."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_app.commands.machine.profile import library_table
from radiant_app.files.profile_file import library_profiles, load_profile, save_profile
from radiant_app.files.system_file import load_system
from radiant_core.errors import BadInput
from tests.core.plan.test_profiles import MEASURED

SYSTEM = """
[[edge]]
id = "e"
profile = "mine.toml"
[[edge.device]]
id = "d1"
profile = "mine.toml"
relative_speed = 2.0
[[edge.device]]
id = "d2"
profile = "rtx-3090"
max_cameras = 100
"""
# gsplat, docs/source/tests/eval.rst: millions of Gaussians and seconds of 30,000 steps per scene on
# a TITAN RTX.
PUBLISHED = np.array([(6.26, 2964), (1.25, 1422), (1.21, 1621), (5.84, 3013), (1.79, 2020), (1.59, 1708), (4.81, 2299)])
OUTDOOR = np.array([(6.26, 169), (5.84, 161), (4.81, 109)])
"""Millions of Gaussians and training photographs (7 of 8) of bicycle, garden and stump."""


@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_what_is_written_is_read_again(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"mine{suffix}"
    profile = replace(
        MEASURED, name=path.name, machine='a "Läptop" 😀 \\ 2', memory_bytes=8e9, measured_steps=300, frames_s=7.5, frames_alone_s=6.5
    )
    profile = replace(profile, latency_s=1.1e-4, add_s_per_byte=2.3e-9)
    save_profile(path, profile)
    assert load_profile(path) == profile


def test_a_system_takes_costs_and_memory_from_profiles(tmp_path: Path) -> None:
    save_profile(tmp_path / "mine.toml", replace(MEASURED, aggregate_alone_s=MEASURED.init_s))
    (tmp_path / "system.toml").write_text(SYSTEM)
    (edge,) = load_system(tmp_path / "system.toml").edges
    first, second = edge.devices
    np.testing.assert_allclose(first.train_s([10, 50]), MEASURED.train_s.curve([10, 50]) / 2)
    assert first.model_bytes == MEASURED.model_bytes.curve
    assert first.profile is not None and first.profile.name == "mine.toml" and first.memory_bytes is None
    assert MEASURED.aggregate_s is not None and edge.aggregate_s == MEASURED.aggregate_s.curve
    assert edge.aggregate_alone_s == MEASURED.init_s.curve and edge.aggregation_s(20, 2) == pytest.approx(30, rel=1e-6)
    assert (second.memory_bytes, second.max_cameras) == (24e9, 100)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('profile = "rtx-3090"', 'profile = "rtx-9999"', "device 'd2': profile 'rtx-9999' is not in the library: use one of a100"),
        ('profile = "rtx-3090"', 'profile = "none.toml"', "device 'd2'"),
        ('profile = "rtx-3090"', 'profile = "rtx-3090"\ntrain_s = { linear = 1.0 }', "device 'd2' has both profile and train_s"),
        ('profile = "mine.toml"\n[[', 'profile = "mine.toml"\naggregate_s = { linear = 1.0 }\n[[', "'e' has both profile and aggregate_s"),
        ('profile = "rtx-3090"', "profile = 3", "profile is 3; expected a valid string"),
    ],
)
def test_a_profile_that_cannot_be_used_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    save_profile(tmp_path / "mine.toml", MEASURED)
    assert old in SYSTEM
    (tmp_path / "system.toml").write_text(SYSTEM.replace(old, new, 1))
    with pytest.raises(BadInput) as caught:
        load_system(tmp_path / "system.toml")
    assert message in str(caught.value) and str(caught.value).startswith(str(tmp_path / "system.toml"))


def test_an_edge_and_the_cloud_take_what_an_exchange_costs_from_profiles_unless_it_is_spelt_out(tmp_path: Path) -> None:
    save_profile(tmp_path / "mine.toml", replace(MEASURED, latency_s=3e-4, add_s_per_byte=5e-9))
    (tmp_path / "system.toml").write_text(SYSTEM)
    (edge,) = load_system(tmp_path / "system.toml").edges
    assert (edge.latency_s, edge.add_s_per_byte) == (3e-4, 5e-9)
    (tmp_path / "system.toml").write_text(SYSTEM.replace('id = "e"', 'id = "e"\nlatency_ms = 7.0', 1))
    (edge,) = load_system(tmp_path / "system.toml").edges
    assert (edge.latency_s, edge.add_s_per_byte) == (7e-3, 5e-9)
    save_profile(tmp_path / "mine.toml", MEASURED)
    (tmp_path / "system.toml").write_text(SYSTEM)
    (edge,) = load_system(tmp_path / "system.toml").edges
    assert (edge.latency_s, edge.add_s_per_byte) == (None, None)


@pytest.mark.parametrize("name", ["latency_s", "add_s_per_byte"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_an_exchange_that_takes_no_time_is_refused(name: str, value: float) -> None:
    with pytest.raises(BadInput, match=f"a profile's {name} is"):
        replace(MEASURED, **{name: value})


def test_an_edge_cannot_take_what_was_not_measured(tmp_path: Path) -> None:
    save_profile(tmp_path / "mine.toml", replace(MEASURED, aggregate_s=None))
    (tmp_path / "system.toml").write_text(SYSTEM)
    with pytest.raises(BadInput, match=r"'e': profile 'mine.toml' has no aggregate_s"):
        load_system(tmp_path / "system.toml")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('kind = "measured"', 'kind = "guessed"', "kind is 'guessed'; expected 'measured' or 'estimate'"),
        ('kind = "measured"', 'kind = "measured"\nspeed = 2', "speed is not a key of a curve file"),
        ("num_steps = 1500", "num_steps = 1500.5", "key.num_steps is 1500.5"),
        ("num_steps = 1500", "num_steps = 0", "key.num_steps is 0"),
        ("num_steps = 1500", "", "key.num_steps is missing"),
        ("linear = 1.0", "linear = -1.0", "init_s.linear is -1.0; expected greater than or equal to 0"),
        ("linear = 1.0", "linear = nan", "init_s.linear is nan"),
        ("linear = 1.0", "linear = 2.0", "init_s: a curve states rmse"),
        ("range = [10, 50]", "range = [10]", "init_s.range is [10]"),
        ("range = [10, 50]", "range = [50, 10]", "init_s: a curve was fitted on 50 to 10 cameras"),
        ("[[10, 20.0], [20, 30.0], [50, 60.0]]", "[[10, 60.0], [20, 30.0], [50, 20.0]]", "init_s: a curve states rmse"),
        ("[[10, 20.0], [20, 30.0], [50, 60.0]]", "[[10, nan], [20, 30.0], [50, 60.0]]", "init_s.samples[0][1] is nan"),
        ("[[10, 20.0], [20, 30.0], [50, 60.0]]", "[[10.5, 20.0], [20, 30.0], [50, 60.0]]", "is no whole number"),
        ("[train_s]", "[train]", "is missing"),
    ],
)
def test_a_bad_value_gets_one_sentence(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "mine.toml"
    fitted = replace(MEASURED.init_s, curve=replace(MEASURED.init_s.curve, constant=10.0, linear=1.0), rmse=0.0, worst_error=0.0)
    save_profile(path, replace(MEASURED, init_s=fitted))
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(BadInput) as caught:
        load_profile(path)
    assert str(caught.value).startswith(f"{path}: ") and message in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"[", b"\xff", b"[1]", b'{"kind": NaN}', b"[" * 2000])
@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_a_file_of_another_kind_is_refused(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = tmp_path / f"file{suffix}"
    path.write_bytes(content)
    with pytest.raises(BadInput, match="file"):
        load_profile(path)


def test_nan_in_json_is_refused_and_a_missing_file_named(tmp_path: Path) -> None:
    path = tmp_path / "mine.json"
    save_profile(path, MEASURED)
    record = json.loads(path.read_text())
    record["train_s"]["constant"] = float("inf")
    path.write_text(json.dumps(record))
    with pytest.raises(BadInput, match="Infinity is not finite"):
        load_profile(path)
    with pytest.raises(BadInput, match="cannot be read"):
        load_profile(tmp_path / "none.json")
    with pytest.raises(BadInput, match="ends in"):
        save_profile(tmp_path / "mine.txt", MEASURED)


def test_every_profile_of_the_library_is_an_estimate_or_measured_and_says_its_source() -> None:
    known = {name: load_profile(path, name) for name, path in library_profiles().items()}
    assert {"rtx-3060", "rtx-3090", "rtx-4090", "a100", "h100", "jetson-orin", "laptop-cpu"} <= known.keys()
    whole = " ".join(library_table().split())
    for name, profile in known.items():
        assert profile.kind == "estimate" and len(profile.source) > 50
        assert profile.aggregate_s is not None and profile.memory_bytes is not None
        # Seconds stand beside the training that they are of.
        assert re.search(rf"(^| ){name} estimate [\d,]+ s {re.escape(str(profile.key))} ", whole)
        assert f"{name}: {profile.machine}. {profile.source}" in whole
    assert "different trainings do not compare" in whole


def test_the_gpus_follow_from_the_published_figures() -> None:
    """The relative least squares of the seven scenes, and the Gaussians per photograph of the outdoor ones."""
    millions, seconds = PUBLISHED.T
    terms = np.column_stack([np.ones(7), millions]) / seconds[:, None]
    (constant, per_million), *_ = np.linalg.lstsq(terms, np.ones(7), rcond=None)
    per_photograph = float(np.mean(OUTDOOR[:, 0] / OUTDOOR[:, 1]))
    titan = load_profile(library_profiles()["titan-rtx"])
    assert titan.train_s.curve.constant == pytest.approx(constant, rel=1e-3)
    assert titan.train_s.curve.linear == pytest.approx(per_million * per_photograph, rel=1e-3)
    assert titan.model_bytes.curve.linear == pytest.approx(1e6 * per_photograph * 59 * 4, rel=1e-3)
    assert titan.train_s.rmse == pytest.approx(np.sqrt(np.mean((terms @ [constant, per_million] - 1) ** 2)), abs=1e-3)
    a100 = load_profile(library_profiles()["a100"])
    faster = titan.train_s.curve.constant / a100.train_s.curve.constant
    assert faster == pytest.approx(np.sqrt(2039 / 672 * 19.5 / 16.3), rel=1e-3)
    # gsplat's own mean over the same scenes on an A100.
    assert faster == pytest.approx(seconds.mean() / (19.39 * 60), rel=0.05)
