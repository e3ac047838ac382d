"""Camera flights for films: an orbit, along a border, smooth paths through keyframes. V frames.

Every frame looks from a position at a target with z up; straight down, north is up. Between
keyframes positions and targets follow Akima's modified splines, which do not overshoot as cubic
ones do (Akima, J. ACM 17, 1970). Pure geometry, once per film.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array

MAX_FRAMES = 100_000
MAX_SIDE_PX = 8192


@dataclass(frozen=True, kw_only=True)
class Lens:
    """What each frame is taken with: size in px, by default 960 × 540; field of view across the
    wider side in degrees, by default 60.

    Example:
        >>> lens = radiant.Lens(size_wh=(640, 480), field_of_view_deg=75)
        >>> cameras = radiant.orbit((0, 0, 0), 20, 30, 4, lens)
        >>> cameras.sizes_wh[0].tolist()
        [640, 480]
    """

    size_wh: tuple[int, int] = (960, 540)
    field_of_view_deg: float = 60.0

    def __post_init__(self) -> None:
        if not all(16 <= side <= MAX_SIDE_PX for side in self.size_wh):
            raise BadInput(f"a frame of {self.size_wh[0]} × {self.size_wh[1]} px was asked for, expected 16 to {MAX_SIDE_PX} px a side.")
        if not 1 <= self.field_of_view_deg <= 150:
            raise BadInput(f"a field of view of {self.field_of_view_deg}° was asked for, expected 1° to 150°.")

    @property
    def K(self) -> FloatArray:
        """Calibration matrix (3,3) px."""
        width, height = self.size_wh
        focal_px = max(self.size_wh) / 2 / np.tan(np.radians(self.field_of_view_deg) / 2)
        return np.array([[focal_px, 0, width / 2], [0, focal_px, height / 2], [0, 0, 1]])


def cameras_looking_at(positions: ArrayLike, targets: ArrayLike, lens: Lens) -> Cameras:
    """Cameras at positions (V,3) that look at targets (V,3), named frame_00000 and so on; BadInput
    where both coincide, or for no frame. Use it for views of your own.

    Args:
        positions: m, where each camera stands.
        targets: m, what is in the middle of its picture.
        lens: size and field of view of the pictures.

    Example:
        >>> lens = radiant.Lens(size_wh=(320, 240))
        >>> cameras = radiant.cameras_looking_at([(0, -9, 5)], [(0, 0, 0)], lens)
        >>> cameras.names
        ('frame_00000',)
    """
    positions = check_array("positions", positions, (None, 3))
    targets = check_array("targets", targets, (len(positions), 3))
    if not 1 <= len(positions) <= MAX_FRAMES:
        raise BadInput(f"{len(positions)} frames were asked for, expected 1 to {MAX_FRAMES:,}.")
    ahead = targets - positions
    distances = np.linalg.norm(ahead, axis=1, keepdims=True)
    if (distances < 1e-9).any():
        raise BadInput(f"frame {int(distances.argmin())} stands where it looks: move its position or its target.")
    ahead = ahead / distances
    right = np.column_stack([ahead[:, 1], -ahead[:, 0], np.zeros(len(ahead))])
    lengths = np.linalg.norm(right, axis=1, keepdims=True)
    right = np.where(lengths > 1e-6, right / np.maximum(lengths, 1e-6), [1.0, 0.0, 0.0])
    down = np.cross(ahead, right)
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, :3] = np.stack([right, down, ahead], axis=1)
    # Straight down, "right" was set by hand: make the frame orthonormal again.
    poses[:, :3, :3] = [_nearest_rotation(rotation) for rotation in poses[:, :3, :3]]
    poses[:, :3, 3] = -np.einsum("vij,vj->vi", poses[:, :3, :3], positions)
    count = len(positions)
    return Cameras(
        names=tuple(f"frame_{index:05d}" for index in range(count)),
        Ks=np.tile(lens.K, (count, 1, 1)),
        cam_from_world=poses,
        sizes_wh=np.tile(np.array(lens.size_wh, np.int64), (count, 1)),
    )


def orbit(center: ArrayLike, radius: float, elevation_deg: float, num_frames: int, lens: Lens) -> Cameras:
    """Once around `center` (3,) at a distance, seen from `elevation_deg` above the horizon; the
    last frame ends before the first begins. Use it for turning films of a model.

    Args:
        center: (3,) m that every frame looks at.
        radius: m from there to the cameras.
        elevation_deg: above the horizon; 90: from straight above.
        num_frames: of the whole circle.
        lens: size and field of view of the frames.

    Example:
        >>> cameras = radiant.orbit((0, 0, 0), 20, 30, 8, radiant.Lens(size_wh=(320, 240)))
        >>> len(cameras), round(float(cameras.centers[0, 2]), 3)
        (8, 10.0)
    """
    if not (np.isfinite(radius) and radius > 0 and -89 <= elevation_deg <= 89):
        raise BadInput(f"an orbit of radius {radius} at {elevation_deg}° was asked for, expected a positive radius and −89° to 89°.")
    center = check_array("center", center, (3,))
    turn, rise = np.linspace(0, 2 * np.pi, _check_count(num_frames), endpoint=False), np.radians(elevation_deg)
    offsets = np.column_stack([np.cos(rise) * np.sin(turn), np.cos(rise) * np.cos(turn), np.full(len(turn), np.sin(rise))])
    return cameras_looking_at(center + radius * offsets, np.tile(center, (len(turn), 1)), lens)


def middle_box(points: ArrayLike) -> FloatArray:
    """Lower and upper corner (2,3) of where most of points (N,3) lie: median ± twice the median
    distance from it, by axis; all of them where they spread evenly, hardly moved by a third that is
    far away, such as sky and haze. Raises BadInput without points."""
    points = check_array("points", points, (None, 3))
    if not len(points):
        raise BadInput("there is no point to look at: give a model that holds some.")
    middle = np.median(points, axis=0)
    reach = 2 * np.median(np.abs(points - middle), axis=0)
    return np.stack([middle - reach, middle + reach])


def box_corners(box: FloatArray) -> FloatArray:
    """The eight corners (8,3) of a box given by its lower and upper one (2,3)."""
    return np.array([[box[x, 0], box[y, 1], box[z, 2]] for x in (0, 1) for y in (0, 1) for z in (0, 1)])


def along_border(ends: ArrayLike, ground: float, height: float, num_frames: int, lens: Lens) -> Cameras:
    """Along the line between `ends` (2,2), `height` above ground, looking ahead and 45° down."""
    ends = check_array("ends", ends, (2, 2))
    length = float(np.linalg.norm(ends[1] - ends[0]))
    if not (length > 0 and np.isfinite(height) and height > 0):
        raise BadInput(f"a flight over a border of length {length} at height {height} was asked for, expected both above zero.")
    ahead = (ends[1] - ends[0]) / length
    # The target moves from end to end; the camera follows as far behind as it is high.
    targets = ends[0] + np.linspace(0, length, _check_count(num_frames))[:, None] * ahead
    positions = np.column_stack([targets - height * ahead, np.full(len(targets), ground + height)])
    return cameras_looking_at(positions, np.column_stack([targets, np.full(len(targets), ground)]), lens)


def through_keyframes(times_s: ArrayLike, positions: ArrayLike, targets: ArrayLike, fps: float, lens: Lens) -> Cameras:
    """A path through K ≥ 2 positions and targets (K,3) at rising times (K,), `fps` frames a second,
    first and last included."""
    from scipy.interpolate import Akima1DInterpolator

    times = check_array("times_s", times_s, (None,))
    if len(times) < 2 or not (np.diff(times) > 0).all():
        raise BadInput(f"the keyframes' times are {times.tolist()[:8]}, expected at least two, each later than the one before.")
    if not 0 < fps <= 240:
        raise BadInput(f"{fps} frames a second were asked for, expected above 0, at most 240.")
    points = np.hstack([check_array(name, value, (len(times), 3)) for name, value in (("positions", positions), ("targets", targets))])
    count = _check_count(round((times[-1] - times[0]) * fps) + 1)
    path = np.asarray(Akima1DInterpolator(times, points, method="makima")(np.linspace(times[0], times[-1], count)))
    return cameras_looking_at(path[:, :3], path[:, 3:], lens)


def _check_count(num_frames: int) -> int:
    if not 1 <= num_frames <= MAX_FRAMES:
        raise BadInput(f"{num_frames} frames were asked for, expected 1 to {MAX_FRAMES:,}.")
    return num_frames


def _nearest_rotation(matrix: FloatArray) -> FloatArray:
    U, _, Vt = np.linalg.svd(matrix)
    return U @ Vt
