"""The native rasterizer below its contract: refusals at its Python border, nothing unrequested."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from radiant_core import _native
from radiant_core.render.contract import SplatTensors, ViewOptions
from radiant_core.render.native_backend import instruction_sets, rasterize_native
from radiant_core.render.rasterize import rasterize
from tests.contract import gaussians

HEIGHT, WIDTH, COUNT = 32, 48, 300
VIEW = ViewOptions(
    width=WIDTH, height=HEIGHT, sh_degree=3, near_m=0.01, far_m=1e10, antialiased=False, background=torch.zeros(3)
)  # fmt: skip


def zeros(*shape: int) -> np.ndarray:
    return np.zeros(shape, np.float32)


class Drawn:
    """One view of 300 Gaussians with all arrays that the native calls want."""

    absgrad: np.ndarray | None = None
    weights: np.ndarray | None = None

    def __init__(self, differentiable: bool, **changed: np.ndarray) -> None:
        self.splats = list(gaussians.regular(COUNT).arrays().values())
        self.view, self.means2d, self.sums = _native.RenderedView(), zeros(COUNT, 2), zeros(COUNT, _native.NUM_MOMENTS)
        self.alphas, self.depths = zeros(HEIGHT, WIDTH), zeros(HEIGHT, WIDTH)
        cameras = gaussians.off_centre_cameras(WIDTH, HEIGHT, focal_px=50)
        outputs = {"images": zeros(HEIGHT, WIDTH, 3), "means2d": self.means2d, "radii_px": zeros(COUNT), **changed}
        self.view.forward(
            "", self.splats, cameras.cam_from_world[0], cameras.Ks[0], WIDTH, HEIGHT, 3, 0.01, 1e10, False, zeros(3), outputs["images"],
            self.alphas, self.depths, outputs["means2d"], outputs["radii_px"], differentiable, 2,
        )  # fmt: skip

    def blend_backward(self) -> None:
        image = np.ones((HEIGHT, WIDTH, 3), np.float32)
        self.view.blend_backward(image, None, None, self.alphas, self.depths, self.means2d, self.sums, self.absgrad, self.weights, 2)

    def project_backward(self, splats: list[np.ndarray]) -> None:
        gradients = [np.zeros_like(array) for array in splats]
        self.view.project_backward(splats, self.means2d, self.sums, gradients, False, 2)


@pytest.mark.parametrize("instruction_set", instruction_sets())
def test_gaussians_that_are_left_out_together_would_not_be_visible_one_by_one(instruction_set: str) -> None:
    edge = gaussians.frustum_edge(2000, seed=3)
    cameras = gaussians.off_centre_cameras(WIDTH, HEIGHT, focal_px=50)
    viewmats, Ks = torch.tensor(cameras.cam_from_world[:1]), torch.tensor(cameras.Ks[:1])
    axis = np.linalg.inv(cameras.cam_from_world[0]) @ [0.0, 0.0, 3.0, 1.0]
    num_out = 0
    for smaller in (0.0, 2.0, 4.0, 8.0):
        model = replace(edge, log_scales=edge.log_scales - np.float32(smaller))
        # Sixteen alike are looked at together; one in the middle of the image keeps its fifteen in.
        alike = model.select(np.repeat(np.arange(len(model)), 16))
        means = alike.means.copy()
        means[::16] = axis[:3]
        together, among = (
            rasterize_native(SplatTensors.from_splats(splats), viewmats, Ks, VIEW, instruction_set=instruction_set)
            for splats in (alike, replace(alike, means=means))
        )
        kept = np.arange(len(alike)) % 16 != 0
        np.testing.assert_array_equal(together.radii_px[0].numpy()[kept], among.radii_px[0].numpy()[kept])
        np.testing.assert_array_equal(together.means2d[0].numpy()[kept], among.means2d[0].numpy()[kept])
        assert (among.radii_px[0].numpy()[::16] > 0).all()
        num_out += int((together.radii_px[0].numpy()[kept] == 0).sum())
    assert 0.2 < num_out / (4 * 15 * len(edge)) < 0.95


def test_there_is_no_way_back_without_a_differentiable_rendering() -> None:
    drawn = Drawn(differentiable=False)
    with pytest.raises(ValueError, match="no rendering with differentiable=True"):
        drawn.blend_backward()
    with pytest.raises(ValueError, match="no rendering with differentiable=True"):
        drawn.project_backward(drawn.splats)


def test_other_harmonics_than_those_rendered_are_refused() -> None:
    drawn = Drawn(differentiable=True)
    drawn.blend_backward()
    with pytest.raises(ValueError, match="splats are not those of the forward pass"):
        drawn.project_backward([*drawn.splats[:5], zeros(COUNT, 0, 3)])


@pytest.mark.parametrize("wrong", [np.zeros((COUNT, 2), np.float64), zeros(2, COUNT).T])
def test_results_are_never_written_into_a_converted_copy(wrong: np.ndarray) -> None:
    with pytest.raises(TypeError, match="incompatible function arguments"):
        Drawn(differentiable=True, means2d=wrong)


def test_without_gradients_nothing_is_kept_for_them(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[bool] = []

    class Spy(_native.RenderedView):
        def forward(self, *arguments) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
            asked.append(arguments[-2])
            super().forward(*arguments)

    monkeypatch.setattr("radiant_core.render.native_backend._FREE_VIEWS.take", Spy)
    leaves = SplatTensors.from_splats(gaussians.regular(20))
    cameras = gaussians.off_centre_cameras(16, 16)
    for enabled in (True, False):
        leaves.means.requires_grad_()
        with torch.set_grad_enabled(enabled):
            rasterize(leaves, torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks), 16, 16, sh_degree=3, backend="native")
    assert asked == [True, False]


def test_the_builds_are_named_fastest_first() -> None:
    assert instruction_sets()[-1] == "portable"


RENDER = """
import gc, os, resource, signal, threading
import torch
from radiant_core.render.contract import SplatTensors, ViewOptions
from radiant_core.render.native_backend import rasterize_native
from tests.contract import gaussians

LEAVES = SplatTensors.from_splats(gaussians.regular(3000))
for leaf in LEAVES.tensors().values():
    leaf.requires_grad_()

def render(width=96, height=64, threads=2, count=1):
    cameras = gaussians.off_centre_cameras(width, height, count=count, focal_px=width)
    view = ViewOptions(
        width=width, height=height, sh_degree=3, near_m=0.01, far_m=1e10, antialiased=False, background=torch.zeros(3)
    )
    return rasterize_native(LEAVES, torch.tensor(cameras.cam_from_world), torch.tensor(cameras.Ks), view, threads=threads).images

torch.set_num_threads(1)
"""


def run_in_a_process_of_its_own(script: str) -> None:
    code = RENDER + script
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120, cwd=Path(__file__).parents[3])


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_no_more_threads_than_the_machine_runs_and_those_not_needed_sleep() -> None:
    run_in_a_process_of_its_own("""
import time
before = len(os.listdir("/proc/self/task"))
few = render(threads=2)
assert torch.equal(render(threads=300), few)
assert len(os.listdir("/proc/self/task")) <= before + os.cpu_count()

# How often threads went to sleep: those that are woken for nothing do so every time.
def switches():
    counts = {}
    for task in os.listdir("/proc/self/task"):
        status = open(f"/proc/self/task/{task}/status").read()
        counts[task] = int(status.split("voluntary_ctxt_switches:")[1].split()[0])
    return counts

time.sleep(0.01)
start = switches()
for _ in range(30):
    render(threads=2)
    time.sleep(0.001)
idle = [task for task, count in switches().items() if count <= start[task] + 3]
assert len(idle) >= len(start) - before - 1, (start, switches())
""")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_child_forked_while_another_thread_renders_renders_too() -> None:
    run_in_a_process_of_its_own("""
import warnings
warnings.simplefilter("ignore")
with torch.no_grad():
    truth = render()
stop = False

def go_on():
    while not stop:
        render(32, 32).sum().backward()

thread = threading.Thread(target=go_on)
thread.start()
results = set()
for _ in range(40):
    child = os.fork()
    if child == 0:
        signal.alarm(20)
        with torch.no_grad():
            os._exit(0 if torch.equal(render(), truth) else 3)
    results.add(os.waitpid(child, 0)[1])
stop = True
thread.join()
assert results == {0}, results
""")


@pytest.mark.skipif(sys.platform != "linux", reason="limits processes as Linux does")
def test_where_no_thread_can_be_started_one_does_the_work() -> None:
    run_in_a_process_of_its_own("""
resource.setrlimit(resource.RLIMIT_NPROC, (1, 1))
if os.getuid() == 0:  # whom the limit does not hold
    os.setuid(65534)
images = render(threads=4)
images.sum().backward()
assert torch.equal(images, render(threads=1))
""")


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_of_a_large_picture_goes_back_after_some_small_ones() -> None:
    run_in_a_process_of_its_own("""
def rss_mb():
    return int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGESIZE") >> 20

render().sum().backward()
before = rss_mb()
render(2500, 2000, count=2).sum().backward()
large = rss_mb()
gc.collect()
for _ in range(40):
    render().sum().backward()
assert large > before + 100 and rss_mb() < before + 40, (before, large, rss_mb())
""")
