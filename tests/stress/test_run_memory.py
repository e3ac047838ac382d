"""The peaks of a run's own worker processes, devices, edges and the cloud, against what the system
file allows them.

Growth is made so fast that every device gets to its limit of Gaussians. A cloud that may hold
enough fits what edges join, at once or in tiles; one that may not cuts it. Figures:
docs/experiments/faults.md.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.commands.run.pipeline import run
from radiant_app.config.run_config import AggregateOptions, ExecutionOptions, RunConfig, TrainOptions

pytestmark = pytest.mark.stress

FAST_GROWTH = {
    "schedule_steps": 40,
    "density.kind": "adc",
    "density.from_step": 1,
    "density.until_step": 35,
    "density.every": 1,
    "density.min_gradient": 0.0,
}
DEVICE_GB, EDGE_GB = 0.45, 0.7


@pytest.mark.parametrize(("cloud_gb", "fits"), [(0.75, True), (0.45, False)])
def test_every_worker_keeps_to_its_limit(cloud_gb: float, fits: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edges = "".join(
        f'[[edge]]\nid = "{edge}"\nmemory_gb = {EDGE_GB}\n'
        + "".join(f'[[edge.device]]\nid = "{edge}-{number}"\nmemory_gb = {DEVICE_GB}\n' for number in (1, 2))
        for edge in ("a", "b")
    )
    (tmp_path / "system.toml").write_text(f"[cloud]\nmemory_gb = {cloud_gb}\n{edges}")
    project = tmp_path / "hamlet"
    project.mkdir()
    for name, folder in (("images", "images"), ("sparse", "known")):
        (project / name).symlink_to(sample_scenes_folder() / "hamlet" / folder)
    training = TrainOptions(long_side_px=160, num_steps=40, max_num_splats=400_000, settings=FAST_GROWTH)
    execution = ExecutionOptions(max_workers=1)
    # After so short trainings edges would join in one epoch and the cloud in none.
    config = RunConfig(
        source=project,
        out=tmp_path / "run",
        system=tmp_path / "system.toml",
        train=training,
        aggregate=AggregateOptions(settings={"edge.epochs": 2, "cloud.epochs": 2}),
        execution=execution,
    )
    result = run(config)
    allowed_gb = {"devices": DEVICE_GB, "edges": EDGE_GB, "cloud": cloud_gb}
    held_gb = {node: peak / 1e9 for node, peak in result.metrics["peak_bytes"].items() if node.split("/")[0] in allowed_gb}
    with capsys.disabled():
        print({node: f"{held:.3f} of {allowed_gb[node.split('/')[0]]} GB" for node, held in sorted(held_gb.items())})
    counts = [json.loads(path.read_text())["num_splats"] for path in tmp_path.glob("run/devices/*/summary.json")]
    assert len(held_gb) == 7 and min(counts) > 5_000, "growth was held by the limit alone"
    assert all(held <= allowed_gb[node.split("/")[0]] for node, held in held_gb.items())
    steps = {node: json.loads((tmp_path / "run" / node / "summary.json").read_text())["num_steps"] for node in ("edges/a", "cloud")}
    with capsys.disabled():
        print(steps)
    assert steps["edges/a"] > 0 and (steps["cloud"] > 0) == fits
    assert "at most" in result.report.read_text(), "the report says what a limit cost"
