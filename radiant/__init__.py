"""Radiant from Python: the stable surface. What is not named here may change in any version.

    scene = radiant.load_scene("SCENE")                  # a folder of `radiant sfm`, a run
    result = radiant.train(scene, num_steps=500)         # one model, as `radiant train`
    print(radiant.evaluate(result.splats, scene))        # on every eighth photograph
    radiant.save_splats(result.splats, "model.ply")

photographs → scene     reconstruct, load_scene              Scene, Cameras
scene → plan            plan_regions                         System, RegionPlan
scene → model           train, join, run                     TrainConfig, RunConfig, Part
model → picture         render (numpy), rasterize (torch)    Splats, SplatTensors
model → files           load_splats, save_splats, export
run → picture           picture
model → figures         evaluate                             Scores

Arrays are numpy's, in metres, OpenCV's axes, pixels from the corner of the picture. `rasterize`
alone takes torch tensors, for gradients. Examples in docstrings have `radiant`, `numpy` as `np`,
`torch`, `pathlib.Path` and `dataclasses.replace`; `help(radiant.train)` shows one. Every function
that takes longer has `listen`, for which `progress()` draws bars. Unusable input is `BadInput`, a
stage that fails is `StageFailed`, both `RadiantError`. Semantic versioning holds for the names in
`__all__`.
"""

from radiant.models import Scores, evaluate, export, join, load_splats, save_splats, train
from radiant.plans import RegionPlan, plan_regions
from radiant.scenes import Scene, load_scene, reconstruct
from radiant.showing import picture, progress
from radiant_app.commands.run.pipeline import RunResult, run
from radiant_app.config.run_config import PlanOptions, RunConfig, TrainOptions
from radiant_app.files.system_file import even_system, load_system
from radiant_core import __version__
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput, RadiantError, StageFailed
from radiant_core.plan.system import System
from radiant_core.render.contract import RenderOutput, SplatTensors
from radiant_core.render.rasterize import rasterize
from radiant_core.render.rendered_view import RenderedView
from radiant_core.render.rendered_view import render_views as render
from radiant_core.render.trajectories import Lens, cameras_looking_at, orbit
from radiant_core.splats import Splats
from radiant_core.train.config import TrainConfig, train_preset
from radiant_core.train.parts import Moment, Part
from radiant_core.train.results import TrainResult

__all__ = [
    "BadInput",
    "Cameras",
    "Lens",
    "Moment",
    "Part",
    "PlanOptions",
    "RadiantError",
    "RegionPlan",
    "RenderOutput",
    "RenderedView",
    "RunConfig",
    "RunResult",
    "Scene",
    "Scores",
    "SplatTensors",
    "Splats",
    "StageFailed",
    "System",
    "TrainConfig",
    "TrainOptions",
    "TrainResult",
    "__version__",
    "cameras_looking_at",
    "evaluate",
    "even_system",
    "export",
    "join",
    "load_scene",
    "load_splats",
    "load_system",
    "orbit",
    "picture",
    "plan_regions",
    "progress",
    "rasterize",
    "reconstruct",
    "render",
    "run",
    "save_splats",
    "train",
    "train_preset",
]
