"""The optional parts of the installation, and the command that adds one to this installation."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path
from shlex import quote

from radiant_core.errors import BadInput

DISTRIBUTION = "radiant-splats"


@dataclass(frozen=True, kw_only=True)
class Extra:
    """One of the extras of pyproject.toml that users choose."""

    modules: tuple[str, ...]
    """What is imported of it."""
    purpose: str
    """What needs it."""


EXTRAS = {
    "sfm": Extra(modules=("pycolmap",), purpose="structure from motion"),
    "geo": Extra(modules=("pyproj",), purpose="coordinate systems beside UTM on WGS84"),
    "flip": Extra(modules=("flip_evaluator",), purpose="the figure ꟻLIP"),
    "desktop": Extra(modules=("PySide6", "pyvistaqt"), purpose="the window of `radiant inspect`"),
    "web": Extra(modules=("trame", "trame_vtk", "trame_vuetify"), purpose="the page of `radiant inspect --web`"),
    "survey": Extra(modules=("laspy", "lazrs", "trimesh"), purpose="LAZ and GLB of `radiant export`"),
    "usd": Extra(modules=("pxr",), purpose="OpenUSD of `radiant export`"),
    "network": Extra(modules=("httpx", "starlette", "uvicorn"), purpose="`radiant node` and --executor network"),
    "cluster": Extra(modules=("ray",), purpose="--executor ray"),
    "cuda": Extra(modules=("gsplat",), purpose="training on a CUDA device"),
}


def missing_modules(extra: str) -> list[str]:
    """Return the modules of an extra that are not installed."""
    return [name for name in EXTRAS[extra].modules if find_spec(name) is None]


def install_command(extra: str) -> str:
    """Return the line for a shell that adds an extra to the Python that runs this."""
    try:
        distribution(DISTRIBUTION)
    except PackageNotFoundError:
        # Run from its source without an installation: only its own set-up helps.
        return quote(str(Path(__file__).resolve().parents[2] / "setup.sh"))
    # pip keeps the Radiant that is there, of a folder or a wheel, and adds what is missing.
    requirement = quote(f"{DISTRIBUTION}[{extra}]")
    if find_spec("pip") is None:
        return f"uv pip install --python {_python()} {requirement}"
    return f"{_python()} -m pip install {requirement}"


def require_extra(extra: str, what_fails: str, instead: str) -> None:
    """Raise BadInput where a module of an extra is missing.

    Args:
        extra: a key of `EXTRAS`.
        what_fails: begins the message, such as "no window can be opened".
        instead: ends it after "or": what works without.
    """
    if missing := missing_modules(extra):
        raise BadInput(f"{what_fails} because {missing[0]} is not installed: {install_command(extra)}, or {instead}.")


def _python() -> str:
    """The running Python for a shell in the current folder."""
    python, here = Path(sys.executable), Path.cwd()
    return quote(str(python.relative_to(here)) if python.is_relative_to(here) else str(python))
