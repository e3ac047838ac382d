"""Fisheyes without coefficients, which COLMAP takes for pinholes when it undistorts. Once per
model.

pycolmap 4.2.1 asks a lens for its coefficients alone: where they are all within 1e-8, or it has
none (SIMPLE_FISHEYE, FISHEYE), `is_undistorted` is true and the bent picture is copied as it is.
The same lens with one coefficient just above that is undistorted, which moves no ray by more than
5e-8 of its angle.
"""

from __future__ import annotations

from radiant_core.io.colmap.records import MAX_STRAIGHT
from radiant_core.sfm.colmap.calls import pycolmap


def bend_plain_fisheyes(model: pycolmap.Reconstruction) -> bool:
    """Give every fisheye of `model` that COLMAP would take for a pinhole a coefficient; whether
    there was one."""
    plain = [camera for camera in model.cameras.values() if "FISHEYE" in camera.model.name and camera.is_undistorted()]
    for camera in plain:
        places = (camera.focal_length_x, camera.focal_length_y, camera.principal_point_x, camera.principal_point_y)
        camera.model = pycolmap.CameraModelId.OPENCV_FISHEYE
        camera.params = [*places, 2 * MAX_STRAIGHT, 0.0, 0.0, 0.0]
    return bool(plain)
