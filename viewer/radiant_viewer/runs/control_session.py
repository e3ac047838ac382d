"""`ControlSession`: ground control of a run while it is marked, kept in RUN/gcp_list.txt.

Every mark is written at once, into the list as the file has it then: another program or window may
have changed it. Photographs are listed as a surveyor wants them: those that are
marked, then those that should see the point, the nearest to their middle first, then the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.georef.control_guess import guess_place, shares_of
from radiant_core.georef.control_list import (
    CONTROL_LIST,
    ControlList,
    ListedPoint,
    list_shortfall,
    load_control_list,
    parse_control_list,
    world_places,
)
from radiant_core.numerics import FloatArray
from radiant_viewer.pictures.images import Image
from radiant_viewer.runs.run_view import RunView
from radiant_viewer.runs.stored_photographs import load_stored, stored_photographs, stored_size_wh

MIN_CONTROL = 3
"""So many points marked twice, and not kept out, place a scene."""


@dataclass(frozen=True, kw_only=True)
class Sight:
    """A photograph of a point: its mark in px, else where it should be as shares of the picture's
    sides, else neither."""

    photograph: str
    mark: tuple[float, float] | None = None
    guess: tuple[float, float] | None = None


class ControlSession:
    """The list of a run's ground control; calls `changed` after each change."""

    def __init__(self, run: RunView, changed: Callable[[], None] = lambda: None) -> None:
        self._run, self.changed = run, changed
        self.folder = stored_photographs(run)
        self.path = run.folder / CONTROL_LIST
        self.list: ControlList | None = None
        self._surveyed: FloatArray = np.zeros((0, 3))
        self._written: bytes | None = None
        self._read_again()
        self._sizes: dict[str, tuple[int, int] | None] = {}

    def open(self, path: Path) -> None:
        """Take the points of a file, and its marks; BadInput while points of another are marked."""
        self._read_again()
        if self.list is not None and self.list.marks:
            raise BadInput(f"{self.path} has marks already: move it away to begin with other points.")
        self._keep(load_control_list(path, self._run.scene.cameras.names))

    def add(self, system: str, point: ListedPoint) -> None:
        """Add a point, the first in a system."""
        self._read_again()
        before = self.list
        if before is None:
            east, north, up = point.place
            self._keep(parse_control_list(f"{system}\n{point.name}\t{east!r}\t{north!r}\t{up!r}", "the point"))
            return
        self._keep(before.with_point(point))

    def mark(self, point: str, photograph: str, pixel: tuple[float, float]) -> None:
        """Mark a point, px of the stored photograph."""
        self._read_again()
        self._keep(self._listed().marked(point, photograph, pixel))

    def unmark(self, point: str, photograph: str) -> None:
        """Take a mark back."""
        self._read_again()
        self._keep(self._listed().unmarked(point, photograph))

    def set_check(self, point: str, is_check: bool) -> None:
        """Keep a point out of the adjustment, or not."""
        self._read_again()
        self._keep(self._listed().with_check(point, is_check))

    def photograph(self, name: str) -> Image:
        """A stored photograph (H,W,3)."""
        return load_stored(self.folder, name)

    def sights(self, name: str) -> tuple[Sight, ...]:
        """The photographs of a point, those first in which it is or should be."""
        marks, names = self._listed().marks_of(name), self._run.scene.cameras.names
        shares = shares_of(self._run.scene.cameras, self._place(name))
        away = np.where(np.isfinite(shares[:, 0]), np.abs(shares - 0.5).max(axis=1), np.inf)
        order = sorted(range(len(names)), key=lambda row: (names[row] not in marks, away[row], names[row]))
        return tuple(
            Sight(
                photograph=names[row],
                mark=marks.get(names[row]),
                guess=(float(shares[row, 0]), float(shares[row, 1])) if np.isfinite(shares[row, 0]) else None,
            )
            for row in order
        )

    def places(self) -> FloatArray:
        """Points (P,3) in the world, by their marks where there are two, else as surveyed; NaN
        where neither is known."""
        return np.array([self._place(point.name) for point in self._listed().points]).reshape(-1, 3)

    def summary(self) -> str:
        """How far the marks reach."""
        listed = self._listed()
        twice = [point for point in listed.points if len(listed.marks_of(point.name)) > 1]
        control = sum(not point.is_check for point in twice)
        marks = f"{len(listed.marks)} mark{'s' * (len(listed.marks) != 1)}"
        lacking = list_shortfall(listed, self._run.scene.frame)
        marks = marks if lacking is None else f"{lacking} {marks}"
        text = f"{marks}; {control} control and {len(twice) - control} check points are marked twice or more"
        if control < MIN_CONTROL:
            return f"{text}; {MIN_CONTROL} control points are needed."
        return f"{text}. They are in {self.path.name} of the run: give it to radiant sfm, or run, by --gcp."

    @property
    def command(self) -> str:
        """How the marks are used."""
        return f"radiant sfm {self.folder} --gcp {self.path} --out SCENE"

    def _place(self, name: str) -> FloatArray:
        control, cameras = self._listed(), self._run.scene.cameras
        index = [point.name for point in control.points].index(name)
        row_of = {photograph: row for row, photograph in enumerate(cameras.names)}
        sizes = {photo: self._size(photo) for photo in control.marks_of(name) if photo in row_of}
        marks = {photo: pixel for photo, pixel in control.marks_of(name).items() if sizes.get(photo) is not None}
        rows = np.array([row_of[photo] for photo in marks], np.int64)
        shares = np.array([np.array(pixel) / sizes[photo] for photo, pixel in marks.items()], np.float64).reshape(-1, 2)
        return guess_place(cameras, rows, shares, self._surveyed[index])

    def _size(self, name: str) -> tuple[int, int] | None:
        if name not in self._sizes:
            self._sizes[name] = stored_size_wh(self.folder / name)
        return self._sizes[name]

    def _listed(self) -> ControlList:
        if self.list is None:
            raise BadInput("no points are listed yet: open a list of surveyed points, or add one.")
        return self.list

    def _take(self, control: ControlList) -> None:
        """BadInput for a place that the list's system does not have."""
        if self.list is None or control.points != self.list.points:
            self._surveyed = world_places(control, self._run.scene.frame)
        self.list = control

    def _read_again(self) -> None:
        """Take the list of the file if that is not what was read or written last; BadInput where it
        cannot be read, and then nothing is written over it."""
        now = self.path.read_bytes() if self.path.is_file() else None
        if now == self._written:
            return
        if now is None:
            self.list, self._written = None, None
            return
        self._take(load_control_list(self.path, self._run.scene.cameras.names))
        self._written = now

    def _keep(self, control: ControlList) -> None:
        self._take(control)
        control.save(self.path)
        self._written = control.text().encode()
        self.changed()
