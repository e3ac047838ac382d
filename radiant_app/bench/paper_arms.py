"""Arms of `radiant bench paper`: each one way of making the model of a cell, cached with its scores. Once per (cell, arm).

Models and scores are stored in the output folder under the hash of their inputs, so that an
interrupted benchmark resumes, and an arm that several sections show is made once. The bands along
borders are the same for all arms of a cell: surfaces are those of the first cell's centralised model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from radiant_app.bench.method_cells import DEVICE_SPEEDS, BenchScene, Cell, Layout, ModelCache, load_bench_scene
from radiant_app.bench.methods import METHODS, OPAQUE, Made, join_cell
from radiant_app.workers.evaluation import region_width
from radiant_core import __version__
from radiant_core.aggregate.config import AggregateConfig, aggregate_preset
from radiant_core.errors import BadInput
from radiant_core.evaluate.borders import DeviceBorders, EdgeBorders
from radiant_core.evaluate.image_error import psnr_db, ssim
from radiant_core.evaluate.seam_error import SeamMasks, seam_masks
from radiant_core.evaluate.seam_scores import seam_scores
from radiant_core.io.records import load_splats, save_splats
from radiant_core.io.run_store import content_key, read_json, write_json
from radiant_core.numerics import FloatArray
from radiant_core.render.rendered_view import RenderedView, render_views
from radiant_core.train.config import train_preset

MAX_NUM_SPLATS = 200_000
"""Of a device's model."""


@dataclass(frozen=True, kw_only=True)
class Arm:
    """One way of making a model of a cell; `settings` complete its name."""

    name: str
    make: Callable[[Cell], Made]
    settings: AggregateConfig | None = None


def method_arm(name: str) -> Arm:
    """A method of `radiant bench methods`."""
    presets = {"paper": "paper", "ours": "default", "ours edges": "default", "even": "default"}
    return Arm(name=name, make=METHODS[name], settings=aggregate_preset(presets[name]) if name in presets else None)


def epochs_arm(name: str, num_epochs: int) -> Arm:
    """`ours` or `paper` with another number of epochs at both tiers; 0 is the plain cut for both."""
    if num_epochs == 0:
        return method_arm("crop")
    preset = aggregate_preset({"ours": "default", "paper": "paper"}[name])
    if num_epochs == preset.num_epochs:
        return method_arm(name)
    settings = replace(preset, num_epochs=num_epochs)
    return Arm(name=f"{name} {num_epochs} epochs", make=lambda cell: join_cell(cell, settings, cell.plan, cell.devices), settings=settings)


@dataclass(frozen=True, kw_only=True)
class ArmRow:
    """Figures of an arm in a cell: psnr_db and ssim per held-out photograph; band and interior in dB over all borders.

    Band and interior are None where too few pixels show a border. CPU seconds and training pixels
    exclude the devices' trainings.
    """

    scene: str
    cell: str
    arm: str
    seed: int
    psnr_db: tuple[float, ...]
    ssim: tuple[float, ...]
    num_gaussians: int
    cpu_s: float
    training_px: float
    band_db: float | None
    interior_db: float | None
    num_band_images: int

    @property
    def mean_psnr_db(self) -> float:
        """Mean over photographs."""
        return float(np.mean(self.psnr_db))

    @property
    def mean_ssim(self) -> float:
        """Mean over photographs."""
        return float(np.mean(self.ssim))


@dataclass(frozen=True, kw_only=True, eq=False)
class Arms:
    """The scene at one size, the folder of the cache, and the layout whose centralised model gives the surfaces."""

    scene: BenchScene
    out: Path
    num_steps: int
    """Of a device's training."""
    layout: Layout

    def cell(self, layout: Layout, seed: int = 0, speeds: tuple[float, ...] = DEVICE_SPEEDS) -> Cell:
        """The scene dealt to a layout."""
        train = train_preset("draft")
        train = replace(train, long_side_px=self.scene.long_side_px, num_steps=self.num_steps, max_num_splats=MAX_NUM_SPLATS)
        cache = ModelCache(folder=self.out / "models")
        return Cell(scene=self.scene, layout=layout, placement=0, seed=seed, train=train, cache=cache, speeds=speeds)

    def row(self, cell: Cell, arm: Arm) -> ArmRow:
        """The arm's figures, from the cache where it has them."""
        model, record = self._files(cell, arm)
        if model.is_file() and record.is_file():
            fields = read_json(record)
            return ArmRow(**{**fields, "psnr_db": tuple(fields["psnr_db"]), "ssim": tuple(fields["ssim"])})
        made = arm.make(cell)
        row = self._scored(cell, arm, made)
        model.parent.mkdir(parents=True, exist_ok=True)
        save_splats(model, made.splats)
        write_json(record, asdict(row))
        return row

    def views(self, cell: Cell, arm: Arm) -> list[RenderedView]:
        """The arm's model at the held-out cameras."""
        self.row(cell, arm)
        return list(render_views(load_splats(self._files(cell, arm)[0]), self.scene.held_out_views.cameras))

    @cached_property
    def photographs(self) -> list[FloatArray]:
        """The held-out photographs, (H,W,3) in 0..1."""
        return [image / 255 for image in self.scene.held_out_views.images]

    def masks(self, cell: Cell) -> SeamMasks:
        """Pixels near the borders of a cell's devices and edges, per held-out photograph."""
        plan, edge_plans = cell.plan
        borders = [EdgeBorders(plan=plan), DeviceBorders(plan=plan, edge_plans=edge_plans)]
        return seam_masks(self.scene.held_out_views.cameras, self._depths_m, borders, region_width(plan.sites))

    @cached_property
    def _depths_m(self) -> list[NDArray[np.floating]]:
        views = render_views(self.cell(self.layout).centralised.splats, self.scene.held_out_views.cameras)
        return [np.where(view.alpha >= OPAQUE, view.depth, 0) for view in views]

    def _scored(self, cell: Cell, arm: Arm, made: Made) -> ArmRow:
        images = [view.image for view in render_views(made.splats, self.scene.held_out_views.cameras)]
        pairs = list(zip(images, self.photographs, strict=True))
        error = seam_scores(images, self.photographs, self.masks(cell)).error()
        return ArmRow(
            scene=self.scene.name,
            cell=cell.name,
            arm=arm.name,
            seed=cell.seed,
            psnr_db=tuple(psnr_db(image, photograph) for image, photograph in pairs),
            ssim=tuple(ssim(image, photograph) for image, photograph in pairs),
            num_gaussians=len(made.splats),
            cpu_s=made.cpu_s,
            training_px=made.training_px,
            band_db=error.seam_psnr_db,
            interior_db=error.interior_psnr_db,
            num_band_images=error.num_band_images,
        )

    def _files(self, cell: Cell, arm: Arm) -> tuple[Path, Path]:
        cameras = self.scene.training.cameras
        seen = {"names": cameras.names, "poses": cameras.cam_from_world, "held_out": self.scene.held_out.cameras.names}
        settings: dict[str, Any] = {"cell": cell.name, "arm": arm.name, "train": asdict(cell.train)}
        key = content_key(__version__, {**settings, "join": asdict(arm.settings) if arm.settings else None, **seen})[:16]
        stem = f"{cell.name}-{arm.name.replace(' ', '_')}-{key}"
        return self.out / "joined" / f"{stem}.safetensors", self.out / "joined" / f"{stem}.json"


def load_arms(scene: Path, out: Path, layout: Layout, long_side_px: int, num_steps: int) -> Arms:
    """Arms of a scene; BadInput where it has too few photographs or `out` is a file."""
    if out.exists() and not out.is_dir():
        raise BadInput(f"{out} is a file: name a folder for the page, its pictures and the models.")
    return Arms(scene=load_bench_scene(scene, long_side_px), out=out, num_steps=num_steps, layout=layout)
