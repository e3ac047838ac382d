"""What structure from motion is made from: the files that it uses, by content, and words for what changed."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_app.config.run_config import RunConfig, SfmOptions
from radiant_app.events import Event, Warned
from radiant_app.run.source_key import source_key, used_files
from radiant_app.workers.sources import sfm_task
from radiant_core.io.run_store import seal, write_json
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.world_frame.placement import Placement


@pytest.fixture
def config(tmp_path: Path) -> RunConfig:
    """Three photographs, two of them with masks."""
    for folder in ("photos", "masks", "run/sfm"):
        (tmp_path / folder).mkdir(parents=True)
    for name in "abc":
        (tmp_path / "photos" / f"{name}.jpg").write_bytes(f"photograph {name}".encode())
    for name in "ab":
        (tmp_path / "masks" / f"{name}.jpg.png").write_bytes(b"mask")
    return RunConfig(source=tmp_path / "photos", sfm=SfmOptions(masks=tmp_path / "masks"), out=tmp_path / "run")


def key_and_words(config: RunConfig) -> tuple[str, list[str]]:
    events: list[Event] = []
    task = sfm_task(config.source, SfmConfig(), config.sfm.masks, Placement())
    key = source_key(config, task, config.out / "sfm", events.append)
    assert all(isinstance(event, Warned) and event.stage == "sfm" for event in events)
    return key, [event.message for event in events if isinstance(event, Warned)]


def finish(config: RunConfig) -> str:
    key, _ = key_and_words(config)
    (config.out / "sfm" / "scene").write_text("a scene")
    seal(config.out / "sfm", key, ["scene"])
    return key


def masks_of(config: RunConfig) -> Path:
    assert config.sfm.masks is not None
    return config.sfm.masks


def touch(config: RunConfig) -> None:
    os.utime(config.source / "a.jpg", (1, 1))
    os.utime(masks_of(config) / "a.jpg.png", (1, 1))


UNUSED: list[Callable[[RunConfig], object]] = [
    lambda config: (config.source / "notes.txt").write_text("windy"),
    lambda config: (config.source / "Thumbs.db").touch(),
    lambda config: (config.source / "clip.mp4").touch(),
    lambda config: shutil.copytree(config.source, config.source / "depth"),
    lambda config: (masks_of(config) / "other.png").touch(),
    touch,
]


@pytest.mark.parametrize("change", UNUSED)
def test_what_is_not_used_and_times_change_nothing(change: Callable[[RunConfig], object], config: RunConfig) -> None:
    key = finish(config)
    change(config)
    assert key_and_words(config) == (key, [])
    assert key_and_words(config) == (key, []), "nor the second time"


def test_what_changed_is_named_before_anything_is_made_again(config: RunConfig) -> None:
    key = finish(config)
    (config.source / "d.jpg").write_bytes(b"photograph d")
    (config.source / "b.jpg").unlink()
    (config.source / "c.jpg").write_bytes(b"photograph e")
    other, (told,) = key_and_words(config)
    assert other != key and told.startswith(
        "photographs changed: 1 new (d.jpg), 2 gone (b.jpg, mask of b.jpg), 1 with other content (c.jpg)"
    )
    assert told.endswith("run again.")


def test_the_same_size_at_the_same_time_is_believed_and_at_another_is_read(config: RunConfig) -> None:
    key = finish(config)
    path = config.source / "a.jpg"
    times_ns = path.stat().st_atime_ns, path.stat().st_mtime_ns
    path.write_bytes(b"photograph z")
    os.utime(path, ns=times_ns)
    assert key_and_words(config)[0] == key, "as every build tool does"
    os.utime(path, (1, 1))
    assert key_and_words(config)[0] != key


def test_before_there_is_a_scene_nothing_is_told(config: RunConfig) -> None:
    key, told = key_and_words(config)
    (config.source / "a.jpg").write_bytes(b"another")
    other, still = key_and_words(config)
    assert told == still == [] and other != key


def test_an_older_run_that_does_not_fit_says_so_in_one_sentence(config: RunConfig) -> None:
    (config.out / "sfm" / "scene").write_text("a scene")
    seal(config.out / "sfm", "made from times that are others now", ["scene"])
    _, (told,) = key_and_words(config)
    assert told.startswith("an older version made this scene: ") and told.count(". ") == 0


@pytest.mark.parametrize("content", ["[]", '{"a.jpg": 1}', "{", '{"a.jpg": [1]}'])
def test_a_damaged_record_is_made_anew(content: str, config: RunConfig) -> None:
    key = finish(config)
    (config.out / "sfm" / "source.json").write_text(content)
    again, told = key_and_words(config)
    assert again == key and len(told) == 1
    assert key_and_words(config) == (key, [])


def test_what_cannot_be_used_is_left_to_structure_from_motion(config: RunConfig) -> None:
    key = finish(config)
    os.mkfifo(config.source / "pipe.jpg")
    (config.source / "lost.jpg").symlink_to("nowhere")
    (config.source / "a\nb.jpg").write_bytes(b"no name for COLMAP")
    Path(os.fsdecode(os.fsencode(config.source) + b"/\xff.jpg")).write_bytes(b"nor this")
    assert key_and_words(config) == (key, [])


def test_of_a_project_the_model_and_the_images_in_it_count(tmp_path: Path) -> None:
    hamlet = sample_scenes_folder() / "hamlet"
    project = tmp_path / "project"
    shutil.copytree(hamlet / "images", project / "images")
    shutil.copytree(hamlet / "known", project / "sparse" / "0")
    (tmp_path / "run" / "sfm").mkdir(parents=True)
    config = RunConfig(source=project, out=tmp_path / "run")
    key = finish(config)
    shutil.copyfile(next((project / "images").iterdir()), project / "images" / "later.jpg")
    (project / "database.db").touch()
    assert key_and_words(config) == (key, [])
    points = next((project / "sparse" / "0").glob("points3D*"))
    points.write_bytes(points.read_bytes() + b"\n")
    other, (told,) = key_and_words(config)
    assert other != key and f"1 with other content (sparse/0/{points.name})" in told


def test_of_a_mill19_folder_what_has_a_pose_counts(tmp_path: Path) -> None:
    for split, name in (("train", "1"), ("train", "2"), ("val", "3")):
        for folder in ("metadata", "rgbs"):
            (tmp_path / split / folder).mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(tmp_path / split / "rgbs" / f"{name}.jpg"), np.zeros((8, 8, 3), np.uint8))
        if name != "2":
            (tmp_path / split / "metadata" / f"{name}.pt").touch()
    (tmp_path / "coordinates.pt").touch()
    (tmp_path / "coordinates.txt").touch()
    named = set(used_files(tmp_path, None))
    assert named == {"coordinates.pt", "train/metadata/1.pt", "train/rgbs/1.jpg", "val/metadata/3.pt", "val/rgbs/3.jpg"}


def test_masks_left_out_are_another_scene(config: RunConfig) -> None:
    key = finish(config)
    without, told = key_and_words(replace(config, sfm=SfmOptions()))
    assert without != key and len(told) == 1
    write_json(config.out / "sfm" / "source.json", {})
    assert key_and_words(config)[0] == key
