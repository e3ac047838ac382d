"""PSNR of the sample town at the three qualities of the start window: `python -m
tests.app.town_qualities SFM OUT`, SFM by `radiant sfm sample_scenes/town/images`, or a run of it.

One training of all photographs each, every eighth held out; prints a line each with CPU seconds.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import get_args

from radiant_app.commands.inspect.start_forecast import QualityName, quality_of


def main(sfm: Path, out: Path) -> None:
    """Train, and print what each quality has."""
    for name in get_args(QualityName):
        quality, began = quality_of(name), os.times()
        command = ["train", str(sfm), *quality.options, "--out", str(out / name)]
        subprocess.run([sys.executable, "-m", "radiant_app", *command], check=True, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        ended = os.times()
        cpu_s = ended.children_user + ended.children_system - began.children_user - began.children_system
        psnr_db = json.loads((out / name / "metrics.json").read_text())["psnr_db"]
        print(f"{name}: {psnr_db:.2f} dB in {cpu_s:.0f} CPU s (radiant {' '.join(command[:-2])})", flush=True)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
