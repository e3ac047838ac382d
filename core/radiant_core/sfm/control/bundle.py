"""A reconstruction as arrays that can be adjusted, and back. Once per scene.

C images with centre c and rotation R (p = R (X − c)), L lenses, P points, T ties (a point seen in
an image). Pixels and their derivatives by the lens are COLMAP's own, for any of its models:
derivatives by central differences, which are off by 1e-9 of a pixel.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from radiant_core.numerics import FloatArray
from radiant_core.sfm.colmap.calls import pycolmap

Rows = NDArray[np.int64]
STEP = 1e-6
LEAST_DEPTH = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Bundle:
    """What is adjusted; nothing is changed in place."""

    image_ids: Rows
    names: tuple[str, ...]
    rotations: FloatArray
    """(C,3,3) cam_from_world."""
    centers: FloatArray
    """(C,3)"""
    lens_of_image: Rows
    """(C,) row of `lenses`."""
    lenses: tuple[pycolmap.Camera, ...]
    params: tuple[FloatArray, ...]
    """Per lens all its parameters."""
    free: tuple[Rows, ...]
    """Per lens which parameters are adjusted."""
    points: FloatArray
    """(P,3)"""
    point_ids: Rows

    def project(self, images: Rows, points: FloatArray) -> FloatArray:
        """Pixels (K,2) of points (K,3) in images (K,); NaN behind the camera."""
        local = np.einsum("kij,kj->ki", self.rotations[images], points - self.centers[images])
        return self._pixels(images, local)

    def derivatives(self, images: Rows, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Pixels (K,2) and their derivatives by rotation and centre (K,2,6), by the free parameters
        of the lens (K,2,F), F the most of any lens, and by the point (K,2,3)."""
        R = self.rotations[images]
        local = np.einsum("kij,kj->ki", R, points - self.centers[images])
        by_local = np.zeros((len(images), 2, 3))
        for axis in range(3):
            step = np.zeros(3)
            step[axis] = STEP
            size = np.maximum(np.abs(local[:, 2:]), LEAST_DEPTH)
            high, low = self._pixels(images, local + step * size), self._pixels(images, local - step * size)
            by_local[:, :, axis] = (high - low) / (2 * STEP * size)
        by_point = np.einsum("kij,kjl->kil", by_local, R)
        x, y, z = local.T
        zero = np.zeros_like(x)
        # exp(ω) p ≈ p + ω × p
        turned = np.stack([np.stack([zero, z, -y], 1), np.stack([-z, zero, x], 1), np.stack([y, -x, zero], 1)], axis=1)
        by_pose = np.concatenate([np.einsum("kij,kjl->kil", by_local, turned), -by_point], axis=2)
        return self._pixels(images, local), by_pose, self._by_lens(images, local), by_point

    def moved(self, turns: FloatArray, shifts: FloatArray, lens_steps: FloatArray, points: FloatArray) -> Bundle:
        """Turned by (C,3) rad, shifted by (C,3), lenses changed by (L,F), with these points."""
        params = []
        for row, (values, free) in enumerate(zip(self.params, self.free, strict=True)):
            changed = values.copy()
            changed[free] += lens_steps[row, : len(free)]
            params.append(changed)
        return Bundle(
            image_ids=self.image_ids,
            names=self.names,
            rotations=Rotation.from_rotvec(turns).as_matrix() @ self.rotations,
            centers=self.centers + shifts,
            lens_of_image=self.lens_of_image,
            lenses=self.lenses,
            params=tuple(params),
            free=self.free,
            points=points,
            point_ids=self.point_ids,
        )

    @property
    def most_free(self) -> int:
        """F, the number of adjusted parameters of the lens that has most."""
        return max(len(free) for free in self.free)

    def _by_lens(self, images: Rows, local: FloatArray) -> FloatArray:
        derivatives = np.zeros((len(images), 2, self.most_free))
        for row, free in enumerate(self.free):
            in_lens = self.lens_of_image[images] == row
            for column, index in enumerate(free.tolist()):
                step = STEP * max(1.0, abs(float(self.params[row][index])))
                high, low = self.params[row].copy(), self.params[row].copy()
                high[index] += step
                low[index] -= step
                derivatives[in_lens, :, column] = (
                    _pixels(self.lenses[row], high, local[in_lens]) - _pixels(self.lenses[row], low, local[in_lens])
                ) / (2 * step)
        return derivatives

    def _pixels(self, images: Rows, local: FloatArray) -> FloatArray:
        pixels = np.full((len(images), 2), np.nan)
        for row, lens in enumerate(self.lenses):
            in_lens = self.lens_of_image[images] == row
            pixels[in_lens] = _pixels(lens, self.params[row], local[in_lens])
        return pixels


@dataclass(frozen=True, kw_only=True, eq=False)
class Ties:
    """What images see of points: images (T,), points (T,), pixels (T,2)."""

    images: Rows
    points: Rows
    pixels: FloatArray

    def at(self, rows: Rows | NDArray[np.bool_]) -> Ties:
        """Some of them."""
        return Ties(images=self.images[rows], points=self.points[rows], pixels=self.pixels[rows])


def bundle_of(model: pycolmap.Reconstruction) -> tuple[Bundle, Ties]:
    """The posed images of a reconstruction, and its ties."""
    images = [model.image(image_id) for image_id in sorted(model.reg_image_ids())]
    lens_ids = sorted({image.camera_id for image in images})
    lenses = tuple(copy(model.camera(lens_id)) for lens_id in lens_ids)
    point_ids = np.array(sorted(model.point3D_ids()), np.int64)
    poses = [image.cam_from_world() for image in images]
    bundle = Bundle(
        image_ids=np.array([image.image_id for image in images], np.int64),
        names=tuple(image.name for image in images),
        rotations=np.array([pose.rotation.matrix() for pose in poses]).reshape(-1, 3, 3),
        centers=np.array([image.projection_center() for image in images]).reshape(-1, 3),
        lens_of_image=np.array([lens_ids.index(image.camera_id) for image in images], np.int64),
        lenses=lenses,
        params=tuple(np.array(lens.params, np.float64) for lens in lenses),
        free=tuple(np.array([*lens.focal_length_idxs(), *lens.extra_params_idxs()], np.int64) for lens in lenses),
        points=np.array([model.point3D(int(point_id)).xyz for point_id in point_ids]).reshape(-1, 3),
        point_ids=point_ids,
    )
    rows, ids, pixels = [], [], []
    for row, image in enumerate(images):
        observations = image.get_observation_points2D()
        rows.append(np.full(len(observations), row))
        ids.append(np.array([point.point3D_id for point in observations], np.int64))
        pixels.append(np.array([point.xy for point in observations]).reshape(-1, 2))
    return bundle, Ties(
        images=np.concatenate(rows).astype(np.int64), points=np.searchsorted(point_ids, np.concatenate(ids)), pixels=np.concatenate(pixels)
    )


def write_back(bundle: Bundle, model: pycolmap.Reconstruction) -> None:
    """Put the poses, lenses and points of a bundle into the reconstruction that it came from."""
    for row, image_id in enumerate(bundle.image_ids.tolist()):
        image = model.image(image_id)
        R = bundle.rotations[row]
        frame = image.frame
        assert frame is not None
        frame.set_cam_from_world(image.camera_id, pycolmap.Rigid3d(pycolmap.Rotation3d(R), -R @ bundle.centers[row]))
        model.camera(image.camera_id).params = bundle.params[bundle.lens_of_image[row]].tolist()
    for row, point_id in enumerate(bundle.point_ids.tolist()):
        model.point3D(point_id).xyz = bundle.points[row]
    model.update_point_3d_errors()


def _pixels(lens: pycolmap.Camera, params: FloatArray, local: FloatArray) -> FloatArray:
    if not len(local):
        return np.zeros((0, 2))
    lens = copy(lens)
    lens.params = params.tolist()
    # Behind the camera it gives NaN.
    return np.asarray(lens.img_from_cam(local), np.float64).reshape(-1, 2)
