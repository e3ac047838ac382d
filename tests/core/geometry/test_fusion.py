"""Depth views are fused by another process, which is sized before: in pieces as in one, and what
does not fit or crashes is a sentence."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_core.errors import BadInput
from radiant_core.geometry import fusion
from radiant_core.geometry.fusion import FusionSettings, blocks_within, fuse_apart, round_up
from radiant_core.geometry.open3d_ops import MAX_BLOCKS, DepthView, Mesh, count_blocks, fused_mesh

MAX_DEPTH_M = 60.0


def hilly_views(count: int = 2) -> Iterator[DepthView]:
    """The same hills, 18 to 22 m away, 160 × 120 px in many colours: a voxel needs two views."""
    rng = np.random.default_rng(0)
    hills = cv2.resize(rng.uniform(18, 22, (9, 12)).astype(np.float32), (160, 120), interpolation=cv2.INTER_CUBIC)
    image = rng.integers(0, 255, (120, 160, 3), dtype=np.uint8)
    K = np.array([[130.0, 0, 80], [0, 130, 60], [0, 0, 1]])
    for _ in range(count):
        yield DepthView(image=image, depth=hills, K=K, cam_from_world=np.eye(4))


def triangles_of(mesh: Mesh) -> list[tuple[float, ...]]:
    """Corners and colours of every triangle, in an order independent of vertex numbers."""
    rows = np.concatenate([mesh.vertices, mesh.colors], axis=1)[mesh.triangles].tolist()
    return sorted(tuple(number for corner in sorted(map(tuple, triangle)) for number in corner) for triangle in rows)


def test_a_mesh_made_in_pieces_is_the_mesh_made_in_one() -> None:
    voxel = 0.25
    room = count_blocks(hilly_views(), voxel, MAX_DEPTH_M)
    whole = fused_mesh(hilly_views(), voxel, MAX_DEPTH_M, room, blocks_at_once=room)
    pieces = fused_mesh(hilly_views(), voxel, MAX_DEPTH_M, room, blocks_at_once=40)
    assert len(whole.triangles) > 10_000 and room > 100
    # The very same: neighbouring pieces compute their common vertices from the same voxels.
    assert triangles_of(pieces) == triangles_of(whole)
    assert len(pieces.vertices) == len(whole.vertices)


def test_what_does_not_fit_is_coarsened_or_refused_with_what_would() -> None:
    few = FusionSettings(voxel=0.25, is_fixed=False, max_depth=MAX_DEPTH_M, max_blocks=40)
    told: list[tuple[int, int]] = []
    coarse = fuse_apart(hilly_views(), few, lambda done, total: told.append((done, total)))
    assert coarse.voxel > 0.25 and 0 < coarse.num_blocks <= 40 and len(coarse.mesh.triangles)
    assert told == [(1, 2), (2, 2)]
    with pytest.raises(BadInput, match=r"choose --resolution [\d.]+ or coarser") as caught:
        fuse_apart(hilly_views(), FusionSettings(voxel=0.25, is_fixed=True, max_depth=MAX_DEPTH_M, max_blocks=40), lambda *_: None)
    advised = float(str(caught.value).split("--resolution ")[1].split()[0])
    # What the sentence names is what it takes.
    assert 0.9 * advised < coarse.voxel <= advised
    assert blocks_within(0) < blocks_within(8 << 30) < blocks_within(1 << 40) == MAX_BLOCKS
    assert [round_up(value) for value in (0.2131, 0.22, 3.01, 12.0)] == [0.22, 0.22, 3.1, 12.0]


@pytest.mark.parametrize(
    ("program", "reason"),
    [("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "signal 11"), ("raise MemoryError('no room')", "no room")],
)
def test_a_process_that_dies_is_one_sentence_with_a_way_on(monkeypatch: pytest.MonkeyPatch, program: str, reason: str) -> None:
    def dying(folder: Path) -> list[str]:
        return [sys.executable, "-c", program]

    monkeypatch.setattr(fusion, "worker_command", dying)
    with pytest.raises(BadInput, match=r"--resolution 0\.5") as caught:
        fuse_apart(hilly_views(), FusionSettings(voxel=0.25, is_fixed=False, max_depth=MAX_DEPTH_M), lambda *_: None)
    assert reason in str(caught.value) and len(str(caught.value).splitlines()) == 1
