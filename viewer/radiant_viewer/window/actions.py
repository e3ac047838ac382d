"""The toolbar and the keys of the inspector's window. Needs the `desktop` extra."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Protocol, TypeVar

from PySide6.QtCore import Qt
from PySide6.QtGui import QAction, QKeySequence, QShortcut
from PySide6.QtWidgets import QMainWindow, QPushButton

from radiant_viewer.editing.planning import Planning
from radiant_viewer.host.canvas import Canvas
from radiant_viewer.host.one_tool import keep_one_on
from radiant_viewer.layers.themes import ThemeName
from radiant_viewer.pictures.view_motion import SIDE_KEYS, Side
from radiant_viewer.runs.run_view import RunView
from radiant_viewer.window.bookmark_keys import BOOKMARK_KEYS
from radiant_viewer.window.docks import Docks
from radiant_viewer.window.panels import Panels
from radiant_viewer.window.shortcuts import show_shortcuts

STEPS = (("Left", -1, "worse"), ("Right", 1, "better"))
_Entry = tuple[str, str, str, Callable[[], object] | None]
"""Text, tip, key and action; one without a text has its button in a dock, or none."""
_Toggle = tuple[str, str, str, Callable[[bool], object]]
_Result = TypeVar("_Result")


class ActionWindow(Protocol):
    """What keys and buttons do with a window; its methods say what they do."""

    run: RunView | None
    view: Canvas
    docks: Docks
    planning: Planning | None
    panels: Panels
    dark_button: QAction | None
    edit_button: QAction | None

    def attempt(self, action: Callable[[], _Result]) -> _Result | None: ...
    def reload(self) -> None: ...
    def reset_views(self) -> None: ...
    def fly_to_selected(self) -> None: ...
    def see_from(self, side: Side) -> None: ...
    def begin_tour(self) -> None: ...
    def ask_screenshot(self) -> None: ...
    def ask_window_picture(self) -> None: ...
    def set_theme(self, name: ThemeName) -> None: ...
    def set_editing(self, active: bool) -> None: ...
    def set_measuring(self, active: bool) -> None: ...
    def set_cropping(self, active: bool) -> None: ...
    def choose_by(self, button: QPushButton) -> None: ...
    def show_places(self) -> object: ...


def add_actions(window: ActionWindow, frame: QMainWindow) -> dict[str, str]:
    """Make toolbar and keys of a window in its frame; returns what each key does, for F1."""
    bar = frame.addToolBar("View")
    bar.setMovable(False)
    bar.setContextMenuPolicy(Qt.ContextMenuPolicy.PreventContextMenu)
    shortcuts: dict[str, str] = {}
    for text, tip, key, action in (*_entries(window, lambda: show_shortcuts(frame, shortcuts)), *_choosing(window)):
        if action is None:
            continue
        shortcuts[key] = tip
        if text:
            button = bar.addAction(text, action)
            button.setToolTip(f"{tip} ({key})")
            button.setShortcut(QKeySequence(key))
        else:
            QShortcut(QKeySequence(key), frame).activated.connect(action)
    shortcuts |= BOOKMARK_KEYS
    for text, tip, key, toggle in _toggles(window):
        shortcuts[key] = tip
        button = bar.addAction(text)
        button.setCheckable(True)
        button.setToolTip(f"{tip} ({key})")
        button.setShortcut(QKeySequence(key))
        button.toggled.connect(toggle)
        if text == "Dark":
            window.dark_button = button
        if text == "Edit plan":
            window.edit_button = button
        if text == "Measure":
            window.docks.survey.click.toggled.connect(button.setChecked)
            keep_one_on(window.docks.click_buttons)
        if text == "Crop":
            window.docks.cleaning.box.active.toggled.connect(button.setChecked)
    bar.addWidget(window.panels.button)
    return shortcuts


def _entries(window: ActionWindow, help_: Callable[[], object]) -> tuple[_Entry, ...]:
    docks, planning = window.docks, window.planning
    photo, seams = docks.photo, docks.seams
    actions = None if planning is None else planning.actions
    undo, redo = _undoing(window)
    return (
        ("Fit", "Fit the scene into both views", "F", window.reset_views),
        *(("", f"See the scene from {word}", f"Ctrl+{key}", partial(window.see_from, side)) for key, side, word in SIDE_KEYS),
        ("", "See again what the 3D view showed before the last move", "V", window.view.go_back),
        ("Places…", "Titles and notes of the bookmarked views, for the page that is sent", "Shift+V", window.show_places),
        ("Fly to", "See the scene from the selected camera", "Return", window.fly_to_selected if window.run else None),
        ("Worst photograph", "The held-out photograph with the lowest PSNR", "W", photo.show_worst if photo else None),
        *(("", f"The next {word} held-out photograph", f"Alt+{key}", partial(photo.step, by)) for key, by, word in STEPS if photo),
        ("Seam tour", "The worst seam first", "T", window.begin_tour if seams else None),
        ("", "The next seam", "N", (lambda: seams.step(1)) if seams else None),
        ("", "The seam before", "Shift+N", (lambda: seams.step(-1)) if seams else None),
        ("", "Keep what the clicked places measure", "Shift+M", lambda: window.attempt(docks.survey.take)),
        ("", "Take the last place, corner or stroke back", "Backspace", docks.undo_corner),
        ("", "End measuring, drawing, lasso and brush; choose nothing", "Escape", docks.end_clicks),
        ("", "Add the 3D view as a keyframe", "K", docks.fly.add_view),
        ("", "Undo the last edit of the plan, or of the cleaning while its panel is in front", "Ctrl+Z", undo),
        ("", "Redo it", "Ctrl+Shift+Z", redo),
        ("", "Save the edited plan", "Ctrl+Shift+P", actions.ask_save if actions else None),
        ("", "Save the plan's regions for a GIS, as GeoJSON", "Ctrl+G", actions.ask_regions if actions else None),
        ("Screenshot…", "Save map and 3D view as PNG", "Ctrl+S", window.ask_screenshot),
        ("", "Save the whole window as PNG", "Ctrl+Shift+S", window.ask_window_picture),
        ("", "Read the run anew", "F5", window.reload),
        ("", "Show all keys and what the mouse does", "F1", help_),
    )


def _undoing(window: ActionWindow) -> tuple[Callable[[], None], Callable[[], None]]:
    """Undo and redo of the plan while it is edited, of the cleaning while its panel is in front,
    else of the plan where there is one."""
    cleaning, planning = window.docks.cleaning, window.planning

    def is_of_plan() -> bool:
        is_edited = window.edit_button is not None and window.edit_button.isChecked()
        return planning is not None and (is_edited or not cleaning.is_in_front)

    def undo() -> None:
        planning.actions.undo() if planning is not None and is_of_plan() else cleaning.undo_last()

    def redo() -> None:
        planning.actions.redo() if planning is not None and is_of_plan() else cleaning.redo_last()

    return undo, redo


def _choosing(window: ActionWindow) -> tuple[_Entry, ...]:
    """Keys of lasso and brush, where there is a model."""
    select = window.docks.cleaning.select
    if select is None:
        return ()
    return (
        ("Lasso", "Choose Gaussians with a lasso in the 3D view", "L", partial(window.choose_by, select.lasso)),
        ("", "Choose Gaussians with a brush in the 3D view", "Shift+L", partial(window.choose_by, select.brush)),
        ("", "Leave out what lasso and brush chose", "Delete", lambda: window.attempt(select.make_step)),
    )


def _toggles(window: ActionWindow) -> tuple[_Toggle, ...]:
    editing: tuple[_Toggle, ...] = (("Edit plan", "Drag edges and borders, select cameras on the map", "E", window.set_editing),)
    return (
        *(editing if window.planning else ()),
        ("Measure", "Measure by clicks in both views, with σ", "M", window.set_measuring),
        ("Crop", "Cleaning: hide what lies outside a box", "B", window.set_cropping),
        ("Dark", "Dark or light theme", "Ctrl+D", lambda dark: window.set_theme("dark" if dark else "light")),
    )
