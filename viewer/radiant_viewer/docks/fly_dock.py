"""Keyframed flights, collected and played in the 3D view and written as films. Needs the `desktop`
extra.

Frames are composed as in the 3D view, one at a time through the event loop: the window stays
usable, and closing it leaves no partial film.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PySide6.QtCore import QTimer
from PySide6.QtWidgets import (
    QComboBox,
    QDockWidget,
    QDoubleSpinBox,
    QFileDialog,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QListWidget,
    QProgressBar,
    QPushButton,
    QWidget,
)

from radiant_core.errors import StoreDamaged
from radiant_viewer.docks.flight_job import FlightJob, SceneFrames
from radiant_viewer.host.protocols import Host
from radiant_viewer.pictures.fly_through import flight_poses
from radiant_viewer.pictures.movie import MovieWriter
from radiant_viewer.pictures.view_pose import ViewPose
from radiant_viewer.runs.flight_file import FlightFile
from radiant_viewer.splats.splat_process import Part

SIZES = {"640 × 360": (640, 360), "1280 × 720": (1280, 720), "1920 × 1080": (1920, 1080)}
SCENE, MODEL, LAYERS = "As the 3D view", "Model alone", "Layers alone"


class FlyDock(QDockWidget):
    """`keyframes` in the order of the flight, kept beside the run; `job` is the film being written,
    or None."""

    def __init__(self, host: Host, ply_path: Path | None, file: FlightFile) -> None:
        super().__init__("Fly-through")
        self.setObjectName("fly-through")
        self._host, self._ply_path, self._file = host, ply_path, file
        self.keyframes: list[ViewPose] = []
        self.job: FlightJob | None = None
        self.list = QListWidget()
        self.list.setToolTip("Double click flies to a keyframe")
        self.list.itemDoubleClicked.connect(lambda _: self._go_to_current())
        self.seconds, self.rate = _spin(3.0, 0.1, 60, " s per leg"), _spin(24.0, 1, 60, " frames/s")
        self.frame_size, self.source = QComboBox(), QComboBox()
        self.frame_size.addItems(list(SIZES))
        self.source.addItems([SCENE, MODEL, LAYERS] if ply_path is not None else [LAYERS])
        self.source.setToolTip("What the film shows: the 3D view as it is, the model alone, or the visible layers alone")
        self.add, self.remove, self.play = QPushButton("Add view"), QPushButton("Remove"), QPushButton("Play")
        self.add.setToolTip("Add the 3D view as the next keyframe (K)")
        self.export, self.cancel = QPushButton("Export…"), QPushButton("Cancel")
        self.export.setToolTip("Write the flight as .webm (for browsers), .mp4 (not for browsers) or .gif")
        self.bar = QProgressBar()
        self.note = QLabel("Move the 3D view and add two or more keyframes.")
        self.note.setProperty("soft", "true")
        self.add.clicked.connect(self.add_view)
        self.remove.clicked.connect(self._remove_current)
        self.play.clicked.connect(self.play_or_stop)
        self.export.clicked.connect(self._ask_export)
        self.cancel.clicked.connect(self.stop)
        self._lay_out()
        self._playing: list[ViewPose] = []
        self._timer = QTimer(self)
        self._timer.timeout.connect(self._show_next)
        self._update()
        try:
            self.set_keyframes(file.load())
        except StoreDamaged as error:
            self.note.setText(str(error))

    def add_view(self) -> None:
        """Append the present 3D view as a keyframe."""
        self.add_keyframe(self._host.view.pose)

    def add_keyframe(self, pose: ViewPose) -> None:
        """Append a keyframe, and keep the flight."""
        self.set_keyframes([*self.keyframes, pose])
        self._host.attempt(lambda: self._file.keep(self.keyframes))

    def set_keyframes(self, keyframes: Sequence[ViewPose]) -> None:
        """Show the keyframes of another flight, which is not written."""
        self.keyframes = list(keyframes)
        self.list.clear()
        for number, pose in enumerate(self.keyframes, 1):
            x, y, z = pose.position
            self.list.addItem(f"{number}:  east {x:.1f}, north {y:.1f}, up {z:.1f}")
        self._update()

    def poses(self) -> list[ViewPose]:
        """Return the poses of all frames; BadInput for fewer than two keyframes."""
        return flight_poses(self.keyframes, self.seconds.value(), self.rate.value())

    def play_or_stop(self) -> None:
        """Play the flight in the 3D view, or stop it."""
        if self._timer.isActive():
            self._timer.stop()
            self.play.setText("Play")
            return
        self._host.attempt(self._play)

    def write(self, path: Path, *, source: str | None = None, size_wh: tuple[int, int] | None = None) -> None:
        """Start writing the flight; BadInput where it cannot be. `job.ended` carries the result."""
        size = size_wh or SIZES[self.frame_size.currentText()]
        poses = self.poses()
        writer = MovieWriter(path, size, self.rate.value())
        content = source or self.source.currentText()
        layers = (
            [] if content == MODEL else [layer for layer in self._host.visible_layers() if layer.name != "Gaussians" or content == LAYERS]
        )
        frames = SceneFrames(layers, size, self._host.origin, self._host.theme)
        if content != LAYERS and self._ply_path is not None:
            frames.add_model(self, self._ply_path, Part(box=self._host.crop_box, keep_path=self._host.kept_path))
        self.job = FlightJob(self, poses, writer, frames)
        self.job.progressed.connect(self.bar.setValue)
        self.job.ended.connect(self._on_ended)
        self.bar.setRange(0, len(poses))
        self._update()
        self.note.setText(f"Writing {len(poses)} frames to {path.name} …")
        self.job.begin()

    def stop(self) -> None:
        """Stop playing, and cancel a film that is being written."""
        self._timer.stop()
        if self.job is not None:
            self.job.give_up()

    def _on_ended(self, message: str) -> None:
        self.job = None
        self._update()
        self.note.setText(message)
        self._host.show_status(message)

    def _play(self) -> None:
        self._playing = self.poses()
        self.play.setText("Stop")
        self._timer.start(round(1000 / self.rate.value()))

    def _show_next(self) -> None:
        if not self._playing:
            self.play_or_stop()
            return
        self._host.view.set_pose(self._playing.pop(0))
        self._host.view.render()

    def _go_to_current(self) -> None:
        if 0 <= (row := self.list.currentRow()) < len(self.keyframes):
            self._host.view.set_pose(self.keyframes[row])
            self._host.render_views()

    def _remove_current(self) -> None:
        row = self.list.currentRow() if self.list.currentRow() >= 0 else len(self.keyframes) - 1
        if row >= 0:
            self.set_keyframes(self.keyframes[:row] + self.keyframes[row + 1 :])
            self._host.attempt(lambda: self._file.keep(self.keyframes))

    def _update(self) -> None:
        flies = len(self.keyframes) > 1
        if flies and self.job is None:
            length_s = (len(self.keyframes) - 1) * self.seconds.value()
            self.note.setText(f"{len(self.keyframes)} keyframes, {length_s:.1f} s")
        self.play.setEnabled(flies)
        self.export.setEnabled(flies and self.job is None)
        self.remove.setEnabled(bool(self.keyframes))
        for widget in (self.bar, self.cancel):
            widget.setVisible(self.job is not None)

    def _ask_export(self) -> None:
        kinds = "WebM for browsers and players (*.webm);;MP4 for desktop players, not for browsers (*.mp4);;GIF (*.gif)"
        path, _ = QFileDialog.getSaveFileName(self, "Export flight", str(Path.cwd() / "flight.webm"), kinds)
        if path:
            self._host.attempt(lambda: self.write(Path(path)))

    def _lay_out(self) -> None:
        body = QWidget()
        grid = QGridLayout(body)
        grid.setContentsMargins(4, 2, 4, 4)
        grid.addWidget(self.list, 0, 0, 4, 1)
        for row, widgets in enumerate(
            ((self.add, self.remove, self.play), (self.seconds, self.rate, self.frame_size), (self.source, self.export))
        ):
            line = QHBoxLayout()
            for widget in widgets:
                line.addWidget(widget)
            line.addStretch(1)
            grid.addLayout(line, row, 1)
        last = QHBoxLayout()
        last.addWidget(self.note, stretch=1)
        last.addWidget(self.bar)
        last.addWidget(self.cancel)
        grid.addLayout(last, 3, 1)
        grid.setColumnStretch(0, 1)
        grid.setColumnStretch(1, 2)
        self.setWidget(body)


def _spin(value: float, low: float, high: float, suffix: str) -> QDoubleSpinBox:
    field = QDoubleSpinBox()
    field.setRange(low, high)
    field.setDecimals(1)
    field.setValue(value)
    field.setSuffix(suffix)
    return field
