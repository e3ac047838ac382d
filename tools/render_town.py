"""The town's render on another system: written down where the reference runs, drawn again with numpy alone where the other does.

    .venv/bin/python tools/render_town.py record RUN town.npz                    # RUN: a folder of `radiant demo`
    qemu-aarch64-static -L ROOT ROOT/usr/bin/python3 tools/render_town.py replay MODULE town.npz

MODULE is `_native.abi3.so` of that system, for example of `tools/cross.py`; ROOT a root of arm64
with Python and numpy. The file holds what the native rasterizer is given for some cameras of the
scene, and what it made of it here, so the other needs neither torch nor the rest of Radiant.
"""

from __future__ import annotations

import argparse
import importlib.util
import platform
import time
from pathlib import Path
from typing import Any

import numpy as np

TENSORS = ("means", "quats", "log_scales", "logit_opacities", "sh0", "shN")
OUTPUTS = ("images", "alphas", "depths")
NUM_VIEWS = 3
# Of every colour and opacity, and of every depth relative to the greatest.
MOST_ERROR = 1e-5


def render(native: Any, arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Images (C,H,W,3), alphas and depths (C,H,W) of the cameras that are given, by the rasterizer of one native module."""
    (width, height), count = arrays["sizes_wh"][0].tolist(), len(arrays["means"])
    shape = (len(arrays["Ks"]), height, width)
    outputs = {"images": np.empty((*shape, 3), np.float32), "alphas": np.empty(shape, np.float32), "depths": np.empty(shape, np.float32)}
    for i, (viewmat, K) in enumerate(zip(arrays["viewmats"], arrays["Ks"], strict=True)):
        native.RenderedView().forward(
            "", [arrays[name] for name in TENSORS], viewmat, K, width, height, int(arrays["sh_degree"]), 0.01, 1e10, False,
            np.zeros(3, np.float32), *(outputs[name][i] for name in OUTPUTS),
            np.empty((count, 2), np.float32), np.empty(count, np.float32), False, 1,
        )  # fmt: skip
    return outputs


def describe(native: Any) -> str:
    """Where and with what a module runs."""
    return f"{platform.machine()}, {native.compiler()}, {native.instruction_sets()[0]}"


def record(run: Path, file: Path) -> None:
    """Write what the rasterizer is given for some cameras of a run's scene, and what it makes of it."""
    from radiant_core import _native
    from radiant_core.io.ply import load_ply
    from radiant_core.io.records import load_scene

    splats, scene = load_ply(run / "scene.ply"), load_scene(run / "sfm" / "scene.safetensors")
    picked = np.linspace(0, len(scene.cameras) - 1, NUM_VIEWS).astype(np.int64)
    cameras = scene.cameras.select(picked)
    arrays = {name: np.ascontiguousarray(array, np.float32) for name, array in splats.arrays().items()}
    arrays |= {"viewmats": cameras.cam_from_world, "Ks": cameras.Ks, "sizes_wh": cameras.sizes_wh, "sh_degree": np.array(splats.sh_degree)}
    np.savez(file, allow_pickle=False, **arrays, **render(_native, arrays))
    print(f"{len(splats):,} Gaussians from {', '.join(cameras.names)} on {describe(_native)}: {file}")


def replay(module: Path, file: Path) -> None:
    """Draw the same with another module; ends with an error where it differs by more than `MOST_ERROR`."""
    spec = importlib.util.spec_from_file_location("_native", module)
    if spec is None or spec.loader is None:
        raise SystemExit(f"{module} is no module of this Python.")
    native = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(native)
    with np.load(file) as loaded:
        arrays = dict(loaded)
    started_s = time.monotonic()
    outputs = render(native, arrays)
    print(f"{describe(native)}: {NUM_VIEWS} views in {time.monotonic() - started_s:.1f} s")
    differ = [name for name in OUTPUTS if not _agree(name, outputs[name], arrays[name])]
    if differ:
        raise SystemExit(f"{' and '.join(differ)} differ by more than {MOST_ERROR:.0e}.")


def _agree(name: str, rendered: np.ndarray, expected: np.ndarray) -> bool:
    """Whether all values are equal within `MOST_ERROR`; prints by how much they differ."""
    difference = np.abs(rendered - expected) / max(1.0, float(expected.max()))
    beyond, largest, changed = int((~(difference <= MOST_ERROR)).sum()), float(difference.max()), int((rendered != expected).sum())
    print(f"  {name}: {changed:,} of {difference.size:,} differ, by {largest:.1e} at most; {beyond} by over {MOST_ERROR:.0e}")
    return beyond == 0


def main() -> None:
    """`record` or `replay`."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("what", choices=["record", "replay"])
    parser.add_argument("source", type=Path, help="record: the folder of a run; replay: the native module")
    parser.add_argument("file", type=Path, help="what is written or read, .npz")
    options = parser.parse_args()
    (record if options.what == "record" else replay)(options.source, options.file)


if __name__ == "__main__":
    main()
