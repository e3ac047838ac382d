"""Which way is up in a scene, by cues of its cameras and points, weighed against each other.

A cue k costs a unit vector u the squared sine of its lean over the cue's standard deviation, uᵀ A_k
u; where positions with the scatter Σᵢ λᵢ eᵢ eᵢᵀ (λ₁ ≥ λ₂ ≥ λ₃) lie level,
    A = Σᵢ₌₁,₂ (1 − λ₃/λᵢ) eᵢ eᵢᵀ / σᵢ²,  σᵢ² = σ² + (λ₃/4 + (0.02)² λ₁) / λᵢ,
so that a line says nothing of its roll: nothing is level to better than 2 % of its length.

cue                   what is said                     σ²                          missing
ground plane          the plane near most points is    (3°)² / share of points     < 20 points
                        level
level flight path     cameras move on one level        (3°)²                       < 4 cameras
level cameras         A = Σ w x xᵀ / σ²: level x axes  (2°)² + roll² / 4           –
                        (y in pictures that stand)
views straight down   the mean view is down            (2°)² + spread² / 4         spread > 20°
upright photographs   the mean of the −y axes is up    (10°)² + spread² / 4        spread > 35°

Up is the direction that the fewest cues contradict (each cue costs at most 3² = 9), then the least
squares of those that agree. The sign is the cameras': photographs are upright, or look down. Those
of one flight err together (mount, wind): more than four make attitudes no surer. Once per scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray

GROUND, PATH, LEVEL = "ground plane", "level flight path", "level cameras"
DOWN, UPRIGHT = "views straight down", "upright photographs"
MAX_COST = 9.0
"""Beyond three standard deviations a cue contradicts, and how far does not matter."""
MAX_INDEPENDENT = 4
SLOPE_RAD = np.radians(3.0)
"""A usual slope of a site, and of a flight over it."""
UNEVENNESS = 0.02
MIN_MOUNT_RAD = np.radians(2.0)
"""What a camera's mount is off by, however many photographs it takes."""
MIN_PITCH_RAD = np.radians(10.0)
MAX_DOWN_SPREAD_RAD = np.radians(20.0)
MAX_UPRIGHT_SPREAD_RAD = np.radians(35.0)
MIN_POINTS = 20
NUM_PLANE_TRIALS = 300
NUM_REFITS = 30
MAX_PLANE_POINTS = 5000
NUM_ROUNDS = 5
RIVAL_RAD = np.radians(8.0)
RIVAL_COST = 6.0
"""A direction elsewhere that costs only so much more could be up too: a likelihood ratio of 20."""
WALL_RAD = np.radians(75.0)
MAX_UNCERTAINTY_DEG = 8.0
MIN_UPWARD = 0.1
NOTHING = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Cue:
    """What one observation says of up: its cost is uᵀ A u; `direction` (3,) is where it alone would
    put up, or down."""

    name: str
    information: FloatArray
    direction: FloatArray

    def cost(self, up: FloatArray) -> float:
        """Squared standard deviations by which `up` leans from what this says, 9 at most."""
        return min(MAX_COST, float(up @ self.information @ up))


@dataclass(frozen=True, kw_only=True, eq=False)
class UpEstimate:
    """Unit vector up (3,), the cues it was taken from, how sure it is; roll_deg is the RMS angle of
    x axes to the level."""

    up: FloatArray
    source: str
    """The cues that agree, in words."""
    roll_deg: float
    uncertainty_deg: float
    """Standard deviation, 90 where nothing is known."""
    left_out: tuple[tuple[str, float], ...] = ()
    """Cues that contradict, and how far from up each would put it [deg]."""
    doubt: str | None = None
    """Why a user should look at it, one clause; None where the cues agree."""


def roll_deg(cameras: Cameras, up: FloatArray) -> float:
    """RMS angle of the x axes of C cameras to the plane across `up`: their roll if that were up."""
    return float(np.degrees(np.arcsin(min(1.0, np.sqrt(np.mean((cameras.cam_from_world[:, 0, :3] @ up) ** 2))))))


def estimate_up(cameras: Cameras, points: FloatArray, seed: int = 0, only: Sequence[str] | None = None) -> UpEstimate:
    """Up in the frame of C cameras and P points (P,3), from all cues or from those named in `only`;
    BadInput where the scene has none of these."""
    shared = _shared_cues(cameras, points, seed)
    readings = [[cue for cue in (*shared, level) if only is None or cue.name in only] for level in _level_cameras_cues(cameras)]
    if not readings[0]:
        size = f"{len(points)} points and {len(cameras)} photographs"
        raise BadInput(f"up cannot be taken from the {_join(only or ())}: the scene of {size} does not show it, give --up another way.")
    # Pictures that stand upright are trusted only where that contradicts less.
    solutions = [_solutions(cues) for cues in readings]
    best = min(range(len(solutions)), key=lambda index: (solutions[index][0][1], index))
    cues, (up, cost) = readings[best], solutions[best][0]
    rival = next(
        (rival_up for rival_up, other_cost in solutions[best] if _angle_rad(up, rival_up) > RIVAL_RAD and other_cost < cost + RIVAL_COST),
        None,
    )
    upward = float(_upward(cameras, on_their_side=best == 1) @ up)
    up = up if upward >= 0 else -up
    agreeing = [cue for cue in cues if cue.cost(up) < MAX_COST]
    uncertainty_deg = _uncertainty_deg(agreeing, up)
    return UpEstimate(
        up=up,
        source=_join([cue.name for cue in agreeing]),
        roll_deg=roll_deg(cameras, up),
        uncertainty_deg=uncertainty_deg,
        left_out=tuple((cue.name, float(np.degrees(_angle_rad(up, cue.direction)))) for cue in cues if cue not in agreeing),
        doubt=_wall_doubt(cues, up) or _doubt(up, rival, uncertainty_deg, abs(upward)),
    )


def _solutions(cues: Sequence[Cue]) -> list[tuple[FloatArray, float]]:
    """Where each cue leads to, with its cost, the cheapest first."""
    return sorted((_settle(cues, cue.direction) for cue in cues), key=lambda solution: solution[1])


def _join(names: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def _wall_doubt(cues: Sequence[Cue], up: FloatArray) -> str | None:
    """Ground from above and a wall from the front look the same where all pictures have one top
    edge and the path allows both."""
    upright = next((cue for cue in cues if cue.name == UPRIGHT), None)
    if upright is None or _angle_rad(up, upright.direction) < WALL_RAD:
        return None
    if any(cue.name == PATH and cue.cost(upright.direction) >= MAX_COST for cue in cues):
        return None
    return "a wall photographed from the front would look the same as ground photographed from above"


def _doubt(up: FloatArray, rival: FloatArray | None, uncertainty_deg: float, upward: float) -> str | None:
    if rival is not None:
        return f"another direction, {np.degrees(_angle_rad(up, rival)):.0f}° away, fits nearly as well"
    if upward < MIN_UPWARD:
        return "the photographs do not tell up from down"
    if uncertainty_deg > MAX_UNCERTAINTY_DEG:
        return f"it is known to {uncertainty_deg:.0f}° only"
    return None


def _settle(cues: Sequence[Cue], start: FloatArray) -> tuple[FloatArray, float]:
    """The direction near `start` that is the least squares of the cues that agree with it, and its
    cost to all cues."""
    up = _unit(start)
    best = (up, sum(cue.cost(up) for cue in cues))
    for _ in range(NUM_ROUNDS):
        total = sum((cue.information for cue in cues if cue.cost(up) < MAX_COST), np.zeros((3, 3)))
        costs, directions = np.linalg.eigh(total)
        if costs[1] - costs[0] <= NOTHING * max(costs[2], 1.0):
            break
        up = directions[:, 0] * (1 if directions[:, 0] @ up >= 0 else -1)
        cost = sum(cue.cost(up) for cue in cues)
        if cost >= best[1]:
            break
        best = (up, cost)
    return best


def _uncertainty_deg(agreeing: Sequence[Cue], up: FloatArray) -> float:
    """Standard deviation in the direction known worst, larger where the cues agree too little."""
    if not agreeing:
        return 90.0
    total = sum((cue.information for cue in agreeing), np.zeros((3, 3)))
    across = np.eye(3) - np.outer(up, up)
    least_information = float(np.linalg.eigvalsh(across @ total @ across + 1e12 * np.outer(up, up))[0])
    excess = max(1.0, sum(cue.cost(up) for cue in agreeing) / max(1, len(agreeing) - 1))
    return min(90.0, float(np.degrees(np.sqrt(excess / max(least_information, NOTHING)))))


def _shared_cues(cameras: Cameras, points: FloatArray, seed: int) -> list[Cue]:
    """All cues but that of the level cameras."""
    rotations = cameras.cam_from_world[:, :3, :3]
    cues = (
        _ground_cue(points, seed),
        _level_scatter_cue(PATH, cameras.centers, SLOPE_RAD) if len(cameras) > 3 else None,
        _mean_cue(DOWN, -rotations[:, 2], MAX_DOWN_SPREAD_RAD, MIN_MOUNT_RAD),
        _mean_cue(UPRIGHT, -rotations[:, 1], MAX_UPRIGHT_SPREAD_RAD, MIN_PITCH_RAD),
    )
    return [cue for cue in cues if cue is not None]


def _mean_cue(name: str, directions: FloatArray, max_spread_rad: float, sigma_rad: float) -> Cue | None:
    """Up is the mean of unit vectors (C,3); None where their RMS angle is over `max_spread_rad`."""
    mean = _unit(directions.sum(axis=0))
    spread_rad = float(np.sqrt(np.mean(np.arccos(np.clip(directions @ mean, -1, 1)) ** 2)))
    if spread_rad > max_spread_rad:
        return None
    variance = sigma_rad**2 + spread_rad**2 / min(len(directions), MAX_INDEPENDENT)
    return Cue(name=name, information=(np.eye(3) - np.outer(mean, mean)) / variance, direction=mean)


def _level_cameras_cues(cameras: Cameras) -> list[Cue]:
    """The x axes lie level; or else the y axes, where the x axes all point one way while the y axes
    turn about it by more than 30°."""
    x_axes, y_axes = cameras.cam_from_world[:, 0, :3], cameras.cam_from_world[:, 1, :3]
    across, down = (np.linalg.eigvalsh(axes.T @ axes / len(axes)) for axes in (x_axes, y_axes))
    upright_pictures = across[1] < 0.05 and down[1] > 0.25
    return [_level_axes_cue(x_axes), *([_level_axes_cue(y_axes)] if upright_pictures else [])]


def _level_axes_cue(axes: FloatArray) -> Cue:
    """Unit vectors (C,3) lie level; least sum of angles, so that a picture on its side counts no
    more than others."""
    weights = np.ones(len(axes))
    level = np.zeros(3)
    for _ in range(NUM_REFITS):
        level = np.linalg.eigh((axes * weights[:, None]).T @ axes)[1][:, 0]
        weights = 1 / np.maximum(np.abs(axes @ level), MIN_MOUNT_RAD)
    weights /= weights.sum()
    variance = MIN_MOUNT_RAD**2 + float(weights @ (axes @ level) ** 2) / min(len(axes), MAX_INDEPENDENT)
    return Cue(name=LEVEL, information=(axes * weights[:, None]).T @ axes / variance, direction=level)


def _upward(cameras: Cameras, *, on_their_side: bool) -> FloatArray:
    """A vector whose sign along up is that of up: pictures are upright (−y up) or look down (−z
    up), on their side only the latter."""
    rotations = cameras.cam_from_world[:, :3, :3]
    return -(rotations[:, 2] + (0 if on_their_side else 1) * rotations[:, 1]).mean(axis=0)


def _ground_cue(points: FloatArray, seed: int) -> Cue | None:
    """The plane near most points; None where they are few or coincide."""
    if len(points) < MIN_POINTS:
        return None
    rng = np.random.default_rng(seed)
    sample = points[rng.choice(len(points), min(len(points), MAX_PLANE_POINTS), replace=False)]
    near = _points_of_dominant_plane(sample, rng)
    if near is None:
        return None
    return _level_scatter_cue(GROUND, sample[near], SLOPE_RAD / np.sqrt(near.mean()))


def _points_of_dominant_plane(sample: FloatArray, rng: np.random.Generator) -> NDArray[np.bool_] | None:
    """Points (P,) within 5 % of the median radius of the plane that most lie near (RANSAC)."""
    middle = np.median(sample, axis=0)
    near = 0.05 * float(np.median(np.linalg.norm(sample - middle, axis=1)))
    best, best_count = None, 2
    for _ in range(NUM_PLANE_TRIALS):
        a, b, c = sample[rng.choice(len(sample), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length == 0:
            continue
        within = np.abs((sample - a) @ (normal / length)) < near
        if within.sum() > best_count:
            best, best_count = within, int(within.sum())
    return best


def _level_scatter_cue(name: str, positions: FloatArray, slope_rad: float) -> Cue | None:
    """These positions (N,3) lie on one level, as far as they spread; None where they coincide."""
    variances, axes = np.linalg.eigh(np.cov(positions.T))
    variances = np.maximum(variances, 0)
    if variances[2] <= NOTHING**2 * max(1.0, float(np.abs(positions).max()) ** 2):
        return None
    information = np.zeros((3, 3))
    for variance, axis in zip(variances[1:], axes.T[1:], strict=True):
        if variance > NOTHING * variances[2]:
            sigma2 = slope_rad**2 + (variances[0] / 4 + UNEVENNESS**2 * variances[2]) / variance
            information += (1 - variances[0] / variance) * np.outer(axis, axis) / sigma2
    return Cue(name=name, information=information, direction=axes[:, 0])


def _unit(vector: FloatArray) -> FloatArray:
    length = float(np.linalg.norm(vector))
    return vector / length if length > NOTHING else np.array([0.0, 0.0, 1.0])


def _angle_rad(a: FloatArray, b: FloatArray) -> float:
    """Angle between two lines, 0 to π/2."""
    return float(np.arccos(min(1.0, abs(float(a @ b)))))
