"""Which photographs share one lens, and how long it is before anything is known of it. Per scene.

    f = f₃₅ / √(36² + 24²) · √(W² + H²) px        the initial focal length, refined later

Photographs are of one lens where maker, model, serial numbers, lens and size agree, and focal
length, its 35 mm equivalent and digital zoom do too, within a width w. A lens that zooms or focuses
says another focal length in each photograph; so w is the least of `WIDTHS` by which a lens has
`LEAST_SHARED` photographs on average, or the most where none has. COLMAP alone would give every
photograph of a call the lens of its first one, and takes no notice of digital zoom.

Nobody believes every tag: a field of view that no lens has is not used, and is said.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from radiant_core.decisions import Decision
from radiant_core.io.photos.listing import CameraKey, Photograph
from radiant_core.sfm.colmap.calls import pycolmap

DIAGONAL_35MM = math.hypot(36, 24)
FOCAL_35MM_RANGE = (5.0, 3000.0)
"""mm: fields of view of 154° to 0.8° across the diagonal, those of a fisheye's edge and of a long
telephoto lens with digital zoom."""
FOCAL_MM_RANGE = (0.5, 3000.0)
CROP_RANGE = (0.4, 40.0)
"""35 mm equivalent ÷ focal length: from larger than medium format to a phone's smallest sensor."""
ZOOM_RANGE = (0.01, 200.0)
"""Digital zoom: twice what the longest phones have."""
WIDTHS = (0.01, 0.02, 0.04)
"""Differences of focal lengths, as shares, that one lens may have."""
LEAST_SHARED = 5.0
SAME_ZOOM = 0.05
DEFAULT_FACTOR = 1.2
"""Focal length in long sides where nothing says it, as COLMAP has it."""


@dataclass(frozen=True, kw_only=True)
class Lens:
    """Photographs of one lens, in their order, and what their tags say of it."""

    photographs: tuple[Photograph, ...]
    focal_35mm: float | None
    """With digital zoom, of the sensor that the picture was cut from; None without a sound one."""
    focal_mm: float | None
    digital_zoom: float
    full_wh: tuple[int, int]
    """Of the picture that the 35 mm equivalent is of: larger where this one is a part of it."""
    is_mistrusted: bool

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its photographs."""
        return tuple(photo.name for photo in self.photographs)


@dataclass(frozen=True, kw_only=True)
class Lenses:
    """The lenses of photographs, why they are these, and what is doubtful in their tags."""

    lenses: tuple[Lens, ...]
    decision: Decision
    warnings: tuple[str, ...]


def group_by_lens(photographs: Sequence[Photograph]) -> Lenses:
    """The lenses that took the photographs, in the order of their first ones."""
    bodies: dict[CameraKey, list[Photograph]] = defaultdict(list)
    for photo in photographs:
        bodies[replace(photo.camera, focal_mm=None, focal_35mm=None, digital_zoom=1.0, taken_wh=None)].append(photo)
    groups: list[list[Photograph]] = []
    warnings: list[str] = []
    for body, members in bodies.items():
        width, split = _split(members)
        groups += split
        if width > WIDTHS[0]:
            warnings.append(_width_warning(body, members, split, width))
    excluded = _cameras_without_zoom_in_35mm(photographs)
    sides = _full_sizes(photographs)
    lenses = tuple(_lens(group, excluded, sides) for group in groups)
    return Lenses(lenses=lenses, decision=_decision(lenses), warnings=(*warnings, *_tag_warnings(lenses, excluded)))


def _split(members: list[Photograph]) -> tuple[float, list[list[Photograph]]]:
    """The width chosen, and the photographs of one body by lens."""
    tried = [(width, _within(members, width)) for width in WIDTHS]
    fewest = len(tried[-1][1])
    fits = (split for split in tried if len(split[1]) == fewest or len(members) >= LEAST_SHARED * len(split[1]))
    return next(fits)


def _within(members: list[Photograph], width: float) -> list[list[Photograph]]:
    """Photographs whose tags agree within `width`, from the shortest focal length on."""
    groups: list[tuple[CameraKey, list[Photograph]]] = []
    for photo in sorted(members, key=lambda photo: _order(photo.camera)):
        group = next((group for first, group in reversed(groups) if _same_lens(first, photo.camera, width)), None)
        if group is None:
            groups.append((photo.camera, group := []))
        group.append(photo)
    rank = {photo.name: index for index, photo in enumerate(members)}
    return sorted((sorted(group, key=lambda photo: rank[photo.name]) for _, group in groups), key=lambda group: rank[group[0].name])


def _order(camera: CameraKey) -> tuple[float, float, float]:
    return camera.focal_mm or 0.0, camera.focal_35mm or 0.0, camera.digital_zoom


def _same_lens(first: CameraKey, second: CameraKey, width: float) -> bool:
    same_zoom = abs(math.log(second.digital_zoom / first.digital_zoom)) <= width
    same_mm = _close(first.focal_mm, second.focal_mm, width)
    # Whole millimetres: 24 may have been 23.5 or 24.5.
    rounding = 0.0 if first.focal_35mm is None or first.focal_mm is None else 1 / first.focal_35mm
    return same_zoom and same_mm and _close(first.focal_35mm, second.focal_35mm, width + rounding)


def _close(first: float | None, second: float | None, width: float) -> bool:
    if first is None or second is None:
        return first is second
    return abs(math.log(second / first)) <= width


def _sound_35mm(camera: CameraKey) -> float | None:
    """The 35 mm equivalent, where a lens may have it."""
    value = camera.focal_35mm
    if value is None or not FOCAL_35MM_RANGE[0] <= value <= FOCAL_35MM_RANGE[1]:
        return None
    if camera.focal_mm is None:
        return value
    crop, zoom = value / camera.focal_mm, max(1.0, camera.digital_zoom)
    return value if CROP_RANGE[0] <= crop <= CROP_RANGE[1] * zoom else None


def _is_sound_mm(camera: CameraKey) -> bool:
    return camera.focal_mm is None or FOCAL_MM_RANGE[0] <= camera.focal_mm <= FOCAL_MM_RANGE[1]


def _is_sound_zoom(camera: CameraKey) -> bool:
    return ZOOM_RANGE[0] <= camera.digital_zoom <= ZOOM_RANGE[1]


def _cameras_without_zoom_in_35mm(photographs: Sequence[Photograph]) -> set[tuple[str, str]]:
    """Makers and models whose 35 mm equivalent leaves digital zoom out: at one focal length it is
    the same with zoom and without. The standard does not say, and writers differ."""
    plain: set[tuple[object, ...]] = set()
    zoomed: set[tuple[object, ...]] = set()
    for camera in (photo.camera for photo in photographs):
        if _sound_35mm(camera) is not None and camera.focal_mm is not None and _is_sound_zoom(camera):
            group = plain if camera.digital_zoom <= 1 + SAME_ZOOM else zoomed
            group.add((camera.make, camera.model, camera.focal_mm, camera.focal_35mm))
    return {(str(make), str(model)) for make, model, *_ in plain & zoomed}


def _full_sizes(photographs: Sequence[Photograph]) -> dict[tuple[object, ...], list[tuple[int, int]]]:
    """Sizes of photographs of one camera at one focal length: a picture cut to another shape is as
    wide as the whole one."""
    sizes: dict[tuple[object, ...], list[tuple[int, int]]] = defaultdict(list)
    for photo in photographs:
        sizes[_optics(photo.camera)].append(photo.size_wh)
    return sizes


def _optics(camera: CameraKey) -> tuple[object, ...]:
    return camera.make, camera.model, camera.lens, camera.focal_mm, camera.focal_35mm, camera.digital_zoom


def _lens(group: list[Photograph], excluded: set[tuple[str, str]], sizes: dict[tuple[object, ...], list[tuple[int, int]]]) -> Lens:
    first = group[0].camera
    values = [value for photo in group if (value := _sound_35mm(photo.camera)) is not None and _is_sound_zoom(photo.camera)]
    zoom = first.digital_zoom if (first.make, first.model) in excluded else 1.0
    focal_35mm = float(np.median(values)) * zoom if values else None
    return Lens(
        photographs=tuple(group),
        focal_35mm=focal_35mm,
        focal_mm=first.focal_mm if _is_sound_mm(first) else None,
        digital_zoom=first.digital_zoom if _is_sound_zoom(first) else 1.0,
        full_wh=_full_size(first, sizes[_optics(first)]),
        is_mistrusted=(first.focal_35mm is not None and not values) or not _is_sound_mm(first) or not _is_sound_zoom(first),
    )


def _full_size(camera: CameraKey, sizes: Sequence[tuple[int, int]]) -> tuple[int, int]:
    """Of the whole picture: what the camera says it took, or the largest that shares a side with
    this one. A whole picture of another size was resized."""
    if camera.taken_wh is not None:
        return camera.taken_wh
    long, short = max(camera.size_wh), min(camera.size_wh)
    whole = {(max(size), min(size)) for size in sizes}
    larger = [size for size in whole if (size[0] == long and size[1] > short) or (size[1] == short and size[0] > long)]
    return max(larger, key=lambda size: math.hypot(*size), default=(long, short))


def initial_focal_px(lens: Lens) -> tuple[float, bool]:
    """The focal length in pixels to begin with, and whether tags say it."""
    width, height = lens.photographs[0].size_wh
    if lens.focal_35mm is not None:
        return lens.focal_35mm / DIAGONAL_35MM * math.hypot(*lens.full_wh), True
    guess_px = None if lens.is_mistrusted or lens.focal_mm is None else _guess_of_colmap(lens.photographs[0].path)
    if guess_px is not None:
        least_px, most_px = (value / DIAGONAL_35MM * math.hypot(width, height) for value in FOCAL_35MM_RANGE)
        if least_px <= guess_px * lens.digital_zoom <= most_px:
            return guess_px * lens.digital_zoom, True
    return DEFAULT_FACTOR * max(width, height) * max(1.0, lens.digital_zoom), False


def _guess_of_colmap(path: Path) -> float | None:
    """What COLMAP makes of a focal length in millimetres: it knows the sensors of many cameras."""
    try:
        camera = pycolmap.infer_camera_from_image(path)
    except (RuntimeError, ValueError):
        return None
    return float(camera.mean_focal_length()) if camera.has_prior_focal_length else None


def set_focal(database: Path, camera_id: int, lens: Lens) -> None:
    """Let a camera in a database begin with the focal length of its lens."""
    focal_px, is_known = initial_focal_px(lens)
    with pycolmap.Database.open(database) as store:
        camera = store.read_camera(camera_id)
        focal_at = set(camera.focal_length_idxs())
        camera.params = [focal_px if index in focal_at else float(value) for index, value in enumerate(camera.params)]
        camera.has_prior_focal_length = is_known
        store.update_camera(camera)


def _decision(lenses: Sequence[Lens]) -> Decision:
    counts = [f"{len(lens.photographs)} by {_lens_text(lens)}" for lens in lenses]
    more = f" and {len(counts) - 5} more" if len(counts) > 5 else ""
    return Decision(
        stage="sfm",
        topic="lenses",
        choice=f"{', '.join(counts[:5])}{more}",
        figure=float(len(lenses)),
        unit="lenses" if len(lenses) != 1 else "lens",
        reason="photographs share one where maker, model, serial numbers, size, focal length and digital zoom agree",
        changes_nothing=len(lenses) == 1,
    )


def _lens_text(lens: Lens) -> str:
    camera = lens.photographs[0].camera
    name = f"{camera.make} {camera.model}".strip() or "a camera without a name"
    focal = f" at {camera.focal_mm:,.4g} mm" if camera.focal_mm else ""
    equivalent = f" ({camera.focal_35mm:,.6g} mm at 35 mm)" if camera.focal_35mm else ""
    zoom = f" with {camera.digital_zoom:.3g} × digital zoom" if camera.digital_zoom != 1 else ""
    return f"{name}{focal}{equivalent}{zoom}, {camera.size_wh[0]} × {camera.size_wh[1]} px"


def _width_warning(body: CameraKey, members: Sequence[Photograph], split: Sequence[object], width: float) -> str:
    values = {_order(photo.camera) for photo in members}
    name = f"{body.make} {body.model}".strip() or "a camera"
    return (
        f"{len(members)} photographs of {name} have {len(values)} different focal lengths: they are taken for {len(split)} lenses, "
        f"in each of which these differ by up to {width:.0%}. A survey with one focal length is more exact."
    )


def _doubtful(camera: CameraKey) -> str:
    if not _is_sound_zoom(camera):
        return f"digital zoom of {camera.digital_zoom:,.6g}"
    return (
        f"focal length of {camera.focal_35mm:,.6g} mm at 35 mm"
        if camera.focal_35mm is not None
        else f"focal length of {camera.focal_mm:,.6g} mm"
    )


def _tag_warnings(lenses: Sequence[Lens], excluded: set[tuple[str, str]]) -> tuple[str, ...]:
    warnings = [
        f"{len(lens.photographs)} photographs say a {_doubtful(lens.photographs[0].camera)}, which no lens of theirs has: "
        "it is not used, and found from the photographs alone."
        for lens in lenses
        if lens.is_mistrusted
    ]
    for make, model in sorted(excluded):
        warnings.append(f"the 35 mm focal lengths of {f'{make} {model}'.strip()} leave digital zoom out: they are multiplied by it.")
    return tuple(warnings)
