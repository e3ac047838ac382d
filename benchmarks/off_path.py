"""Views that no photograph was taken from, and how a model looks there. Once per benchmark.

`sample_scenes/generate.py --off-path N` writes such a folder: images/, depth/ and a COLMAP model of
the views, and known/, the flown cameras. The known cameras' centres, matched by name, give the
similarity from the folder's frame to the scene's; views and depths are moved by it. A scene whose
cameras do not lie where the known ones do is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.haze import haze_mask, haze_share
from benchmarks.metric import Direction, Metric
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.image_error import image_errors
from radiant_core.frames import Sim3
from radiant_core.geometry.align import compare_centers
from radiant_core.io.colmap.model import read_model
from radiant_core.io.run_store import content_key
from radiant_core.numerics import FloatArray
from radiant_core.render.rendered_view import render_views
from radiant_core.sfm.world_frame.world import cameras_of
from radiant_core.splats import Splats
from radiant_core.train.photographs import load_images

MAX_CENTER_PERCENT = 1.0
"""Largest error of a camera's centre, of the extent of the flight; the town has 0.02."""
MAX_ROTATION_DEG = 1.0
MIN_VIEWS = 2
"""A surface that fewer flown photographs see is none that a model could know."""


@dataclass(frozen=True, kw_only=True)
class OffPathFigures:
    """Figures of a model per view, in the order of the views' names."""

    names: tuple[str, ...]
    psnr_db: tuple[float, ...]
    psnr_cc_db: tuple[float, ...]
    flip: tuple[float | None, ...]
    haze: tuple[float | None, ...]
    """Share of pixels with haze, of those that show a surface."""
    haze_seen: tuple[float | None, ...]
    """The same of the pixels whose surface two or more flown photographs see."""

    def of_kind(self, kind: str) -> OffPathFigures:
        """Of the views whose names begin with `kind`."""
        rows = [row for row, name in enumerate(self.names) if name.startswith(kind)]
        return OffPathFigures(**{field.name: tuple(getattr(self, field.name)[row] for row in rows) for field in fields(self)})

    @property
    def kinds(self) -> tuple[str, ...]:
        """What the names begin with, up to the first underscore."""
        return tuple(sorted({name.partition("_")[0] for name in self.names}))

    def mean(self, figure: str) -> float | None:
        """Mean over the views that have the figure; None where none has it."""
        values = [value for value in getattr(self, figure) if value is not None]
        return float(np.mean(values)) if values else None


def figures_of(record: dict[str, Any] | None) -> OffPathFigures | None:
    """The figures of a record as `asdict` made it; None for none."""
    return None if record is None else OffPathFigures(**{name: tuple(values) for name, values in record.items()})


@dataclass(frozen=True, kw_only=True, eq=False)
class OffPath:
    """Views of a folder in the frame of a scene, at the size of the benchmark."""

    folder: Path
    cameras: Cameras
    """In the frame of the scene."""
    scene_from_folder: Sim3
    center_percent: float
    """Largest distance of a camera's centre from the known one, in percent of the extent."""
    rotation_deg: float
    """Largest angle between a camera and the known one."""
    key: str
    """Hash of all that decides the figures."""

    @cached_property
    def photographs(self) -> list[FloatArray]:
        """The true pictures (H,W,3) in 0..1."""
        return [image / 255 for image in load_images(self.folder / "images", self.cameras)]

    @cached_property
    def truths(self) -> list[tuple[FloatArray, NDArray[np.bool_]]]:
        """Per view the true depth (H,W) in the scene's unit, infinite in the sky, and where two or
        more flown photographs see the surface."""
        pairs = zip(self.cameras.names, self.cameras.sizes_wh, strict=True)
        return [_load_truth(self.folder / "depth" / f"{Path(name).stem}.npz", size, self.scene_from_folder.scale) for name, size in pairs]

    def score(self, splats: Splats) -> OffPathFigures:
        """The figures of a model in the frame of the scene."""
        errors, shares = [], []
        for view, photograph, (depth, is_seen) in zip(render_views(splats, self.cameras), self.photographs, self.truths, strict=True):
            errors.append(image_errors(view.name, view.image, photograph))
            haze = haze_mask(view.alpha, view.depth, depth)
            shares.append((haze_share(haze, depth), haze_share(haze, depth, is_seen)))
        return OffPathFigures(
            names=self.cameras.names,
            psnr_db=tuple(error.psnr_db for error in errors),
            psnr_cc_db=tuple(error.psnr_cc_db for error in errors),
            flip=tuple(error.flip for error in errors),
            haze=tuple(share for share, _ in shares),
            haze_seen=tuple(share for _, share in shares),
        )


def load_off_path(folder: Path, cameras: Cameras, long_side_px: int) -> OffPath:
    """The views of `folder` for a scene with these cameras, at most `long_side_px` wide.

    Raises BadInput where the folder lacks a part, fewer than three of its known cameras are in the
    scene, or the scene's lie elsewhere than the known ones.
    """
    if not (folder / "known").is_dir():
        raise BadInput(f"{folder} holds no known/: give the folder off_path that sample_scenes/generate.py --off-path writes.")
    known_cameras, views = cameras_of(read_model(folder / "known")), cameras_of(read_model(folder))
    shared = sorted(set(known_cameras.names) & set(cameras.names))
    if len(shared) < 3 or not len(views):
        raise BadInput(f"{folder} has {len(views)} views and shares {len(shared)} cameras with the scene, expected 1 and 3 or more.")
    known_cameras, scene_cameras = known_cameras.named(shared), cameras.named(shared)
    fit = compare_centers(scene_cameras.centers, known_cameras.centers)
    scene_from_folder = fit.reference_from_scene.inverse()
    rotation_deg = largest_turn_deg(scene_from_folder.apply_to_poses(known_cameras.cam_from_world), scene_cameras.cam_from_world)
    if not (fit.max_percent <= MAX_CENTER_PERCENT and rotation_deg <= MAX_ROTATION_DEG):
        raise BadInput(
            f"the scene's cameras lie up to {fit.max_percent:.2f} % of the flight's extent and {rotation_deg:.2f}° off those of "
            f"{folder / 'known'}, at most {MAX_CENTER_PERCENT:g} % and {MAX_ROTATION_DEG:g}° allow a comparison: check the scene's poses."
        )
    moved = Cameras(
        names=views.names, Ks=views.Ks, cam_from_world=scene_from_folder.apply_to_poses(views.cam_from_world), sizes_wh=views.sizes_wh
    ).scaled(long_side_px)
    return OffPath(
        folder=folder,
        cameras=moved,
        scene_from_folder=scene_from_folder,
        center_percent=fit.max_percent,
        rotation_deg=rotation_deg,
        key=content_key(folder, long_side_px),
    )


def largest_turn_deg(poses: FloatArray, others: FloatArray) -> float:
    """Largest angle in degrees between poses (C,4,4) and others (C,4,4) of the same cameras."""
    turns = np.einsum("cij,ckj->cik", poses[:, :3, :3], others[:, :3, :3])
    # By the sine as well: the cosine alone knows no angle below 1e-8.
    skew = turns - turns.transpose(0, 2, 1)
    sines = np.linalg.norm(skew[:, [2, 0, 1], [1, 2, 0]], axis=1)
    return float(np.degrees(np.arctan2(sines, np.trace(turns, axis1=1, axis2=2) - 1)).max())


def off_path_metrics(key: str, figures: Sequence[OffPathFigures]) -> list[Metric]:
    """Means over views and models, of all views and of each kind."""
    units: dict[str, tuple[str, Direction]] = {
        "psnr_db": ("dB", "higher"),
        "psnr_cc_db": ("dB", "higher"),
        "flip": ("1", "lower"),
        "haze": ("1", "lower"),
        "haze_seen": ("1", "lower"),
    }
    metrics = []
    for kind in ("", *figures[0].kinds):
        of_kind = [one.of_kind(kind) for one in figures]
        for name, (unit, direction) in units.items():
            means = [mean for one in of_kind if (mean := one.mean(name)) is not None]
            if means:
                label = f"{key}.off_path.{kind}.{name}" if kind else f"{key}.off_path.{name}"
                metrics.append(Metric(key=label, value=float(np.mean(means)), unit=unit, direction=direction))
    return metrics


def _load_truth(path: Path, size_wh: NDArray[np.int64], scale: float) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Depth (H,W) and where it is seen, of the pixel under the middle of each smaller one."""
    try:
        with np.load(path) as arrays:
            depth, num_views = arrays["depth_m"].astype(np.float64), arrays["num_views"]
    except (OSError, ValueError, KeyError) as error:
        raise BadInput(f"{path} holds no depth_m and num_views ({error}): write the folder anew.") from error
    rows, columns = (
        ((np.arange(small) + 0.5) * (large / small)).astype(np.int64) for small, large in zip(size_wh[::-1], depth.shape, strict=True)
    )
    return scale * depth[np.ix_(rows, columns)], num_views[np.ix_(rows, columns)] >= MIN_VIEWS
