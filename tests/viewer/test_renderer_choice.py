"""Which renderer draws the main view: ours without a graphics card, Open3D's where it is faster and its depths are ours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiant_core.io.ply import save_ply
from radiant_viewer.splats import choosing
from radiant_viewer.splats.choosing import MAX_DEPTH_ERROR, OPEN3D, Measured, _open3d_measured, choose_renderer
from radiant_viewer.splats.open3d_rgbd import depth_error
from tests.viewer.test_model_among_layers import house


def test_without_a_graphics_card_open3d_is_not_even_asked() -> None:
    def never(*_: object) -> Measured:
        raise AssertionError

    made = choose_renderer(house(), Path("unused"), lambda: False, never)
    assert made.choice == "our renderer (native)" and "no graphics card" in made.reason
    assert made.figure is not None and made.figure > 0 and made.unit.startswith("s a picture")


@pytest.mark.parametrize(
    ("found", "is_open3d", "told"),
    [
        ((1e-9, MAX_DEPTH_ERROR / 2), True, "depths agree within 0.5 %"),
        ((1e-9, 2 * MAX_DEPTH_ERROR), False, "depths off by up to 2.0 %"),
        ((1e-9, 1e9), False, "other pixels"),
        ((1e9, 0.0), False, "takes 1000000000.000 s"),
        ("its process ended with exit code -6", False, "drew nothing: its process ended"),
    ],
)
def test_open3d_draws_where_it_is_faster_and_its_depths_are_ours(found: Measured, is_open3d: bool, told: str) -> None:
    made = choose_renderer(house(), Path("unused"), lambda: True, lambda *_: found)
    assert (made.choice == OPEN3D) == is_open3d and told in made.reason


def test_depths_are_compared_where_both_show_something() -> None:
    ours = np.zeros((4, 5, 4), np.float32)
    ours[:3, :, 3] = 10
    same = ours.copy()
    same[0, 0, 3] = 11
    assert depth_error(same, ours) < 1e-6, "one of fifteen may be off"
    same[..., 3] *= 1.5
    assert depth_error(same, ours) == pytest.approx(0.5, abs=1e-6)
    assert depth_error(np.zeros_like(ours), ours) == float("inf")


@pytest.mark.stress
def test_open3d_is_measured_in_a_process_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Its first picture compiles: in software some seconds, on a busy machine more than a user waits.
    monkeypatch.setattr(choosing, "PATIENCE_S", 300.0)
    folder = tmp_path
    save_ply(folder / "house.ply", house())
    seen: list[Measured] = []

    def measure(path: Path, given: Path) -> Measured:
        seen.append(_open3d_measured(path, given))
        return seen[0]

    choose_renderer(house(), folder / "house.ply", lambda: True, measure)
    assert isinstance(seen[0], tuple), seen
    # The block's front is flat: where Open3D drew it, it is nearly as far as ours.
    assert seen[0][0] > 0 and seen[0][1] < 0.1
    assert isinstance(_open3d_measured(folder / "none.ply", folder / "none.npz"), str)
