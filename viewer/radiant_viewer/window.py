"""`InspectorWindow`: the Qt window over a `RunView`. Import only after `desktop.require_desktop`.

Map and 3D view hold the same layers; a layer's box hides its actors in both. A row of the table, once selected, marks its
camera in both views.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyvista as pv
from PySide6.QtCore import QItemSelection, QSortFilterProxyModel, Qt, QTimer
from PySide6.QtGui import QCloseEvent, QIcon, QImage, QKeySequence, QPixmap, QShowEvent
from PySide6.QtWidgets import (
    QAbstractItemView,
    QDockWidget,
    QFileDialog,
    QLabel,
    QMainWindow,
    QSplitter,
    QTableView,
    QTreeWidget,
    QTreeWidgetItem,
    QVBoxLayout,
    QWidget,
)
from pyvistaqt import QtInteractor

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray
from radiant_viewer.camera_layer import camera_layer, highlight_layer
from radiant_viewer.camera_table import SORT_ROLE, CameraTable
from radiant_viewer.detail import moving_note
from radiant_viewer.drawing import SLOTS_PER_LAYER, add_layer
from radiant_viewer.images import Image, save_png
from radiant_viewer.layers import Layer, drawn_positions
from radiant_viewer.offscreen import aim_camera
from radiant_viewer.palette import INK, ColorArray, heat_table
from radiant_viewer.point_detail import PointDetail
from radiant_viewer.run_view import RunView
from radiant_viewer.splat_layer import sparse_point_layer, splat_layer
from radiant_viewer.views import plan_layers, seam_of

HIDDEN_AT_FIRST = frozenset({"Device strips", "Gaussians", "Cameras by PSNR"})
"""Layers that cover others: one click away."""


@dataclass(eq=False)
class _Canvas:
    """One of the two views: its plotter, its actors by layer, and whether layers lie flat."""

    plotter: QtInteractor
    is_map: bool
    detail: PointDetail
    actors: dict[str, list[pv.Actor]] = field(default_factory=dict)


class InspectorWindow(QMainWindow):
    """The window of one run."""

    def __init__(self, run: RunView) -> None:
        super().__init__()
        self.run = run
        self.layers = window_layers(run)
        drawn = drawn_positions(self.layers)
        self.origin: FloatArray = (drawn.min(axis=0) + drawn.max(axis=0)) / 2
        self.setWindowTitle(f"Radiant: {run.folder.resolve().name}")
        self.resize(1280, 800)
        splitter = QSplitter(Qt.Orientation.Horizontal)
        self.map = self._canvas(splitter, "Map", is_map=True)
        self.view = self._canvas(splitter, "3D", is_map=False)
        splitter.setSizes([640, 640])
        self.setCentralWidget(splitter)
        self.tree = self._layer_tree()
        self.table = self._camera_table()
        self._add_actions()
        for canvas in (self.map, self.view):
            self._draw_layers(canvas)
        self.statusBar().showMessage(
            f"{len(run.scene.cameras)} cameras, {len(run.cloud_plan.edge_ids)} regions, {len(run.roles.device_ids)} devices"
        )

    def set_layer_visible(self, name: str, visible: bool) -> None:
        """Show or hide a layer in both views, as its check box does."""
        self._item(name).setCheckState(0, Qt.CheckState.Checked if visible else Qt.CheckState.Unchecked)

    def select_camera(self, name: str) -> None:
        """Select the row of a camera, which marks it in both views; BadInput for an unknown name."""
        if name not in self.run.scene.cameras.names:
            raise BadInput(f"there is no camera named {name!r} in this run: check the first column of the table.")
        source = self.cameras.index(self.run.scene.cameras.names.index(name), 0)
        row = self.sorted_cameras.mapFromSource(source)
        self.table.selectRow(row.row())
        self.table.scrollTo(row)

    def reset_views(self) -> None:
        """Fit all layers into both views."""
        drawn = drawn_positions(self.layers) - self.origin
        spans = drawn.max(axis=0) - drawn.min(axis=0)
        plotter = self.map.plotter
        plotter.enable_parallel_projection()
        plotter.enable_image_style()
        top = float(SLOTS_PER_LAYER * (len(self.layers) + 2))
        plotter.camera.focal_point, plotter.camera.position, plotter.camera.up = (0, 0, 0), (0, 0, top), (0, 1, 0)
        width, height = plotter.window_size
        plotter.camera.parallel_scale = 0.55 * float(max(spans[1], spans[0] * height / max(width, 1), 1e-6))
        plotter.renderer.reset_camera_clipping_range()
        aim_camera(self.view.plotter, drawn)
        self._render()

    def screenshot(self) -> Image:
        """Map and 3D view as they are on screen, side by side (H,W,3)."""
        images = []
        for canvas in (self.map, self.view):
            canvas.detail.refine()
            pixels = canvas.plotter.screenshot(return_img=True)
            assert pixels is not None
            images.append(np.asarray(pixels, np.uint8))
        height = min(image.shape[0] for image in images)
        return np.concatenate([image[:height] for image in images], axis=1)

    def save_screenshot(self, path: Path) -> None:
        """Write `screenshot` as PNG; BadInput where it cannot be written."""
        save_png(path, self.screenshot())
        self.statusBar().showMessage(f"Saved {path}")

    def showEvent(self, event: QShowEvent) -> None:
        """Fit the layers once the views have their size."""
        super().showEvent(event)
        QTimer.singleShot(0, self.reset_views)

    def closeEvent(self, event: QCloseEvent) -> None:
        """Free both views before Qt takes their windows away; VTK would draw into nothing."""
        for canvas in (self.map, self.view):
            canvas.plotter.close()
        super().closeEvent(event)

    def _canvas(self, parent: QSplitter, title: str, *, is_map: bool) -> _Canvas:
        frame = QWidget(parent)
        layout = QVBoxLayout(frame)
        layout.setContentsMargins(4, 4, 4, 4)
        layout.setSpacing(2)
        heading = QLabel(title)
        heading.setStyleSheet("font-weight: bold")
        layout.addWidget(heading)
        plotter = QtInteractor(frame, auto_update=False, multi_samples=4)
        plotter.background_color = pv.Color("white")
        layout.addWidget(plotter, stretch=1)
        detail = PointDetail(plotter, later=lambda seconds, call: QTimer.singleShot(int(1000 * seconds), self, call))
        return _Canvas(plotter=plotter, is_map=is_map, detail=detail)

    def _layer_tree(self) -> QTreeWidget:
        tree = QTreeWidget()
        tree.setHeaderHidden(True)
        for layer in reversed(self.layers):
            item = QTreeWidgetItem(tree, [layer.name])
            item.setFlags(item.flags() | Qt.ItemFlag.ItemIsUserCheckable)
            item.setCheckState(0, Qt.CheckState.Unchecked if layer.name in HIDDEN_AT_FIRST else Qt.CheckState.Checked)
            rows = [(entry.text, _color_icon(np.array([[entry.color]], np.uint8))) for entry in layer.legend]
            if layer.heat is not None:
                rows += [
                    (f"{layer.heat.low:.4g} to {layer.heat.high:.4g}", _color_icon(heat_table()[None])),
                    (layer.heat.label, QIcon()),
                ]
            rows += [(note, QIcon()) for note in [moving_note(layer)] if note]
            for text, icon in rows:
                row = QTreeWidgetItem(item, [text])
                row.setIcon(0, icon)
                row.setToolTip(0, text)
            item.setExpanded(len(layer.legend) <= 8)
        tree.itemChanged.connect(self._on_item_changed)
        dock = QDockWidget("Layers", self)
        dock.setWidget(tree)
        self.addDockWidget(Qt.DockWidgetArea.LeftDockWidgetArea, dock)
        self.resizeDocks([dock], [280], Qt.Orientation.Horizontal)
        return tree

    def _camera_table(self) -> QTableView:
        self.cameras = CameraTable(self.run)
        self.sorted_cameras = QSortFilterProxyModel()
        self.sorted_cameras.setSourceModel(self.cameras)
        self.sorted_cameras.setSortRole(SORT_ROLE)
        table = QTableView()
        table.setModel(self.sorted_cameras)
        table.setSortingEnabled(True)
        table.sortByColumn(0, Qt.SortOrder.AscendingOrder)
        table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        table.verticalHeader().setDefaultSectionSize(22)
        table.resizeColumnsToContents()
        table.selectionModel().selectionChanged.connect(self._on_selection)
        dock = QDockWidget("Cameras", self)
        dock.setWidget(table)
        self.addDockWidget(Qt.DockWidgetArea.BottomDockWidgetArea, dock)
        self.resizeDocks([dock], [220], Qt.Orientation.Vertical)
        return table

    def _add_actions(self) -> None:
        bar = self.addToolBar("View")
        bar.setMovable(False)
        entries = (
            ("Fit", "Fit all layers into both views (F)", "F", self.reset_views),
            ("Screenshot…", "Save map and 3D view as PNG (Ctrl+S)", "Ctrl+S", self._ask_screenshot),
        )
        for text, tip, keys, action in entries:
            button = bar.addAction(text, action)
            button.setToolTip(tip)
            button.setShortcut(QKeySequence(keys))

    def _draw_layers(self, canvas: _Canvas) -> None:
        for index, layer in enumerate(self.layers):
            height = float(SLOTS_PER_LAYER * index) if canvas.is_map else None
            canvas.actors[layer.name] = add_layer(canvas.plotter, layer, self.origin, flat_height=height, detail=canvas.detail)
            if layer.labels and canvas.is_map:
                canvas.actors[layer.name].append(self._add_labels(layer, float(SLOTS_PER_LAYER * index)))
            for actor in canvas.actors[layer.name]:
                actor.SetVisibility(layer.name not in HIDDEN_AT_FIRST)

    def _add_labels(self, layer: Layer, height: float) -> pv.Actor:
        places = np.array([label.position for label in layer.labels]) - self.origin
        places[:, 2] = height
        style = {"font_size": 11, "text_color": "black", "shape_color": "white", "shape_opacity": 0.8, "show_points": False}
        # Names only: VTK does not keep labels inside the view, and the figures stand in the layer tree.
        texts = [label.text.splitlines()[0] for label in layer.labels]
        return self.map.plotter.add_point_labels(places, texts, always_visible=True, reset_camera=False, render=False, **style)

    def _on_item_changed(self, item: QTreeWidgetItem) -> None:
        name = item.text(0)
        for canvas in (self.map, self.view):
            for actor in canvas.actors.get(name, []) if item.parent() is None else []:
                actor.SetVisibility(item.checkState(0) == Qt.CheckState.Checked)
        self._render()

    def _on_selection(self, selected: QItemSelection) -> None:
        if not selected.indexes():
            return
        index = self.sorted_cameras.mapToSource(selected.indexes()[0]).row()
        layer = highlight_layer(self.run.scene.cameras, index)
        for canvas in (self.map, self.view):
            for actor in canvas.actors.pop(layer.name, []):
                canvas.plotter.remove_actor(actor, render=False)
            height = float(SLOTS_PER_LAYER * len(self.layers)) if canvas.is_map else None
            canvas.actors[layer.name] = add_layer(canvas.plotter, layer, self.origin, flat_height=height)
        row = self.cameras.rows[index]
        self.statusBar().showMessage("   ·   ".join(str(cell) for cell in row[:4] if cell))
        self._render()

    def _ask_screenshot(self) -> None:
        path, _ = QFileDialog.getSaveFileName(self, "Save screenshot", str(Path.cwd() / "inspect.png"), "PNG (*.png)")
        if path:
            try:
                self.save_screenshot(Path(path))
            except BadInput as error:
                self.statusBar().showMessage(str(error))

    def _item(self, name: str) -> QTreeWidgetItem:
        items = self.tree.findItems(name, Qt.MatchFlag.MatchExactly)
        if not items:
            raise BadInput(f"there is no layer {name!r}: use one of {', '.join(layer.name for layer in self.layers)}.")
        return items[0]

    def _render(self) -> None:
        for canvas in (self.map, self.view):
            canvas.plotter.render()


def window_layers(run: RunView) -> list[Layer]:
    """All layers of a run from the ground up: points, plan, cameras, and what the run has beyond: model, seams, errors."""
    regions, strips, borders, cameras, edges = plan_layers(run.scene, run.cloud_plan, run.edge_plans, run.roles)
    layers = [regions, strips, sparse_point_layer(run.scene)]
    if run.splats is not None:
        layers.append(splat_layer(run.splats))
    layers += [borders, cameras]
    if run.psnr_db:
        layers.append(camera_layer(run.scene.cameras, run.roles, "psnr", run.psnr_db))
    if run.splats is not None and len(run.cloud_plan.edge_ids) > 1:
        layers.append(seam_of(run.scene, run.cloud_plan, run.splats)[0])
    return [*layers, edges]


def _color_icon(colors: ColorArray) -> QIcon:
    """An icon with a dark rim from colours (1,K,3), one or a whole scale from left to right."""
    icon = np.tile(np.array(INK, np.uint8), (14, 14, 1))
    columns = np.linspace(0, colors.shape[1] - 1, 12).round().astype(int)
    icon[1:-1, 1:-1] = colors[:, columns]
    return QIcon(QPixmap.fromImage(QImage(icon.tobytes(), 14, 14, 42, QImage.Format.Format_RGB888)))
