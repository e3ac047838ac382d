"""The rasterizer's C++ under the address and undefined-behaviour sanitizers, on random and degenerate models of awkward sizes."""

from __future__ import annotations

import platform
import shutil
import subprocess
from pathlib import Path

import pytest

NATIVE = Path(__file__).parents[2] / "core" / "radiant_core" / "native"
FLAGS = ["-std=c++17", "-g", "-O1", "-Wno-psabi", "-ffast-math", "-fno-finite-math-only", f"-I{NATIVE}"]
# Only float divisions by zero and casts of what is out of range are defined on every CPU here and used on purpose.
FLAGS += ["-fsanitize=address,undefined", "-fno-sanitize=float-divide-by-zero", "-fno-sanitize-recover=all"]


@pytest.mark.stress
@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
def test_address_and_undefined_behaviour_sanitizers_find_nothing(tmp_path: Path) -> None:
    builds = {"portable": []}
    if platform.machine() in ("x86_64", "AMD64"):
        builds |= {"avx2": ["-march=x86-64-v3"], "avx512": ["-march=x86-64-v4"]}
        FLAGS.append("-DRADIANT_X86")
    objects = []
    for name, flags in builds.items():
        objects.append(tmp_path / f"{name}.o")
        subprocess.run(["g++", *FLAGS, *flags, f"-DRADIANT_ISA={name}", "-c", NATIVE / "raster_kernels.cpp", "-o", objects[-1]], check=True)
    sources = [
        Path(__file__).with_name("raster_driver.cpp"),
        *(NATIVE / f"{name}.cpp" for name in ("raster", "buffers", "depth_sort", "thread_pool")),
    ]
    subprocess.run(["g++", *FLAGS, *sources, *objects, "-pthread", "-o", tmp_path / "driver"], check=True)
    result = subprocess.run([tmp_path / "driver"], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout[-2000:] + result.stderr[-6000:]
