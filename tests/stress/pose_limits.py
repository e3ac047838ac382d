"""How small a wrong convention the check of alignments sees: python -m tests.stress.pose_limits sample_scenes/town

Photographs are bent by a lens with one coefficient, the alignment has it with the other sign (k1), exchanged (p1 for p2) or
a principal point that is shifted; a row says what was refused. Of files that say what their photographs see (openMVG's
structure), and of those that do not (RealityScan's table).
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from radiant_core.errors import BadInput
from radiant_core.sfm.pose_project import read_project
from tests.core.io.poses import writers
from tests.core.io.poses.bent_hamlet import Truth, bent_scene


def is_refused(truth: Truth, write: Callable[..., Path], photos: Path) -> bool:
    """Whether the alignment of this truth is refused."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            read_project(write(Path(folder), truth), photos)
        except BadInput:
            return True
    return False


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", type=Path)
    scene = parser.parse_args().scene
    kinds = {"with observations": writers.openmvg, "without": writers.realityscan}
    with tempfile.TemporaryDirectory() as made:
        for value in (0.0025, 0.005, 0.01, 0.02, 0.04):
            truth = bent_scene(scene, Path(made) / "k", (-value, 0.0, 0.0, 0.0, 0.0))
            wrong = replace(truth, dist=(value, 0.0, 0.0, 0.0, 0.0))
            edge_px = 2 * value * (truth.width / 2 / truth.fx) ** 3 * truth.fx
            told = {name: is_refused(wrong, write, Path(made) / "k" / "images") for name, write in kinds.items()}
            print(f"k1 of the other sign, {value:g} ({edge_px:.2f} px at the side): refused {told}", flush=True)
        for value in (0.001, 0.002, 0.004, 0.008):
            truth = bent_scene(scene, Path(made) / "p", (-0.1, 0.0, value, 0.0, 0.0))
            wrong = replace(truth, dist=(-0.1, 0.0, 0.0, value, 0.0))
            edge_px = 3 * value * (truth.width / 2 / truth.fx) ** 2 * truth.fx
            told = {name: is_refused(wrong, write, Path(made) / "p" / "images") for name, write in kinds.items()}
            print(f"p1 for p2, {value:g} ({edge_px:.2f} px at the side): refused {told}", flush=True)
        truth = bent_scene(scene, Path(made) / "c", (-0.1, 0.0, 0.0, 0.0, 0.0))
        for shift in (0.5, 2.0, 8.0, 16.0, 32.0):
            wrong = replace(truth, cx=truth.cx + shift, cy=truth.cy + shift)
            told = {name: is_refused(wrong, write, Path(made) / "c" / "images") for name, write in kinds.items()}
            print(f"principal point {shift:g} px aside and below: refused {told}", flush=True)


if __name__ == "__main__":
    main()
