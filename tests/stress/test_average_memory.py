"""Peak memory of averaging refinements at the cloud and at an edge: within `average_bytes`, however many send. A minute."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from radiant_core.aggregate.averaging import average_bytes

WORK = """
import sys
from pathlib import Path
import numpy as np
from radiant_core.aggregate.averaging import Refinement
from radiant_core.cameras import concatenate_cameras
from radiant_core.hierarchy.codec import save_refinement
from radiant_core.io.ply import load_ply, save_ply
from radiant_core.io.records import save_cameras
from radiant_core.splats import SH_BASES, Splats
from tests.core.scenes import cameras_above

folder, num_splats, degree, num_senders = Path(sys.argv[1]), *map(int, sys.argv[2:5])
rng = np.random.default_rng(0)
def normal(*shape): return (0.1 * rng.normal(size=(num_splats, *shape))).astype(np.float32)
made = Splats(means=normal(3), quats=1 + normal(4), log_scales=normal(3) - 4, logit_opacities=normal(), sh0=normal(1, 3),
              shN=normal(SH_BASES[degree] - 1, 3))
part = folder / "refine"
part.mkdir(parents=True)
save_ply(part / "scene.ply", made)
scene = load_ply(part / "scene.ply")
one = Refinement(rows=np.arange(num_splats), splats=scene, weights=np.full(num_splats, 1 / num_splats, np.float32))
for index in range(num_senders):
    for place in (part / "inbox" / f"s{index}", folder / "inbox" / f"s{index}"):
        place.mkdir(parents=True)
    save_refinement(part / "inbox" / f"s{index}", one, scene, "float16", print)
    save_cameras(folder / "inbox" / f"s{index}" / "cameras.safetensors", cameras_above([(0.0, 0.0), (0.1, 0.0)], size_wh=(4000, 3000)))
"""
AVERAGE = """
import shutil
import sys
from pathlib import Path
from radiant_app.workers.memory import peak_bytes, reset_peak_bytes
from radiant_app.workers.refining import run_average, run_finish
from radiant_app.reporting import EventReporter
from radiant_app.workers.tasks import AverageTask, FinishTask

folder, kind, num_senders = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
senders = tuple(f"s{index}" for index in range(num_senders))
common = {"senders": senders, "num_dealt": (2,) * num_senders}
shown = {"backend": "native", "long_side_px": 4000, "joined": "", "counted_in": (0,) * num_senders}
reporter = EventReporter(stage="x", emit=lambda event: None)
reset_peak_bytes()
if kind == "finish":
    (folder / "refine/kept").mkdir(exist_ok=True)
    shutil.copyfile(folder / "refine/scene.ply", folder / "refine/kept/scene.ply")
    reset_peak_bytes()
    run_finish(folder / "refine", FinishTask(**common, another_round=True), reporter)
else:
    run_average(folder / "refine", AverageTask(**common, corrections=((),) * num_senders, upload="float16", **shown), reporter)
print(peak_bytes())
"""


def peak_of(folder: Path, kind: str, num_splats: int, degree: int, num_senders: int) -> int:
    def call(script: str, *arguments: object) -> str:
        command = [sys.executable, "-c", script, *map(str, arguments)]
        return subprocess.run(command, check=True, capture_output=True, text=True, cwd=Path(__file__).parents[2]).stdout

    call(WORK, folder, num_splats, degree, num_senders)
    return int(call(AVERAGE, folder, kind, num_senders).split()[-1])


@pytest.mark.stress
@pytest.mark.parametrize("kind", ["finish", "average"])
@pytest.mark.parametrize(("num_splats", "degree"), [(50_000, 1), (300_000, 1), (150_000, 3)])
def test_averaging_needs_no_more_memory_than_is_said_however_many_send(tmp_path: Path, kind: str, num_splats: int, degree: int) -> None:
    peaks = {count: peak_of(tmp_path / str(count), kind, num_splats, degree, count) for count in (2, 8)}
    allowed = average_bytes(num_splats, degree, renders=kind == "average")
    print(f"{kind}, {num_splats:,} Gaussians of degree {degree}: {peaks[2] / 1e6:.0f} and {peaks[8] / 1e6:.0f} MB of {allowed / 1e6:.0f}")
    assert peaks[8] < peaks[2] + 0.08 * allowed and max(peaks.values()) <= allowed
    assert max(peaks.values()) > 0.5 * allowed, "no more than needed is asked for"
