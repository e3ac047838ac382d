"""A folder of each kind given to `radiant run` without options: one line says what was found, and the run ends with a model in
the frame of the file. Metashape's is run with every suite, the others with `make stress`."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from radiant_core.georef.given_frame import load_given_frame
from radiant_core.io.ply import load_ply
from tests.app.test_alignments import WRITERS
from tests.colmap_projects import HAMLET, hamlet_model, write_model
from tests.core.io.film.films import photographs, shaken, write_film
from tests.core.io.poses.bent_hamlet import BROWN, SIMPLE, Truth
from tests.core.io.poses.test_readers import CENTRED, bent
from tests.forked import run_module

__all__ = ["bent"]
SMALL = ("--steps", "20", "--long-side-px", "96")
"""Of the training alone: what is found and placed is what a run without options finds."""


def _alignment(name: str) -> Callable[[Path, Path, Truth], str]:
    def make(folder: Path, images: Path, truth: Truth) -> str:
        shutil.copytree(images, folder / "images")
        path = WRITERS[name](folder, truth)
        return f"{path.parent.name if path.parent.name == 'corrected_cameras' else path.name} of "

    return make


def _colmap(folder: Path, images: Path, truth: Truth) -> str:
    del images, truth
    shutil.copytree(HAMLET / "images", folder / "images")
    write_model(folder / "sparse" / "0", hamlet_model())
    return "sparse/0 of COLMAP gives the poses of 12 photographs"


def _folders_and_masks(folder: Path, images: Path, truth: Truth) -> str:
    del images, truth
    for number, path in enumerate(sorted((HAMLET / "images").iterdir())):
        place = folder / "images" / f"flight_{number % 2}"
        place.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, place)
    mask = np.full((240, 320), 255, np.uint8)
    mask[:40] = 0
    (folder / "masks" / "flight_0").mkdir(parents=True)
    cv2.imwrite(str(folder / "masks" / "flight_0" / "drone_0000.png"), mask)
    return "masks/: masks of 1 of 12 photographs are used, black is left out."


def _film(folder: Path, images: Path, truth: Truth) -> str:
    del images, truth
    folder.mkdir(exist_ok=True)
    write_film(folder / "DJI_0007.MP4", shaken(photographs()))
    return "DJI_0007.MP4"


KINDS: dict[str, Callable[[Path, Path, Truth], str]] = {
    **{name: _alignment(name) for name in WRITERS},
    "sparse/0": _colmap,
    "folders and masks": _folders_and_masks,
    "film": _film,
}


LENSES = {"bundle.out": (SIMPLE, CENTRED), "keyframes/corrected_cameras/drone_0000.json": ((0.0,) * 5, {})}
"""Where a format cannot hold that of the others."""


@pytest.mark.parametrize("kind", [pytest.param(name, marks=() if name == "cameras.xml" else pytest.mark.stress) for name in KINDS])
def test_one_line_says_what_was_found(kind: str, bent, tmp_path: Path) -> None:
    images, truth = bent(*LENSES.get(kind, (BROWN, {})))
    folder, out = tmp_path / "dropped", tmp_path / "run"
    folder.mkdir()
    told = KINDS[kind](folder, images, truth)
    ended = run_module("radiant_app", "run", folder, "--out", out, *SMALL, timeout_s=600)
    assert ended.returncode == 0, ended.stderr
    warnings = json.loads((out / "manifest.json").read_text())["warnings"]
    lines = [warning for warning in warnings if told in warning and (kind not in WRITERS or "gives the poses of" in warning)]
    assert len(lines) == 1 and "\n" not in lines[0], warnings
    assert len(load_ply(out / "scene.ply")) > 100
    if kind in WRITERS:
        given = load_given_frame(out)
        assert "gives the poses of 12 photographs" in lines[0] and given is not None and given.is_default
