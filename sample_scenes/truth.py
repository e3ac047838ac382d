"""A run on photographs of the generator beside the truth: the mesh, its colours from above, and the
similarity between their frames.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, cast

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from radiant_core.frames import Sim3
from radiant_core.geometry.align import fit_sim3
from radiant_core.io.colmap.model import read_model
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.sfm.world_frame.world import cameras_of
from scenegen.config import SceneConfig
from scenegen.raycast import town_of

ABOVE_M, ROW = 500.0, 8192


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """What the generator knows: its settings, a caster of rays onto its mesh, and the similarity
    that moves the run's frame onto it."""

    config: SceneConfig
    caster: Any
    truth_from_run: Sim3

    def heights(self, places: FloatArray) -> FloatArray:
        """Height (P,) of the topmost surface over places (P,2) of the truth's frame."""
        rays = np.zeros((len(places), 6), np.float32)
        rays[:, :2], rays[:, 2], rays[:, 5] = places, ABOVE_M, -1.0
        return ABOVE_M - self.caster.cast_rays(cast(Any, o3d.core.Tensor)(rays))["t_hit"].numpy().astype(np.float64)

    def flown(self, cell_m: float, share: float = 1.0) -> tuple[FloatArray, tuple[int, int]]:
        """Middles (P,2) of cells over the area of the flight, or a share of its sides, from the
        north-west row by row, and their rows and columns."""
        half = share * np.array(self.config.extent_m) / 2
        x, y = np.arange(-half[0] + cell_m / 2, half[0], cell_m), np.arange(half[1] - cell_m / 2, -half[1], -cell_m)
        east, north = np.meshgrid(x, y)
        return np.column_stack([east.ravel(), north.ravel()]), (len(y), len(x))


def config_of(known: Path) -> SceneConfig:
    """The settings that the scene of a folder `known` was made with."""
    record = json.loads((known / "frame.json").read_text())["config"]
    names = {field.name for field in fields(SceneConfig)}
    given: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in record.items() if key in names}
    return SceneConfig(**given)


def load_truth(known: Path, scene: SfmScene) -> Truth:
    """The truth in the folder `known` beside the photographs of a scene."""
    config = config_of(known)
    truth = cameras_of(read_model(known))
    shared = sorted(set(truth.names) & set(scene.cameras.names))
    mesh = town_of(config)
    caster = o3d.t.geometry.RaycastingScene()
    tensor = cast(Any, o3d.core.Tensor)
    caster.add_triangles(tensor(np.ascontiguousarray(mesh.vertices, np.float32)), tensor(np.ascontiguousarray(mesh.triangles, np.uint32)))
    move = fit_sim3(scene.cameras.named(shared).centers, truth.named(shared).centers)
    return Truth(config=config, caster=caster, truth_from_run=move)


def sample(image: NDArray[Any], cells: FloatArray) -> NDArray[np.float32]:
    """Bilinear values of an image (H,W) or (H,W,B) at rows and columns (P,2), middles at 0.5."""
    import cv2

    # OpenCV takes maps of fewer than 32,768 columns.
    at = np.zeros((-(-len(cells) // ROW) * ROW, 2), np.float32)
    at[: len(cells)] = cells - 0.5
    rows, columns = (np.ascontiguousarray(axis.reshape(-1, ROW)) for axis in at.T)
    parts = [
        cv2.remap(image, columns[first : first + ROW], rows[first : first + ROW], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for first in range(0, len(rows), ROW)
    ]
    return np.concatenate(parts).reshape(-1, *image.shape[2:])[: len(cells)].astype(np.float32)
