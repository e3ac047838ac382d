"""Which backend renders on this machine. Once per run and model; torch is loaded only where gsplat
may be usable, so that a process that plans and waits does without."""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from radiant_core.render.contract import Backend, Renderer

DRIVER = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"
"""The library of CUDA's driver, without which PyTorch sees no device."""


def resolve_backend(backend: Backend) -> Renderer:
    """The backend that `auto` means for float32 models here: gsplat where usable, else native."""
    if backend != "auto":
        return backend
    if find_spec("gsplat") is None or not _has_driver():
        return "native"
    from radiant_core.render.gsplat_backend import missing_for_gsplat

    return "native" if missing_for_gsplat() else "gsplat"


@cache
def _has_driver() -> bool:
    try:
        ctypes.CDLL(DRIVER)
    except OSError:
        return False
    return True


def device_of(backend: str) -> str:
    """Where the tensors of a model that `backend` renders lie: "cuda" for gsplat, else "cpu"."""
    return "cuda" if backend == "gsplat" else "cpu"
