"""The demo: the sample town of the project's source, at a size that takes minutes on two cores."""

from __future__ import annotations

from pathlib import Path

import radiant_app
from radiant_app.config.run_config import RunConfig, TrainOptions
from radiant_core.errors import BadInput

DEMO_TRAINING = TrainOptions(preset="draft", long_side_px=400, num_steps=800, max_num_splats=20_000)


def sample_scenes_folder() -> Path:
    """The folder `sample_scenes` of the project's source, or that of the installed package, which
    has the town alone.

    Raises:
        BadInput: it is in neither place.
    """
    package = Path(radiant_app.__file__).resolve().parent
    for folder in (package.parent / "sample_scenes", package / "sample_scenes"):
        if (folder / "town").is_dir():
            return folder
    raise BadInput("the sample scenes are not in this installation: install Radiant's wheel again, or clone its repository.")


def demo_config(out: Path) -> RunConfig:
    """Two edges with two devices each on the sample town."""
    town = sample_scenes_folder() / "town"
    return RunConfig(source=town / "images", system=town / "system.toml", out=out, train=DEMO_TRAINING)
