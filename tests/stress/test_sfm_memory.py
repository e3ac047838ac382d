"""Structure from motion within limits of memory: the peak of its process, six photographs of 2,000
× 1,500 px and the town's sixty small ones, whose mapping takes more than finding features.

Figures: docs/experiments/faults.md.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from radiant_app.commands.run.demo import sample_scenes_folder

pytestmark = pytest.mark.stress

SCRIPT = """
import sys
from pathlib import Path
from radiant_app.workers.memory import peak_bytes
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.reconstruct import reconstruct

limit = None if sys.argv[3] == "none" else 1e6 * float(sys.argv[3])
config = SfmConfig(num_threads=2, max_num_features=int(sys.argv[4]), memory_bytes=limit)
result = reconstruct(Path(sys.argv[1]), Path(sys.argv[2]), config, lambda progress: None)
choices = [decision.choice for decision in result.decisions if decision.topic == "memory"]
print(round(peak_bytes() / 1e6), len(result.scene.cameras), *choices)
"""


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six photographs of the hamlet, enlarged."""
    folder = tmp_path_factory.mktemp("photos")
    for path in sorted((sample_scenes_folder() / "hamlet" / "images").iterdir())[:6]:
        photograph = cv2.imread(str(path))
        assert photograph is not None
        cv2.imwrite(str(folder / path.name), cv2.resize(photograph, (2000, 1500), interpolation=cv2.INTER_CUBIC))
    return folder


@pytest.mark.parametrize("limit", ["none", "900", "600", "400"])
def test_the_peak_keeps_to_the_limit(photos: Path, limit: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert placed_within(limit, photos, 2000, tmp_path, capsys) >= 4


@pytest.mark.parametrize("limit", ["none", "330", "300"])
def test_the_peak_of_mapping_keeps_to_the_limit(limit: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert placed_within(limit, sample_scenes_folder() / "town" / "images", 4096, tmp_path, capsys) >= 57


def placed_within(limit: str, photos: Path, num_features: int, folder: Path, capsys: pytest.CaptureFixture[str]) -> int:
    """How many photographs were placed within so many MB; the peak of the process is below them."""
    command = [sys.executable, "-c", SCRIPT, str(photos), str(folder), limit, str(num_features)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600).stdout
    peak_mb, num_cameras = map(int, done.split()[:2])
    with capsys.disabled():
        print(f"{limit} MB allowed: {done.strip()}")
    assert limit == "none" or peak_mb <= int(limit)
    return num_cameras
