"""Lengths and areas on the map, and the length of its scale bar. Once per click; K corners.

length = Σ ‖x_{k+1} − x_k‖,  area = ½ |Σ x_k y_{k+1} − x_{k+1} y_k|  (the shoelace formula)
"""

from __future__ import annotations

import numpy as np

from radiant_core.errors import BadInput
from radiant_core.numerics import FloatArray, check_array


def path_length(corners: FloatArray) -> float:
    """Return the length of the open path through corners (K,2); 0 for fewer than two."""
    places = check_array("corners", corners, (None, 2))
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


def polygon_area(corners: FloatArray) -> float:
    """Return the area of the polygon of corners (K,2); BadInput where two of its sides cross."""
    places = check_array("corners", corners, (None, 2))
    if len(places) < 3:
        return 0.0
    from shapely.geometry import Polygon

    # Relative to the first corner: products of UTM coordinates lose eight digits.
    polygon = Polygon(places - places[0])
    if polygon.area > 0 and not polygon.is_valid:
        raise BadInput("the sides of the measured polygon cross: undo the last corner, or begin again.")
    return float(polygon.area)


def scale_bar_length(limit: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten up to `limit` > 0: 73 gives 50."""
    power = 10.0 ** np.floor(np.log10(limit))
    return float(max(step * power for step in (1, 2, 5) if step * power <= limit * (1 + 1e-9)))


def length_text(length: float, unit: str) -> str:
    """Return a length as text: "84.2 m", "1.27 km", "3.4 units"."""
    if unit == "m" and length >= 1000:
        return f"{length / 1000:.4g} km"
    return f"{length:.4g} {unit}"


def area_text(area: float, unit: str) -> str:
    """Return an area as text: "84.2 m²", "1.27 ha" from 10,000 m², "2.1 km²" from a million."""
    if unit != "m":
        return f"{area:.4g} square {unit}"
    if area >= 1e6:
        return f"{area / 1e6:.4g} km²"
    return f"{area / 1e4:.4g} ha" if area >= 1e4 else f"{area:.4g} m²"
