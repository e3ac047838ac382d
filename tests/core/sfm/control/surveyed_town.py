"""The sample town's true cameras and points as COLMAP would have found them, in a frame of their own, and its ground control."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from control_points import ControlConfig, control_list
from radiant_core.georef.control_points import ControlPoints, ControlRequest, parse_control
from radiant_core.io.photos.listing import CameraKey, Photograph
from radiant_core.sfm.colmap.calls import pycolmap

TOWN = Path(__file__).parents[4] / "sample_scenes" / "town"
TRUE_ORIGIN = np.array([47.37, 8.54, 430.0])


def found_model(seed: int = 0, noise_px: float = 0.3, kept_every: int = 3) -> pycolmap.Reconstruction:
    """Ties of every so many points, with noise; poses and points moved by a similarity and bent by a
    bowl, as self-calibration leaves flights. A copy, which may be changed."""
    return pycolmap.Reconstruction(_made_model(seed, noise_px, kept_every))


@cache
def _made_model(seed: int, noise_px: float, kept_every: int) -> pycolmap.Reconstruction:
    rng = np.random.default_rng([seed, 3])
    model = pycolmap.Reconstruction(TOWN / "known")
    for number in sorted(model.points3D.keys()):
        if number % kept_every:
            model.delete_point3D(number)
    for image in model.images.values():
        # In place: what a reconstruction holds are its own points.
        for point in image.points2D:
            point.xy = point.xy + rng.normal(scale=noise_px, size=2)
        pose, center = image.cam_from_world(), image.projection_center()
        center = center + np.array([0.0, 0.0, 2e-4 * (center[:2] @ center[:2])])
        assert image.frame is not None
        image.frame.set_cam_from_world(image.camera_id, pycolmap.Rigid3d(pose.rotation, -pose.rotation.matrix() @ center))
    turn = pycolmap.Rotation3d(np.array([0.3, -0.2, 0.5]))
    model.transform(pycolmap.Sim3d(0.17, turn, np.array([3.0, -2.0, 1.0])))
    return model


def photographs(model: pycolmap.Reconstruction) -> tuple[Photograph, ...]:
    key = CameraKey(make="", model="", focal_mm=None, size_wh=(640, 480))
    names = sorted(image.name for image in model.images.values())
    return tuple(Photograph(name=name, path=Path(name), size_wh=(640, 480), lat_lon_alt=None, camera=key) for name in names)


def control(seed: int = 0, check: str = "", sigma_m: float = 0.02, **config: object) -> ControlPoints:
    text = control_list(TOWN, ControlConfig(seed=seed, **config))
    return parse_control(ControlRequest(text=text, source="gcp_list.txt", check=check, horizontal_m=sigma_m, vertical_m=sigma_m))
