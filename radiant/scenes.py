"""Scenes: photographs with their cameras and sparse points, of structure from motion."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from radiant_app.commands.run.steps import reconstruct_into
from radiant_app.events import Listener
from radiant_app.workers.sources import captures_of, is_held_out, load_scored_scene, masks_folder_of, sfm_task
from radiant_core.cameras import Cameras
from radiant_core.evaluate.split import held_out_mask
from radiant_core.light.captures import Captures
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_core.sfm.config import SfmConfig
from radiant_core.sfm.world_frame.placement import Placement
from radiant_core.train.photographs import load_training_views
from radiant_core.train.views import TrainingViews

Part = Literal["training", "held_out", "all"]
"""held_out: every eighth photograph by name, which no model is trained on; training: the others."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """Photographs with poses and sparse points. `load_scene` and `reconstruct` make it.

    Example:
        >>> scene = radiant.load_scene("SCENE")
        >>> views = scene.views("held_out", long_side_px=64)
        >>> views.images[0].shape
        (48, 64, 3)
    """

    sfm: SfmScene
    """Cameras, points and which camera sees which point."""
    images: Path
    """Folder of the undistorted photographs."""
    masks: Path | None = None
    """Folder of their masks."""
    captures: Captures = field(default_factory=dict)
    """When they were taken and how exposed, by EXIF."""
    held_out: frozenset[str] | None = None
    """Names of photographs that no model is trained on; None: every eighth by name."""
    notes: tuple[str, ...] = ()
    """Sentences about photographs that were left out."""

    def __repr__(self) -> str:
        held_out = len(self.indices("held_out"))
        unit = "m" if self.sfm.frame.kind == "metric" else "units without a scale"
        return f"Scene({len(self.cameras)} photographs, {held_out} held out, {len(self.points):,} points, {unit})"

    @property
    def cameras(self) -> Cameras:
        """All cameras (C), undistorted."""
        return self.sfm.cameras

    @property
    def points(self) -> FloatArray:
        """Sparse points (P,3)."""
        return self.sfm.points

    @property
    def colors(self) -> NDArray[np.uint8]:
        """Of the points (P,3)."""
        return self.sfm.colors

    def indices(self, part: Part = "all") -> NDArray[np.int64]:
        """Rows (K,) of `cameras` that belong to a part."""
        names = self.cameras.names
        held_out = held_out_mask(names) if self.held_out is None else np.isin(names, sorted(self.held_out))
        return np.flatnonzero({"training": ~held_out, "held_out": held_out, "all": np.ones(len(held_out), bool)}[part])

    def views(self, part: Part | NDArray[np.int64] = "training", long_side_px: int = 576) -> TrainingViews:
        """The photographs of a part, or of rows (K,) of `cameras`, 8 bits, reduced to
        `long_side_px`, with their cameras at that size: `.images[i]` is (H,W,3). BadInput for one
        that is missing or of another size."""
        rows = self.indices(part) if isinstance(part, str) else part
        cameras = self.cameras.select(rows).scaled(long_side_px)
        return load_training_views(self.images, cameras, self.masks)


def load_scene(folder: str | Path) -> Scene:
    """Load the scene in a folder of `radiant sfm`, `radiant train` or `radiant run`.

    Use it for all that comes after structure from motion: training, scoring, planning.

    Args:
        folder: the folder of such a command; `reconstruct` makes one of photographs.

    Returns:
        The scene without photographs that repeat others, which `notes` name.

    Raises:
        BadInput: the folder holds no scene.

    Example:
        >>> scene = radiant.load_scene("SCENE")
        >>> len(scene.indices("training")), len(scene.indices("held_out"))
        (10, 2)
    """
    folder = Path(folder)
    scene, notes, images = load_scored_scene(folder)
    names = scene.cameras.names
    held_out = frozenset(name for name, apart in zip(names, is_held_out(folder, names), strict=True) if apart)
    return Scene(sfm=scene, images=images, masks=masks_folder_of(folder), captures=captures_of(folder), held_out=held_out, notes=notes)


def reconstruct(
    photographs: str | Path,
    out: str | Path,
    listen: Listener = lambda event: None,
    *,
    masks: str | Path | None = None,
    poses: str | Path | None = None,
) -> Scene:
    """Find poses and sparse points of photographs by structure from motion, as `radiant sfm`.

    Use it once per set of photographs, minutes of which `load_scene` saves afterwards.

    Args:
        photographs: a folder of photographs, with an alignment or without, a COLMAP project or a
            Mill 19 folder.
        out: a new or empty folder, which gets the scene.
        listen: hears progress and warnings, such as `progress()`.
        masks: a folder of masks, photograph.jpg.png or photograph.png, 0 is ignored; without it
            masks/ beside the photographs, if its names are theirs.
        poses: the alignment to use: a COLMAP model's folder or another program's file.

    Returns:
        The scene, which `load_scene(out)` loads again.

    Raises:
        BadInput: photographs that cannot be used, in one sentence.
        StageFailed: too few photographs overlap.

    Example:
        >>> with radiant.progress() as listen:  # doctest: +SKIP
        ...     scene = radiant.reconstruct("PHOTOGRAPHS", "NEW_SCENE", listen)
        >>> result = radiant.train(scene)  # doctest: +SKIP
    """
    out = Path(out)
    paths = [None if path is None else Path(path) for path in (masks, poses)]
    reconstruct_into(out, sfm_task(Path(photographs), SfmConfig(), paths[0], Placement(), paths[1]), listen)
    return load_scene(out)
