"""`Subject`: what a window shows, a run, a plan or a PLY, as layers. Built once per window."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.geometry.cleaning import Surroundings
from radiant_core.io.model_reader import model_kind
from radiant_core.numerics import FloatArray
from radiant_core.scene import SfmScene
from radiant_viewer.editing.tools.plan_layers import add_planning_layers
from radiant_viewer.layers.layer import Layer, framing_positions
from radiant_viewer.layers.ortho_layer import ortho_layer
from radiant_viewer.layers.splat_layer import splat_layer
from radiant_viewer.runs.cleaned_model import CleanedModel, surroundings
from radiant_viewer.runs.cleaning_session import CleaningSession
from radiant_viewer.runs.ground_map import GroundMap
from radiant_viewer.runs.model_file import load_model
from radiant_viewer.runs.plan_view import load_plan_view
from radiant_viewer.runs.run_layers import ground_height, layer_of_known, run_layers
from radiant_viewer.runs.run_view import FileStamps, RunView, file_stamps, load_run_view
from radiant_viewer.runs.shown_model import framed_box, framed_positions
from radiant_viewer.runs.words import counted


@dataclass(frozen=True, kw_only=True, eq=False)
class Subject:
    """layers in drawing order; model and run if any; unit of the world; ground: height of the
    regions."""

    path: Path
    layers: tuple[Layer, ...]
    model: CleanedModel | None
    run: RunView | None
    unit: str
    ground: float
    summary: str
    box: FloatArray | None = None
    """Where the scene is (2,3): what of the model lies around it is hidden at first; None where
    nothing says so, as of a model alone."""
    framed: FloatArray | None = None
    """Places (K,3) that frame the scene; None where all layers do."""
    stamps: FileStamps = ()
    """Stamps of the files before they were read."""

    @property
    def framing(self) -> FloatArray:
        """Places (K,3) that a view of all frames: the scene, or all layers where nothing says where
        it is."""
        return framing_positions(self.layers) if self.framed is None else self.framed

    @cached_property
    def _ground_map(self) -> GroundMap | None:
        points = self.run.scene.points if self.run is not None and len(self.run.scene.points) else None
        if points is None and self.model is not None:
            points = self.model.splats.means.astype(np.float64)
        return None if points is None else GroundMap.of(points)

    def ground_under(self, place: FloatArray) -> float | None:
        """Height of the ground under a place (3,), where points say it."""
        return None if self._ground_map is None else self._ground_map.under(place)

    def cleaning_session(self) -> CleaningSession | None:
        """The cleaning of the model; None without one."""
        if self.model is None:
            return None
        if self.run is None:
            return CleaningSession(self.path, self.model, Surroundings())
        around = surroundings(self.run.folder, self.run.scene, self.run.cloud_plan, len(self.model.whole))
        return CleaningSession(self.path, self.model, around)


def load_subject(path: Path, scene: SfmScene | None = None) -> Subject:
    """Read a run folder, a model file, or a plan, of `scene` where it has no waypoints; BadInput or
    StoreDamaged where that fails."""
    stamps = file_stamps(path)
    return replace(_load_subject(path, scene), stamps=stamps)


def _load_subject(path: Path, scene: SfmScene | None) -> Subject:
    if not path.is_dir() and model_kind(path) is not None:
        model = load_model(path)
        splats = model.splats
        if not len(splats):
            raise BadInput(f"{path} holds no Gaussian: there is nothing to show.")
        summary = f"{len(splats):,} Gaussians, spherical harmonics of degree {splats.sh_degree}"
        summary += "".join(f".   {note.rstrip('.')}" for note in model.notes)
        # A model alone has no unit.
        layers = (splat_layer(splats),)
        return Subject(path=path, layers=layers, model=model, run=None, unit="units", ground=0.0, summary=summary)
    if path.suffix.lower() == ".json" and not path.is_dir():
        return run_subject(load_plan_view(path, scene))
    return run_subject(load_run_view(path, with_files=True, growing=True))


def run_subject(run: RunView) -> Subject:
    """Return a run with all its layers."""
    roles = run.roles
    model = "no model yet" if run.splats is None else f"{len(run.splats):,} Gaussians"
    if run.is_growing:
        model += " so far: the run is at work"
    dealt = f"{counted(len(roles.edge_ids), 'region')}, {counted(len(roles.device_ids), 'device')}"
    if run.kind != "run":
        dealt = f"{len(run.scene.points):,} points"
    ground, below = _below(run)
    layers = add_planning_layers(run, run_layers(run)) if run.kind == "run" else run_layers(run)
    return Subject(
        path=run.folder,
        layers=(*ground, *layers),
        model=run.model,
        run=run,
        unit=run.unit,
        ground=ground_height(run.scene),
        # Without a model there is nothing around it, and the layers are all there is to frame.
        box=None if run.splats is None else framed_box(run.scene, run.cloud_plan),
        framed=None if run.splats is None else framed_positions(run.scene, run.cloud_plan),
        summary=f"{counted(len(run.scene.cameras), 'camera')}, {dealt}, {model}{below}{layer_of_known(run)[1]}",
    )


def _below(run: RunView) -> tuple[list[Layer], str]:
    """The orthophoto, if the run has one, and why it cannot be shown."""
    try:
        layer = ortho_layer(run.folder, run.scene.frame, ground_height(run.scene))
    except BadInput as error:
        return [], f".   {error}"
    return ([] if layer is None else [layer]), ""
