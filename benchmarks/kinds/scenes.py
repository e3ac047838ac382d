"""Kinds of scenes to test defaults on, made by the generator of the sample scenes. Once per kind
and number of photographs, in seconds.

A scene is a COLMAP project with the true cameras and with surface points where photographs have
contrast: OUT/scenes/KIND-PHOTOGRAPHS-WIDTHpx/{images,sparse/0}. Flights grow with their
photographs, whose overlap stays as it is; of what is walked around or stood in there are more
pictures.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from radiant_app.commands.run.demo import sample_scenes_folder
from radiant_core.errors import BadInput

POINTS_PER_PHOTOGRAPH, FEWEST_POINTS = 60, 1_500
FLOWN_M, FLOWN_PHOTOGRAPHS = (120.0, 80.0), 60
"""Width and height over which so many photographs are flown."""
WALKED_M_PER_PHOTOGRAPH, LONGEST_WALK_M = 1.5, 150.0


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One kind of scene."""

    switches: Callable[[int], list[str]]
    """Arguments of the generator for so many photographs."""
    about: str
    """What is special about it, in a few words."""


def _flown(*more: str) -> Callable[[int], list[str]]:
    def switches(num_photographs: int) -> list[str]:
        width, height = np.array(FLOWN_M) * np.sqrt(num_photographs / FLOWN_PHOTOGRAPHS)
        return ["--flight", "survey", "--extent-m", f"{width:.1f}x{height:.1f}", *more]

    return switches


def _walked(num_photographs: int) -> list[str]:
    length_m = max(12.0, min(LONGEST_WALK_M, WALKED_M_PER_PHOTOGRAPH * num_photographs))
    return ["--flight", "street", "--extent-m", f"{length_m:.1f}x30"]


def _around(flight: str, *more: str) -> Callable[[int], list[str]]:
    return lambda num_photographs: ["--flight", flight, "--no-gps", *more]


KINDS: Mapping[str, Kind] = {
    "turntable": Kind(switches=_around("turntable"), about="an object turns before a still wall, the lamp stands beside the camera"),
    "room": Kind(switches=_around("room"), about="a furnished room from inside, bare walls, a window"),
    "street": Kind(switches=_walked, about="a walk along a street"),
    "facade": Kind(switches=_around("facade"), about="the fronts of three houses from across the street"),
    "clouds": Kind(switches=_flown("--cloud-shadow", "0.8"), about="a survey under clouds that drift"),
    "mixed": Kind(switches=_flown("--num-lenses", "2"), about="a survey by two cameras: lens, size and exposure differ"),
    "survey": Kind(switches=_flown(), about="a survey in even light, a seventh of it oblique"),
    "orbit": Kind(switches=_around("orbit", "--extent-m", "60x40"), about="a block of houses from all sides, sky above"),
    "shaken": Kind(switches=_flown("--shaken-share", "0.15"), about="a survey of which every seventh photograph is blurred"),
}


def make_scene(out: Path, kind: str, num_photographs: int, long_side_px: int) -> Path:
    """The folder of a scene, made where it is not there yet.

    Raises:
        BadInput: there is no generator in this installation, or it fails; the message is its own.
    """
    project = out / "scenes" / f"{kind}-{num_photographs}-{long_side_px}px"
    if project.is_dir():
        return project
    project.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=".partial-", dir=project.parent) as temporary:
        scene = Path(temporary) / "made"
        _generate(scene, [*KINDS[kind].switches(num_photographs), *_size(num_photographs, long_side_px)])
        (scene / "sparse").mkdir()
        (scene / "known").rename(scene / "sparse" / "0")
        # A call beside this one may have been faster.
        if not project.is_dir():
            shutil.move(scene, project)
    return project


def _size(num_photographs: int, long_side_px: int) -> list[str]:
    points = max(FEWEST_POINTS, POINTS_PER_PHOTOGRAPH * num_photographs)
    return [
        *("--num-cameras", str(num_photographs), "--num-known-points", str(points), "--textured-points"),
        *("--width-px", str(long_side_px), "--height-px", str(round(0.75 * long_side_px)), "--jpeg-quality", "92"),
    ]


def _generate(folder: Path, switches: list[str]) -> None:
    generator = sample_scenes_folder() / "generate.py"
    if not generator.is_file():
        raise BadInput("kinds of scenes are made by sample_scenes/generate.py, which this installation lacks: clone Radiant's repository.")
    command = [sys.executable, str(generator), "--out", str(folder), *switches]
    ended = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "TERM": "dumb"}, check=False)
    if ended.returncode:
        last = (ended.stderr.strip().splitlines() or ["it said nothing"])[-1]
        raise BadInput(f"the generator of sample scenes failed with exit code {ended.returncode}: {last}")
