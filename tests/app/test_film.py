"""A film in place of photographs: `radiant sfm` places its sharp frames by the positions of its subtitles."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from radiant_app.commands.run.steps import sfm
from radiant_app.commands.run.train import TrainRequest, train
from radiant_app.config.run_config import RunConfig, SfmOptions, TrainOptions
from radiant_app.report.progress import ProgressDisplay
from radiant_app.run.source_key import source_key, used_files
from radiant_app.workers.sources import NO_POSES, detect_source, load_scene_of, notes_on_source, sfm_task
from radiant_core.errors import BadInput
from radiant_core.io.colmap.model import read_model
from radiant_core.io.photos.listing import photograph_positions
from radiant_core.io.photos.masks import save_mask
from radiant_core.io.run_store import SEAL_NAME
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.intake import Intake
from radiant_core.sfm.known_poses import cameras_of
from radiant_core.sfm.world_frame.placement import Placement
from tests.core.io.film.films import HAMLET, photographs, shaken, srt, write_film

TINY = TrainOptions(long_side_px=96, num_steps=20, max_num_splats=1500)


def quiet() -> ProgressDisplay:
    return ProgressDisplay(Console(quiet=True))


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A film of the hamlet, each photograph once sharp and twice blurred, with its positions as subtitles."""
    folder = tmp_path_factory.mktemp("flight")
    write_film(folder / "DJI_0007.MP4", shaken(photographs()))
    positions = [position for _, position in sorted(photograph_positions(HAMLET).items()) if position is not None]
    text = "[latitude: {:.7f}] [longitude: {:.7f}] [rel_alt: 40.0 abs_alt: {:.3f}]"
    # Each position is written when its sharp frame is shown.
    (folder / "DJI_0007.SRT").write_text(srt((0.3 * index + 0.1, text.format(*position)) for index, position in enumerate(positions)))
    return folder


@pytest.mark.parametrize("given", ["folder", "file"])
def test_the_sharp_frames_of_a_film_are_placed_where_its_photographs_were(given: str, flight: Path, tmp_path: Path) -> None:
    source = flight if given == "folder" else flight / "DJI_0007.MP4"
    assert detect_source(source)[0] == "film" and set(used_files(source, None)) == {"DJI_0007.MP4", "DJI_0007.SRT"}
    result = sfm(source, tmp_path / "out", SfmConfig(max_image_size_px=640, num_threads=1), quiet(), intake=Intake(film_frames=12))
    assert result["frame"] == "metric" and result["cameras"] >= 11
    scene = load_scene_of(tmp_path / "out")
    known = cameras_of(read_model(HAMLET.parent / "known"))
    names = [int(match[1]) // 3 for name in scene.cameras.names if (match := re.search(r"_(\d{6})\.jpg$", name))]
    truth = known.centers[[sorted(known.names).index(f"drone_{index:04d}.jpg") for index in names]]
    moved = scene.cameras.centers - scene.cameras.centers.mean(axis=0)
    # The subtitles' heights and places are as noisy as the photographs' GPS, and mp4v blurs: the shape is that of the flight.
    assert np.abs(moved - (truth - truth.mean(axis=0))).max() < 0.05 * np.ptp(truth, axis=0).max()


def test_a_training_of_a_film_is_scored_on_frames_and_goes_on(flight: Path, tmp_path: Path) -> None:
    request = TrainRequest(source=flight, out=tmp_path / "out", overrides=TINY.overrides, intake=Intake(film_frames=12))
    metrics = train(request)
    assert metrics["num_photographs"] >= 11
    assert all(row["name"].startswith("film_DJI_0007/") for row in metrics["images"])
    again = train(request, resume=True)
    assert again["images"] == metrics["images"]


def test_films_beside_photographs_are_left_and_asked_for_in_one_place_only(flight: Path, tmp_path: Path) -> None:
    for path in HAMLET.iterdir():
        (tmp_path / path.name).symlink_to(path)
    (tmp_path / "film.mp4").symlink_to(flight / "DJI_0007.MP4")
    assert detect_source(tmp_path)[0] == "photographs"
    with pytest.raises(BadInput, match="expected 3 or more"):
        RunConfig(source=flight, out=tmp_path / "out", sfm=SfmOptions(film_frames=2)).sfm.intake  # noqa: B018
    with pytest.raises(BadInput, match="--film-frames and --panoramas are of photographs in one place"):
        RunConfig(source=flight, out=tmp_path / "out", sfm=SfmOptions(film_frames=20), frames="gps")


def test_frames_of_a_film_take_no_poses(flight: Path, tmp_path: Path) -> None:
    (tmp_path / "film.mp4").symlink_to(flight / "DJI_0007.MP4")
    (tmp_path / "transforms.json").write_text("{}")
    assert detect_source(tmp_path)[0] == detect_source(tmp_path, NO_POSES)[0] == "film"
    assert notes_on_source(tmp_path) == ("not used: transforms.json, since the frames of a film are placed by themselves.",)
    for source in (tmp_path, flight / "DJI_0007.MP4"):
        with pytest.raises(BadInput, match=r"is a film or holds films alone.*leave out --poses"):
            detect_source(source, tmp_path / "transforms.json")
        with pytest.raises(BadInput, match="no poses to adjust: leave out --refine-poses"):
            sfm(source, tmp_path / "out", SfmConfig(), quiet(), refine_poses=True)


def test_masks_of_a_films_frames_are_among_the_files_that_a_scene_is_made_from(flight: Path, tmp_path: Path) -> None:
    mask = tmp_path / "masks" / "film_DJI_0007" / "DJI_0007_000001.png"
    save_mask(mask, np.ones((240, 320), bool))
    (tmp_path / "masks" / "note.txt").write_text("no mask")
    assert set(used_files(flight, tmp_path / "masks")) == {"DJI_0007.MP4", "DJI_0007.SRT", "mask film_DJI_0007/DJI_0007_000001.png"}
    config = RunConfig(source=flight, out=tmp_path / "out", sfm=SfmOptions(masks=tmp_path / "masks"))
    task = sfm_task(flight, SfmConfig(), tmp_path / "masks", Placement())
    work = tmp_path / "out" / "sfm"
    work.mkdir(parents=True)
    first = source_key(config, task, work, lambda event: None)
    (work / SEAL_NAME).write_text("{}")
    assert source_key(config, task, work, lambda event: None) == first
    save_mask(mask, np.eye(240, 320) > 0)
    told: list[str] = []
    assert source_key(config, task, work, lambda event: told.append(getattr(event, "message", ""))) != first
    assert "1 with other content (mask film_DJI_0007/DJI_0007_000001.png): structure from motion" in told[0]
