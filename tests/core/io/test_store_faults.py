"""The run store on a disk that fails: what is sealed stays, a full disk pauses with one sentence, a
flipped bit is found before use."""

from __future__ import annotations

import random
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from radiant_app.config.run_config import RunConfig
from radiant_app.files.run_folder import Manifest, open_run, read_manifest
from radiant_core.errors import BadInput
from radiant_core.io.run_store import RunLock, file_sha256, seal_problem
from tests.core.io.store_faults import STAGES, Job, every_failing_call
from tests.memory_folder import memory_folder


def test_a_full_disk_at_any_moment_leaves_what_was_sealed_and_can_be_resumed() -> None:
    # `make stress` lets every call fail.
    with memory_folder() as folder:
        assert every_failing_call(folder, step=7) == []


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 40 kB of its own."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=40k", "tmpfs", place], capture_output=True, check=False)
    if mounted.returncode:
        pytest.skip("no file system can be mounted here")
    yield place
    subprocess.run(["umount", place], check=True)


def test_a_real_full_disk_pauses_and_more_space_lets_it_go_on(small_disk: Path) -> None:
    job = Job(small_disk)
    with pytest.raises(BadInput, match=r"No space left on device|cannot make"):
        job.run()
    sealed = job.sealed()
    assert 0 < len(sealed) < len(STAGES) and job.problem(sealed, None) is None
    subprocess.run(["mount", "-o", "remount,size=400k", small_disk], check=True)
    assert set(job.run()) == set(STAGES) - sealed and job.sealed() == set(STAGES)


def test_flipped_bits_of_stored_files_are_found_before_they_are_used() -> None:
    # `make stress` flips a thousand.
    with memory_folder() as folder:
        assert undiscovered_flips(folder, count=300) == []


def undiscovered_flips(folder: Path, count: int) -> list[str]:
    """Flip random bits of sealed files, seals and a manifest, singly; return the unnoticed ones."""
    job = Job(folder)
    job.run()
    manifest = Manifest(folder=folder, config={"seed": 1}, stages={"sfm": {"started_s": 0.0, "ended_s": 2.5}}, warnings=["sfm: dark"])
    manifest.save()
    assert read_manifest(folder).stages == manifest.stages and job.sealed() == set(STAGES)
    rng = random.Random(9)
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    missed = []
    for _ in range(count):
        path = rng.choice(files)
        place, bit = rng.randrange(path.stat().st_size), rng.randrange(8)
        flip(path, place, bit)
        if not (
            is_manifest_refused(path) if path.name == "manifest.json" else seal_problem(path.parent, str(path.parent.relative_to(folder)))
        ):
            missed.append(f"{path.name} byte {place} bit {bit}")
        flip(path, place, bit)
    assert job.sealed() == set(STAGES)
    return missed


def is_manifest_refused(path: Path) -> bool:
    try:
        read_manifest(path.parent)
    except BadInput as error:
        return "damaged" in str(error)
    return False


def flip(path: Path, place: int, bit: int) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 1 << bit
    path.write_bytes(data)


def test_a_second_run_into_the_same_folder_gets_one_sentence_and_changes_nothing(tmp_path: Path) -> None:
    config = RunConfig(source=tmp_path / "photos", out=tmp_path / "run")
    with open_run(config, resume=False):
        before = {path.name: file_sha256(path) for path in config.out.iterdir()}
        for resume, sentence in [(True, r"another process \(\d+\) is writing"), (False, "exists and is not empty")]:
            with pytest.raises(BadInput, match=sentence) as caught, open_run(config, resume=resume):
                pytest.fail("it was let in")
            assert str(caught.value).count("\n") == 0
        assert {path.name: file_sha256(path) for path in config.out.iterdir()} == before
    with RunLock(config.out):
        pass
