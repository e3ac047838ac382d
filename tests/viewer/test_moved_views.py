"""Layers and model agree on the screen after every way of moving the view: keys, buttons, mouse, bookmarks, flights,
sizes, and two pixels of the screen for one of the window. Once F drew layers as the view before had them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.viewer.beacons import with_beacons
from tests.viewer.made_up_run import made_up_town, save_run
from tests.viewer.window_kit import run_python, virtual_display


def move(folder: Path, screen: str, seed: int, number: int, scale: int = 1, painter: str = "") -> dict[str, float]:
    """Move the window's views so often on a screen: what was seen, or the window's own assertion."""
    pytest.importorskip("pyvistaqt", reason="the extra 'desktop' is not installed")
    save_run(folder / "run", with_beacons(made_up_town()))
    arguments = (str(folder / "run"), str(seed), str(number), *([painter] if painter else []))
    with virtual_display(screen) as display:
        environment = {"DISPLAY": display, "QT_QPA_PLATFORM": "xcb", "QT_SCALE_FACTOR": str(scale)}
        result = run_python(["-m", "tests.viewer.moved_views"], *arguments, patience_s=60 + 6 * number, **environment)
    assert result.returncode == 0, result.stderr[-3000:]
    return json.loads(result.stdout.splitlines()[-1])


@pytest.mark.parametrize(("screen", "scale", "number"), [("1440x900x24", 1, 8), ("2000x1400x24", 2, 3)])
def test_layers_lie_where_the_model_is_after_every_way_of_moving(tmp_path: Path, screen: str, scale: int, number: int) -> None:
    seen = move(tmp_path, screen, seed=3, number=number, scale=scale)
    assert seen["seen"] > 3 * number, "too little was in sight to tell"
