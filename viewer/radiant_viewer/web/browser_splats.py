"""The model drawn by the browser itself, in the page's 3D view: the page of a scene in a frame.

The frame is the page that `radiant inspect --page` serves, under the same address and port, in a
folder whose name is a secret that only authorised browsers are told. The frame draws nothing where
the browser has no WebGL 2; then the picture of the server behind it stays in sight. Once per
server."""

from __future__ import annotations

import secrets
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from radiant_core.errors import RadiantError
from radiant_core.lod.cells import whole_region
from radiant_core.lod.levels import LodLimits
from radiant_viewer.layers.layer import Layer
from radiant_viewer.layers.palette import GREY, VERMILLION, ColorArray, rgb
from radiant_viewer.layers.themes import LIGHT, Theme, apply_theme, hex_color
from radiant_viewer.runs.run_view import RunView
from radiant_viewer.share.folder import page_of_run, save_page
from radiant_viewer.share.scene_page import PagePlace, drawn_cameras, frustum_line, run_overview, viewer_camera

MARK_WIDTH_PX, MARK_COLOR = 4.0, VERMILLION
"""As the ring on the map."""
SIDES = 8
"""Lines of a camera's pyramid in its layer; one of the page."""


class BrowserSplats:
    """The frame of one run: a folder to serve, and what the frame is told to show."""

    def __init__(self, run: RunView) -> None:
        self._run = run
        self._folder = tempfile.TemporaryDirectory(prefix="radiant-web-")
        self.route = f"splats-{secrets.token_urlsafe(16)}"
        self.page_state: dict[str, Any] = {"look": None, "layers": [], "mark": None, "colors": {}, "ground": hex_color(LIGHT.view)}
        self._layers: list[str] = []
        self._part = "scene"
        self._num_looks = 0

    @property
    def served(self) -> dict[str, str]:
        """What the server serves: folder by route."""
        return {self.route: self._folder.name}

    @property
    def address(self) -> str:
        """Of the frame, beside the page's own."""
        return f"{self.route}/{self._part}/index.html?webgl"

    def write(self, *, with_surroundings: bool = False) -> str:
        """Write the folder of the scene, or of all of the model, where that was not done; returns
        why it cannot be, or nothing. Takes seconds: for a thread."""
        part = "whole" if with_surroundings else "scene"
        folder = Path(self._folder.name) / part
        try:
            page = page_of_run(self._run, with_photographs=False, with_surroundings=with_surroundings)
            if not folder.is_dir():
                folder.mkdir()
                save_page(folder, page, [whole_region(page.splats.means)], LodLimits(), lambda num_done, total: None)
        except RadiantError as error:
            return str(error)
        self._part = part
        self._layers = [layer["name"] for layer in page.layers]
        return ""

    def show(self, layers: Sequence[Layer], theme: Theme) -> None:
        """Show these layers in the colours of the map, "Cameras by PSNR" and the like as cameras, on the theme's ground."""
        kinds = {name.split(":")[0]: name for name in self._layers}
        self.page_state = {
            **self.page_state,
            "layers": [name for kind, name in kinds.items() if any(layer.name.startswith(kind) for layer in layers)],
            "colors": {
                name: [hex_color(rgb(color)) for color in colors]
                for kind, name in kinds.items()
                for layer in layers
                if layer.name.startswith(kind) and len(colors := self._line_colors(kind, apply_theme(layer, theme)))
            },
            "ground": hex_color(theme.view),
        }

    def _line_colors(self, kind: str, layer: Layer) -> ColorArray:
        """Colours (L,3) of the page's lines of a layer; none where the page has its own."""
        colors = layer.segment_colors
        if kind == "Cameras" and len(colors):
            return colors[::SIDES][drawn_cameras(len(self._run.scene.cameras))]
        if kind == "Seams":
            # The page has no lines where nothing is known.
            return colors[(colors != np.array(GREY, np.uint8)).any(axis=1)]
        return colors[:1] if kind == "Borders" else colors[:0]

    def look(self, place: PagePlace) -> None:
        """Fly to a place."""
        self._num_looks += 1
        self.page_state = {**self.page_state, "look": {**viewer_camera(place), "number": self._num_looks}}

    def fit(self) -> None:
        """Fly to where the whole scene is seen."""
        self.look(run_overview(self._run))

    def mark(self, camera: int | None) -> None:
        """Draw the pyramid of the selected camera over all; None: of no camera."""
        line = None if camera is None else frustum_line(self._run, camera, hex_color(MARK_COLOR), MARK_WIDTH_PX)
        self.page_state = {**self.page_state, "mark": line}

    def close(self) -> None:
        """Remove the folder."""
        self._folder.cleanup()
