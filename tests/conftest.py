"""What every test runs under: whatever is built of the types below is checked against its declared
shapes and numbers.

numpy products check themselves when they are built; their torch twins do not, for speed, so a wrong
shape would only show far away. Here jaxtyping proves each instance that any test brings about, with
one meaning per letter within an instance.
"""

from __future__ import annotations

import atexit
import functools
import gc
import os
from collections.abc import Callable
from dataclasses import fields
from typing import Any

# OpenMP reads both when torch is imported.
os.environ.setdefault("GOMP_SPINCOUNT", "0")
if "PYTEST_XDIST_WORKER_COUNT" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", str(max(1, (os.cpu_count() or 1) // int(os.environ["PYTEST_XDIST_WORKER_COUNT"]))))

import hypothesis
import jaxtyping
import numpy as np
import pytest
from jaxtyping import Float, Float32, Float64, Int64, UInt8
from torch import Tensor

from radiant_app.executors import local
from radiant_app.run import pooled
from radiant_app.run.few_photographs import Workforce
from radiant_core.aggregate.config import Refine
from radiant_core.cameras import Cameras
from radiant_core.render.contract import RenderOutput, SplatTensors
from radiant_core.scene import SfmScene
from radiant_core.splats import Splats
from tests import forked, whole_files
from tests.cpu_seconds import CpuSeconds
from tests.memory_folder import root_in_memory

pytest.MonkeyPatch().setattr(local, "LEAST_FORKED", 1)
pytest.MonkeyPatch().setattr(local, "open_server", forked.open_server_of_tests)
pytest.MonkeyPatch().setattr(local, "start_server", forked.start_server_of_tests)
# Runs of the smallest scene are dealt to all devices of their system; tests of `--devices auto` undo this.
pytest.MonkeyPatch().setattr(pooled, "choose_workforce", lambda config, system, *rest: Workforce(system=system))
forked.keep_until_the_end()
atexit.register(forked.end_all)

# No deadline: the first example pays for imports. The same examples each time, so that a failure is
# a failure for everybody.
hypothesis.settings.register_profile("radiant", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("radiant")


# Collections of garbage would look through libraries and some 9,000 tests again and again.
gc.disable()


def pytest_collection_finish() -> None:
    """What was imported and collected stays until the end."""
    gc.freeze()
    gc.enable()


_rounds_after: Callable[..., int] = Refine.rounds_after


def _two_rounds_at_most(refine: Refine, trainings: Any) -> int:
    """Runs whose trainings show each photograph a few times would be refined in five: 35 nodes in place of 14."""
    return refine.rounds or min(2, _rounds_after(refine, trainings))


@pytest.fixture
def usual_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many rounds of refining as outside of tests."""
    monkeypatch.setattr(Refine, "rounds_after", _rounds_after)


def pytest_configure(config: pytest.Config) -> None:
    # Tests of stress write more than memory holds, and measure it.
    if config.getoption("markexpr") == "not stress":
        pytest.MonkeyPatch().setattr(Refine, "rounds_after", _two_rounds_at_most)
        if root := root_in_memory():
            os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(root))
    config.pluginmanager.register(CpuSeconds(), "cpu seconds")
    config.pluginmanager.register(whole_files, "whole files")


_SPLATS = {"means": "N 3", "quats": "N 4", "log_scales": "N 3", "logit_opacities": "N", "sh0": "N 1 3", "shN": "N K 3"}
_RENDER = {"images": "C H W 3", "alphas": "C H W", "depths": "C H W", "radii_px": "C N", "means2d": "C N 2"}

SHAPES: dict[type, dict[str, Any]] = {
    Cameras: {
        "Ks": Float64[np.ndarray, "C 3 3"],
        "cam_from_world": Float64[np.ndarray, "C 4 4"],
        "sizes_wh": Int64[np.ndarray, "C 2"],
    },
    SfmScene: {
        "points": Float64[np.ndarray, "P 3"],
        "colors": UInt8[np.ndarray, "P 3"],
        "observations": Int64[np.ndarray, "T 2"],
    },
    Splats: {name: Float32[np.ndarray, shape] for name, shape in _SPLATS.items()},
    SplatTensors: {name: Float[Tensor, shape] for name, shape in _SPLATS.items()},
    RenderOutput: {name: Float[Tensor, shape] for name, shape in _RENDER.items()},
}


def check_shapes(product: object, shapes: dict[str, Any]) -> None:
    """Raise TypeError naming the first field whose shape or number type is not the declared one."""
    with jaxtyping.jaxtyped("context"):
        for name, declared in shapes.items():
            value = getattr(product, name)
            if not isinstance(value, declared):
                raise TypeError(f"{type(product).__name__}.{name} is {value.dtype} {tuple(value.shape)}, declared {declared}")


def _check_every_instance(kind: type, shapes: dict[str, Any]) -> None:
    assert set(shapes) <= {field.name for field in fields(kind)}
    build = kind.__init__

    @functools.wraps(build)
    def checked_build(self: object, *args: Any, **kwargs: Any) -> None:
        build(self, *args, **kwargs)
        check_shapes(self, shapes)

    kind.__init__ = checked_build


for _kind, _shapes in SHAPES.items():
    _check_every_instance(_kind, _shapes)
