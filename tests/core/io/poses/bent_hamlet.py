"""A sample scene as a real lens would have taken it: its true poses, its photographs bent by OpenCV's equations.

Nothing here uses the project's lenses or readers: points are projected by cv2.projectPoints, photographs are bent by
cv2.undistortPoints, and poses are plain matrices.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from radiant_core.io.colmap.model import read_model
from tests.colmap_projects import HAMLET

SIMPLE = (-0.11, 0.03, 0.0, 0.0, 0.0)
"""k1 k2 p1 p2 k3, as OpenCV orders them: radial alone."""
BROWN = (-0.11, 0.03, 0.012, -0.008, -0.01)


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """Names, cam_from_world and what they see, of one camera."""

    names: list[str]
    R: np.ndarray
    t: np.ndarray
    points: np.ndarray
    colors: np.ndarray
    width: int = 320
    height: int = 240
    fx: float = 211.0
    fy: float = 211.0
    cx: float = 163.0
    cy: float = 117.5
    dist: tuple[float, float, float, float, float] = BROWN
    k4: float = 0.0
    skew: float = 0.0
    seen: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)

    @property
    def C(self) -> np.ndarray:
        return np.array([-R.T @ t for R, t in zip(self.R, self.t, strict=True)])

    @property
    def K(self) -> np.ndarray:
        return np.array([[self.fx, self.skew, self.cx], [0, self.fy, self.cy], [0, 0, 1]])

    def project(self, number: int, points: np.ndarray) -> np.ndarray:
        """Pixels (P,2), the first one's middle at 0.5."""
        inside = points @ self.R[number].T + self.t[number]
        x, y = inside[:, 0] / inside[:, 2], inside[:, 1] / inside[:, 2]
        k1, k2, p1, p2, k3 = self.dist
        r2 = x**2 + y**2
        bend = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3 + self.k4 * r2**4
        u, v = x * bend + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * bend + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
        if self.k4 == 0 and self.skew == 0:
            pixels, _ = cv2.projectPoints(points[:, None], cv2.Rodrigues(self.R[number])[0], self.t[number], self.K, np.array(self.dist))
            return pixels[:, 0]
        return np.column_stack([self.cx + self.fx * u + self.skew * v, self.cy + self.fy * v])


def bent_hamlet(folder: Path, dist: tuple[float, float, float, float, float] = BROWN, **changed: float) -> Truth:
    """Write images/ into `folder`; the truth of its cameras in the hamlet's metres."""
    return bent_scene(HAMLET, folder, dist, **changed)


def bent_scene(scene: Path, folder: Path, dist: tuple[float, float, float, float, float] = BROWN, **changed: float) -> Truth:
    """The same of any scene of sample_scenes; `changed` is in px of a picture of 320."""
    model = read_model(scene / "known")
    (camera,) = model.cameras.values()
    scale = camera.size_wh[0] / 320
    lens = {"fx": 211.0, "fy": 211.0, "cx": 163.0, "cy": 117.5, "skew": 0.0} | {key: each for key, each in changed.items() if key != "k4"}
    names = [image.name for image in model.images]
    poses = np.array([image.cam_from_world for image in model.images])
    truth = Truth(
        names=names,
        R=poses[:, :3, :3],
        t=poses[:, :3, 3],
        points=model.points.xyz,
        colors=model.points.colors,
        dist=dist,
        width=camera.size_wh[0],
        height=camera.size_wh[1],
        k4=changed.get("k4", 0.0),
        **{key: scale * each for key, each in lens.items()},  # type: ignore[arg-type]
    )
    (folder / "images").mkdir(parents=True, exist_ok=True)
    columns, rows = _sources(truth, camera.params)
    for name in names:
        pixels = cv2.imread(str(scene / "images" / name))
        assert pixels is not None
        bent = cv2.remap(pixels, columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        cv2.imwrite(str(folder / "images" / name), bent, [cv2.IMWRITE_JPEG_QUALITY, 95])
    for number, image in enumerate(model.images):
        rows_seen = image.point3d_ids[image.point3d_ids != -1] - 1
        px = truth.project(number, truth.points[rows_seen])
        inside = ((px > 0) & (px < (truth.width, truth.height))).all(axis=1)
        truth.seen.append((px[inside], rows_seen[inside]))
    return truth


def _sources(truth: Truth, pinhole: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Where each pixel of a bent photograph lies in the scene's own pinhole (index px)."""
    grid = np.stack(np.meshgrid(np.arange(truth.width) + 0.5, np.arange(truth.height) + 0.5), axis=-1).reshape(-1, 2)
    rays = (grid - (truth.cx, truth.cy)) / (truth.fx, truth.fy)
    for _ in range(60):
        rays = rays - (_bend(truth, rays) - grid) / (truth.fx, truth.fy)
    assert np.abs(_bend(truth, rays) - grid).max() < 1e-6
    fx, fy, cx, cy = pinhole
    source = rays * (fx, fy) + (cx, cy) - 0.5
    maps = source.reshape(truth.height, truth.width, 2).astype(np.float32)
    return maps[..., 0], maps[..., 1]


def _bend(truth: Truth, xy: np.ndarray) -> np.ndarray:
    x, y = xy.T
    k1, k2, p1, p2, k3 = truth.dist
    r2 = x**2 + y**2
    bend = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3 + truth.k4 * r2**4
    u, v = x * bend + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * bend + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return np.column_stack([truth.cx + truth.fx * u + truth.skew * v, truth.cy + truth.fy * v])
