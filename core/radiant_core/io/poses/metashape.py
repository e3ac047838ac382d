"""cameras.xml of Metashape (Export Cameras). Once per source.

    camera     <transform>: chunk from camera (4,4), OpenCV's axes
    lens       f, cx and cy from the middle; fx = f + b1, skew b2; p1 and p2 are exchanged against
               OpenCV's; k4 is of r⁸. <calibration class="adjusted"> goes before "initial";
               type="spherical" has none: u = w/2 + w/2π · atan(X/Z), v alike
    component  <transform>: world = scale · rotation · chunk + translation, or that of the chunk

Where the chunk has a coordinate system the world is geocentric (ECEF), else it is local. Lenses of
versions before 2017 have <fx>, <fy>, <skew>, a principal point from the corner and OpenCV's p1, p2.
Sources: Metashape's manual (appendix D), EasyIDP's reconstruct.py and metashape.py.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree.ElementTree import Element, ParseError, fromstring

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.frames import Sim3
from radiant_core.io.poses.fields import read_text
from radiant_core.io.poses.lens import Lens, sphere_lens
from radiant_core.io.poses.pose_file import UNKNOWN_WORLD, GivenWorld, PosedView, PoseFile, SizeOf, nearest_rotation, posed_view
from radiant_core.numerics import FloatArray

EARTH_M = 6e6
"""A world so far from its origin is geocentric."""
LENS_TYPES = ("frame", "fisheye", "spherical")
_DECLARED_ENCODING = re.compile(r"^(\s*<\?xml[^>]*?)\sencoding\s*=\s*(\"[^\"]*\"|'[^']*')")
"""What the text was in before it was decoded."""
NO_TRANSFORM = Sim3(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))


def read_metashape(path: Path, size_of: SizeOf) -> PoseFile:
    """The aligned cameras of the largest component of the first chunk that has any. Raises BadInput
    for a lens that is not read here, by its name."""
    del size_of
    text = read_text(path)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise BadInput(f"{path} declares a document type or entities, which Metashape does not write and which are not read.")
    try:
        # What is dangerous here needs the DTD that was refused above.
        root = fromstring(_DECLARED_ENCODING.sub(r"\1", text[:200]) + text[200:])  # noqa: S314
    except (ParseError, ValueError, RecursionError) as error:
        raise BadInput(f"{path} is no valid XML ({str(error)[:80]}): export the cameras again.") from None
    chunks = [root] if root.tag == "chunk" else root.findall("chunk")
    chosen = max(chunks, key=lambda chunk: len(_aligned(chunk)), default=None)
    if chosen is None or not _aligned(chosen):
        raise BadInput(f"{path} has no chunk with aligned cameras: export the cameras of an aligned chunk.")
    cameras = _aligned(chosen)
    components = [camera.get("component_id", "") for camera in cameras]
    component = max(dict.fromkeys(components), key=components.count)
    used = [camera for camera, component_id in zip(cameras, components, strict=True) if component_id == component]
    total = len(chosen.findall(".//cameras//camera"))
    notes = []
    if len(chunks) > 1:
        notes.append(f"of {len(chunks)} chunks in {path.name} the one with {len(cameras)} aligned cameras is used.")
    if len(used) < len(cameras):
        notes.append(f"{len(cameras) - len(used)} of {len(cameras)} cameras are in another component than most and are left out.")
    if len(cameras) < total:
        notes.append(f"{total - len(cameras)} of {total} cameras of the chunk are not aligned and are left out.")
    world_from_chunk, has_world = _world_from_chunk(chosen, component, path)
    lenses, numbers = _lenses(chosen, used, path)
    return PoseFile(
        path=path,
        program="Metashape",
        lenses=lenses,
        views=tuple(_view(camera, numbers, world_from_chunk, path) for camera in used),
        points=np.zeros((0, 3)),
        world=_world(chosen, world_from_chunk, has_world=has_world),
        notes=tuple(notes),
    )


def _aligned(chunk: Element) -> list[Element]:
    return [camera for camera in chunk.findall(".//cameras//camera") if camera.findtext("transform")]


def _lenses(chunk: Element, cameras: list[Element], path: Path) -> tuple[dict[int, Lens], dict[str, int]]:
    sensors = {sensor.get("id", ""): sensor for sensor in chunk.findall(".//sensors/sensor")}
    wanted = list(dict.fromkeys(camera.get("sensor_id", "") for camera in cameras))
    lost = [sensor_id for sensor_id in wanted if sensor_id not in sensors]
    if lost:
        raise BadInput(f"{path} has no sensor {lost[0]!r}, which a camera names: export the cameras again.")
    numbers = {sensor_id: number for number, sensor_id in enumerate(wanted, 1)}
    return {numbers[sensor_id]: _lens(sensors[sensor_id], path) for sensor_id in wanted}, numbers


def _lens(sensor: Element, path: Path) -> Lens:
    label = f"{path}: sensor {sensor.get('label', sensor.get('id', ''))[:60]!r}"
    kind = sensor.get("type", "frame")
    if kind not in LENS_TYPES:
        raise BadInput(f"{label} is of type {kind!r}, expected {' or '.join(LENS_TYPES)}: undistort or cut its photographs in Metashape.")
    if kind == "spherical":
        # It has no calibration: its picture is the whole sphere.
        return sphere_lens(_size_wh(sensor.find("resolution"), label))
    calibrations = {calibration.get("class", "adjusted"): calibration for calibration in sensor.findall("calibration")}
    calibration = calibrations.get("adjusted", calibrations.get("initial"))
    if calibration is None:
        raise BadInput(f"{label} has no calibration: align the photographs and export the cameras again.")
    resolution = calibration.find("resolution")
    resolution = sensor.find("resolution") if resolution is None else resolution
    size_wh = width, height = _size_wh(resolution, label)

    def value(tag: str, default: float = 0.0) -> float:
        text = calibration.findtext(tag)
        return default if text is None else float(_numbers(text, 1, f"{label}: <{tag}>")[0])

    k = (value("k1"), value("k2"), value("k3"), value("k4"))
    if calibration.find("fx") is not None:
        fx, fy, cx, cy = value("fx"), value("fy"), value("cx", width / 2), value("cy", height / 2)
        return Lens(size_wh=size_wh, fx=fx, fy=fy, cx=cx, cy=cy, k=k, p1=value("p1"), p2=value("p2"), skew=value("skew"))
    if value("p3") or value("p4"):
        raise BadInput(f"{label} has p3 or p4, which no lens here has: optimise the cameras without them.")
    f = value("f")
    return Lens(
        size_wh=size_wh,
        fx=f + value("b1"),
        fy=f,
        cx=width / 2 + value("cx"),
        cy=height / 2 + value("cy"),
        kind="fisheye" if kind == "fisheye" else "brown",
        k=k,
        p1=value("p2"),
        p2=value("p1"),
        skew=value("b2"),
    )


def _size_wh(resolution: Element | None, label: str) -> tuple[int, int]:
    if resolution is None:
        raise BadInput(f"{label} has no resolution: export the cameras again.")
    width, height = (_numbers(resolution.get(side), 1, label)[0] for side in ("width", "height"))
    return int(width), int(height)


def _world_from_chunk(chunk: Element, component: str, path: Path) -> tuple[Sim3, bool]:
    """The similarity of the component, else of the chunk; the identity where neither has one."""
    places = [element.find("transform") for element in chunk.findall(".//components/component") if element.get("id", "") == component]
    transform = next((place for place in (*places, chunk.find("transform")) if place is not None and place.findtext("rotation")), None)
    if transform is None:
        return NO_TRANSFORM, False
    label = f"{path}: the transform of the chunk"
    scale = float(_numbers(transform.findtext("scale", "1"), 1, label)[0])
    if not 1e-9 < scale < 1e9:
        raise BadInput(f"{label} has the scale {scale:g}, expected a positive one: export the cameras again.")
    rotation = nearest_rotation(_numbers(transform.findtext("rotation"), 9, label).reshape(3, 3), "the chunk")
    return Sim3(scale=scale, rotation=rotation, translation=_numbers(transform.findtext("translation", "0 0 0"), 3, label)), True


def _world(chunk: Element, world_from_chunk: Sim3, *, has_world: bool) -> GivenWorld:
    reference = (chunk.findtext("reference") or "").strip()
    if not has_world:
        return UNKNOWN_WORLD
    if reference and not reference.startswith("LOCAL_CS") and np.linalg.norm(world_from_chunk.translation) > EARTH_M:
        return GivenWorld(kind="ecef")
    return GivenWorld(kind="metres")


def _view(camera: Element, numbers: dict[str, int], world_from_chunk: Sim3, path: Path) -> PosedView:
    name = camera.get("label", "")
    label = f"{path}: camera {name[:80]!r}"
    matrix = _numbers(camera.findtext("transform"), 16, label).reshape(4, 4)
    rotation = nearest_rotation(matrix[:3, :3], f"camera {name[:80]!r}").T @ world_from_chunk.rotation.T
    center = world_from_chunk.apply(matrix[None, :3, 3])[0]
    return posed_view(name, numbers[camera.get("sensor_id", "")], rotation, -rotation @ center)


def _numbers(text: str | None, count: int, label: str) -> FloatArray:
    words = (text or "").split()
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not (np.abs(values) < 1e12).all():
        raise BadInput(f"{label} is {(text or '')[:60]!r}, expected {count} finite number{'s' * (count > 1)}: export the cameras again.")
    return values
