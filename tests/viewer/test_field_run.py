"""A run whose photographs stayed with their devices: figures, and where the pictures are."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.io.ply import save_ply
from radiant_core.io.records import save_cameras, save_plan, save_scene
from radiant_core.io.run_store import write_json
from radiant_viewer.runs.photo_access import find_photograph
from radiant_viewer.runs.run_figures import image_figures
from radiant_viewer.runs.run_pictures import comparisons_picture, screenshot
from radiant_viewer.runs.run_view import RunView, load_run_view
from radiant_viewer.window.subject import run_subject
from tests.viewer.made_up_run import made_up_town
from tests.viewer.window_kit import run_python

HERE, ELSEWHERE = "north-1", "harbour-2"
WORST = f"{HERE}/held-out-0000"
PSNR_DB = {WORST: 17.5, f"{ELSEWHERE}/held-out-0000": 21.25, f"{HERE}/held-out-0001": 23.0}


def renamed(cameras: Cameras, names: list[str]) -> Cameras:
    return replace(cameras, names=tuple(names))


def save_field_run(folder: Path, *, with_pictures: bool = False) -> None:
    """The town as `--frames gps` leaves it; the folder of one device alone lies in the run's."""
    town = made_up_town()
    owners = np.empty(len(town.scene.cameras), object)
    for plan in town.edge_plans:
        owners[plan.camera_indices] = np.array(plan.device_ids, object)[plan.device_of_camera]
    numbers: dict[str, int] = {}
    names = []
    for owner in owners.tolist():
        numbers[owner] = numbers.get(owner, -1) + 1
        names.append(f"{owner}/{numbers[owner]:04d}")
    own = np.flatnonzero(owners == HERE)
    (folder / "delivered").mkdir(parents=True)
    (folder / "devices" / HERE / "photos").mkdir(parents=True)
    save_scene(folder / "delivered/scene.safetensors", replace(town.scene, cameras=renamed(town.scene.cameras, names)))
    save_plan(folder / "delivered/plan.json", town.cloud_plan, town.edge_plans)
    save_scene(folder / "devices" / HERE / "scene.safetensors", town.scene.restricted_to(own))
    save_cameras(folder / "devices" / HERE / "held_out.safetensors", renamed(town.scene.cameras.select([0, 1]), ["out_7.jpg", "out_8.jpg"]))
    save_ply(folder / "scene.ply", town.splats)
    write_json(folder / "manifest.json", {"status": "done"})
    rows = [{"name": name, "psnr_db": value, "ssim": 0.5 + value / 100} for name, value in PSNR_DB.items()]
    write_json(folder / "metrics.json", {"images": rows, "frames": "gps"})
    for kind in ("photographs", "renders", "differences") if with_pictures else ():
        for name in PSNR_DB:
            path = folder / "pictures" / kind / f"{name}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), np.full((60, 80, 3), 90, np.uint8))


@pytest.fixture
def run(tmp_path: Path) -> RunView:
    save_field_run(tmp_path / "run")
    return load_run_view(tmp_path / "run", with_files=True)


def index_of(run: RunView, name: str) -> int:
    return run.photographs.index(name)


def test_the_figures_that_went_up_are_there_without_the_places_they_were_measured_at(run: RunView) -> None:
    assert run.psnr_db == PSNR_DB
    assert run.unplaced == tuple(sorted(PSNR_DB))
    assert run.photographs[: len(run.scene.cameras)] == run.scene.cameras.names
    assert {run.owner(index_of(run, name)) for name in PSNR_DB} == {HERE, ELSEWHERE}
    # No camera has a figure: there is no layer of PSNR, and the other layers are as ever.
    names = [layer.name for layer in run_subject(run).layers]
    assert "Cameras by PSNR" not in names and "Cameras by split" in names


def test_numbers_have_names_of_files_only_where_the_devices_folder_is_here(run: RunView) -> None:
    assert run.files[WORST] == "out_7.jpg" and run.files[f"{HERE}/0000"].startswith("DJI_")
    assert not [name for name in run.files if not name.startswith(f"{HERE}/")]
    assert load_run_view(run.folder).files == {}, "what makes a report knows no names"
    photos = run.folder / "devices" / HERE / "photos"
    (photos / "out_7.jpg").write_bytes(b"x")
    assert find_photograph(run, index_of(run, WORST)).path == photos / "out_7.jpg"
    away = find_photograph(run, index_of(run, f"{ELSEWHERE}/held-out-0000"))
    assert away.path is None and f"never left device {ELSEWHERE}" in away.reason
    climbing = replace(run, files={WORST: "../../../secret.jpg", f"{HERE}/0000": "/etc/hostname"})
    for name in climbing.files:
        assert find_photograph(climbing, index_of(run, name)).path is None
    (run.folder / "devices" / HERE / "held_out.safetensors").write_bytes(b"broken")
    assert WORST not in load_run_view(run.folder, with_files=True).files


def test_pictures_that_stayed_are_named_with_the_way_to_have_them(run: RunView) -> None:
    with pytest.raises(BadInput, match=f"{WORST}.* stayed with device {HERE}.*--single-owner"):
        comparisons_picture(run)
    assert screenshot(run.folder, "cameras").std() > 5


def test_collected_pictures_are_compared_from_the_worst_on(tmp_path: Path) -> None:
    save_field_run(tmp_path / "run", with_pictures=True)
    assert screenshot(tmp_path / "run", "compare").ndim == 3
    assert screenshot(tmp_path / "run", "compare", camera=WORST).ndim == 3
    with pytest.raises(BadInput, match="did you mean"):
        screenshot(tmp_path / "run", "splats", camera=WORST)


def test_the_table_has_a_row_for_each_figure(run: RunView, tmp_path: Path) -> None:
    pytest.importorskip("PySide6", reason="the extra 'desktop' is not installed")
    from radiant_viewer.docks.camera_table import CameraTable

    table = CameraTable(run, image_figures(run.folder))
    assert len(table.rows) == len(run.photographs)
    table.save_csv(tmp_path / "cameras.csv", range(len(table.rows)))
    rows = {row["Photograph"]: row for row in csv.DictReader((tmp_path / "cameras.csv").read_text().splitlines())}
    worst, trained = rows[WORST], rows[f"{HERE}/0000"]
    assert (worst["PSNR (dB)"], worst["SSIM"], worst["Use"], worst["Region"], worst["Device"]) == (
        "17.5",
        "0.675",
        "held out",
        "north",
        HERE,
    )
    assert (worst["East (m)"], worst["File"], rows[f"{ELSEWHERE}/held-out-0000"]["File"]) == ("", "out_7.jpg", "")
    assert (trained["PSNR (dB)"], trained["Use"]) == ("", "training") and float(trained["East (m)"]) < 0


DOCK = """
import sys
from pathlib import Path
from PySide6.QtWidgets import QApplication, QMainWindow
from radiant_viewer.docks.photo_dock import PhotoDock
from radiant_viewer.runs.run_figures import image_figures
from radiant_viewer.runs.run_view import load_run_view

class Window(QMainWindow):
    def show_status(self, message):
        print("status:", message)
    def select_camera(self, name):
        self.dock.show_camera(run.photographs.index(name))

application = QApplication([])
run, window = load_run_view(Path(sys.argv[1]), with_files=True), Window()
dock = window.dock = PhotoDock(window, run, image_figures(run.folder))
dock.show_worst()
for by in (1, 1, 1):
    print(dock.name.text(), "|", dock.figures_text.text(), "|", dock.picture.message)
    dock.step(by)
"""


def test_the_worst_photograph_has_its_figures_and_says_where_its_pictures_are(run: RunView) -> None:
    pytest.importorskip("PySide6", reason="the extra 'desktop' is not installed")
    result = run_python(DOCK, str(run.folder), QT_QPA_PLATFORM="offscreen")
    assert result.returncode == 0, result.stderr[-2000:]
    # A figure stays on the line of its name.
    assert "PSNR\xa017.50\xa0dB" in result.stdout
    first, second, third = result.stdout.replace("\xa0", " ").strip().splitlines()
    assert first.startswith(f"out_7.jpg ({WORST}) | worst of 3") and "PSNR 17.50 dB" in first
    assert f"never left device {HERE}" in first and "--single-owner" in first
    assert second.startswith(f"{ELSEWHERE}/held-out-0000 | 2. worst of 3") and f"device {ELSEWHERE}" in second
    assert "PSNR 23.00 dB" in third
