"""`WindowState`: the user's arrangement of a window, carried over when its run is read again. Needs
the `desktop` extra."""

from __future__ import annotations

from dataclasses import dataclass

from PySide6.QtCore import QRect

from radiant_core.numerics import FloatArray
from radiant_viewer.pictures.view_pose import ViewPose
from radiant_viewer.window.window import InspectorWindow


@dataclass(frozen=True, kw_only=True, eq=False)
class WindowState:
    """Poses of both views, visible layers, selection, docks in front and floating docks."""

    pose: ViewPose
    map_middle: FloatArray
    map_half_height: float
    visible: dict[str, bool]
    solo: str | None
    camera: str | None
    in_front: tuple[str, ...]
    floating: dict[str, QRect]
    keyframes: tuple[ViewPose, ...]
    is_editing: bool


def read_window_state(window: InspectorWindow) -> WindowState:
    """Return the state that `restore_window` gives to another window of the same run."""
    camera = window.map.plotter.camera
    selected = None if window.run is None or window.selected is None else window.run.scene.cameras.names[window.selected]
    docks = window.all_docks()
    planning = window.planning
    return WindowState(
        pose=window.view.pose,
        map_middle=window.map.pose.focal_point[:2],
        map_half_height=float(camera.parallel_scale),
        visible=window.layer_dock.checked(),
        solo=window.layer_dock.solo,
        camera=selected,
        in_front=tuple(dock.objectName() for dock in docks if not dock.visibleRegion().isEmpty()),
        floating={dock.objectName(): dock.geometry() for dock in docks if dock.isFloating()},
        keyframes=tuple(window.docks.fly.keyframes),
        is_editing=planning is not None and planning.tools.is_active,
    )


def restore_window(window: InspectorWindow, state: WindowState) -> None:
    """Arrange a window as another one was, as far as both have the same parts."""
    for dock in window.all_docks():
        if dock.objectName() in state.floating:
            dock.setFloating(True)
            dock.setGeometry(state.floating[dock.objectName()])
        if dock.objectName() in state.in_front:
            dock.raise_()
    layer_names = window.layer_dock.checked()
    for name, visible in state.visible.items():
        if name in layer_names:
            window.set_layer_visible(name, visible)
    if state.solo in layer_names:
        window.layer_dock.set_solo(state.solo)
    if state.is_editing and window.edit_button is not None:
        window.edit_button.setChecked(True)
    window.docks.fly.set_keyframes(state.keyframes)
    if window.run is not None and state.camera in window.run.scene.cameras.names:
        window.select_camera(state.camera)
    window.view.set_pose(state.pose)
    window.map.center_on(state.map_middle, state.map_half_height)
    window.render_views()
