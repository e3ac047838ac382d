"""The process that draws with Open3D: `python -m radiant_viewer.open3d_window.worker JOB.json`.

JOB.json: {"source", "picture", "size_wh", "camera"}; picture null for a window, camera null or a
photograph's name. Open3D can end its process by a signal, and holds one renderer per process: here
it takes nothing with it. Exit code 2 with one sentence on standard error for what a user can mend.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput, RadiantError
from radiant_core.io.run_store import read_json
from radiant_core.numerics import FloatArray
from radiant_viewer.layers.layer import Layer, framing_positions
from radiant_viewer.open3d_window.parts import Part, layer_parts, lift_of, model_part
from radiant_viewer.pictures.images import Image, save_png
from radiant_viewer.pictures.splat_picture import fit_camera
from radiant_viewer.runs.run_layers import hidden_at_first
from radiant_viewer.window.subject import Subject, load_subject

DRAWS = 3
"""Open3D's splats are now and then wrong in single tiles: a picture is the median of so many."""
POINTS = "Gaussians"
"""The layer that the splats stand for."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shown:
    """What a window or a picture shows: the subject's layers, of which some are hidden at first,
    relative to `origin` (3,)."""

    subject: Subject
    layers: tuple[Layer, ...]
    hidden: frozenset[str]
    origin: FloatArray
    lift: float

    def model(self) -> Part | None:
        """The Gaussians; None without any."""
        splats = self.subject.model and self.subject.model.splats
        return None if splats is None else model_part(splats, self.origin)

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


def load_shown(source: Path) -> Shown:
    """Read a run, a training, a scene, a plan or a model alone; raises as `load_subject`."""
    subject = load_subject(source)
    splats = None if subject.model is None else subject.model.splats
    layers = tuple(layer for layer in subject.layers if splats is None or layer.name != POINTS)
    drawn = framing_positions(layers or subject.layers)
    return Shown(
        subject=subject,
        layers=layers or subject.layers,
        hidden=hidden_at_first(subject.layers) | (frozenset() if layers else frozenset({POINTS})),
        origin=(drawn.min(axis=0) + drawn.max(axis=0)) / 2,
        lift=lift_of(splats, layers),
    )


def draw_picture(shown: Shown, size_wh: tuple[int, int], photograph: str | None) -> Image:
    """The layers that are not hidden, (H,W,3), without a window."""
    parts = [part for layer in shown.layers if layer.name not in shown.hidden for part in shown.parts(layer)]
    model = shown.model()
    return draw_parts([*([] if model is None else [model]), *parts], shown.view(size_wh, photograph), shown.origin)


def draw_parts(parts: Sequence[Part], camera: Cameras, origin: FloatArray) -> Image:
    """Geometries relative to `origin` (3,) as a camera of the world sees them, (H,W,3), over white.
    Once per process: Open3D 0.20 ends by a signal where it had two renderers."""
    from open3d.visualization import rendering

    size_wh = (int(camera.sizes_wh[0, 0]), int(camera.sizes_wh[0, 1]))
    renderer: Any = rendering.OffscreenRenderer(*size_wh)
    renderer.scene.set_background(np.ones(4))
    for part in parts:
        renderer.scene.add_geometry(part.name, part.geometry, part.material)
    pose = camera.cam_from_world[0].copy()
    pose[:3, 3] += pose[:3, :3] @ origin
    renderer.setup_camera(camera.Ks[0], pose, *size_wh)
    draws = [np.asarray(renderer.render_to_image()) for _ in range(DRAWS)]
    return np.rint(np.median(draws, axis=0)).astype(np.uint8)


def main() -> int:
    """Do the job of the file and return the exit code."""
    try:
        job = read_json(Path(sys.argv[1]), ("source", "picture", "size_wh", "camera"))
        shown = load_shown(Path(job["source"]))
        width, height = (int(side) for side in job["size_wh"])
        if job["picture"] is not None:
            save_png(Path(job["picture"]), draw_picture(shown, (width, height), job["camera"]))
            return 0
        from radiant_viewer.open3d_window.gui_window import show_window

        return show_window(shown, (width, height), job["camera"])
    except RadiantError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code


if __name__ == "__main__":
    sys.exit(main())
