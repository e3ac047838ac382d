"""What this machine has and what it lacks. Once per call of `radiant doctor`."""

from __future__ import annotations

import importlib
import importlib.util
import os
import platform
import shutil
import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from radiant_app.workers.memory import available_bytes
from radiant_core.errors import BadInput
from radiant_viewer.window.desktop import install_command


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


PACKAGES = ("torch", "pycolmap", "open3d", "numpy", "scipy", "opencv-contrib-python-headless", "pyvista", "safetensors")


def examine() -> list[Finding]:
    """All findings, cheapest first."""
    return [_python(), *(_package(name) for name in PACKAGES), _native(), _cuda(), _desktop(), _memory(), _disk(), _sample_scenes()]


def table(findings: list[Finding]) -> str:
    """One line per finding."""
    lines = []
    for finding in findings:
        mark = "ok     " if finding.ok else ("MISSING" if finding.needed else "absent ")
        advice = f"  → {finding.advice}" if finding.advice and not finding.ok else ""
        lines.append(f"{mark} {finding.name:<32} {finding.found}{advice}")
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
        return Finding(name=name, ok=False, needed=True, found="not installed", advice="run ./setup.sh.")


def _native() -> Finding:
    advice = "install a C++ compiler (g++) and run ./setup.sh."
    try:
        from radiant_core import _native
    except ImportError as error:
        return Finding(name="native module", ok=False, needed=True, found=f"not built for this Python ({error})", advice=advice)
    return Finding(name="native module", ok=True, needed=True, found=f"{_native.compiler()}, {', '.join(_native.instruction_sets())}")


def _cuda() -> Finding:
    import torch

    available = torch.cuda.is_available()
    found = torch.cuda.get_device_name(0) if available else "none; models are trained on the CPU"
    return Finding(name="CUDA device", ok=available, needed=False, found=found)


def _desktop() -> Finding:
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    extra = importlib.util.find_spec("pyvistaqt") is not None
    found = f"display {display or 'none'}, extra {'installed' if extra else 'not installed'}"
    missing = ["on a machine with a display"] if not display else []
    missing += [] if extra else [install_command("desktop")]
    advice = f"{' and '.join(missing)}; pictures work without."
    return Finding(name="desktop window", ok=bool(display) and extra, needed=False, found=found, advice=advice)


def _memory() -> Finding:
    gib = available_bytes() / 2**30
    return Finding(name="free memory", ok=gib >= 2, needed=False, found=f"{gib:.1f} GiB", advice="2 GiB or more are advised.")


def _disk() -> Finding:
    gib = shutil.disk_usage(Path.cwd()).free / 2**30
    return Finding(name="free disk here", ok=gib >= 1, needed=False, found=f"{gib:.1f} GiB", advice="1 GiB or more is advised.")


def _sample_scenes() -> Finding:
    from radiant_app.commands.demo import sample_scenes_folder

    try:
        return Finding(name="sample scenes", ok=True, needed=False, found=sample_scenes_folder().name)
    except BadInput as error:
        return Finding(name="sample scenes", ok=False, needed=False, found="not here", advice=str(error))
