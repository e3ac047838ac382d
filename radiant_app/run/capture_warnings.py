"""What a capture is unfit for, said while somebody may still fly again. Once per scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from radiant_core.io.photos.listing import load_thumbnail
from radiant_core.next_flight.capture_faults import CaptureFault, capture_faults
from radiant_core.scene import SfmScene
from radiant_core.survey.seen_ground import usual_depth
from radiant_core.threads import in_order

THUMBNAIL_PX, NUM_READERS = 160, 8


def faults_of_capture(scene: SfmScene, images: Path | None) -> tuple[CaptureFault, ...]:
    """The faults of a scene whose photographs lie in `images`; without all of them nothing is said
    of exposure."""
    names = scene.cameras.names
    at_hand = images is not None and all((images / name).is_file() for name in names)
    pictures: list[NDArray[np.uint8]] | None = None
    if images is not None and at_hand:
        pictures = list(in_order(lambda name: load_thumbnail(images / name, THUMBNAIL_PX), names, NUM_READERS))
    return capture_faults(scene, usual_depth(scene), pictures)


def capture_warnings(scene: SfmScene, images: Path | None) -> tuple[str, ...]:
    """The same in sentences."""
    return tuple(f"the capture: {fault.sentence}" for fault in faults_of_capture(scene, images))
