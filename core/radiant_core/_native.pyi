"""Types of the native module; its sources are in native/."""

import numpy as np
from numpy.typing import NDArray

def assign_power_cells(positions: NDArray[np.float64], sites: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.int32]: ...
