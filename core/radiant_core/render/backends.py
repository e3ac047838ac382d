"""Which backend renders on this machine. Once per run and model; torch is loaded only where gsplat
is installed, so that what plans a run does without."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from radiant_core.render.contract import Backend, Renderer


def resolve_backend(backend: Backend) -> Renderer:
    """The backend that `auto` means for float32 models here: gsplat where usable, else native."""
    if backend != "auto":
        return backend
    if find_spec("gsplat") is None:
        return "native"
    from radiant_core.render.gsplat_backend import missing_for_gsplat

    return "native" if missing_for_gsplat() else "gsplat"


def device_of(backend: str) -> str:
    """Where the tensors of a model that `backend` renders lie: "cuda" for gsplat, else "cpu"."""
    return "cuda" if backend == "gsplat" else "cpu"
