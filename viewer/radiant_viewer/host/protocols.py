"""What docks and tools see of the window that holds them; each asks for the least it needs.

    StatusHost   a status bar and a way to read the files again: also a window without a plan
    Host         both views, the layers and marks in them, the selected camera and the theme
    PlanHost     for editing a plan: layers that change and a run that is replaced

Pure: it needs neither Qt nor VTK at run time.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

from radiant_core.numerics import FloatArray
from radiant_viewer.layers.layer import Layer
from radiant_viewer.layers.themes import Theme
from radiant_viewer.runs.run_view import RunView

if TYPE_CHECKING:
    from radiant_viewer.host.canvas import Canvas

_Result = TypeVar("_Result")


class StatusHost(Protocol):
    """A window with a status bar that can read its files again."""

    def show_status(self, message: str) -> None:
        """Show one line in the status bar."""
        ...

    def reload(self) -> None:
        """Read the files again and show what they hold now."""
        ...


class Host(StatusHost, Protocol):
    """A window with a map and a 3D view of the same layers."""

    map: Canvas
    view: Canvas
    origin: FloatArray
    """Of both views (3,) in the world."""
    layers: list[Layer]
    theme: Theme

    @property
    def crop_box(self) -> FloatArray | None:
        """The box (2,3) that hides what lies outside of it, or None."""
        ...

    @property
    def kept_path(self) -> Path | None:
        """The mask (.npy) of the Gaussians that the cleaning keeps, None for all."""
        ...

    def attempt(self, action: Callable[[], _Result]) -> _Result | None:
        """Return what `action` returns; for a RadiantError show its sentence and return None."""
        ...

    def set_layer_visible(self, name: str, visible: bool) -> None:
        """Show or hide a layer in both views; BadInput for an unknown name."""
        ...

    def visible_layers(self) -> list[Layer]:
        """Return the layers that are shown, from the ground up."""
        ...

    def draw_mark(self, layer: Layer) -> None:
        """Draw a layer over all others in both views, in place of the mark of its name."""
        ...

    def remove_mark(self, name: str) -> None:
        """Remove the mark of this name, if there is one."""
        ...

    def render_views(self, *, map_only: bool = False) -> None:
        """Draw both views, or the map alone; nothing before the window is shown."""
        ...

    def select_camera(self, name: str) -> None:
        """Select a photograph and its camera everywhere; BadInput for an unknown name."""
        ...

    def fly_to_selected(self) -> None:
        """Move the 3D view to the selected camera."""
        ...


class PlanHost(Host, Protocol):
    """A window whose plan can be replaced."""

    def replace_layer(self, layer: Layer, *, map_only: bool = False) -> None:
        """Draw a layer in place of the one of its name; on the map alone while a drag lasts."""
        ...

    def show_run(self, run: RunView) -> None:
        """Show the same run with another plan."""
        ...
