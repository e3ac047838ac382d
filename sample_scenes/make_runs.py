"""Makes the two finished runs that viewers and tests read: `runs/tiny` of the hamlet, and
`runs/planted_seam`, the same with a seam.

    python sample_scenes/make_runs.py

Of the tiny run what a viewer reads is kept, and its report. The planted seam brightens all
Gaussians in the first edge's region by 30 of 255 levels, so that its border shows a step of that
height; figures and pictures of the model without it are left out there.
"""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from radiant_app.commands.run.pipeline import run
from radiant_app.config.run_config import PlanOptions, RunConfig, TrainOptions
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.io.records import load_plan
from radiant_core.io.run_store import read_json, write_json
from radiant_core.plan.regions.power_diagram import assign
from radiant_core.splats import SH_C0, Splats

HERE = Path(__file__).resolve().parent
PLANNED = ("manifest.json", "plan.json", "scene.ply", "sfm/scene.safetensors", "sfm/result.json")
KEPT = (*PLANNED, "metrics.json", "report.html")
KEPT_FOLDERS = ("pictures/photographs", "pictures/renders", "pictures/differences")
SEAM_LEVELS = 30
SIZE = TrainOptions(long_side_px=120, num_steps=120, max_num_splats=2_000)


def main() -> None:
    """Run the hamlet in a temporary folder and keep the two small copies."""
    tiny, planted = HERE / "runs" / "tiny", HERE / "runs" / "planted_seam"
    for folder in (tiny, planted):
        shutil.rmtree(folder, ignore_errors=True)
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary) / "run"
        run(RunConfig(source=HERE / "hamlet" / "images", out=out, train=SIZE, plan=PlanOptions(devices="all")))
        for name in KEPT:
            (tiny / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(out / name, tiny / name)
        for name in KEPT_FOLDERS:
            shutil.copytree(out / name, tiny / name)
    _forget_where_it_was_made(tiny / "manifest.json")
    for name in PLANNED:
        (planted / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(tiny / name, planted / name)
    plan, _ = load_plan(planted / "plan.json")
    save_ply(planted / "scene.ply", with_seam(load_ply(planted / "scene.ply"), plan.sites, plan.weights))


def with_seam(splats: Splats, sites: np.ndarray, weights: np.ndarray) -> Splats:
    """The same model, brighter by `SEAM_LEVELS` where the first edge owns the ground."""
    first = assign(splats.means[:, :2].astype(np.float64), sites, weights) == 0
    sh0 = splats.sh0.copy()
    sh0[first] += SEAM_LEVELS / 255 / SH_C0
    return replace(splats, sh0=sh0)


def _forget_where_it_was_made(manifest: Path) -> None:
    record = read_json(manifest)
    record["config"]["source"] = "sample_scenes/hamlet/images"
    write_json(manifest, record)


if __name__ == "__main__":
    main()
