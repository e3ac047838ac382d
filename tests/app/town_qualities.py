"""PSNR of the sample town at the three qualities of the start window: `python -m
tests.app.town_qualities SFM OUT`, SFM by `radiant sfm sample_scenes/town/images`, or a run of it.

One training of all photographs each, every eighth held out and compared in full size: at that of
each training a finer one has more detail to miss. Prints a line each with CPU seconds.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import get_args

import radiant
from radiant_app.commands.inspect.start_forecast import QualityName, quality_of

FULL_PX = 640


def main(sfm: Path, out: Path) -> None:
    """Train, and print what each quality has."""
    scene = radiant.load_scene(sfm)
    for name in get_args(QualityName):
        quality, began = quality_of(name), os.times()
        command = ["train", str(sfm), *quality.options, "--out", str(out / name)]
        subprocess.run([sys.executable, "-m", "radiant_app", *command], check=True, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        ended = os.times()
        cpu_s = ended.children_user + ended.children_system - began.children_user - began.children_system
        psnr_db = radiant.evaluate(radiant.load_splats(out / name / "scene.ply"), scene, long_side_px=FULL_PX).mean_psnr_db
        print(f"{name}: {psnr_db:.2f} dB in {cpu_s:.0f} CPU s (radiant {' '.join(command[:-2])})", flush=True)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
