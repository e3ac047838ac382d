"""A run folder as pictures: every view of a finished run, one clear sentence for others; charts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiant_core.errors import BadInput, RadiantError, StoreDamaged
from radiant_core.io.run_store import write_json
from radiant_viewer.charts.charts import TimelineRow, TimelineSpan, comparison_picture, timeline_picture
from radiant_viewer.runs.run_pictures import screenshot
from radiant_viewer.runs.run_view import load_run_view
from tests.viewer.made_up_run import made_up_town, save_run


@pytest.fixture
def run_folder(tmp_path: Path) -> Path:
    save_run(tmp_path / "run", made_up_town(step_levels=30))
    return tmp_path / "run"


def test_a_finished_run_comes_back_whole(tmp_path: Path) -> None:
    town = made_up_town()
    psnr_db = save_run(tmp_path / "run", town)
    run = load_run_view(tmp_path / "run")
    assert run.held_out == town.held_out
    assert run.psnr_db == psnr_db
    assert run.splats is not None
    assert len(run.splats) == len(town.splats)
    assert run.roles.device_ids == ("north-1", "north-2", "harbour-1", "harbour-2", "quarry-1", "quarry-2")


@pytest.mark.parametrize("view", ["regions", "cameras", "seams", "splats"])
def test_every_view_of_a_finished_run_is_a_picture_of_the_size_asked_for(run_folder: Path, view: str) -> None:
    image = screenshot(run_folder, view, (640, 420))
    assert image.shape == (420, 640, 3)
    assert (image != 255).any(axis=2).mean() > 0.05


def test_the_comparison_shows_the_stored_pictures_of_the_worst_photograph(run_folder: Path) -> None:
    image = screenshot(run_folder, "compare")
    for level in (200, 180, 60):
        # 380 × 285 px each: small pictures are enlarged to a readable width.
        assert (image == level).all(axis=2).sum() >= 0.98 * 380 * 285


def test_an_unknown_view_names_the_known_ones(run_folder: Path) -> None:
    with pytest.raises(BadInput, match="regions, cameras, seams, splats, compare"):
        screenshot(run_folder, "x-ray")


@pytest.mark.parametrize(
    ("missing", "view", "sentence"),
    [
        ("manifest.json", "regions", "is no run"),
        ("sfm/scene.safetensors", "regions", "structure from motion is not finished.*--resume"),
        ("plan.json", "regions", "the plan is not finished.*--resume"),
        ("scene.ply", "splats", r"no scene\.ply.*--resume"),
        ("scene.ply", "seams", r"no scene\.ply.*--resume"),
        ("metrics.json", "compare", "no figures.*--resume"),
        ("pictures/renders/DJI_0000.JPG.png", "compare", "DJI_0000.*--resume"),
    ],
)
def test_a_run_that_is_not_finished_says_what_is_missing_and_how_to_finish(
    run_folder: Path, missing: str, view: str, sentence: str
) -> None:
    (run_folder / missing).unlink()
    with pytest.raises(BadInput, match=sentence) as caught:
        screenshot(run_folder, view)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("name", ["sfm/scene.safetensors", "plan.json", "metrics.json", "scene.ply"])
def test_a_broken_file_is_named_in_one_sentence(run_folder: Path, name: str) -> None:
    whole = (run_folder / name).read_bytes()
    (run_folder / name).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RadiantError, match=Path(name).name) as caught:
        screenshot(run_folder, "splats")
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("record", [[], {}, {"images": 3}, {"images": [{"name": "a"}]}, {"images": [{"name": "a", "psnr_db": True}]}])
def test_figures_of_another_form_are_refused(run_folder: Path, record: object) -> None:
    write_json(run_folder / "metrics.json", record)
    with pytest.raises(StoreDamaged, match=r"metrics\.json"):
        load_run_view(run_folder)


def test_before_evaluation_the_cameras_are_shown_by_split(run_folder: Path) -> None:
    (run_folder / "metrics.json").unlink()
    run = load_run_view(run_folder)
    assert run.psnr_db is None
    assert run.held_out == {"DJI_0000.JPG", "DJI_0008.JPG", "DJI_0016.JPG"}
    assert screenshot(run_folder, "cameras", (640, 420)).shape == (420, 640, 3)


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="nowhere"):
        load_run_view(tmp_path / "nowhere")


def rows(*lengths_s: float) -> list[TimelineRow]:
    return [
        TimelineRow(name=f"north-{i}", spans=(TimelineSpan(stage="train", start_s=0, stop_s=length),)) for i, length in enumerate(lengths_s)
    ]


def test_a_bar_is_as_long_as_its_time() -> None:
    image = timeline_picture(rows(50.0, 25.0, 12.5))
    # Below the keys: the bar's fill is the only saturated blue.
    blue = (image[92:, :, 2].astype(int) - image[92:, :, 0] > 150).sum(axis=1)
    longest = blue.max()
    lengths = {int(count) for count in blue if count > 0.1 * longest}
    # 3 px: the white edges between bars are blended.
    assert any(abs(length - longest / 2) <= 3 for length in lengths)
    assert any(abs(length - longest / 4) <= 3 for length in lengths)


@pytest.mark.parametrize("span", [(1.0, 0.0), (-1.0, 0.0), (0.0, np.nan), (0.0, np.inf)])
def test_impossible_times_are_refused(span: tuple[float, float]) -> None:
    with pytest.raises(BadInput, match="expected"):
        TimelineSpan(stage="train", start_s=span[0], stop_s=span[1])


def test_a_timeline_without_times_or_room_is_refused() -> None:
    for bad_rows, width_px in (([], 1280), ([TimelineRow(name="a", spans=())], 1280), (rows(1.0), 100)):
        with pytest.raises(BadInput):
            timeline_picture(bad_rows, width_px=width_px)


def test_equal_pictures_have_a_black_difference_and_other_sizes_are_refused() -> None:
    photo = np.full((80, 300, 3), 120, np.uint8)
    image = comparison_picture(photo, photo, title="equal")
    assert (image == 0).all(axis=2).sum() >= photo.shape[0] * photo.shape[1]
    with pytest.raises(BadInput, match="expected equal"):
        comparison_picture(photo, photo[:, :-1])
