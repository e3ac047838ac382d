"""`Rgbd`: a picture with depths, as renderers draw it and `Backdrop` shows it. It loads no library
that draws."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Rgbd = NDArray[np.float32]
"""Colours 0 to 1 and depth (H,W,4), rows downwards; a depth of 0 m where nothing was hit."""
OPAQUE = 0.5
"""Least share of a pixel that the model must fill to hide what lies behind it."""
