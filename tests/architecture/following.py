"""A message followed through the code while it runs: the rooms (files) whose functions are given it, and the calls that climb.

with follow(RunConfig) as way: radiant.run(config)
way.rooms     files in the order in which they are first given one
way.climbs    calls into a file that stands above its caller's: one that imports it, or imports what imports it
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

from tests.architecture.test_imports import PACKAGES, imports_within, modules_of


@dataclass
class Way:
    """Where messages of some types came."""

    kinds: tuple[type, ...]
    rooms: list[str] = field(default_factory=list)
    climbs: list[str] = field(default_factory=list)

    def note(self, frame: FrameType, event: str, _: Any) -> None:
        """Note one call, as `sys.setprofile` reports it."""
        room = _room(frame.f_code.co_filename) if event == "call" else None
        if room is None or not self._is_given(frame):
            return
        if room not in self.rooms:
            self.rooms.append(room)
        caller = frame.f_back
        while caller is not None and _room(caller.f_code.co_filename) is None:
            caller = caller.f_back
        above = None if caller is None else _room(caller.f_code.co_filename)
        if caller is not None and above is not None and _floors()[room] > _floors()[above]:
            self.climbs.append(f"{above}:{caller.f_code.co_name} calls {room}:{frame.f_code.co_name}")

    def _is_given(self, frame: FrameType) -> bool:
        code = frame.f_code
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        return any(isinstance(frame.f_locals.get(name), self.kinds) for name in names if name != "self")


@contextmanager
def follow(*kinds: type) -> Iterator[Way]:
    """Follow messages of these types in all threads until the block ends."""
    way = Way(kinds=kinds)
    sys.setprofile(way.note)
    threading.setprofile(way.note)
    try:
        yield way
    finally:
        sys.setprofile(None)
        threading.setprofile(None)


@cache
def _modules() -> dict[str, Path]:
    return {name: file for package in PACKAGES for name, file in modules_of(package).items()}


@cache
def _rooms() -> dict[str, str]:
    return {str(file): module for module, file in _modules().items()}


def _room(file: str) -> str | None:
    return _rooms().get(file)


@cache
def _floors() -> dict[str, int]:
    """Module → 1 more than the highest that it imports."""
    graph, floors = imports_within(_modules()), {}

    def floor(module: str) -> int:
        if module not in floors:
            floors[module] = 1 + max((floor(below) for below in graph[module]), default=0)
        return floors[module]

    for module in graph:
        floor(module)
    return floors
