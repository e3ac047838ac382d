"""The most memory that `radiant train --memory` holds on the sample town, when the model grows to the limit of Gaussians it got."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from radiant_app.commands.run.demo import sample_scenes_folder

pytestmark = pytest.mark.stress

TOLERANCE = 0.1
GROWING = """
import json, sys
from dataclasses import replace
import radiant_app.commands.run.train as command
from radiant_app.workers.memory import peak_bytes
from radiant_core.io.run_store import read_json
from pathlib import Path
from radiant_core.train.densify.policies import Adc, densification_of
source, out, memory, kind = sys.argv[1:]
chosen = command.fit_to_backend
def growing(*arguments):
    config, decisions = chosen(*arguments)
    # Every round doubles the model at most, so that it is at its limit soon; then it goes on for as long again.
    every = 2 if kind == "planned" else 1
    adc = Adc(from_step=1, until_step=60, every=every, min_gradient=0.0, reset_opacity_every=1000, pixels_per_splat=None)
    return replace(config, density=densification_of(kind, adc), num_steps=70, schedule_steps=70, long_side_px=576), decisions
command.fit_to_backend = growing
request = command.TrainRequest(source=Path(source), out=Path(out), memory_bytes=int(memory), checkpoint_every_s=1.0)
metrics = command.train(request)
limit = next(d for d in read_json(Path(out) / "manifest.json")["decisions"] if d["topic"] == "memory")
print(json.dumps({"peak_bytes": peak_bytes(), "num_splats": metrics["num_gaussians"], "choice": limit["choice"],
                  "trained_peak_bytes": metrics["peak_bytes"]["train"]}))
"""


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The town's scene from its known cameras."""
    folder = tmp_path_factory.mktemp("town")
    (folder / "images").symlink_to(sample_scenes_folder() / "town" / "images")
    (folder / "sparse").symlink_to(sample_scenes_folder() / "town" / "known")
    subprocess.run([sys.executable, "-m", "radiant_app", "sfm", str(folder), "--out", str(folder / "scene")], check=True, timeout=600)
    return folder / "scene"


@pytest.mark.parametrize("memory_bytes", [600_000_000, 1_000_000_000, 2_000_000_000])
def test_the_peak_follows_the_limit(memory_bytes: int, town: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-c", GROWING, str(town), str(tmp_path / "out"), str(memory_bytes), "planned"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1800, check=False)
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout.splitlines()[-1])
    print(figures)
    assert abs(figures["peak_bytes"] / memory_bytes - 1) <= TOLERANCE, figures
