"""What this machine has, what is missing, and what a run will take here. Once per call."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from shlex import quote

from radiant_app.commands.machine.forecast import forecast
from radiant_app.workers.memory import available_bytes
from radiant_core.errors import BadInput
from radiant_core.extras import EXTRAS, install_command, missing_modules
from radiant_viewer.window.desktop import DISPLAY_VARIABLES

LEAST_FREE_GIB = 2.0
"""Of memory and of disk, below which a small run is at risk."""
DISK_BYTES_PER_PHOTOGRAPH = 3_600_000
"""A run's folder beside its photographs, once: `du -sb` of 12 photographs of the sample town with
`--train-preset draft --steps 200`, 43 MB with figures and pictures."""
ELSEWHERE = "not known here; 18 took 1.5 min and 75 took 8.4 min elsewhere on two cores (docs/benchmarks.md)"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that was looked at."""

    name: str
    ok: bool
    needed: bool
    """Whether a run fails without it."""
    found: str
    advice: str = ""
    """What to do when it is not ok."""


PACKAGES = ("torch", "open3d", "numpy", "scipy", "opencv-contrib-python-headless", "pyvista", "safetensors")
"""Of the packages that every run needs those that are most often broken."""


def examine(num_photographs: int = 100, profile: Path | None = None) -> list[Finding]:
    """All findings, cheapest first; BadInput where `profile` is no curve file."""
    return [
        _python(),
        *(_package(name) for name in PACKAGES),
        _native(),
        *(_extra(name) for name in EXTRAS if name != "cuda"),
        _cuda(),
        _display(),
        _memory(),
        _disk(num_photographs),
        scenes := _sample_scenes(),
        _run_of(num_photographs, profile, has_scenes=scenes.ok),
    ]


def table(findings: list[Finding]) -> str:
    """One line per finding, and one with the command below what lacks something."""
    lines = []
    for finding in findings:
        mark = "ok     " if finding.ok else ("MISSING" if finding.needed else "absent ")
        lines.append(f"{mark} {finding.name:<30} {finding.found}")
        if finding.advice and not finding.ok:
            lines.append(f"        {'':<30} → {finding.advice}")
    return "\n".join(lines)


def _python() -> Finding:
    return Finding(
        name="Python",
        ok=sys.version_info >= (3, 11),
        needed=True,
        found=f"{platform.python_version()} on {platform.platform()}, {os.cpu_count()} cores",
        advice="use Python 3.11 or newer.",
    )


def _package(name: str) -> Finding:
    try:
        return Finding(name=name, ok=True, needed=True, found=version(name))
    except PackageNotFoundError:
        advice = f"{quote(sys.executable)} -m pip install {quote(name)}"
        return Finding(name=name, ok=False, needed=True, found="not installed", advice=advice)


def _native() -> Finding:
    advice = "install a C++ compiler (apt-get install g++) and run ./setup.sh."
    try:
        from radiant_core import _native
    except ImportError as error:
        return Finding(name="native module", ok=False, needed=True, found=f"not built for this Python ({error})", advice=advice)
    return Finding(name="native module", ok=True, needed=True, found=f"{_native.compiler()}, {', '.join(_native.instruction_sets())}")


def _extra(name: str) -> Finding:
    missing, purpose = missing_modules(name), EXTRAS[name].purpose
    state = f"{', '.join(missing)} not installed; for {purpose}" if missing else f"for {purpose}"
    return Finding(name=f"extra {name}", ok=not missing, needed=False, found=state, advice=install_command(name))


def _cuda() -> Finding:
    import torch

    if torch.cuda.is_available():
        name, gsplat = torch.cuda.get_device_name(0), not missing_modules("cuda")
        memory = f"{torch.cuda.get_device_properties(0).total_memory / 2**30:.0f} GiB"
        state = f"{name}, {memory}" + ("" if gsplat else "; not used, for gsplat is not installed")
        return Finding(name="CUDA device", ok=gsplat, needed=False, found=state, advice=install_command("cuda"))
    if torch.version.cuda is None and (card := _nvidia_card()) is not None:
        state = f"{card}; not used, for torch {torch.__version__} is a build without CUDA"
        advice = f"{quote(sys.executable)} -m pip install --force-reinstall torch, then {install_command('cuda')}"
        return Finding(name="CUDA device", ok=False, needed=False, found=state, advice=advice)
    return Finding(name="CUDA device", ok=False, needed=False, found="none; models are trained on the CPU")


def _nvidia_card() -> str | None:
    """The name of a card that the driver knows, whatever torch was built for."""
    try:
        command = ["nvidia-smi", "--query-gpu=name", "--format=csv,noheader"]
        lines = subprocess.run(command, capture_output=True, text=True, timeout=20, check=True).stdout.splitlines()
    except (OSError, subprocess.SubprocessError):
        return None
    return lines[0].strip() if lines else None


def _display() -> Finding:
    display = next((os.environ[name] for name in DISPLAY_VARIABLES if os.environ.get(name)), None)
    if display is None and sys.platform in ("darwin", "win32"):
        display = "the desktop's"
    advice = "log in at a desktop for the window; without one: radiant inspect RUN --web, or --screenshot out.png."
    return Finding(name="display", ok=display is not None, needed=False, found=display or "none", advice=advice)


def _memory() -> Finding:
    gib = available_bytes() / 2**30
    advice = "close other programs, or run with --workers 1 and a lower --long-side-px."
    return Finding(name="free memory", ok=gib >= LEAST_FREE_GIB, needed=False, found=f"{gib:.1f} GiB", advice=advice)


def _disk(num_photographs: int) -> Finding:
    free = shutil.disk_usage(Path.cwd()).free
    needed = DISK_BYTES_PER_PHOTOGRAPH * num_photographs
    state = f"{free / 2**30:.1f} GiB; {num_photographs} photographs take some {needed / 2**30:.1f} GiB beside copies of themselves"
    ok = free >= max(needed, LEAST_FREE_GIB * 2**30)
    return Finding(name="free disk here", ok=ok, needed=False, found=state, advice="free some, or give --out on another disk.")


def _sample_scenes() -> Finding:
    from radiant_app.commands.run.demo import sample_scenes_folder

    try:
        return Finding(name="sample scenes", ok=True, needed=False, found=sample_scenes_folder().name)
    except BadInput as error:
        return Finding(name="sample scenes", ok=False, needed=False, found="not here", advice=str(error))


def _run_of(num_photographs: int, profile: Path | None, *, has_scenes: bool) -> Finding:
    name = f"a run of {num_photographs} photographs"
    if profile is None:
        # Without photographs it measures on a sample scene.
        photographs = "" if has_scenes else "PHOTOGRAPHS "
        advice = f"radiant machine profile {photographs}--out machine.toml (5 minutes), then radiant machine check --profile machine.toml"
        return Finding(name=name, ok=False, needed=False, found=ELSEWHERE, advice=advice)
    estimate = forecast(num_photographs, profile, available_bytes())
    text = estimate.text
    if estimate.shortage is not None:
        text += f"; {estimate.shortage}"
    return Finding(name=name, ok=True, needed=False, found=text)
