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


def steep_plane(slope: tuple[float, float]) -> Mesh:
    """z = 5 + slope · (x, y), seen twice at fx = 100 px; what is right of pixel 95 is white."""
    K = np.array([[100.0, 0, 80], [0, 100, 60], [0, 0, 1]])
    rays = np.stack(np.meshgrid((np.arange(160) + 0.5 - 80) / 100, (np.arange(120) + 0.5 - 60) / 100), axis=-1)
    depth = (5 / (1 - rays @ slope)).astype(np.float32)
    image = np.zeros((120, 160, 3), np.uint8)
    image[:, 95:] = 255
    view = DepthView(image=image, depth=np.where(depth < 9, depth, 0), K=K, cam_from_world=np.eye(4))
    return fused_mesh([view, view], 0.04, 10.0)


@pytest.mark.parametrize("slope", [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])
def test_a_steep_plane_is_fused_where_it_lies(slope: tuple[float, float]) -> None:
    points = steep_plane(slope).vertices
    off_px = 100 / points[:, 2] * (points[:, 2] - 5 - points[:, :2] @ slope) / sum(slope)
    # A voxel is 0.4 to 1.5 px; K off by half a pixel moves the plane along its slope by that much.
    assert len(off_px) > 10_000 and abs(np.median(off_px)) < 0.1


@pytest.mark.parametrize("slope", [(0.0, 1.0), (0.0, -1.0)])
def test_colors_lie_where_their_pixels_look(slope: tuple[float, float]) -> None:
    mesh = steep_plane(slope)
    from_edge_px = 100 * mesh.vertices[:, 0] / mesh.vertices[:, 2] + 80 - 95
    white = mesh.colors[:, 0] > 127
    sides_px = [np.median(from_edge_px[(np.abs(from_edge_px) < 2) & side]) for side in (white, ~white)]
    # Two pixels of each side: their medians are 1 and -1, and 1.25 and -0.73 half a pixel away.
    assert sides_px == pytest.approx([1, -1], abs=0.1)


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
