"""The lights of photographs that were all taken in the canonical one."""

from __future__ import annotations

import numpy as np

from radiant_core.cameras import Cameras
from radiant_core.light.lights import NUM_TERMS, Lights, cameras_alike


def no_lights(cameras: Cameras) -> Lights:
    camera_of, count = cameras_alike(cameras)
    known = np.zeros(len(cameras), bool)
    return Lights(log_gains=np.zeros((len(cameras), 3)), camera_of=camera_of, vignettings=np.zeros((count, NUM_TERMS, 3)), is_known=known)
