"""Open3D's window and picture show the layers of our own, and nothing that Open3D does ends the command."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_app.commands.inspect.window import Picture, inspect_with_open3d
from radiant_core.errors import BadInput, StageFailed
from radiant_viewer.layers.layer import Layer
from radiant_viewer.layers.palette import VERMILLION
from radiant_viewer.open3d_window import launch
from radiant_viewer.open3d_window.parts import layer_parts, lift_of
from radiant_viewer.pictures.images import load_image
from radiant_viewer.pictures.splat_picture import draw_splat_view, fit_camera
from radiant_viewer.pictures.view_pose import ViewPose
from tests.viewer.made_up_run import made_up_town, save_run
from tests.viewer.test_model_among_layers import SIZE_WH, VIEW, house
from tests.viewer.window_kit import virtual_display

ROOT = Path(__file__).parents[2]
BY_DEPTH = """
import sys
import numpy as np
from radiant_viewer.open3d_window.parts import layer_parts, model_part
from radiant_viewer.open3d_window.picture import draw_parts
from tests.viewer.test_model_among_layers import SIZE_WH, VIEW, frustum, house
origin = np.array([0.0, 0, 4])
parts = [model_part(house(), origin), *layer_parts(frustum(float(sys.argv[1])), origin)]
np.save(sys.argv[2], draw_parts(parts, VIEW.camera(SIZE_WH), origin))
"""

CORNERS = """
import sys
import numpy as np
from radiant_viewer.open3d_window.parts import layer_parts, model_part
from radiant_viewer.open3d_window.picture import draw_parts
from tests.viewer.test_model_among_layers import SIZE_WH, house
from tests.viewer.test_open3d_window import corners, seen_from
origin = np.array([2.0, -1, 4])
parts = [model_part(house(), origin), *layer_parts(corners(), origin)]
np.save(sys.argv[2], draw_parts(parts, seen_from(int(sys.argv[1])).camera(SIZE_WH), origin))
"""
NEAR_PX = 2.0


def corners() -> Layer:
    """Points just outside the corners and the middles of the sides of the house."""
    signs = np.stack(np.meshgrid(*[[-1.0, 0, 1]] * 3), axis=-1).reshape(-1, 3)
    signs = signs[np.abs(signs).sum(axis=1) != 0]
    points = 5.2 * signs + (0, 0, 4)
    red = np.tile(np.array(VERMILLION, np.uint8), (len(points), 1))
    return Layer(name="corners", points=points, point_colors=red, point_size_px=7)


def seen_from(seed: int) -> ViewPose:
    """The house from one of many sides."""
    rng = np.random.default_rng(seed)
    side, height, distance = rng.uniform(0, 2 * np.pi), rng.uniform(-0.2, 1.2), rng.uniform(24, 40)
    away = distance * np.array([np.cos(side) * np.cos(height), np.sin(side) * np.cos(height), np.sin(height)])
    target = np.array([0.0, 0, 4]) + rng.uniform(-2, 2, 3)
    return ViewPose(position=target + away, focal_point=target, up=np.array([0.0, 0, 1]), angle_deg=40.0)


def red_spots(image: np.ndarray) -> np.ndarray:
    """Middles (S,2) px of the red spots of a picture, whose frame they do not touch."""
    # By hue, not by level: Open3D's colours pass through its own tone mapping.
    red = (image[..., 0].astype(int) - image[..., 2]) > 80
    count, _, boxes, middles = cv2.connectedComponentsWithStats(red.astype(np.uint8))
    left, top, width, height, area = boxes.T
    inside = (left > 0) & (top > 0) & (left + width < image.shape[1]) & (top + height < image.shape[0]) & (area > 12)
    return middles[inside & (np.arange(count) > 0)]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    save_run(tmp_path / "run", made_up_town())
    return tmp_path / "run"


def drawn_at(y: float, tmp_path: Path) -> np.ndarray:
    path = tmp_path / f"{y}.npy"
    subprocess.run([sys.executable, "-c", BY_DEPTH, str(y), str(path)], cwd=ROOT, check=True, capture_output=True, timeout=120)
    return np.load(path)


def test_a_frustum_behind_a_house_is_hidden_and_one_before_it_is_not(tmp_path: Path) -> None:
    before, behind = drawn_at(-12.0, tmp_path), drawn_at(9.0, tmp_path)
    # By hue, not by level: Open3D's colours pass through its own tone mapping.
    red = [int(((image[..., 0].astype(int) - image[..., 2]) > 80).sum()) for image in (before, behind)]
    assert red[0] > 100 and red[1] == 0
    ours = draw_splat_view([], house(), VIEW.camera(SIZE_WH)).image
    grey = [(image.astype(int).max(axis=2) < 200) & (np.ptp(image.astype(int), axis=2) < 30) for image in (behind, ours)]
    assert (grey[0] & grey[1]).sum() / (grey[0] | grey[1]).sum() > 0.95, "the house is elsewhere than in our own picture"


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.stress) for seed in (1, 2))])
def test_layers_lie_where_our_own_picture_has_them_from_every_side(seed: int, tmp_path: Path) -> None:
    path = tmp_path / "picture.npy"
    command = [sys.executable, "-c", CORNERS, str(seed), str(path)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=300)
    camera = seen_from(seed).camera(SIZE_WH)
    theirs, ours = red_spots(np.load(path)), red_spots(draw_splat_view([corners()], house(), camera).image)
    pose, K = camera.cam_from_world[0], camera.Ks[0]
    in_camera = corners().points @ pose[:3, :3].T + pose[:3, 3]
    places = in_camera[:, :2] / in_camera[:, 2:] * K[0, 0] + K[:2, 2]
    away = np.linalg.norm(theirs[:, None] - places, axis=2).min(axis=1)
    print(f"{len(theirs)} spots, at most {away.max():.2f} px from where the camera has them; ours shows {len(ours)}")
    assert len(theirs) >= 6 and away.max() < NEAR_PX
    # What the house hides of one it hides of the other, but for spots at its rim.
    assert np.sum(np.linalg.norm(theirs[:, None] - ours, axis=2).min(axis=1) > 2 * NEAR_PX) <= 1
    assert np.sum(np.linalg.norm(ours[:, None] - theirs, axis=2).min(axis=1) > 2 * NEAR_PX) <= 1


def test_a_picture_shows_model_cameras_and_borders(run: Path, tmp_path: Path) -> None:
    assert inspect_with_open3d(run, None, tmp_path / "a.png", Picture(size_wh=(320, 240))) == 0
    image = load_image(tmp_path / "a.png").astype(int)
    assert image.shape == (240, 320, 3)
    green = (image[..., 1] > image[..., 0] + 10) & (image[..., 1] > image[..., 2] + 10)
    blue = (image[..., 2] > image[..., 0] + 80) & (image[..., 2] > image[..., 1])
    assert green.mean() > 0.1 and blue.sum() > 30 and (image.max(axis=2) < 70).sum() > 100
    with pytest.raises(BadInput, match="exists"):
        inspect_with_open3d(run, None, tmp_path / "a.png")
    with pytest.raises(BadInput, match="no photograph 'nobody'"):
        inspect_with_open3d(run, None, tmp_path / "b.png", Picture(camera="nobody"))
    with pytest.raises(BadInput, match="picture of our own"):
        inspect_with_open3d(run, "compare", tmp_path / "b.png")
    with pytest.raises(BadInput, match="there is neither a folder nor a file"):
        inspect_with_open3d(tmp_path / "nothing", None, tmp_path / "b.png")
    assert not (tmp_path / "b.png").exists()


@pytest.fixture
def display() -> Iterator[str]:
    with virtual_display("1000x700x24") as name:
        yield name


def test_the_window_opens_and_closes_by_a_signal(run: Path, display: str) -> None:
    command = [sys.executable, "-m", "radiant_app.cli.app", "inspect", str(run), "--viewer", "open3d", "--size", "640x480"]
    with subprocess.Popen(command, cwd=ROOT, env={**os.environ, "DISPLAY": display}, stderr=subprocess.PIPE, text=True) as process:
        children, end = Path(f"/proc/{process.pid}/task/{process.pid}/children"), time.monotonic() + 60
        while not children.read_text() and time.monotonic() < end:
            time.sleep(0.1)
        child = int(children.read_text().split()[0])
        time.sleep(10)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
        assert process.returncode == 130 and "Traceback" not in said, said
        while Path(f"/proc/{child}").exists() and time.monotonic() < end + 60:
            time.sleep(0.1)
        assert not Path(f"/proc/{child}").exists()


def test_without_a_display_it_says_so(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(BadInput, match="DISPLAY"):
        inspect_with_open3d(run, None, None)


def test_an_end_by_a_signal_is_one_sentence(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launch, "worker_command", lambda job: [sys.executable, "-c", "import os; os.kill(os.getpid(), 11)"])
    with pytest.raises(StageFailed, match=r"Open3D ended by signal 11 .*leave out --viewer open3d"):
        inspect_with_open3d(run, None, tmp_path / "a.png")
    monkeypatch.setattr(launch, "worker_command", lambda job: [sys.executable, "-c", ""])
    with pytest.raises(StageFailed, match="drew no picture"):
        inspect_with_open3d(run, None, tmp_path / "a.png")


def test_layers_in_front_are_lifted_onto_the_model() -> None:
    town = made_up_town()
    line = np.array([[[0.0, 0, -4], [10.0, 0, -4]]])
    layer = Layer(name="border", segments=line, segment_colors=np.zeros((1, 3), np.uint8), in_front=True)
    lift = lift_of(town.splats, [layer])
    # The town's Gaussians lie between 0 and 1 m.
    assert abs(lift - 4.9) < 0.05
    (part,) = layer_parts(layer, np.array([5.0, 0, 0]), lift)
    np.testing.assert_allclose(np.asarray(part.geometry.points), [[-5, 0, -4 + lift], [5, 0, -4 + lift]])
    assert lift_of(None, [layer]) == 0 and fit_camera(line.reshape(-1, 3), (8, 8)).sizes_wh[0, 0] == 8
