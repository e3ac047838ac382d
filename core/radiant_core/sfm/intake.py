"""What is made of a source's files before structure from motion: a user's choices. Imports nothing
heavy."""

from __future__ import annotations

from dataclasses import dataclass

from radiant_core.choices import MaskIgnores, Panoramas
from radiant_core.errors import BadInput

LEAST_FRAMES = 3
FACES, FACE_MASKS = "faces", "faces.masks"
"""Folders of a work folder with what is cut from panoramas and from their masks."""


@dataclass(frozen=True, kw_only=True)
class Intake:
    """Colour that masks leave out, frames taken of films, photographs that are panoramas; None: as
    it is found. BadInput for a number of frames that makes no scene."""

    mask_ignores: MaskIgnores | None = None
    film_frames: int | None = None
    panoramas: Panoramas | None = None

    def __post_init__(self) -> None:
        if self.film_frames is not None and self.film_frames < LEAST_FRAMES:
            raise BadInput(f"--film-frames is {self.film_frames}, expected {LEAST_FRAMES} or more.")


AS_FOUND = Intake()
