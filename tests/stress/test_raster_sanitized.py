"""The native kernels under the address and undefined-behaviour sanitizers on awkward input, the thread pool under the thread sanitizer."""

from __future__ import annotations

import platform
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

NATIVE = Path(__file__).parents[2] / "core" / "radiant_core" / "native"
IS_X86 = platform.machine() in ("x86_64", "AMD64")
FLAGS = ["-std=c++17", "-g", "-O1", "-Wno-psabi", f"-I{NATIVE}", *(["-DRADIANT_X86"] if IS_X86 else [])]
# Only float divisions by zero and casts of what is out of range are defined on every CPU here and
# used on purpose.
SANITIZED = ["-fsanitize=address,undefined", "-fno-sanitize=float-divide-by-zero", "-fno-sanitize-recover=all"]
BUILDS = {"portable": [], **({"avx2": ["-march=x86-64-v3"], "avx512": ["-march=x86-64-v4"]} if IS_X86 else {})}

pytestmark = [pytest.mark.stress, pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")]


def compile_and_run(folder: Path, driver: str, sources: Sequence[str], kernels: str | None, flags: Sequence[str]) -> None:
    """Build `driver` with `sources`, and `kernels` once per instruction set; the run must end with 0."""
    objects = []
    for name, build_flags in BUILDS.items() if kernels else ():
        objects.append(folder / f"{name}.o")
        command = ["g++", *FLAGS, *flags, *build_flags, f"-DRADIANT_ISA={name}", "-c", NATIVE / f"{kernels}.cpp", "-o", objects[-1]]
        subprocess.run(command, check=True)
    files = [Path(__file__).with_name(f"{driver}.cpp"), *(NATIVE / f"{name}.cpp" for name in sources)]
    subprocess.run(["g++", *FLAGS, *flags, *files, *objects, "-pthread", "-o", folder / driver], check=True)
    result = subprocess.run([folder / driver], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout[-2000:] + result.stderr[-6000:]


def test_the_rasterizer_under_address_and_undefined_behaviour_sanitizers(tmp_path: Path) -> None:
    sources = ("raster", "buffers", "depth_sort", "thread_pool", "instruction_sets")
    compile_and_run(tmp_path, "raster_driver", sources, "raster_kernels", [*SANITIZED, "-ffast-math", "-fno-finite-math-only"])


def test_loss_adam_and_cells_under_address_and_undefined_behaviour_sanitizers(tmp_path: Path) -> None:
    sources = ("training_loss", "training_isa", "adam", "power_cells", "thread_pool", "instruction_sets")
    compile_and_run(tmp_path, "training_driver", sources, "training_kernels", SANITIZED)


def test_the_thread_pool_under_the_thread_sanitizer(tmp_path: Path) -> None:
    compile_and_run(tmp_path, "threads_driver", ("thread_pool",), None, ["-fsanitize=thread"])
