"""Random ways of moving the views of the real window, after each of which layers and model must
agree: `python -m tests.viewer.moved_views RUN SEED NUMBER [PAINTER]`, under an X server.

Beside the corners of the regions the run's model has bright balls (`with_beacons`), and the window gets
marks as a layer. Both are looked for on the screen, where the view's own camera has them: within
`NEAR_PX` pixels of the screen. Prints one JSON line: how many places were seen, the largest error.

Imported only in processes that show a window: pytest's own keep clear of Qt.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from PySide6.QtCore import QPoint, QPointF, Qt
from PySide6.QtGui import QAction, QImage, QKeySequence, QWheelEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget

from radiant_core.choices import Painter
from radiant_viewer.host.canvas import Canvas
from radiant_viewer.layers.layer import Layer
from radiant_viewer.pictures.images import save_png
from radiant_viewer.window.window import InspectorWindow
from tests.viewer.beacons import BALL, BALL_M, beacon_places
from tests.viewer.made_up_run import HALF_WH, Town, made_up_town
from tests.viewer.window_user import until, use_window

NEAR_PX, REST_MS = 2.0, 450
MARK = np.array([0, 255, 255])
SPACING_PX, OTHER_PX, COVERED_PX, LINE_PX, EDGE_PX = 18.0, 13.0, 20.0, 10.0, 20.0
"""Places nearer to each other, to one of the other kind, to a border or a camera, to a line of any
layer, which may cover them, or to the rim of a view are not looked for."""
THERE_AND_BACK = ("T", "F")
SEEN = Path("moved_views.png")
"""Where the screen is kept on which layers and model disagreed."""
LEAST_BALL_PX, LARGEST_BALL_PX = 1.6, 4.0
LEFT, MIDDLE, RIGHT = Qt.MouseButton.LeftButton, Qt.MouseButton.MiddleButton, Qt.MouseButton.RightButton


class Mover:
    """Moves the views of a window as a person does, chosen by a seed; the eye stays over the
    town, for what is below the ground hides the balls."""

    def __init__(self, window: InspectorWindow, seed: int) -> None:
        self.window, self.rng = window, np.random.default_rng(seed)
        self._bookmarked = False
        self.moves: tuple[Callable[[], str], ...] = (
            *(partial(self.press, key) for key in ("F", "T", "N", "Shift+N", "Ctrl+1", "Ctrl+2", "Ctrl+5", "V", "Return", "F", "F")),
            *(partial(self._button, text) for text in ("Fit", "Fly to", "Seam tour")),
            *(partial(self._drag, button) for button in (LEFT, MIDDLE, RIGHT)),
            self._fly, self._wheel, self._double_click, self._bookmark, self._resize, self._share, self._play,
            self._select, self._drag_map, self._wheel_on_map, self._theme,
        )  # fmt: skip

    def move(self) -> str:
        """Do one of them, and say which."""
        return self.moves[int(self.rng.integers(len(self.moves)))]()

    def press(self, key: str) -> str:
        """Press a key."""
        QTest.keySequence(self.window, QKeySequence(key))
        return f"key {key}"

    def _button(self, text: str) -> str:
        next(action for action in self.window.findChildren(QAction) if action.text() == text).trigger()
        return f"button {text}"

    def _spot(self, canvas: Canvas) -> QPoint:
        width, height = canvas.plotter.width(), canvas.plotter.height()
        return QPoint(*(int(share * side) for share, side in zip(self.rng.uniform(0.3, 0.7, 2), (width, height), strict=True)))

    def _drag_in(self, canvas: Canvas, button: Qt.MouseButton, num_steps: int = 4) -> None:
        spot, view = self._spot(canvas), canvas.plotter
        step = QPoint(*(int(pixels) for pixels in self.rng.uniform(-18, 18, 2)))
        QTest.mouseMove(view, spot)
        QTest.mousePress(view, button, pos=spot)
        for _ in range(num_steps):
            spot += step
            QTest.mouseMove(view, spot)
            QTest.qWait(15)
        QTest.mouseRelease(view, button, pos=spot)

    def _drag(self, button: Qt.MouseButton) -> str:
        self._drag_in(self.window.view, button)
        return f"drag {button.name}"

    def _drag_map(self) -> str:
        self._drag_in(self.window.map, LEFT)
        return "drag on the map"

    def _fly(self) -> str:
        view, spot = self.window.view.plotter, self._spot(self.window.view)
        key = (Qt.Key.Key_W, Qt.Key.Key_A, Qt.Key.Key_S, Qt.Key.Key_D, Qt.Key.Key_E)[int(self.rng.integers(5))]
        QTest.mousePress(view, RIGHT, pos=spot)
        QTest.keyPress(view, key)
        QTest.qWait(120)
        QTest.keyRelease(view, key)
        QTest.mouseRelease(view, RIGHT, pos=spot)
        return f"fly {key.name}"

    def _turn_wheel(self, canvas: Canvas) -> None:
        view, spot = canvas.plotter, QPointF(self._spot(canvas))
        turn = QPoint(0, int(120 * self.rng.choice([-1, 1])))
        buttons, keys = Qt.MouseButton.NoButton, Qt.KeyboardModifier.NoModifier
        event = QWheelEvent(spot, view.mapToGlobal(spot), QPoint(), turn, buttons, keys, Qt.ScrollPhase.NoScrollPhase, False)
        QApplication.sendEvent(view, event)

    def _wheel(self) -> str:
        self._turn_wheel(self.window.view)
        return "wheel"

    def _wheel_on_map(self) -> str:
        self._turn_wheel(self.window.map)
        return "wheel on the map"

    def _double_click(self) -> str:
        view, spot = self.window.view.plotter, self._spot(self.window.view)
        QTest.mouseDClick(view, LEFT, pos=spot)
        # A double click of QTest ends with the button down.
        QTest.mouseRelease(view, LEFT, pos=spot)
        return "double click"

    def _bookmark(self) -> str:
        key = "Alt+5" if self._bookmarked and self.rng.random() < 0.6 else "Ctrl+Alt+5"
        self._bookmarked = True
        return self.press(key)

    def _resize(self) -> str:
        screen = self.window.screen().availableSize()
        size = [int(side * share) for side, share in zip(screen.toTuple(), self.rng.uniform(0.8, 1.0, 2), strict=True)]
        self.window.resize(*size)
        return f"resize {size}"

    def _share(self) -> str:
        self.window._share_views(float(self.rng.uniform(0.25, 0.6)))
        return "splitter"

    def _play(self) -> str:
        fly = self.window.docks.fly
        fly.add_view()
        if len(fly.keyframes) < 2:
            return "keyframe"
        fly.set_keyframes(fly.keyframes[-2:])
        fly.seconds.setValue(0.2)
        fly.play_or_stop()
        until(lambda: not fly._timer.isActive(), "the flight never ended")
        return "play"

    def _select(self) -> str:
        self.window.select_index(int(self.rng.integers(24)))
        return self.press("Return")

    def _theme(self) -> str:
        return self.press("Ctrl+D")


class Watcher:
    """Looks for balls and marks on the screen."""

    def __init__(self, window: InspectorWindow, town: Town) -> None:
        self.window, (self.balls, self.marks) = window, beacon_places(town)
        self.covered = np.concatenate([_along_borders(town), town.scene.cameras.centers])
        window.draw_mark(
            Layer(
                name="Beacons",
                points=self.marks,
                point_colors=np.tile(MARK.astype(np.uint8), (len(self.marks), 1)),
                point_size_px=7,
                square_points=True,
                in_front=True,
            )
        )
        # Balls in the air are what lies around this scene; the other layers would cover marks or balls.
        window.set_layer_visible("Surroundings", True)
        for name in ("Regions", "Edges", "Edge loads", "Seams"):
            window.set_layer_visible(name, False)
        self.num_seen, self.worst_px, self.moved = 0, 0.0, ""

    def settle(self) -> None:
        """Wait until both views show the model for their cameras, and it is painted."""
        model = self.window.model
        assert model is not None
        QTest.qWait(30)
        until(lambda: model.shown_is_full and model._map_drawn == model._map_key(), f"never sharp after {self.moved}")
        QTest.qWait(REST_MS)

    def check(self, moved: str) -> None:
        """Both views after a move; AssertionError names it, the place and where it is instead."""
        self.moved = moved
        self.settle()
        try:
            self._look_at_both()
        except AssertionError:
            save_png(SEEN, pixels_of(self.window))
            raise

    def _look_at_both(self) -> None:
        screen = pixels_of(self.window)
        for canvas in (self.window.view, self.window.map):
            for color, places, what in ((BALL, self.balls, "the model's ball"), (MARK, self.marks, "the layer's mark")):
                self._look(canvas, screen, color, places, what)

    def _look(self, canvas: Canvas, screen: np.ndarray, color: np.ndarray, places: np.ndarray, what: str) -> None:
        width, height = canvas.size_wh
        corner = canvas.plotter.mapTo(self.window, QPoint(0, 0)) * self.window.devicePixelRatioF()
        shown = screen[corner.y() : corner.y() + height, corner.x() : corner.x() + width].astype(int)
        strength = np.clip(1 - np.abs(shown - color).sum(axis=2) / 200, 0, 1)
        expected, others = (
            self._expected(canvas, each) for each in ((places, self.marks) if places is self.balls else (places, self.balls))
        )
        for index in self._fit_to_be_seen(canvas, expected, others, places is self.balls):
            x, y = expected[index]
            reach = int(SPACING_PX // 2)
            rows, columns = (np.arange(int(at) - reach, int(at) + reach + 1) for at in (y, x))
            near = strength[np.ix_(rows, columns)]
            where = f"{'map' if canvas.is_map else '3D'}, {x:.0f}, {y:.0f} px"
            assert near.sum() > 4, f"{self.moved}: {what} {index} is not where the camera has it, {where}"
            at = np.array([(near * (columns + 0.5)[None]).sum(), (near * (rows + 0.5)[:, None]).sum()]) / near.sum()
            error = float(np.linalg.norm(at - (x, y)))
            self.num_seen, self.worst_px = self.num_seen + 1, max(self.worst_px, error)
            assert error <= NEAR_PX, f"{self.moved}: {what} {index} is {error:.1f} px away from where the camera has it"

    def _along_lines(self) -> np.ndarray:
        """Places (K,3) along the lines that are drawn: the frame of a selected camera is wide."""
        shown = [*self.window.visible_layers(), *self.window._marks._layers.values()]
        ends = np.concatenate([np.zeros((1, 2, 3)), *(layer.segments for layer in shown)])
        shares = np.linspace(0, 1, 40)[:, None, None]
        return ((1 - shares) * ends[None, :, 0] + shares * ends[None, :, 1]).reshape(-1, 3)

    def _expected(self, canvas: Canvas, places: np.ndarray) -> np.ndarray:
        """Places (K,3) as the canvas's own camera has them, px (K,2) from the upper left."""
        return canvas.pixels_of(places) * (1, -1) + (0, canvas.size_wh[1])

    def _fit_to_be_seen(self, canvas: Canvas, expected: np.ndarray, others: np.ndarray, are_balls: bool) -> np.ndarray:
        """Of the expected places (K,2) px those inside of the view, apart from all others (K,2) px
        and, of balls, of a size that has a middle."""
        with np.errstate(invalid="ignore"):
            chosen = ((expected > EDGE_PX) & (expected < np.array(canvas.size_wh) - EDGE_PX)).all(axis=1)
            chosen &= (_away_px(expected, expected) < SPACING_PX).sum(axis=1) == 1
            chosen &= ~(_away_px(expected, others) < OTHER_PX).any(axis=1)
            chosen &= ~(_away_px(expected, self._expected(canvas, self.covered)) < COVERED_PX).any(axis=1)
            chosen &= ~(_away_px(expected, self._expected(canvas, self._along_lines())) < LINE_PX).any(axis=1)
            if are_balls:
                # Their standard deviation across the view.
                rims = [self._expected(canvas, self.balls + BALL_M * step) for step in np.eye(3)]
                radius = np.max([np.linalg.norm(rim - expected, axis=1) for rim in rims], axis=0)
                chosen &= (radius > LEAST_BALL_PX) & (radius < LARGEST_BALL_PX)
        return np.flatnonzero(chosen)


def _along_borders(town: Town) -> np.ndarray:
    """Places (K,3) every metre or so along all borders."""
    ends = [(start, end) for border in town.cloud_plan.borders for start, end in zip(border, np.roll(border, -1, axis=0), strict=True)]
    lines = np.concatenate([np.linspace(start, end, 150) for start, end in ends])
    return np.column_stack([lines, np.zeros(len(lines))])


def _away_px(places: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Distances (K,L), infinite to what is behind the camera."""
    return np.nan_to_num(np.linalg.norm(places[:, None] - others[None], axis=2), nan=np.inf)


def pixels_of(window: QWidget) -> np.ndarray:
    """What the screen shows of a window (H,W,3), in pixels of the screen."""
    picture = window.screen().grabWindow(int(window.winId())).toImage().convertToFormat(QImage.Format.Format_RGB888)
    rows = np.frombuffer(picture.constBits(), np.uint8).reshape(picture.height(), picture.bytesPerLine())
    # A copy: the picture ends with this function.
    return rows[:, : 3 * picture.width()].reshape(picture.height(), picture.width(), 3).copy()


def act(window: InspectorWindow, town: Town, seed: int, number: int) -> None:
    """Move so often, look after each move, and print what was seen."""
    watcher, mover = Watcher(window, town), Mover(window, seed)
    watcher.check("the first picture")
    for step in range(number):
        # First there and back: to fit once more is to come to a camera that was there before.
        name = mover.move() if step >= len(THERE_AND_BACK) else mover.press(THERE_AND_BACK[step])
        pose = window.view.pose
        assert np.isfinite(pose.position).all()
        if pose.position[2] < 3 or np.linalg.norm(pose.focal_point[:2]) > 3 * HALF_WH[0]:
            # From below the ground, or far away, there is nothing to look for.
            window.reset_views()
            name += ", then Fit"
        watcher.check(f"step {step}, {name}")
        print(f"{step}: {name}, {watcher.num_seen} seen, worst {watcher.worst_px:.2f} px", file=sys.stderr, flush=True)
    print(json.dumps({"seen": watcher.num_seen, "worst_px": round(watcher.worst_px, 2)}))


def main(run: str, seed: str, number: str, *painter: Painter) -> None:
    """Open the window of a run that `with_beacons` made, and move its views."""
    use_window(Path(run), lambda window: act(window, made_up_town(), int(seed), int(number)), *painter)


if __name__ == "__main__":
    main(*sys.argv[1:])
