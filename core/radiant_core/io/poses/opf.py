"""Projects in the Open Photogrammetry Format 1.0 (project.opf). Once per source.

    calibrated cameras  world from camera = Rx(ω) Ry(φ) Rz(κ), OpenGL's axes; position: the centre
    internals           pixels from the first one's corner; R1 R2 R3 T1 T2 = k1 k2 k3 p1 p2
    scene frame         processing = swap(scale · base) + shift: undone, so that the world is the
                        base system's, east before north

Names and sizes stand in the camera list and the input cameras. Tracks are glTF and not read: points
are triangulated. Source: the specification, https://pix4d.github.io/opf-spec
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from urllib.parse import unquote, urlsplit

import numpy as np
from scipy.spatial.transform import Rotation

from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.io.poses.fields import Fields, read_json_file
from radiant_core.io.poses.lens import Lens, sphere_lens
from radiant_core.io.poses.pose_file import UNKNOWN_WORLD, GivenWorld, PosedView, PoseFile, SizeOf, posed_view

FLIP = np.diag([1.0, -1.0, -1.0])
KINDS = {
    "calibrated": "application/opf-calibrated-cameras+json",
    "list": "application/opf-camera-list+json",
    "input": "application/opf-input-cameras+json",
    "frame": "application/opf-scene-reference-frame+json",
}
LOCAL_NAMES = ("LOCAL_CS", "ENGCRS", "ENGINEERINGCRS", "Arbitrary")
NO_MOVE = Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))


def parts_of(path: Path) -> dict[str, Path]:
    """The files of the project that are read, by what they hold."""
    project = Fields(read_json_file(path), str(path))
    parts: dict[str, Path] = {}
    for item in project.objects("items"):
        for resource in item.objects("resources"):
            form = resource.text("format")
            kind = next((kind for kind, name in KINDS.items() if name == form), None)
            if kind is None:
                continue
            if kind in parts:
                raise BadInput(f"{path} has two resources of the format {form}: export a project with one calibration.")
            parts[kind] = path.parent / _inner(resource.text("uri"), path)
    return parts


def read_opf(path: Path, size_of: SizeOf) -> PoseFile:
    """The calibrated cameras of a project. Raises BadInput for a lens that is not read here, by its
    name."""
    del size_of
    parts = parts_of(path)
    lacking = [KINDS[kind] for kind in ("calibrated", "list", "input") if kind not in parts]
    if lacking:
        raise BadInput(f"{path} has no resource of the format {lacking[0]}: export the project with its calibration.")
    files = {kind: Fields(read_json_file(part), str(part)) for kind, part in parts.items()}
    names = {camera.whole("id"): _name(camera.text("uri")) for camera in files["list"].objects("cameras")}
    sizes = {sensor.whole("id"): sensor.numbers("image_size_px", (2,)) for sensor in files["input"].objects("sensors")}
    lenses = {sensor.whole("id"): _lens(sensor, sizes) for sensor in files["calibrated"].objects("sensors")}
    numbers = {sensor: number for number, sensor in enumerate(lenses, 1)}
    world, base_from_processing, notes = _world(files.get("frame"))
    views = [_view(camera, names, numbers, base_from_processing) for camera in files["calibrated"].objects("cameras")]
    used = {view.lens_id for view in views}
    return PoseFile(
        path=path,
        program="OPF",
        lenses={numbers[sensor]: lens for sensor, lens in lenses.items() if numbers[sensor] in used},
        views=tuple(views),
        points=np.zeros((0, 3)),
        world=world,
        notes=notes,
    )


def _inner(uri: str, path: Path) -> str:
    """The path of a resource below the project."""
    parts = urlsplit(uri)
    name = PurePosixPath(unquote(parts.path))
    if parts.scheme or parts.netloc or name.is_absolute() or ".." in name.parts or not str(name).isprintable():
        raise BadInput(f"{path} names the resource {uri[:80]!r}, expected a path inside its folder: copy the whole project here.")
    return str(name)


def _name(uri: str) -> str:
    name = unquote(urlsplit(uri.replace("\\", "/")).path) if "://" in uri or "%" in uri else uri
    return name if name.isprintable() and name else repr(name)


def _lens(sensor: Fields, sizes: dict[int, np.ndarray]) -> Lens:
    internals = sensor.object("internals")
    kind = internals.text("type")
    if kind not in ("perspective", "spherical"):
        raise BadInput(
            f"{internals.place} is of the type {kind!r}, which is not read here, expected 'perspective' or 'spherical': undistort first."
        )
    size = sizes.get(sensor.whole("id"))
    if size is None or (size != np.rint(size)).any():
        raise BadInput(f"{sensor.place} has no size in whole pixels among the input cameras: export the project again.")
    if kind == "spherical":
        return sphere_lens((int(size[0]), int(size[1])))
    focal = internals.number("focal_length_px")
    cx, cy = internals.numbers("principal_point_px", (2,)).tolist()
    k1, k2, k3 = internals.numbers("radial_distortion", (3,)).tolist()
    p1, p2 = internals.numbers("tangential_distortion", (2,)).tolist()
    return Lens(size_wh=(int(size[0]), int(size[1])), fx=focal, fy=focal, cx=cx, cy=cy, k=(k1, k2, k3, 0.0), p1=p1, p2=p2)


def _world(frame: Fields | None) -> tuple[GivenWorld, Sim3, tuple[str, ...]]:
    """The world, base_from_processing, and what is said of them."""
    if frame is None:
        return UNKNOWN_WORLD, NO_MOVE, ("the project has no scene reference frame: its coordinates are taken as they are.",)
    transform, crs = frame.object("base_to_canonical"), frame.object("crs")
    scale, shift = transform.numbers("scale", (3,)), transform.numbers("shift", (3,))
    if not (scale > 1e-6).all() or np.ptp(scale) > 1e-9 * scale.max():
        raise BadInput(f"{transform.place} scales the axes by {scale.tolist()}, expected one positive scale: export in a metric system.")
    move = Sim3(scale=1 / float(scale[0]), rotation=np.eye(3), translation=-shift / float(scale[0]))
    definition, swapped = crs.text("definition").strip(), transform.value.get("swap_xy") is True
    notes = ["the base system counts north before east: coordinates are given east first."] if swapped else []
    if "geoid_height" in crs:
        notes.append(f"heights count from a geoid {crs.number('geoid_height'):g} m above the ellipsoid.")
    local = definition.startswith(LOCAL_NAMES)
    return GivenWorld(kind="metres") if local else GivenWorld(kind="crs", crs=definition), move, tuple(notes)


def _view(camera: Fields, names: dict[int, str], numbers: dict[int, int], base_from_processing: Sim3) -> PosedView:
    number, sensor = camera.whole("id"), camera.whole("sensor_id")
    if number not in names or sensor not in numbers:
        raise BadInput(f"{camera.place} is in no camera list or of no sensor: copy the whole project here.")
    omega, phi, kappa = camera.numbers("orientation_deg", (3,)).tolist()
    rotation = FLIP @ Rotation.from_euler("XYZ", [omega, phi, kappa], degrees=True).as_matrix().T
    center = base_from_processing.apply(camera.numbers("position", (3,))[None])[0]
    return posed_view(names[number], numbers[sensor], rotation, -rotation @ center)
