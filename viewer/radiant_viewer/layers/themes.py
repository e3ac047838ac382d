"""The light and the dark theme of the window: one table of colours for Qt, both views, and layers.

Pure: a `Theme` is plain colours; `apply_theme` recolours a layer. Once per change of theme.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from radiant_viewer.layers.layer import HeatScale, Layer
from radiant_viewer.layers.palette import BLUE, INK, SKY, WHITE, ColorArray, rgb, tint, trim_heat_colors

ThemeName = Literal["light", "dark"]
DARK_HEAT_START = 0.4
"""Of viridis: its blue-green stands out from a dark view by 3.5 : 1 in luminance, violet by 1.1."""
FILL_SHARE = 0.62
"""Share of the background in fills of regions in a dark view, as of white in a light one."""


@dataclass(frozen=True, kw_only=True)
class Theme:
    """Colours (3,), 0 to 255, of panels, fields, text, selection, and the views' ground and ink."""

    name: ThemeName
    panel: tuple[int, int, int]
    field: tuple[int, int, int]
    line: tuple[int, int, int]
    text: tuple[int, int, int]
    soft_text: tuple[int, int, int]
    accent: tuple[int, int, int]
    view: tuple[int, int, int]
    ink: tuple[int, int, int]


LIGHT = Theme(
    name="light",
    panel=(243, 244, 246),
    field=WHITE,
    line=(208, 212, 218),
    text=(31, 35, 41),
    soft_text=(98, 106, 117),
    accent=BLUE,
    view=WHITE,
    ink=INK,
)
DARK = Theme(
    name="dark",
    panel=(37, 40, 46),
    field=(28, 30, 35),
    line=(66, 71, 80),
    text=(226, 229, 234),
    soft_text=(150, 158, 170),
    accent=SKY,
    view=(24, 26, 30),
    ink=(205, 210, 218),
)
THEMES: dict[ThemeName, Theme] = {"light": LIGHT, "dark": DARK}


def apply_theme(layer: Layer, theme: Theme) -> Layer:
    """Return the layer and its legend in a theme's colours: ink, pale fills, and white become the
    theme's, and a heat scale begins where it is visible; other colours of data stay."""
    is_plain = not (len(layer.segments) or layer.polygons or layer.heat or any(entry.marker == "line" for entry in layer.legend))
    if theme.name == "light" or is_plain:
        # The same object, so that both views share the cached cloud.
        return layer
    strokes = np.array([entry.color for entry in layer.legend if entry.marker == "line"], np.uint8).reshape(-1, 3)
    inked = iter(_recolor_ink(strokes, theme).tolist())
    is_white = (layer.polygon_colors == 255).all(axis=1, keepdims=True)
    solid = np.where(is_white, np.array(theme.field, np.uint8), layer.polygon_colors)
    inked_layer = replace(
        layer,
        segment_colors=_recolor_ink(layer.segment_colors, theme),
        polygon_colors=_darken_fills(layer.polygon_colors, theme) if layer.pale_fills else solid,
        legend=tuple(replace(entry, color=tuple(next(inked))) if entry.marker == "line" else entry for entry in layer.legend),
    )
    return inked_layer if layer.heat is None else _trim_dark_end(inked_layer, layer.heat)


def hex_color(color: tuple[int, int, int]) -> str:
    """Return a colour as "#rrggbb"."""
    return "#{:02x}{:02x}{:02x}".format(*color)


def style_sheet(theme: Theme) -> str:
    """Return the style sheet of a theme, for what Qt's palette lacks."""
    panel, field, line, text, soft, accent = (
        hex_color(color) for color in (theme.panel, theme.field, theme.line, theme.text, theme.soft_text, theme.accent)
    )
    chosen = hex_color(rgb(tint(theme.accent, theme.field, 0.72)))
    return f"""
QMainWindow::separator {{ background: {panel}; width: 5px; height: 5px; }}
QDockWidget {{ font-weight: 600; }}
QTreeView, QTableView, QListView {{ background: {field}; border: 1px solid {line}; alternate-background-color: {panel};
  selection-background-color: {chosen}; selection-color: {text}; gridline-color: {line}; }}
QHeaderView {{ background: {panel}; }}
QHeaderView::section {{ background: {panel}; color: {soft}; border: none; border-bottom: 1px solid {line}; padding: 3px 6px; }}
QTableCornerButton::section {{ background: {panel}; border: none; }}
QToolBar {{ background: {panel}; border: none; border-bottom: 1px solid {line}; spacing: 2px; padding: 2px 4px; }}
QToolBar QToolButton {{ background: transparent; color: {text}; border: 1px solid transparent; border-radius: 4px; padding: 3px 8px; }}
QToolBar QToolButton[popupMode="2"] {{ padding-right: 18px; }}
QToolBar QToolButton::menu-indicator {{ subcontrol-origin: padding; subcontrol-position: right center; right: 5px; }}
QToolBar QToolButton:hover {{ border-color: {accent}; }}
QToolBar QToolButton:checked {{ background: {chosen}; border-color: {accent}; }}
QTabBar::tab {{ background: {panel}; color: {soft}; padding: 4px 10px; border: none; border-bottom: 2px solid transparent; }}
QTabBar::tab:selected {{ color: {text}; border-bottom: 2px solid {accent}; }}
QTabBar {{ qproperty-drawBase: 0; }}
QTreeView::indicator, QCheckBox::indicator {{ width: 12px; height: 12px; border: 1px solid {soft}; border-radius: 3px;
  background: {field}; }}
QTreeView::indicator:checked, QCheckBox::indicator:checked {{ background: {accent}; border-color: {accent}; }}
QStatusBar {{ background: {panel}; color: {soft}; border-top: 1px solid {line}; }}
QToolTip {{ background: {field}; color: {text}; border: 1px solid {line}; padding: 3px; }}
QLabel[soft="true"] {{ color: {soft}; }}
QScrollArea {{ border: none; }}
"""


def _recolor_ink(colors: ColorArray, theme: Theme) -> ColorArray:
    """Return colours (S,3) with ink, and greys between ink and white, in the theme's ink."""
    spread = colors.max(axis=1, initial=0).astype(int) - colors.min(axis=1, initial=255).astype(int) if len(colors) else np.zeros(0, int)
    is_ink = (spread < 20) & (colors.mean(axis=1) < 130) if len(colors) else np.zeros(0, bool)
    return np.where(is_ink[:, None], np.array(theme.ink, np.uint8), colors)


def _trim_dark_end(layer: Layer, heat: HeatScale) -> Layer:
    return replace(
        layer,
        point_colors=trim_heat_colors(layer.point_colors, DARK_HEAT_START),
        segment_colors=trim_heat_colors(layer.segment_colors, DARK_HEAT_START),
        polygon_colors=trim_heat_colors(layer.polygon_colors, DARK_HEAT_START),
        heat=replace(heat, start=DARK_HEAT_START),
    )


def _darken_fills(colors: ColorArray, theme: Theme) -> ColorArray:
    """Return fills (R,3) with the view's background in place of their 62 % of white."""
    pure = (colors.astype(np.float64) - FILL_SHARE * 255) / (1 - FILL_SHARE)
    return np.rint((1 - FILL_SHARE) * np.clip(pure, 0, 255) + FILL_SHARE * np.array(theme.view)).astype(np.uint8)
