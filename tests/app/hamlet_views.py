"""Views of the hamlet that were never flown, as the generator adds them to a scene."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import generate
from radiant_app.commands.run.demo import sample_scenes_folder
from scenegen.config import SceneConfig


def add_off_path(folder: Path, count: int) -> Path:
    """Copy the hamlet into `folder` and return the folder of so many views beside its flight."""
    hamlet = sample_scenes_folder() / "hamlet"
    stored = json.loads((hamlet / "known" / "frame.json").read_text())["config"]
    for name in ("images", "known"):
        shutil.copytree(hamlet / name, folder / name)
    generate.generate(SceneConfig(**{**stored, "extent_m": tuple(stored["extent_m"]), "off_path": count}), folder)
    return folder / "off_path"
