"""Reports whose pictures are blank: to draw them takes longer than all stages of a tiny run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_app.events import Listener
from radiant_app.files.run_folder import Manifest
from radiant_app.report import html
from radiant_app.report.prediction_error import SYSTEM_NAME

BLANK = np.full((2, 2, 3), 255, np.uint8)


_DRAWN = {"_save_pictures": html._save_pictures, "_save_sides": html._save_sides}


def leave_pictures_blank(patch: pytest.MonkeyPatch) -> None:
    """From here on, reports that this process writes have blank pictures of the same names."""
    patch.setattr(html, "_save_pictures", _save_blank_pictures)
    patch.setattr(html, "_save_sides", _save_blank_sides)


@contextmanager
def drawn_pictures() -> Iterator[None]:
    """Within the block, reports have the pictures that they have outside of tests."""
    with pytest.MonkeyPatch.context() as patch:
        for name, function in _DRAWN.items():
            patch.setattr(html, name, function)
        yield


@pytest.fixture(scope="session", autouse=True)
def blank_pictures() -> Iterator[None]:
    """Runs that tests and their fixtures make leave pictures blank, but within `drawn_pictures`."""
    with pytest.MonkeyPatch.context() as patch:
        leave_pictures_blank(patch)
        yield


@pytest.fixture(autouse=True)
def pictures_of_a_test(request: pytest.FixtureRequest) -> Iterator[None]:
    """Runs that a test marked `draws` makes itself draw their pictures."""
    with nullcontext() if request.node.get_closest_marker("draws") is None else drawn_pictures():
        yield


def _save_blank_pictures(run: Path, manifest: Manifest, listen: Listener, *, has_borders: bool) -> dict[str, Path]:
    names = ["timeline", "regions", "regions_phone", "cameras"]
    names += ["gantt"] if (run / SYSTEM_NAME).is_file() else []
    names += ["timeline_emulated"] if manifest.emulated else []
    names += ["seams"] if has_borders else []
    return {name: _save_blank(run / "pictures" / f"{name}.png") for name in names}


def _save_blank_sides(run: Path, listen: Listener) -> list[str]:
    _save_blank(run / "pictures" / "model.png")
    return [html._jpeg(BLANK)] * 2


def _save_blank(path: Path) -> Path:
    path.parent.mkdir(exist_ok=True)
    assert cv2.imwrite(str(path), BLANK)
    return path
