"""Structure from motion that was killed goes on with the features and matches that are there, if
they are of the same photographs."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from radiant_core.choices import Effort
from radiant_core.errors import CannotWrite, StageFailed
from radiant_core.io.run_store import read_json, write_json
from radiant_core.sfm.colmap import undistort as sfm_undistort
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.colmap.kept_database import RECORD_NAME, database_key, prepare_database
from radiant_core.sfm.colmap.workspace import list_usable
from radiant_core.sfm.config import SfmConfig, SfmProgress
from radiant_core.sfm.reconstruct import reconstruct

SMALL = SfmConfig(max_image_size_px=320, max_num_features=600, num_threads=1, effort="thorough")
PHOTOS_PER_CALL = 2
KILLED = f"""
import os, signal, sys
from pathlib import Path
from radiant_core.sfm.colmap import database
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.reconstruct import reconstruct

database.PHOTOS_PER_CALL_AND_THREAD = {PHOTOS_PER_CALL}
phase, least = sys.argv[3], int(sys.argv[4])

def report(progress):
    if progress.phase == phase and progress.done >= least:
        os.kill(os.getpid(), signal.SIGKILL)

sizes = dict(max_image_size_px={SMALL.max_image_size_px}, max_num_features={SMALL.max_num_features})
config = SfmConfig(**sizes, num_threads=1, effort=sys.argv[5])
reconstruct(Path(sys.argv[1]), Path(sys.argv[2]), config, report)
"""


@pytest.fixture(scope="module")
def photos(hamlet: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight photographs with spaces in their names."""
    folder = tmp_path_factory.mktemp("photos")
    for path in sorted((hamlet / "images").iterdir())[:8]:
        shutil.copy(path, folder / path.name.replace("_", " "))
    return folder


def content(database: Path) -> dict[str, Any]:
    """Features of every photograph and inliers of every pair, by names."""
    with pycolmap.Database.open(database) as store:
        names = {image.image_id: image.name for image in store.read_all_images()}
        found: dict[str, Any] = {name: store.read_keypoints(image_id).tobytes() for image_id, name in names.items()}
        pairs = [(a, b) for a in names for b in names if a < b and store.exists_two_view_geometry(a, b)]
        return found | {f"{names[a]} {names[b]}": store.read_two_view_geometry(a, b).inlier_matches.tobytes() for a, b in pairs}


def killed(photos: Path, work: Path, phase: str, least: int, effort: str = "thorough") -> None:
    command = [sys.executable, "-c", KILLED, str(photos), str(work), phase, str(least), effort]
    assert subprocess.run(command, capture_output=True, timeout=120, check=False).returncode == -signal.SIGKILL


@pytest.mark.parametrize("effort", ["auto", pytest.param("thorough", marks=pytest.mark.stress)])
def test_a_killed_reconstruction_goes_on_with_its_features_and_matches(effort: Effort, photos: Path, tmp_path: Path) -> None:
    config = replace(SMALL, effort=effort)
    whole = reconstruct(photos, tmp_path / "whole", config, lambda progress: None)
    work = tmp_path / "killed"
    killed(photos, work, "features", 3, effort)
    num_found = len(content(work / "database.db"))
    assert 3 <= num_found <= 4, "two calls of two photographs by COLMAP, three by OpenCV, one of which may be found besides"
    killed(photos, work, "matching", 9, effort)
    assert 8 < len(content(work / "database.db")) < len(content(tmp_path / "whole" / "database.db"))
    told: list[SfmProgress] = []
    result = reconstruct(photos, work, config, told.append)
    features, matching = ([progress.done for progress in told if progress.phase == phase] for phase in ("features", "matching"))
    assert features == [8] and matching[0] >= 8, "what was there is not done again"
    assert content(work / "database.db") == content(tmp_path / "whole" / "database.db")
    assert result.scene.cameras.names == whole.scene.cameras.names
    # Mapping is done anew from the same features and matches, in one thread.
    np.testing.assert_allclose(result.scene.cameras.centers, whole.scene.cameras.centers, atol=1e-6)
    assert ({"adjustment", "features", "verification"} <= {decision.topic for decision in result.decisions}) == (effort == "auto")


def test_what_is_of_other_photographs_settings_or_another_start_of_the_machine_is_not_kept(photos: Path, tmp_path: Path) -> None:
    photographs = list_usable(photos, lambda progress: None).photographs
    key = database_key(photographs, SMALL, None)
    masks = tmp_path / "masks"
    masks.mkdir()
    (masks / "a.png").touch()
    others = [
        database_key(photographs[1:], SMALL, None),
        database_key((replace(photographs[0], path=photographs[1].path), *photographs[1:]), SMALL, None),
        database_key(photographs, replace(SMALL, max_num_features=601), None),
        database_key(photographs, SMALL, masks),
        database_key(photographs, replace(SMALL, effort="auto"), None),
    ]
    assert len({key, *others}) == 6 and key == database_key(photographs, replace(SMALL, num_threads=2), None)

    def is_kept(key: str) -> bool:
        with prepare_database(tmp_path / "work", key) as database:
            there = database.is_file()
            if not there:
                pycolmap.Database.open(database).close()
        return there

    assert [is_kept(name) for name in (key, key, others[0], key)] == [False, True, False, False]
    record = tmp_path / "work" / RECORD_NAME
    write_json(record, {**read_json(record), "boot": "an earlier one"})
    assert not is_kept(key)
    data = (tmp_path / "work" / "database.db").read_bytes()
    for broken in (b"", b"half written", data[: len(data) // 2]):
        (tmp_path / "work" / "database.db").write_bytes(broken)
        assert is_kept(key) == (broken == b""), "an empty file is an empty database"


def test_what_colmap_fails_on_is_not_kept_for_the_next_attempt(tmp_path: Path) -> None:
    with pytest.raises(StageFailed), prepare_database(tmp_path, "key"):
        raise StageFailed("the database disk image is malformed")
    assert not (tmp_path / RECORD_NAME).exists()


def test_what_colmap_fails_on_with_a_full_disk_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: usage._replace(free=4096))
    with pytest.raises(CannotWrite, match="is full"), prepare_database(tmp_path, "key"):
        raise StageFailed("database or disk is full")
    assert (tmp_path / RECORD_NAME).exists()


def test_images_that_were_undistorted_onto_a_full_disk_are_not_believed(
    hamlet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: usage._replace(free=4096))
    monkeypatch.setattr(sfm_undistort, "call_colmap", lambda *arguments, **options: None)
    with pytest.raises(CannotWrite, match="is full"):
        sfm_undistort.undistort(hamlet / "known", hamlet / "images", tmp_path, 1, lambda progress: None)
    assert not (tmp_path / "undistorted").exists()


def test_a_photograph_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "folder").write_text("a file where a folder is needed")
    with pytest.raises(CannotWrite, match=r"cannot write .*a\.jpg: .*: choose another folder that may be written"):
        sfm_undistort._write(tmp_path / "folder" / "a.jpg", b"")
