"""Checkpoints: every bit comes back, damage is recognised, writing is atomic and cheap."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.run_store import read_json
from radiant_core.train.checkpoint import MAX_SHARE, CheckpointFolder, training_key
from radiant_core.train.config import TrainConfig, with_settings
from radiant_core.train.densify.policies import Adc
from radiant_core.train.results import TrainResult, TrainState
from radiant_core.train.trainer import FitOptions, Training, fit_splats
from tests.core.train.test_trainer import CONFIG, grey_start, photographs

VIEWS = photographs()
SCHEDULE = replace(CONFIG, num_steps=24, schedule_steps=24, sh_degree=1)
EDITS = Adc(from_step=2, until_step=22, every=3, min_gradient=1e-6, reset_opacity_every=11)
EVERYTHING = replace(
    SCHEDULE,
    density=EDITS,
    max_num_splats=600,
    start_scale=0.5,
)


class Killed(Exception):
    """Stands for the end of the process: raised where it would die; the run is not used after."""


class Clock:
    """Seconds that only the test moves."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


class EveryStep(CheckpointFolder):
    """Saves after each step, and dies after one of them."""

    def __init__(self, folder: Path, key: str, die_after: int) -> None:
        clock = Clock()
        super().__init__(folder, key, every_s=1e-9, clock=clock)
        self._test_clock, self._die_after = clock, die_after

    def offer(self, step: int, state: Callable[[], TrainState]) -> None:
        """Save, then perhaps die."""
        self._test_clock.now_s += 1
        super().offer(step, state)
        if step == self._die_after:
            raise Killed


def with_checkpoints(checkpoints: CheckpointFolder, config: TrainConfig, validation: bool = False) -> TrainResult:
    options = FitOptions(checkpoints=checkpoints, validation=VIEWS.select([1, 4]) if validation else None)
    return fit_splats(grey_start(), VIEWS, config, options)


def run_key(config: TrainConfig = CONFIG) -> str:
    return training_key(grey_start(), VIEWS, config, FitOptions())


def saved_twice(folder: Path) -> None:
    """Checkpoints of the steps 3 and 4 of `SCHEDULE`."""
    with pytest.raises(Killed):
        with_checkpoints(EveryStep(folder, run_key(SCHEDULE), die_after=4), SCHEDULE)


@pytest.mark.parametrize(
    "config",
    [
        pytest.param(EVERYTHING, id="adc, half size first"),
        pytest.param(
            with_settings(EVERYTHING, {"density.kind": "planned", "adam": "dense", "sh_degree_every": 8}),
            id="planned, dense Adam, degrees of colour",
        ),
        pytest.param(with_settings(EVERYTHING, {"density.kind": "mcmc"}), id="mcmc"),
        pytest.param(replace(EVERYTHING, density=replace(EDITS, gradient="absolute", min_absolute=4e-6)), id="adc by absolute gradients"),
    ],
)
@pytest.mark.parametrize("die_after", [1, 9, 10, 23])
def test_a_run_that_died_ends_with_the_bits_of_one_that_did_not(config: TrainConfig, die_after: int, tmp_path: Path) -> None:
    whole = fit_splats(grey_start(), VIEWS, config, FitOptions(validation=VIEWS.select([1, 4])))
    with pytest.raises(Killed):
        with_checkpoints(EveryStep(tmp_path, "key", die_after), config, validation=True)
    resumed = with_checkpoints(CheckpointFolder(tmp_path, "key"), config, validation=True)
    for name, array in whole.splats.arrays().items():
        np.testing.assert_array_equal(array, resumed.splats.arrays()[name], err_msg=name)
    for name in ("num_steps", "first_loss", "last_loss", "density", "validation", "best_step"):
        assert getattr(whole, name) == getattr(resumed, name), name


def test_all_that_a_state_holds_comes_back_from_the_disk(tmp_path: Path) -> None:
    training = Training(grey_start(), VIEWS, EVERYTHING, FitOptions())
    for _ in range(8):
        training.take_step()
    before = training.state()
    clock = Clock()
    folder = CheckpointFolder(tmp_path, "key", clock=clock)
    clock.now_s = 100
    folder.offer(training.step, lambda: before)
    after = folder.load()
    assert after is not None and after.numbers == before.numbers and after.arrays.keys() == before.arrays.keys()
    for name, array in before.arrays.items():
        assert after.arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(after.arrays[name], array, err_msg=name)


def test_the_newest_two_are_kept_and_a_finished_run_removes_them(tmp_path: Path) -> None:
    folder = tmp_path / "checkpoints"
    saved_twice(folder)
    assert sorted(path.name for path in folder.iterdir()) == [f"step-0000000{n}.{kind}" for n in (3, 4) for kind in ("json", "safetensors")]
    CheckpointFolder(folder, "any").remove()
    assert not folder.exists()


@pytest.mark.parametrize("name", ["step-00000004.safetensors", "step-00000004.json"])
@pytest.mark.parametrize("damage", ["flip", "cut", "empty", "gone"])
def test_a_damaged_checkpoint_gives_way_to_the_one_before(name: str, damage: str, tmp_path: Path) -> None:
    saved_twice(tmp_path)
    path = tmp_path / name
    data = bytearray(path.read_bytes())
    if damage == "flip":
        data[len(data) // 2] ^= 4
    path.unlink() if damage == "gone" else path.write_bytes({"cut": data[: len(data) // 2], "empty": b"", "flip": bytes(data)}[damage])
    told: list[str] = []
    state = CheckpointFolder(tmp_path, run_key(SCHEDULE), warn=told.append).load()
    assert state is not None and state.numbers["step"] == 3
    # Without its record a file is what a kill left of a checkpoint: nothing was lost that had been
    # there.
    assert len(told) == (0 if (name.endswith("json") and damage == "gone") else 1), told
    assert not list(tmp_path.glob("step-00000004*"))


def test_every_flipped_bit_of_a_record_is_noticed(tmp_path: Path) -> None:
    saved_twice(tmp_path)
    path = tmp_path / "step-00000004.json"
    whole, arrays = path.read_bytes(), path.with_suffix(".safetensors").read_bytes()
    meant = read_json(path)
    for place in range(len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        path.with_suffix(".safetensors").write_bytes(arrays)
        told: list[str] = []
        state = CheckpointFolder(tmp_path, run_key(SCHEDULE), warn=told.append).load()
        assert state is not None
        # A flip in the white space changes nothing that is read.
        assert state.numbers["step"] == 3 if told else read_json(path) == meant


def test_nothing_whole_left_means_from_the_start(tmp_path: Path) -> None:
    saved_twice(tmp_path)
    for path in tmp_path.glob("*.safetensors"):
        path.write_bytes(b"")
    told: list[str] = []
    assert CheckpointFolder(tmp_path, run_key(SCHEDULE), warn=told.append).load() is None
    assert len(told) == 2 and not list(tmp_path.iterdir())


def test_what_a_kill_left_half_written_is_cleared_away(tmp_path: Path) -> None:
    saved_twice(tmp_path)
    (tmp_path / ".step-00000005.safetensors.12ab34cd.part").write_bytes(b"half")
    (tmp_path / "step-00000005.safetensors").write_bytes(b"whole, but its record was never written")
    (tmp_path / "notes.txt").write_text("somebody's own")
    state = CheckpointFolder(tmp_path, run_key(SCHEDULE)).load()
    assert state is not None and state.numbers["step"] == 4
    assert len(list(tmp_path.iterdir())) == 5


def test_another_run_is_refused_or_removed(tmp_path: Path) -> None:
    saved_twice(tmp_path)
    with pytest.raises(BadInput, match="other settings, photographs or software"):
        CheckpointFolder(tmp_path, run_key(replace(SCHEDULE, seed=1))).load()
    CheckpointFolder(tmp_path, run_key(SCHEDULE)).remove_foreign()
    assert len(list(tmp_path.iterdir())) == 4
    CheckpointFolder(tmp_path, "other").remove_foreign()
    assert not list(tmp_path.glob("*.json"))


def test_the_key_follows_settings_model_pixels_and_poses() -> None:
    options = FitOptions()
    pixels = replace(VIEWS, images=(VIEWS.images[0] ^ 1, *VIEWS.images[1:]))
    poses = VIEWS.cameras.cam_from_world.copy()
    poses[0, 2, 3] += 1e-9
    moved = replace(VIEWS, cameras=replace(VIEWS.cameras, cam_from_world=poses))
    start = grey_start()
    other_start = replace(start, sh0=start.sh0 + np.float32(1e-6))
    keys = {
        training_key(start, VIEWS, CONFIG, options),
        training_key(start, VIEWS, replace(CONFIG, means_lr=CONFIG.means_lr * (1 + 1e-15)), options),
        training_key(other_start, VIEWS, CONFIG, options),
        training_key(start, pixels, CONFIG, options),
        training_key(start, moved, CONFIG, options),
        training_key(start, VIEWS, CONFIG, replace(options, validation=VIEWS)),
        training_key(start, VIEWS, CONFIG, replace(options, backend="reference")),
    }
    assert len(keys) == 7
    assert training_key(grey_start(), photographs(), CONFIG, FitOptions(report=print)) in keys


def test_writing_takes_at_most_its_share_of_the_time(tmp_path: Path) -> None:
    clock = Clock()
    folder = CheckpointFolder(tmp_path, "key", every_s=10, clock=clock)
    saved_s: list[float] = []

    def slow() -> TrainState:
        saved_s.append(clock.now_s)
        clock.now_s += 3
        return TrainState(arrays={"a": np.zeros(3)}, numbers={})

    while clock.now_s < 1000:
        clock.now_s += 0.5
        folder.offer(round(2 * clock.now_s), slow)
    assert saved_s[0] == 10
    assert np.diff(saved_s).min() >= 3 / MAX_SHARE
    assert len(saved_s) == pytest.approx(1 + 990 / 60, abs=1)


@pytest.mark.parametrize("call", ["replace", "fsync"])
def test_on_a_full_disk_training_goes_on_and_the_last_checkpoint_stays(call: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    saved_twice(tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    undisturbed = fit_splats(grey_start(), VIEWS, SCHEDULE)

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path if call == "replace" else os, call, full)
    told: list[str] = []
    clock = Clock()

    def tick() -> float:
        clock.now_s += 7
        return clock.now_s

    folder = CheckpointFolder(tmp_path, run_key(SCHEDULE), every_s=5, clock=tick, warn=told.append)
    result = with_checkpoints(folder, SCHEDULE)
    np.testing.assert_array_equal(result.splats.means, undisturbed.splats.means)
    assert told and all("No space left on device" in message and "Training goes on" in message for message in told)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_library_that_cannot_write_is_a_warning_too(tmp_path: Path) -> None:
    told: list[str] = []
    (tmp_path / "file").write_text("")
    clock = Clock()
    folder = CheckpointFolder(tmp_path / "file" / "checkpoints", "key", clock=clock, warn=told.append)
    clock.now_s = 100
    folder.offer(1, lambda: TrainState(arrays={}, numbers={}))
    assert len(told) == 1 and "cannot make" in told[0]


@pytest.mark.parametrize("every_s", [0, -1, float("nan")])
def test_an_interval_must_be_positive(every_s: float, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="positive number of seconds"):
        CheckpointFolder(tmp_path, "key", every_s=every_s)
