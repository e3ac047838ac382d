"""What tests of photographs that stay on their devices share."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

from radiant_app.config.run_config import TrainOptions
from radiant_app.events import Event
from radiant_app.reporting import EventReporter
from radiant_app.workers.tasks import PlacingTask, SfmSettings

TINY = TrainOptions(long_side_px=96, num_steps=60, max_num_splats=1500)
ONE_EDGE = '[[edge]]\nid = "north"\n[[edge.device]]\nid = "north-1"\n[[edge.device]]\nid = "south-1"\n'
TWO_EDGES = "".join(f'[[edge]]\nid = "{edge}"\n[[edge.device]]\nid = "{edge}-1"\n' for edge in ("north", "south"))


def reporter(stage: str, listen: Callable[[Event], None] = lambda event: None) -> EventReporter:
    return EventReporter(stage=stage, emit=listen)


def split_by_device(images: Path, target: Path) -> Path:
    for index, path in enumerate(sorted(images.iterdir())):
        folder = target / ("north-1" if index % 2 else "south-1")
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, folder / path.name)
    return target


def placing_in(source: Path) -> PlacingTask:
    """By GPS, of photographs in a device's own folder."""
    sfm = SfmSettings(matching="auto", seed=0)
    origin = (50.0, 8.0, 100.0)
    return PlacingTask(frames="gps", source=str(source), names=(), held_out=(), fetch=False, origin=origin, sfm=sfm, poses=None)
