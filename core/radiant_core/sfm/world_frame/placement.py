"""What a user says of the world frame: up, north and one known length, or surveyed points. Once per
scene.

up:    auto | ground | level | down | name of a photograph whose top edge is up | x,y,z of a model
north: the direction that one photograph looks in, where GPS does not say
size:  the distance of two photographs, or the cameras' median height over the ground, in metres
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.choices import Contradictions
from radiant_core.errors import BadInput
from radiant_core.georef.control_points import ControlPoints, ControlRequest, parse_control
from radiant_core.numerics import FloatArray
from radiant_core.sfm.world_frame.up import GROUND, LEVEL, UPRIGHT, UpEstimate, estimate_up, roll_deg

AUTO = "auto"
CUES = {"ground": (GROUND,), "level": (LEVEL, UPRIGHT)}
"""Values of `up` that name some of the cues of `up.py`."""
UP_CHOICES = (AUTO, *CUES, "down")
UP_EXPECTED = f"{', '.join(UP_CHOICES)}, the name of a photograph, or x,y,z in the frame of a COLMAP project"
MAX_LENGTH_M = 1e6
MAX_HEADING_DEG = 360.0
MIN_LEVEL_SHARE = 0.35
"""A photograph whose direction lies more than 70° below the horizon looks down."""


@dataclass(frozen=True, kw_only=True)
class Placement:
    """What is known of the world beside photographs; BadInput for a value that makes no sense."""

    up: str = AUTO
    """auto: GPS, or else whatever the scene shows; ground: the plane through most points is level;
    level: photographs were held level; down: they look straight down; a photograph's name: its top
    edge is up; x,y,z: that direction in the frame of a COLMAP project."""
    distance: str | None = None
    """PHOTO,PHOTO,METRES: how far apart two photographs were taken."""
    height_m: float | None = None
    """How high the cameras were over the ground that they see, median."""
    north: str | None = None
    """PHOTO,DEGREES: where a photograph looks, clockwise from north; of one that looks down where
    its top edge points."""
    control: ControlRequest | None = None
    """Surveyed points, which fix all of the frame."""
    contradictions: Contradictions = "stop"
    """What becomes of what contradicts the photographs' GPS (`contradictions.py`)."""

    def __post_init__(self) -> None:
        if self.control is not None and (self.up, self.distance, self.height_m, self.north) != (AUTO, None, None, None):
            raise BadInput("--gcp fixes up, north and scale: leave out --up, --north, --distance and --height.")
        if self.north is not None:
            _split_north(self.north)
        if self.distance is not None and self.height_m is not None:
            raise BadInput("--distance and --height both give the scale: keep one of them.")
        if self.height_m is not None and not 0 < self.height_m <= MAX_LENGTH_M:
            raise BadInput(f"--height is {self.height_m}, expected metres above 0, at most {MAX_LENGTH_M:,.0f}.")
        if self.distance is not None:
            _split_distance(self.distance)
        vector = self.vector
        if vector is not None and not (np.isfinite(vector).all() and np.linalg.norm(vector) > 0):
            raise BadInput(f"--up {self.up} is no direction: give three numbers that are not all 0.")

    @property
    def vector(self) -> FloatArray | None:
        """`up` as a direction (3,), None where it is a word or a name."""
        parts = self.up.split(",")
        try:
            return np.array([float(part) for part in parts]) if len(parts) == 3 else None
        except ValueError:
            return None

    @property
    def control_text(self) -> str | None:
        """The list of ground control as it came; None without one."""
        return None if self.control is None else self.control.text

    def parsed_control(self, photographs: Sequence[str] = ()) -> ControlPoints | None:
        """The surveyed points, if there are any, marked in `photographs`; raises as
        `parse_control`."""
        return None if self.control is None else parse_control(self.control, photographs)

    def turn_to_north(self, cameras: Cameras) -> FloatArray | None:
        """The rotation (3,3) about z that turns C cameras with z up to north; None unless asked."""
        if self.north is None:
            return None
        name, heading_deg = _split_north(self.north)
        if name not in cameras.names:
            raise BadInput(f"--north names {name!r}, which has no pose or is no photograph here: name another.")
        pose = cameras.cam_from_world[cameras.names.index(name)]
        # A photograph that looks down has its top edge where the flight went.
        across = pose[2, :2] if np.hypot(*pose[2, :2]) > MIN_LEVEL_SHARE else -pose[1, :2]
        turn = np.arctan2(across[1], across[0]) - np.radians(90.0 - heading_deg)
        cosine, sine = np.cos(turn), np.sin(turn)
        return np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])

    @property
    def length_option(self) -> str:
        """The known length as it was typed."""
        return f"--distance {self.distance}" if self.distance is not None else f"--height {self.height_m:g}"

    def length_by(self, factor: float) -> str:
        """The known length in a scene that is `factor` times smaller than it makes it."""
        if self.distance is not None:
            return f"the two photographs are {_split_distance(self.distance)[1] / factor:.3g} m apart"
        assert self.height_m is not None
        return f"the cameras are {self.height_m / factor:.3g} m over the ground that they see"

    @property
    def north_deg(self) -> float:
        """Where `north` says that its photograph looks."""
        assert self.north is not None
        return _split_north(self.north)[1]

    @property
    def gives_scale(self) -> bool:
        """Whether a length is known."""
        return self.distance is not None or self.height_m is not None

    def check_names(self, names: Iterable[str], *, of_model: bool) -> None:
        """Raise BadInput where a photograph is named that is not among `names`, or a direction for
        photographs that have no frame yet."""
        known_names = set(names)
        if self.distance is not None:
            self._pair(known_names)
        if self.vector is not None:
            if not of_model:
                raise BadInput(
                    f"--up {self.up} is a direction in the frame of a COLMAP project, and photographs have none yet: "
                    f"use {', '.join(UP_CHOICES[1:])}, or the name of a photograph whose top edge is up."
                )
        elif self.up not in UP_CHOICES and self.up not in known_names:
            raise BadInput(f"--up {self.up!r} is unknown: expected {UP_EXPECTED}.")

    def check_copies(self, copies: Mapping[str, str]) -> None:
        """Raise BadInput where a named photograph is left out as a copy of another one; `copies`:
        copy → the one that stays."""
        if self.up not in UP_CHOICES and self.up in copies:
            raise BadInput(f"--up {self.up!r} is a copy of {copies[self.up]}: name that one.")
        if self.distance is not None:
            names, _ = _split_distance(self.distance)
            parts = [part.strip() for at, letter in enumerate(names) if letter == "," for part in (names[:at], names[at + 1 :])]
            copy = next((part for part in parts if part in copies), None)
            if copy is not None:
                raise BadInput(f"--distance names {copy!r}, which is a copy of {copies[copy]}: name that one.")

    def given_up(self, cameras: Cameras, points: FloatArray, seed: int) -> UpEstimate | None:
        """Up as it was asked for, in the frame of C cameras and P points (P,3); None for auto."""
        if self.up == AUTO:
            return None
        if self.up in CUES:
            return estimate_up(cameras, points, seed, only=CUES[self.up])
        vector, source = self.vector, f"direction {self.up}"
        if self.up == "down":
            vector, source = -cameras.cam_from_world[:, 2, :3].sum(axis=0), "photographs that look straight down"
        elif vector is None:
            vector, source = -_pose(cameras, self.up)[1, :3], f"top edge of {self.up}"
        length = float(np.linalg.norm(vector))
        if length < 1e-6 * len(cameras):
            raise BadInput("--up down: the photographs look to all sides, so their mean is no direction: name one, or use level or ground.")
        up = vector / length
        return UpEstimate(up=up, source=source, roll_deg=roll_deg(cameras, up), uncertainty_deg=0.0)

    def scale(self, cameras: Cameras, points: FloatArray, observations: NDArray[np.int64]) -> float | None:
        """Metres per unit of C cameras and P points (P,3) with z up, T observations (T,2); None
        without a known length."""
        if self.distance is not None:
            first, second, metres = self._pair(set(cameras.names))
            length = float(np.linalg.norm(np.subtract(*cameras.named([first, second]).centers)))
        elif self.height_m is not None:
            metres = self.height_m
            length = float(np.median(cameras.centers[observations[:, 1], 2] - points[observations[:, 0], 2])) if len(observations) else 0.0
        else:
            return None
        if length <= 1e-9 * float(np.abs(cameras.centers).max()):
            where = "were taken at one place" if self.distance is not None else "are not above the ground that they see"
            raise BadInput(f"the photographs {where}, which fixes no scale: give --distance of two that lie apart.")
        return metres / length

    def _pair(self, known_names: set[str]) -> tuple[str, str, float]:
        assert self.distance is not None
        names, metres = _split_distance(self.distance)
        # A name may hold a comma itself.
        splits = [(names[:at], names[at + 1 :]) for at, letter in enumerate(names) if letter == ","]
        pair = next(((a.strip(), b.strip()) for a, b in splits if a.strip() in known_names and b.strip() in known_names), None)
        if pair is None:
            lost = [part.strip() for part in names.split(",") if part.strip() not in known_names]
            raise BadInput(f"--distance names {', '.join(map(repr, lost))}, which has no pose or is no photograph here: name two others.")
        if pair[0] == pair[1]:
            raise BadInput(f"--distance names {pair[0]!r} twice: name two photographs that lie apart.")
        return (*pair, metres)


def _split_distance(text: str) -> tuple[str, float]:
    names, length_m = _split_last(text)
    if "," not in names or not 0 < length_m <= MAX_LENGTH_M:
        raise BadInput(f"--distance is {text!r}, expected PHOTO,PHOTO,METRES with metres above 0, at most {MAX_LENGTH_M:,.0f}.")
    return names, length_m


def _split_north(text: str) -> tuple[str, float]:
    name, heading_deg = _split_last(text)
    if not name or not abs(heading_deg) <= MAX_HEADING_DEG:
        raise BadInput(f"--north is {text!r}, expected PHOTO,DEGREES with degrees clockwise from north, at most {MAX_HEADING_DEG:.0f}.")
    return name, heading_deg


def _split_last(text: str) -> tuple[str, float]:
    """What stands before the last comma, which a name may hold too, and the number behind it, NaN
    where there is none."""
    name, _, number = text.rpartition(",")
    try:
        return name.strip(), float(number)
    except ValueError:
        return name.strip(), float("nan")


def _pose(cameras: Cameras, name: str) -> FloatArray:
    if name not in cameras.names:
        raise BadInput(f"--up {name!r} has no pose in the scene: name another photograph.")
    return cameras.cam_from_world[cameras.names.index(name)]
