"""The way back from a scene to the frame of the model that it was made from. Once per scene, and
once per file that is written in that frame.

    x_given = given_from_scene x_scene,    file coordinate = x_given − offset

A given model is turned until z is up and moved near its origin, and scaled where nothing fixes its
scale, since everything here counts on that. given_frame.json beside the scene holds the matrix in
float64, so that nothing of the model's own coordinates (a map's, say) is lost. Files hold float32,
which keeps a millimetre within ten kilometres: whatever lies farther out gets a whole offset, which
stands beside the file.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.geometry.similarity import move_cameras, move_splats
from radiant_core.io.run_store import read_json, write_json
from radiant_core.numerics import FloatArray, check_array
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats

NAME = "given_frame.json"
GIVEN_CRS = "given"
"""What `radiant export --crs` calls it."""
MAX_EXACT = 1e4
"""Coordinates up to here are left as they are: float32 keeps 1e-3 of their unit."""
STEP = 100.0


@dataclass(frozen=True, kw_only=True, eq=False)
class GivenFrame:
    """The similarity to the frame of `model`, and how far at most a camera centre of the scene is
    from where that has it, in its unit: 0 unless the poses were adjusted."""

    given_from_scene: Sim3
    model: str
    largest_error: float = 0.0
    crs: str | None = None
    """The system that the given frame is, where the model says so."""
    is_default: bool = False
    """Whether files are written in it where no other system is asked for."""
    lowered: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """By how much a file's offset is less than that of the others."""

    @property
    def offset(self) -> FloatArray:
        """What is taken off the coordinates (3,) in files."""
        return offset_of(self.given_from_scene.translation) - self.lowered

    @property
    def file_from_scene(self) -> Sim3:
        """The similarity to the coordinates of files."""
        return replace(self.given_from_scene, translation=self.given_from_scene.translation - self.offset)

    @property
    def is_same(self) -> bool:
        """Whether the scene is in the given frame as it is."""
        move = self.given_from_scene
        return move.scale == 1 and bool((move.rotation == np.eye(3)).all()) and not move.translation.any()

    def apply(self, points: FloatArray) -> FloatArray:
        """File coordinates (P,3) of points (P,3) of the scene."""
        return self.file_from_scene.apply(points)

    def move(self, splats: Splats) -> Splats:
        """The Gaussians in file coordinates."""
        return move_splats(splats, self.file_from_scene)

    def move_scene(self, scene: SfmScene) -> SfmScene:
        """Cameras and points in file coordinates."""
        return replace(scene, cameras=move_cameras(scene.cameras, self.file_from_scene), points=self.apply(scene.points))

    def notes(self) -> tuple[str, ...]:
        """What is said of a scene that is not in the given frame as it is; nothing of another."""
        if self.is_same:
            return ()
        move = self.given_from_scene.inverse()
        turned_deg = np.degrees(np.arccos(np.clip((np.trace(move.rotation) - 1) / 2, -1, 1)))
        adjusted = f", to {self.largest_error:.2g} after the adjustment" if self.largest_error else ""
        turned = [f"turned by {turned_deg:.1f}°"] if turned_deg > 1e-6 else []
        scaled = "in its own unit" if move.scale == 1 else f"scaled by {move.scale:.6g}"
        export = "`radiant export`" if self.is_default else f"`radiant export --crs {GIVEN_CRS}`"
        return (
            f"the scene is {self.model}, {', '.join([*turned, 'moved', scaled])}: {NAME} beside it has the matrix back{adjusted}, and "
            f"{export} writes files in its own coordinates.",
        )

    def comments(self) -> tuple[str, ...]:
        """Lines for the header of a PLY."""
        system = () if self.crs is None else (f"crs {self.crs}",)
        return (f"in the frame of {self.model}", *system, f"offset {' '.join(f'{value:.10g}' for value in self.offset)}")

    def record(self) -> dict[str, Any]:
        """The content of the JSON beside an exported file."""
        return {
            "schema": "radiant.georeference",
            "version": 1,
            "crs": GIVEN_CRS,
            **({} if self.crs is None else {"given_crs": self.crs}),
            "model": self.model,
            "offset": self.offset.tolist(),
            "given_from_scene": matrix_of(self.given_from_scene).tolist(),
        }


def offset_of(place: FloatArray) -> FloatArray:
    """Whole hundreds (3,) below a place (3,) that float32 would lose digits of; else zeros."""
    return np.floor(place / STEP) * STEP if np.abs(place).max() > MAX_EXACT else np.zeros(3)


def matrix_of(move: Sim3) -> FloatArray:
    """A similarity as matrix (4,4)."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = move.scale * move.rotation, move.translation
    return matrix


def shifted_frame(cameras: Cameras, model: str) -> GivenFrame:
    """The frame of given cameras that stay as they are, but for a whole offset where they lie far
    out."""
    return GivenFrame(
        given_from_scene=Sim3(scale=1.0, rotation=np.eye(3), translation=offset_of(np.median(cameras.centers, axis=0))), model=model
    )


def save_given_frame(folder: Path, frame: GivenFrame) -> str:
    """Write given_frame.json beside the scene in `folder`, atomically; its name."""
    write_json(
        folder / NAME,
        {
            "schema": "radiant.given_frame",
            "version": 1,
            "model": frame.model,
            "given_from_scene": matrix_of(frame.given_from_scene).tolist(),
            "largest_error": frame.largest_error,
            **({} if frame.crs is None else {"crs": frame.crs}),
            **({"is_default": True} if frame.is_default else {}),
        },
    )
    return NAME


def load_given_frame(folder: Path) -> GivenFrame | None:
    """The given frame of a run, a training or a scene; None where there is none. BadInput where the
    file holds no similarity."""
    path = next((path for path in (folder / NAME, folder / "sfm" / NAME) if path.is_file()), None)
    if path is None:
        return None
    record = read_json(path, ("model", "given_from_scene", "largest_error"))
    matrix = check_array("given_from_scene", record["given_from_scene"], (4, 4))
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    crs = record.get("crs")
    is_text = isinstance(record["model"], str) and isinstance(crs, str | None)
    if not scale > 0 or not is_text or not isinstance(record["largest_error"], int | float):
        raise BadInput(f"{path} holds no similarity: give the file as it was written.")
    move = Sim3(scale=scale, rotation=matrix[:3, :3] / scale, translation=matrix[:3, 3])
    return GivenFrame(
        given_from_scene=move,
        model=record["model"],
        largest_error=float(record["largest_error"]),
        crs=crs,
        is_default=record.get("is_default") is True,
    )
