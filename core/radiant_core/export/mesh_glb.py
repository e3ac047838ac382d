"""A raster of heights with a picture on it as a textured mesh in one GLB file, by trimesh. Once per
export.

glTF has y up: (x, y, z) = (east, up, −north) on the map, in metres, less an offset that stands in
the scene's `extras`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from radiant_core.errors import BadInput
from radiant_core.io.run_store import write_atomic
from radiant_core.numerics import FloatArray

JPEG_QUALITY = 90


def save_glb(
    path: Path, vertices: FloatArray, triangles: NDArray[np.int64], uv: FloatArray, picture: NDArray[np.uint8], about: dict[str, Any]
) -> None:
    """Write vertices (V,3) east, north, up, triangles (T,3), uv (V,2) with v upwards, and a picture
    (H,W,3), atomically; `about` becomes extras. BadInput without triangles."""
    import io

    import trimesh
    from PIL import Image
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    if not len(triangles):
        raise BadInput("the surface has no triangle to write as GLB: look at the surface model first.")
    coded, jpeg = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not coded:
        raise BadInput(f"a picture of {picture.shape} cannot be a texture: choose a coarser --resolution.")
    material = PBRMaterial(
        baseColorTexture=Image.open(io.BytesIO(jpeg.tobytes())), metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True
    )
    mesh = trimesh.Trimesh(
        vertices=vertices[:, [0, 2, 1]] * [1, 1, -1],
        faces=triangles,
        visual=TextureVisuals(uv=uv, material=material),
        process=False,
    )
    scene = trimesh.Scene(mesh)
    scene.metadata.update(about)
    content = scene.export(file_type="glb")
    assert isinstance(content, bytes)
    write_atomic(path, content)
