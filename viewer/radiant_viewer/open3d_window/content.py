"""`Content`: what Open3D's window or picture shows of a run, a plan or a model. Built once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_core.splats import Splats
from radiant_viewer.layers.layer import Layer, framing_positions
from radiant_viewer.open3d_window.parts import Part, layer_parts, lift_of, model_part
from radiant_viewer.pictures.splat_picture import fit_camera
from radiant_viewer.runs.run_layers import hidden_at_first
from radiant_viewer.runs.shown_model import SURROUNDINGS, shown_model
from radiant_viewer.window.subject import Subject, load_subject

POINTS = "Gaussians"
"""The layer that the splats stand for."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Content:
    """What a window or a picture shows: the subject's layers, of which some are hidden at first,
    relative to `origin` (3,)."""

    subject: Subject
    layers: tuple[Layer, ...]
    hidden: frozenset[str]
    origin: FloatArray
    lift: float

    def model(self) -> Part | None:
        """The Gaussians; None without any."""
        splats = self.splats
        return None if splats is None else model_part(splats, self.origin)

    @property
    def splats(self) -> Splats | None:
        """The model without what lies around the scene; None without one."""
        return _seen_of(self.subject)

    def parts(self, layer: Layer) -> list[Part]:
        """The geometries of a layer."""
        return list(layer_parts(layer, self.origin, self.lift))

    def view(self, size_wh: tuple[int, int], photograph: str | None = None) -> Cameras:
        """The camera of a photograph, or one that sees all from the south-west; in the world."""
        if photograph is None:
            return fit_camera(framing_positions(self.layers), size_wh)
        run = self.subject.run
        if run is None or photograph not in run.scene.cameras.names:
            raise BadInput(f"there is no photograph {photograph!r} with a known place here: leave --camera out.")
        camera = run.scene.cameras.named([photograph])
        scale = float(np.min(np.array(size_wh) / camera.sizes_wh[0]))
        K = camera.Ks.copy()
        K[:, :2] *= scale
        K[:, :2, 2] += (np.array(size_wh) - scale * camera.sizes_wh[0]) / 2
        return Cameras(names=camera.names, Ks=K, cam_from_world=camera.cam_from_world, sizes_wh=np.array([size_wh], np.int64))


def load_content(source: Path) -> Content:
    """Read a run, a training, a scene, a plan or a model alone; raises as `load_subject`."""
    subject = load_subject(source)
    splats = _seen_of(subject)
    layers = tuple(layer for layer in subject.layers if splats is None or layer.name not in (POINTS, SURROUNDINGS))
    positions = framing_positions(layers or subject.layers)
    return Content(
        subject=subject,
        layers=layers or subject.layers,
        hidden=hidden_at_first(subject.layers) | (frozenset() if layers else frozenset({POINTS})),
        origin=(positions.min(axis=0) + positions.max(axis=0)) / 2,
        lift=lift_of(splats, layers),
    )


def _seen_of(subject: Subject) -> Splats | None:
    if subject.model is None or subject.box is None:
        return subject.model and subject.model.splats
    return shown_model(subject.model.splats, subject.box).splats
