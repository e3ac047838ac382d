"""The page of `radiant measure --since`: both dates with the patches, what was compared, and a
table."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jinja2 import Environment, PackageLoader
from numpy.typing import NDArray

from radiant_core.io.run_store import write_atomic
from radiant_core.survey.change import Change

MAX_SIDE_PX = 1200
COLORS = {"height": (200, 40, 30), "both": (150, 30, 160), "colour": (30, 80, 200)}
_PALE = 0.25


def write_change_page(
    path: Path, change: Change, images: Sequence[NDArray[np.uint8]], rows: Sequence[Mapping[str, Any]], figures: Mapping[str, Any]
) -> None:
    """Write one self-contained page; images are the older and the newer orthophoto (H,W,3)."""
    page = Environment(loader=PackageLoader("radiant_app"), autoescape=True).get_template("change.html.j2")
    named = [("Before", _outlined(images[0], change)), ("After", _outlined(images[1], change)), ("Height change", _heights(change))]
    pictures = [(name, b64encode(_png(picture)).decode()) for name, picture in named]
    text = page.render(rows=rows, figures=figures, pictures=pictures, colors={name: f"rgb{color}" for name, color in COLORS.items()})
    write_atomic(path, text.encode())


def _outlined(image: NDArray[np.uint8], change: Change) -> NDArray[np.uint8]:
    """A picture made paler, with the outlines of the patches and their numbers."""
    factor = min(1.0, MAX_SIDE_PX / max(image.shape[:2]))
    size = max(1, round(image.shape[1] * factor)), max(1, round(image.shape[0] * factor))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    picture = np.ascontiguousarray(small + (255 - small.astype(np.float32)) * _PALE, np.uint8)
    for number, patch in enumerate(change.patches, 1):
        corners = np.rint(change.grid.cells_of(patch.outline)[:, ::-1] * factor).astype(np.int32)
        cv2.polylines(picture, [corners], True, COLORS[patch.kind], 2, cv2.LINE_AA)
        at = int(corners[:, 0].max()) + 3, int(corners[:, 1].mean()) + 4
        cv2.putText(picture, str(number), at, cv2.FONT_HERSHEY_SIMPLEX, 0.45, COLORS[patch.kind], 1, cv2.LINE_AA)
    return picture


def _heights(change: Change) -> NDArray[np.uint8]:
    """Falls blue, rises red, grey where nothing can be compared."""
    has_change = np.isfinite(change.height_change)
    span = max(float(np.quantile(np.abs(change.height_change[has_change]), 0.995)), 1e-6) if has_change.any() else 1.0
    share = np.clip(np.where(has_change, change.height_change, 0) / span, -1, 1)[..., None]
    red, blue = np.array([200.0, 40, 30]), np.array([30.0, 80, 200])
    picture = 255 + np.where(share > 0, share * (red - 255), -share * (blue - 255))
    picture[~has_change] = 215
    return _outlined(picture.astype(np.uint8), change)


def _png(picture: NDArray[np.uint8]) -> bytes:
    is_encoded, coded = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))
    assert is_encoded
    return coded.tobytes()
