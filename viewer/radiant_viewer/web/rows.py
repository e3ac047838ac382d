"""The lists of the web page as JSON values: layers, cameras, borders, and pictures as data URLs.

Pure but for reading photographs. Lists once per run, pictures once per selected camera.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from radiant_core.errors import BadInput
from radiant_viewer.layers.detail import moving_note
from radiant_viewer.layers.layer import Layer
from radiant_viewer.layers.palette import heat_table
from radiant_viewer.layers.themes import LIGHT, Theme, apply_theme, hex_color
from radiant_viewer.pictures.images import Image, load_image
from radiant_viewer.runs.camera_figures import CameraFigures, camera_figures
from radiant_viewer.runs.photo_access import find_photograph
from radiant_viewer.runs.run_figures import FIGURES, image_figures
from radiant_viewer.runs.run_view import RunView, comparison_paths
from radiant_viewer.runs.seam_findings import observed_text
from radiant_viewer.runs.seam_tour import SeamStop

SHOWN_PX = 1000
"""Long side of a picture as sent; one of 20 megapixels is 8 MB, and is shown 400 px wide."""
JPEG_QUALITY = 88
Row = dict[str, Any]


def layer_row(layer: Layer, theme: Theme = LIGHT) -> Row:
    """Return name, legend entries and colour bar of a layer under a theme."""
    themed = apply_theme(layer, theme)
    legend, scale = themed.legend, themed.heat
    entries = [{"text": entry.text, "color": hex_color(entry.color), "marker": entry.marker} for entry in legend]
    note = moving_note(layer)
    heat = scale and {"label": scale.label, "low": f"{scale.low:.4g}", "high": f"{scale.high:.4g}", "gradient": _gradient(scale.start)}
    return {"name": layer.name, "legend": entries, "note": note or "", "heat": heat}


def _gradient(start: float) -> str:
    """Return the heat scale from left to right as CSS."""
    colors = heat_table(start)[np.linspace(0, 255, 9).astype(int)]
    return f"linear-gradient(to right, {', '.join(hex_color(tuple(color)) for color in colors.tolist())})"


def run_camera_figures(run: RunView) -> CameraFigures:
    """Return all figures of all cameras: of plan and reconstruction, and of the scored pictures."""
    base = camera_figures(run.scene, run.roles, run.cloud_plan, run.psnr_db)
    scored = image_figures(run.folder)
    columns, headings = dict(base.columns), dict(base.headings)
    measured: dict[str, np.ndarray] = {}
    for figure in FIGURES:
        values = np.array([scored.get(name, {}).get(figure.key, np.nan) for name in run.scene.cameras.names], np.float64)
        if np.isfinite(values).any():
            measured[figure.key] = values
            headings[figure.key] = figure.heading
    # The table has it already as psnr_db.
    del columns["psnr"], headings["psnr"]
    # Figures first: a phone shows three columns, and the worst photograph is what is looked for.
    order = ["name", *measured, "use", "region", "device"]
    whole = columns | measured
    return CameraFigures(columns={key: whole[key] for key in dict.fromkeys([*order, *whole])}, headings=headings)


def camera_rows(figures: CameraFigures) -> list[Row]:
    """Return one row per camera in the scene's order, numbers as shown; `index` is the camera's."""
    decimals = {figure.key: figure.decimals for figure in FIGURES} | {"points": 0}
    columns = {
        key: [_number_text(value, decimals.get(key, 2)) for value in values.tolist()] if values.dtype.kind == "f" else values.tolist()
        for key, values in figures.columns.items()
    }
    return [{"index": index, **{key: column[index] for key, column in columns.items()}} for index in range(len(figures))]


def camera_headers(figures: CameraFigures) -> list[Row]:
    """Return the headings of the table in the order of its columns; figures are right-aligned."""
    return [
        {"key": key, "title": figures.headings[key], "align": "end" if values.dtype.kind == "f" else "start", "nowrap": True}
        for key, values in figures.columns.items()
    ]


def seam_rows(stops: Sequence[SeamStop], unit: str) -> list[Row]:
    """Return one row per border in the order of the tour."""
    return [
        {
            "index": index,
            "title": stop.title,
            "step": _number_text(stop.figures.step_levels, 1) or "–",
            "texture": _number_text(stop.figures.texture_levels, 1) or "–",
            "worst": _number_text(stop.worst_levels, 1) or "–",
            "observed": observed_text(stop.figures.observed_length, stop.length, unit),
            "verdict": stop.figures.verdict,
        }
        for index, stop in enumerate(stops)
    ]


def camera_pictures(run: RunView, index: int) -> Row:
    """Return photograph, render and difference of a camera as data URLs, "" with a reason where a
    picture is not here."""
    name = run.scene.cameras.names[index]
    row = {"photograph": "", "render": "", "difference": "", "reason": ""}
    if run.roles.held_out[index]:
        try:
            paths = comparison_paths(run, name)
        except BadInput as error:
            row["reason"] = str(error)
        else:
            return row | {key: data_url(load_image(path)) for key, path in zip(("photograph", "render", "difference"), paths, strict=True)}
    answer = find_photograph(run, index)
    if answer.path is None:
        return row | {"reason": answer.reason}
    return row | {
        "photograph": data_url(load_image(answer.path)),
        "reason": "A training photograph: only held-out ones are rendered.",
    }


def picture_url(path: Path) -> str:
    """Return a PNG of the run as a data URL, "" where there is none."""
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode() if path.is_file() else ""


def data_url(image: Image) -> str:
    """Return a picture (H,W,3), at most 1,000 px a side, as a JPEG in a data URL."""
    share = min(1.0, SHOWN_PX / max(image.shape[:2]))
    size_wh = (max(1, round(image.shape[1] * share)), max(1, round(image.shape[0] * share)))
    small = cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA) if share < 1 else image
    ok, data = cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    assert ok, "OpenCV could not write a JPEG of 8-bit colours"
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


def _number_text(value: float, decimals: int) -> str:
    return f"{value:,.{decimals}f}".replace("-", "−") if np.isfinite(value) else ""
