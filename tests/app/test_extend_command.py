"""`radiant join`: the new region's cameras stand where its model was moved to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from radiant_app.commands.model.extend import _virtual_cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.hierarchy.codec import VIRTUAL_CAMERAS, sim3_record
from radiant_core.io.records import save_cameras
from radiant_core.io.run_store import write_json
from radiant_core.render.trajectories import Lens, cameras_looking_at


def test_cameras_move_with_the_models_that_the_cloud_moved_and_those_of_refused_edges_are_left_out(tmp_path: Path) -> None:
    two = cameras_looking_at(np.array([[0.0, -8, 6], [0.0, 8, 6]]), np.zeros((2, 3)), Lens(size_wh=(32, 32)))
    for edge in ("north", "south"):
        (tmp_path / "cloud" / "inbox" / edge).mkdir(parents=True)
        save_cameras(tmp_path / "cloud" / "inbox" / edge / VIRTUAL_CAMERAS, two)
    move = Sim3(scale=2.0, rotation=np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), translation=np.array([100.0, 0, 0]))
    write_json(tmp_path / "cloud" / "corrections.json", {"north": sim3_record(move), "south": None})
    found = _virtual_cameras(tmp_path)
    np.testing.assert_allclose(found.centers, [[116, 0, 12], [84, 0, 12]], atol=1e-9)
    write_json(tmp_path / "cloud" / "corrections.json", {"north": None, "south": None})
    with pytest.raises(BadInput, match="holds no virtual cameras"):
        _virtual_cameras(tmp_path)
