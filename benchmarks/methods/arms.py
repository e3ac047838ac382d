"""Arms of `radiant bench methods` and `paper`: each one way of making the model of a cell.

Models and scores are stored in the output folder under the hash of their inputs: an interrupted
benchmark resumes, and an arm that several sections show is made once per cell. The bands along
borders are the same for all arms: surfaces are those of the first cell's centralised model.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.methods.cells import DEVICE_SPEEDS, BenchScene, Cell, Layout, ModelCache, deal_cell, deal_system, load_bench_scene, run_cell
from benchmarks.methods.device_borders import DeviceBorders
from benchmarks.methods.emulated_latency import NodeWork
from benchmarks.methods.group_latency import GroupWork, LinkTime, scene_times
from benchmarks.methods.seam_error import SeamMasks, band_and_interior_psnr_db, region_width, seam_masks
from benchmarks.off_path import OffPath, OffPathFigures, figures_of, load_off_path
from benchmarks.options import HeldPart
from radiant_core import __version__
from radiant_core.cameras import Cameras, concatenate_cameras
from radiant_core.choices import CutBy
from radiant_core.errors import BadInput
from radiant_core.evaluate.borders import EdgeBorders
from radiant_core.evaluate.color_correction import correct_colors
from radiant_core.evaluate.image_error import flip, psnr_db, ssim
from radiant_core.evaluate.lpips import Lpips
from radiant_core.evaluate.shown_pixels import count_shown_pixels
from radiant_core.hierarchy.messages import DeviceSettings
from radiant_core.hierarchy.recipe import Recipe
from radiant_core.hierarchy.refining_plan import choose_rounds
from radiant_core.io.array_file import load_arrays, save_arrays
from radiant_core.io.records import load_splats, save_splats
from radiant_core.io.run_store import content_key, read_json, write_json
from radiant_core.light.canonical import light_of_score, show_in_light
from radiant_core.numerics import FloatArray
from radiant_core.plan.system import System
from radiant_core.render.contract import Backend
from radiant_core.render.rendered_view import RenderedView, render_views
from radiant_core.splats import Splats

VIEWS_SCHEMA = "radiant.held_out_pictures"
OPAQUE = 0.5
"""Pixels that the centralised model covers less have no ground."""


@dataclass(frozen=True, kw_only=True)
class Round:
    """What a round of federated learning sent up, and how good the server's model was after it."""

    sent_bytes: int
    psnr_db: float | None = None


@dataclass(frozen=True, kw_only=True)
class ArmModel:
    """What an arm made of a cell, and its work beside the device models."""

    splats: Splats | None = None
    """None for what is no Gaussians: then `images` are given."""
    images: tuple[FloatArray, ...] = ()
    """(H,W,3) in 0..1, of the held-out cameras."""
    num_parameters: int = 0
    """Of what is no Gaussians."""
    cpu_s: float
    training_px: float
    nodes: tuple[NodeWork, ...] = ()
    """The work of each node, the devices' among it, where nodes made it."""
    rounds: tuple[Round, ...] = ()
    """Of federated learning."""
    groups: Mapping[str, GroupWork] = field(default_factory=dict)
    """By root, the work of devices that trained as one model."""
    times: tuple[LinkTime, ...] = ()
    """Where they are known without the work."""


@dataclass(frozen=True, kw_only=True)
class Arm:
    """One way of making a model of a cell by a recipe."""

    name: str
    make: Callable[[Cell, Recipe], ArmModel]
    recipe: Callable[[Cell], Recipe] = lambda cell: cell.recipe
    settings: Any = None
    """What decides the model beside the recipe; part of its key in the cache."""
    of_gaussians: bool = True
    """False: the model is a field, of which the held-out pictures are kept."""


@dataclass(frozen=True, kw_only=True)
class ArmRow:
    """Figures of an arm in a cell: psnr_db and ssim per held-out photograph, psnr_cc_db after an
    affine correction of a render's colours to the photograph's; band and interior where enough
    pixels show a border. CPU seconds and pixels exclude the devices' trainings."""

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
    nodes: tuple[NodeWork, ...] = ()
    off_path: OffPathFigures | None = None
    """At views that were never flown, where there are some."""
    flip: tuple[float | None, ...] = ()
    """Per held-out photograph; empty in rows that were kept before it was measured."""
    psnr_cc_db: tuple[float, ...] = ()
    """As flip."""
    num_parameters: int = 0
    """Of a field, which has no Gaussians."""
    rounds: tuple[Round, ...] = ()
    """Of federated learning."""
    times: tuple[LinkTime, ...] = ()
    """When the scene was done over links, where nodes made it."""

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
    """The folder of the cache, and the cell whose centralised model gives the surfaces."""

    out: Path
    first: Cell
    off_path: OffPath | None = None
    """Views that were never flown, at which every row is scored as well."""
    field_steps: int = 1_000
    """Of a radiance field, in the paper's main table."""
    lpips: Lpips | None = None
    """Scores LPIPS there; None: it is not measured."""

    @property
    def scene(self) -> BenchScene:
        """That of all cells."""
        return self.first.scene

    @property
    def layout(self) -> Layout:
        """That of the first cell."""
        return self.first.layout

    @property
    def num_steps(self) -> int:
        """Of a device's training."""
        return self.first.recipe.train.num_steps

    def seen_from(self, off_path: Path) -> Arms:
        """Also scored at the views of that folder; BadInput where they do not fit the scene."""
        cameras = concatenate_cameras([self.scene.training.cameras, self.scene.held_out.cameras])
        return replace(self, off_path=load_off_path(off_path, cameras, self.scene.long_side_px))

    def cell(self, layout: Layout, seed: int = 0, speeds: tuple[float, ...] = DEVICE_SPEEDS, placement: int = 0) -> Cell:
        """The scene dealt to a layout, with the first cell's settings but for the seed."""
        return deal_cell(self.scene, self.first.cache, self._settings(seed), layout, placement, speeds)

    def system_cell(self, system: System, name: str, seed: int = 0) -> Cell:
        """The same for a system, under its name."""
        return deal_system(self.scene, self.first.cache, self._settings(seed), system, f"{self.scene.name}-{name}-s{seed}")

    def _settings(self, seed: int) -> DeviceSettings:
        recipe = self.first.recipe
        return DeviceSettings(train=replace(recipe.train, seed=seed), backend=recipe.backend, upload=recipe.upload)

    def row(self, cell: Cell, arm: Arm, max_gaussians: int | None = None) -> ArmRow:
        """The arm's figures, cached; of its Gaussians reduced to `max_gaussians`, where given."""
        row = self._row(cell, arm, max_gaussians if arm.of_gaussians else None)
        return (
            row
            if self.off_path is None or not arm.of_gaussians
            else replace(row, off_path=self._off_path_figures(self.off_path, cell, arm, max_gaussians))
        )

    def _off_path_figures(self, views: OffPath, cell: Cell, arm: Arm, max_gaussians: int | None) -> OffPathFigures:
        """The figures at views off the path, cached apart from the others."""
        model = self.model_file(cell, arm)
        reduced = "" if max_gaussians is None else f".{max_gaussians}"
        record = model.with_suffix(f"{reduced}.off_path-{views.key[:16]}.json")
        if record.is_file() and (stored := figures_of(read_json(record))) is not None:
            return stored
        splats = load_splats(model)
        figures = views.score(splats if max_gaussians is None else select_strongest(splats, self.scene.views.cameras, max_gaussians))
        write_json(record, asdict(figures))
        return figures

    def _row(self, cell: Cell, arm: Arm, max_gaussians: int | None) -> ArmRow:
        model = self.model_file(cell, arm)
        record = model.with_suffix(".json" if max_gaussians is None else f".{max_gaussians}.json")
        if model.is_file() and record.is_file():
            row = _row_of(read_json(record))
            return row if row.times else replace(row, times=scene_times(cell.recipe.system, row.nodes, {}))
        if max_gaussians is None:
            arm_model = arm.make(cell, arm.recipe(cell))
            model.parent.mkdir(parents=True, exist_ok=True)
            if arm_model.splats is not None:
                save_splats(model, arm_model.splats)
            else:
                save_arrays(model, VIEWS_SCHEMA, {f"{i:04d}": _in_bytes(image) for i, image in enumerate(arm_model.images)}, {})
        else:
            whole = self._row(cell, arm, None)
            splats = select_strongest(load_splats(model), self.scene.views.cameras, max_gaussians)
            arm_model = ArmModel(splats=splats, cpu_s=whole.cpu_s, training_px=whole.training_px, nodes=whole.nodes, times=whole.times)
        row = self._score(cell, arm, arm_model)
        write_json(record, {name: value for name, value in asdict(row).items() if name != "off_path"})
        return row

    def views(self, cell: Cell, arm: Arm) -> list[RenderedView]:
        """The arm's Gaussians at the held-out cameras."""
        self.row(cell, arm)
        return self._renders(load_splats(self.model_file(cell, arm)), cell)

    def images(self, cell: Cell, arm: Arm) -> list[FloatArray]:
        """The arm's pictures (H,W,3) in 0..1 of the held-out cameras, of a field in 8 bits."""
        if arm.of_gaussians:
            return [view.image.astype(np.float64) for view in self.views(cell, arm)]
        self.row(cell, arm)
        arrays, _ = load_arrays(self.model_file(cell, arm), VIEWS_SCHEMA, None)
        return [arrays[name] / 255 for name in sorted(arrays)]

    def _renders(self, splats: Splats, cell: Cell) -> list[RenderedView]:
        """A model at the held-out cameras, in the light that is predicted of the photographs."""
        scene, cameras = self.scene, self.scene.held_out_views.cameras
        views = list(render_views(splats, cameras))
        if (light := light_of_score(splats, scene.views, cameras, scene.captures, cell.recipe.train.light)) is None:
            return views
        numbered = enumerate(views)
        return [replace(view, image=show_in_light(view.image, light.held_out, index, cameras)) for index, view in numbered]

    @cached_property
    def photographs(self) -> list[FloatArray]:
        """The held-out photographs, (H,W,3) in 0..1."""
        return [image / 255 for image in self.scene.held_out_views.images]

    def masks(self, cell: Cell) -> SeamMasks:
        """Pixels near the borders of a cell's devices and edges, per held-out photograph."""
        plan = cell.recipe.cloud_plan
        borders = [EdgeBorders(plan=plan), DeviceBorders(plan=plan, edge_plans=cell.recipe.edge_plans)]
        return seam_masks(self.scene.held_out_views.cameras, self._depths_m, borders, region_width(plan.sites))

    @cached_property
    def _depths_m(self) -> list[NDArray[np.floating]]:
        views = render_views(self.first.centralised_model.splats, self.scene.held_out_views.cameras)
        return [np.where(view.alpha >= OPAQUE, view.depth, 0) for view in views]

    def _score(self, cell: Cell, arm: Arm, model: ArmModel) -> ArmRow:
        images = list(model.images) if model.splats is None else [view.image for view in self._renders(model.splats, cell)]
        pairs = list(zip(images, self.photographs, strict=True))
        error = band_and_interior_psnr_db(images, self.photographs, self.masks(cell))
        return ArmRow(
            scene=self.scene.name,
            cell=cell.name,
            arm=arm.name,
            seed=cell.recipe.train.seed,
            psnr_db=tuple(psnr_db(image, photograph) for image, photograph in pairs),
            ssim=tuple(ssim(image, photograph) for image, photograph in pairs),
            flip=tuple(flip(image, photograph) for image, photograph in pairs),
            psnr_cc_db=tuple(psnr_db(correct_colors(image, photograph), photograph) for image, photograph in pairs),
            num_gaussians=0 if model.splats is None else len(model.splats),
            cpu_s=model.cpu_s,
            training_px=model.training_px,
            band_db=error.seam_psnr_db,
            interior_db=error.interior_psnr_db,
            num_band_images=error.num_band_images,
            nodes=model.nodes,
            times=model.times or scene_times(cell.recipe.system, model.nodes, model.groups),
            num_parameters=model.num_parameters,
            rounds=model.rounds,
        )

    def model_file(self, cell: Cell, arm: Arm) -> Path:
        """Where an arm's model is kept, or the pictures of its field."""
        recipe = arm.recipe(cell)
        # What the settings leave to the product is what it does today.
        schedule = (recipe.joining, choose_rounds(recipe))
        decides = (recipe, *schedule, *(() if arm.settings is None else (arm.settings,)))
        key = content_key(__version__, arm.name, *decides, self.scene.training, self.scene.held_out.cameras)[:16]
        return self.out / "joined" / f"{cell.name}-{arm.name.replace(' ', '_')}-{key}.safetensors"


def _row_of(record: dict[str, Any]) -> ArmRow:
    nodes = tuple(NodeWork(**node) for node in record.get("nodes", ()))
    rounds = tuple(Round(**one) for one in record.get("rounds", ()))
    figures = {name: tuple(record.get(name, ())) for name in ("psnr_db", "ssim", "flip", "psnr_cc_db")}
    times = tuple(LinkTime(**one) for one in record.get("times", ()))
    return ArmRow(**{**record, **figures, "nodes": nodes, "rounds": rounds, "times": times})


def _in_bytes(image: FloatArray) -> NDArray[np.uint8]:
    return np.rint(255 * np.clip(image, 0, 1)).astype(np.uint8)


def load_arms(
    scene: Path, out: Path, layout: Layout | None, settings: DeviceSettings, cut_by: CutBy = "auto", part: HeldPart = "interleaved"
) -> Arms:
    """Arms of a scene dealt to a layout or, without one, of a run under its own plan and settings;
    BadInput where the scene has too few photographs or is not of a run, or `out` is a file."""
    if out.exists() and not out.is_dir():
        raise BadInput(f"{out} is a file: name a folder for the page, its pictures and the models.")
    cache = ModelCache(folder=out / "models")
    if layout is None:
        first = run_cell(scene, cache)
    else:
        first = deal_cell(load_bench_scene(scene, settings.train.long_side_px, cut_by, part), cache, settings, layout)
    return Arms(out=out, first=first)


def select_strongest(splats: Splats, cameras: Cameras, count: int, backend: Backend = "auto") -> Splats:
    """The `count` Gaussians that show most to the cameras, in their order; the model if smaller."""
    if count < 1:
        raise BadInput(f"{count} Gaussians are to be left, expected at least 1.")
    if len(splats) <= count:
        return splats
    return splats.select(np.sort(np.argsort(-count_shown_pixels(splats, cameras, backend), kind="stable")[:count]))
