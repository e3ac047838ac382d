"""A run at work shows what its nodes have made so far, and nothing of it leaves in an export."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.io.array_file import save_arrays
from radiant_core.io.records import save_splats
from radiant_viewer.runs.model_file import load_model
from radiant_viewer.runs.run_view import file_stamps, load_run_view
from radiant_viewer.window.subject import run_subject
from tests.viewer.made_up_run import Town, made_up_town, save_run


@pytest.fixture
def town() -> Town:
    return made_up_town()


@pytest.fixture
def run(tmp_path: Path, town: Town) -> Path:
    save_run(tmp_path / "run", town)
    (tmp_path / "run" / "scene.ply").unlink()
    (tmp_path / "run" / "metrics.json").unlink()
    return tmp_path / "run"


def checkpoint(run: Path, device: str, step: int, town: Town, count: int) -> Path:
    folder = run / "devices" / device / "checkpoints"
    folder.mkdir(parents=True, exist_ok=True)
    arrays = {f"splats.{name}": array for name, array in town.splats.select(np.arange(count)).arrays().items()}
    path = folder / f"step-{step:08d}.safetensors"
    save_arrays(path, "radiant.checkpoint", arrays, {"step": step, "key": "k", "numbers": {}})
    return path


def shown(run: Path) -> int:
    splats = load_run_view(run, growing=True).splats
    return 0 if splats is None else len(splats)


def test_checkpoints_then_models_then_joined_edges_are_seen(run: Path, town: Town) -> None:
    assert shown(run) == 0
    before = file_stamps(run)
    checkpoint(run, "north-1", 100, town, 50)
    assert shown(run) == 50 and file_stamps(run) != before
    checkpoint(run, "north-1", 200, town, 70)
    checkpoint(run, "harbour-1", 100, town, 30)
    assert shown(run) == 100, "the newest checkpoint of each device"
    (run / "devices" / "north-1" / "checkpoints" / "step-00000200.safetensors").write_bytes(b"half")
    assert shown(run) == 80, "a checkpoint that is being written is left out"
    save_splats(run / "devices" / "north-1" / "model.safetensors", town.splats.select(np.arange(200)))
    assert shown(run) == 230
    (run / "edges" / "harbour").mkdir(parents=True)
    save_splats(run / "edges" / "harbour" / "model.safetensors", town.splats.select(np.arange(1000)))
    assert shown(run) == 1200, "a joined edge stands for its devices"
    view = load_run_view(run, growing=True)
    assert view.is_growing and "1,200 Gaussians so far" in run_subject(view).summary


def test_what_is_growing_is_only_looked_at(run: Path, town: Town) -> None:
    checkpoint(run, "north-1", 100, town, 50)
    assert load_run_view(run).splats is None
    with pytest.raises(BadInput, match=r"has no scene\.ply"):
        load_model(run)
