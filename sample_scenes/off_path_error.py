"""How runs look from views that their photographs were not taken from.

    python sample_scenes/off_path_error.py TOWN RUN [RUN ...]

TOWN/off_path: what `generate.py --off-path N` writes. Prints the mean PSNR of each run's model.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.off_path import load_off_path
from radiant_app.commands.survey.parts import load_survey


def main() -> None:
    """Score the models of some runs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("town", type=Path)
    parser.add_argument("runs", type=Path, nargs="+")
    parser.add_argument("--long-side-px", type=int, default=384)
    chosen = parser.parse_args()
    for folder in chosen.runs:
        survey = load_survey(folder)
        figures = load_off_path(chosen.town / "off_path", survey.run.scene.cameras, chosen.long_side_px).score(survey.splats)
        kinds = ", ".join(f"{kind} {figures.of_kind(kind).mean('psnr_db'):.2f}" for kind in figures.kinds)
        print(f"{folder.name}: {figures.mean('psnr_db'):.2f} dB ({kinds})")


if __name__ == "__main__":
    main()
