"""Layers and model agree after 200 random ways of moving the view, and 60 on a screen of twice the density. Minutes."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.viewer.test_moved_views import move


@pytest.mark.stress
@pytest.mark.parametrize(("screen", "scale", "seed", "number"), [("1440x900x24", 1, 11, 200), ("2880x1800x24", 2, 12, 60)])
def test_layers_lie_where_the_model_is_after_200_moves(tmp_path: Path, screen: str, scale: int, seed: int, number: int) -> None:
    seen = move(tmp_path, screen, seed, number, scale)
    assert seen["seen"] > 3 * number, "too little was in sight to tell"
