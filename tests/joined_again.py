"""The cloud node of a finished run once more, within other limits, and what its scene is worth on the photographs that were left out."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from radiant_app.events import Decided, Event, Warned
from radiant_app.workers.nodes import run_node
from radiant_core.evaluate.image_error import psnr_db
from radiant_core.io.ply import load_ply
from radiant_core.io.records import load_cameras
from radiant_core.io.run_store import read_json, write_json
from radiant_core.render.rendered_view import render_views
from radiant_core.splats import Splats
from radiant_core.train.photographs import load_images


@dataclass(frozen=True)
class JoinedAgain:
    """What the cloud made of the edges' models, and what it said."""

    splats: Splats
    choice: str
    warnings: list[str]


def joined_again(run: Path, folder: Path, **limits: float) -> JoinedAgain:
    """Run the cloud node of `run` with other limits in the new `folder`."""
    shutil.copytree(run / "cloud", folder)
    task = read_json(folder / "task.json")
    write_json(folder / "task.json", {**task, "limits": {**task["limits"], **limits}})
    events: list[Event] = []
    run_node("cloud", folder, "cloud", events.append)
    (choice,) = [e.decision.choice for e in events if isinstance(e, Decided) and e.decision.topic == "aggregation"]
    warnings = [event.message for event in events if isinstance(event, Warned)]
    return JoinedAgain(splats=load_ply(folder / "scene.ply"), choice=choice, warnings=warnings)


def held_out_db(run: Path, splats: Splats) -> float:
    """Mean PSNR over the photographs that the run left out, at the size of its trainings."""
    cameras = load_cameras(run / "evaluation" / "held_out.safetensors")
    cameras = cameras.scaled(read_json(run / "cloud" / "task.json")["train"]["long_side_px"])
    images = load_images(run / "evaluation" / "photos", cameras)
    return float(np.mean([psnr_db(view.image, image / 255) for view, image in zip(render_views(splats, cameras), images, strict=True)]))
