"""`WebPage`: the state of the page and its actions. Import only after `web.require_web`.

The browser holds the lists and draws the model where it can; this machine renders all else. All
open pages share one view and one selection, and the run is not changed. Traffic: the lists and the
model once, pictures per selection, frames as JPEG.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from trame.app import get_server
from trame_client.module.vue3 import www

from radiant_core.errors import BadInput
from radiant_viewer.layers.camera_layer import highlight_layer
from radiant_viewer.layers.themes import DARK, LIGHT
from radiant_viewer.pictures.view_pose import camera_pose
from radiant_viewer.runs.camera_figures import sort_rows
from radiant_viewer.runs.run_figures import FIGURES
from radiant_viewer.runs.run_layers import color_step_layer, ground_height, hidden_at_first, run_layers
from radiant_viewer.runs.run_view import RunView
from radiant_viewer.runs.seam_tour import SeamStop, seam_stops
from radiant_viewer.runs.shown_model import SURROUNDINGS, framed_positions
from radiant_viewer.runs.words import counted
from radiant_viewer.share.scene_page import PagePlace
from radiant_viewer.web.browser_splats import BrowserSplats
from radiant_viewer.web.first_picture import add_first_picture, first_picture
from radiant_viewer.web.layout import HEADERS, build_layout
from radiant_viewer.web.rows import (
    Row,
    camera_headers,
    camera_pictures,
    camera_rows,
    layer_row,
    picture_url,
    run_camera_figures,
    seam_rows,
)
from radiant_viewer.web.scene import WebScene


class WebPage:
    """The page of one run; create and serve it inside a running event loop."""

    def __init__(self, run: RunView) -> None:
        self.run = run
        self.figures = run_camera_figures(run)
        layers = run_layers(run, with_seams=False)
        framed = None if run.splats is None else framed_positions(run.scene, run.cloud_plan)
        self.scene = WebScene(layers, hidden_at_first(layers), self._later, framed=framed)
        self.stops: tuple[SeamStop, ...] = ()
        self.before_solo: list[str] | None = None
        self.splats = BrowserSplats(run)
        self.server: Any = get_server(f"radiant-{id(self)}", client_type="vue3")
        self.server.enable_module({"serve": self.splats.served})
        self._fill_state()
        self.images = build_layout(self.server, self)
        self.server.state.change("visible")(self._on_visible)
        self.server.state.change("dark")(self._on_dark)
        self.server.state.change("sort_by")(self._on_sort)
        self.server.state.change("panes")(self._on_panes)
        self.server.state.change("selected")(self._on_selected)
        self._tasks: set[asyncio.Task[None]] = set()

    async def serve(self, host: str, port: int, secret: str, ready: Callable[[int], None]) -> None:
        """Serve until cancelled; `ready` receives the port once it is bound."""
        self.server.cli.set_defaults(authKey=secret, host=host, trame_args="")
        for name, value in HEADERS.items():
            self.server.http_headers.set_header(name, value)

        picture = first_picture(self.run.folder, self.scene.view.picture)

        def on_bind(bound: Any) -> None:
            add_first_picture(bound.app, Path(www), self._loaded(), picture, secret)

        def on_ready(**_: object) -> None:
            ready(self.server.port)
            self._spawn(self._prepare())

        self.server.controller.on_server_bind.add(on_bind)
        self.server.controller.on_server_ready.add(on_ready)
        try:
            await self.server.start(
                port=port, host=host, thread=True, open_browser=False, show_connection_info=False, disable_logging=True,
                timeout=0, exec_mode="coroutine",
            )  # fmt: skip
        finally:
            self.scene.close()
            self.splats.close()

    def push(self) -> None:
        """Send a frame of both views."""
        self.server.state.splats_told = self.splats.page_state
        for image in self.images:
            image.update()

    def select_camera(self, index: int) -> None:
        """Mark a camera and show its pictures."""
        cameras = self.run.scene.cameras
        if not 0 <= index < len(cameras):
            raise BadInput(f"there is no camera {index}: this run has {len(cameras)}.")
        self.scene.set_mark(highlight_layer(cameras, index))
        self.splats.mark(index)
        state = self.server.state
        state.selected = index
        state.pictures = camera_pictures(self.run, index)
        state.figures = [
            {"heading": figure.heading, "value": f"{value:.{figure.decimals}f}", "meaning": figure.meaning}
            for figure in FIGURES
            if figure.key in self.figures.columns and np.isfinite(value := float(self.figures.columns[figure.key][index]))
        ]
        self.push()

    def fly_to_camera(self) -> None:
        """Move the 3D view to the selected camera."""
        index = self.server.state.selected
        if index is None:
            return
        cameras = self.run.scene.cameras
        distance = max(float(cameras.centers[index, 2]) - ground_height(self.run.scene), 0.05 * self._side())
        pose = camera_pose(cameras, int(index), distance)
        self.scene.view.look(pose, distance)
        self.scene.map.look(pose, 0.25 * self._side())
        width, height = cameras.sizes_wh[int(index)]
        self.splats.look(PagePlace(title="", text="", view=pose, aspect=float(width) / float(height)))
        self.push()

    def go_to_seam(self, index: int) -> None:
        """Move both views to a stop of the seam tour, round at either end."""
        if not self.stops:
            return
        place = index % len(self.stops)
        stop = self.stops[place]
        self.server.state.seam = place
        pose = stop.view(ground_height(self.run.scene))
        self.scene.view.look(pose, stop.length)
        self.splats.look(PagePlace(title="", text="", view=pose, aspect=1.0))
        self.scene.map.look(pose, 0.6 * stop.length)
        visible = {*self.server.state.visible, "Seams"}
        self.server.state.visible = [layer.name for layer in self.scene.layers if layer.name in visible]
        self.push()

    def toggle_solo(self, name: str) -> None:
        """Show one layer alone; a second call restores the layers shown before."""
        state = self.server.state
        if state.solo == name:
            state.solo, state.visible = "", self.before_solo or []
            return
        if not state.solo:
            self.before_solo = list(state.visible)
        state.solo, state.visible = name, [name]

    def fit(self) -> None:
        """Fit all layers into both views."""
        self.scene.fit()
        self.splats.fit()
        self.push()

    def _loaded(self) -> list[Path]:
        """The files that a browser fetches before the page stands."""
        state, folders = self.server.state, self.server.serve
        parts = [str(url).split("/", maxsplit=1) for url in (*state.trame__scripts, *state.trame__styles)]
        return [Path(folders[part[0]]) / part[1] for part in parts if len(part) > 1 and part[0] in folders]

    def _layer_rows(self) -> list[Row]:
        return [layer_row(layer, self.scene.theme) for layer in reversed(self.scene.layers)]

    def _side(self) -> float:
        return float(np.ptp(self.run.scene.cameras.centers, axis=0).max())

    def _fill_state(self) -> None:
        run, state = self.run, self.server.state
        state.trame__title = f"Radiant: {run.folder.resolve().name}"
        state.trame__favicon = ""
        state.title = run.folder.resolve().name
        state.subtitle = _subtitle(run)
        state.layers = self._layer_rows()
        state.visible = [layer.name for layer in self.scene.layers if layer.name in self.scene.visible]
        state.cameras, state.headers = camera_rows(self.figures), camera_headers(self.figures)
        scored = "psnr_db" in self.figures.columns
        state.sort_by = [{"key": "psnr_db" if scored else "name", "order": "asc"}]
        state.order = sort_rows(self.figures, state.sort_by[0]["key"]).tolist()
        state.gantt = picture_url(run.folder / "pictures" / "gantt.png")
        state.update({"splats_page": "", "splats_told": self.splats.page_state, "splats_shown": True, "splats_reason": ""})
        state.update({"dark": False, "solo": "", "seams": [], "seam": -1, "seams_note": "Measuring the seams …", "selected": None})
        state.update(
            {"pictures": None, "figures": [], "kind": "photograph", "share": 50, "tab": "cameras", "panes": "both", "drawer": False}
        )

    def _show_layers(self) -> None:
        self.splats.show([layer for layer in self.scene.layers if layer.name in self.scene.visible], self.scene.theme)

    def _on_selected(self, selected: int | None, **_: object) -> None:
        # A phone closes the sheet of a camera.
        if selected is None and self.scene.mark is not None:
            self.scene.set_mark(None)
            self.splats.mark(None)
            self.push()

    def _on_visible(self, visible: list[str], **_: object) -> None:
        if set(visible) != self.scene.visible:
            if (SURROUNDINGS in visible) != (SURROUNDINGS in self.scene.visible) and self.server.state.splats_page:
                self._spawn(self._show_model(with_surroundings=SURROUNDINGS in visible))
            self.scene.set_visible(visible)
            self._show_layers()
            if self.server.state.solo and set(visible) != {self.server.state.solo}:
                self.server.state.solo = ""
            self.push()

    def _on_dark(self, dark: bool, **_: object) -> None:
        theme = DARK if dark else LIGHT
        if theme is not self.scene.theme:
            self.scene.set_theme(theme)
            self._show_layers()
            self.server.state.layers = self._layer_rows()
            self.push()

    def _on_sort(self, sort_by: list[dict[str, str]], **_: object) -> None:
        key, order = (sort_by[0]["key"], sort_by[0]["order"]) if sort_by else ("name", "asc")
        if key in self.figures.columns:
            self.server.state.order = sort_rows(self.figures, key, descending=order == "desc").tolist()

    def _on_panes(self, **_: object) -> None:
        # The browser sends the new size first; the map keeps its scale.
        self._later(0.3, self.push)

    async def _prepare(self) -> None:
        """What takes seconds, while the page is in use: the seams, then the browser's model."""
        await self._find_seams()
        if self.run.splats is None:
            return
        await self._show_model(with_surroundings=SURROUNDINGS in self.server.state.visible)

    async def _show_model(self, *, with_surroundings: bool) -> None:
        """Let the browser draw the model, without what lies around the scene unless wanted."""
        reason = await asyncio.to_thread(self.splats.write, with_surroundings=with_surroundings)
        with self.server.state as state:
            self._show_layers()
            state.splats_told = self.splats.page_state
            state.splats_page = "" if reason else self.splats.address
            state.splats_reason = reason and f"The browser cannot draw the model: {reason}"

    async def _find_seams(self) -> None:
        run, state = self.run, self.server.state
        with state:
            if run.splats is None:
                state.seams_note = "The run has no model yet: there are no seams to measure."
            elif len(run.cloud_plan.edge_ids) < 2:
                state.seams_note = "The plan has one region only: there is no border and no seam."
            if run.splats is None or len(run.cloud_plan.edge_ids) < 2:
                return
        # It takes seconds for millions of Gaussians, while the page is in use.
        self.stops = await asyncio.to_thread(seam_stops, run.scene, run.cloud_plan, run.splats)
        layer = await asyncio.to_thread(color_step_layer, run.scene, run.cloud_plan, run.splats)
        with state:
            self.scene.add_layer(layer)
            self._show_layers()
            state.layers = self._layer_rows()
            state.visible = [*state.visible, layer.name]
            state.seams, state.seams_note = seam_rows(self.stops, run.unit), ""
            self.push()

    def _spawn(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _later(self, seconds: float, call: Callable[[], None]) -> None:
        def run() -> None:
            call()
            if self.server.protocol:
                self.push()

        asyncio.get_running_loop().call_later(seconds, run)


def _subtitle(run: RunView) -> str:
    parts = [
        counted(len(run.scene.cameras), "camera"),
        counted(len(run.cloud_plan.edge_ids), "region"),
        counted(len(run.roles.device_ids), "device"),
        *([counted(len(run.splats), "Gaussian")] if run.splats is not None else []),
        *([f"held-out PSNR {np.mean(list(run.psnr_db.values())):.2f} dB"] if run.psnr_db else []),
    ]
    return " · ".join(parts)
