"""What a benchmark of models holds out of a set. Once per benchmark.

The interleaved split asks how a model looks between its photographs, a whole flight line away from
them. What holds a line out bears it in its name, so that neither is read for the other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmarks.options import HeldPart, HoldOut
from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.evaluate.split import held_out_mask
from radiant_core.numerics import check_array
from radiant_core.plan.flight.lines import MIN_LINE, flight_lines


def parts_of(hold_out: HoldOut) -> tuple[HeldPart, ...]:
    """What is held out in turn, each with models of its own."""
    return ("interleaved", "line") if hold_out == "both" else (hold_out,)


def mask_of(part: HeldPart, cameras: Cameras, number: int = 0) -> NDArray[np.bool_]:
    """Mask (C,) of the photographs held out: split or line `number`; raises as either does."""
    if part == "line":
        return held_out_line(cameras.names, cameras.centers, number)
    return held_out_mask(cameras.names, first=number)


def name_of(scene: str, part: HeldPart) -> str:
    """The scene's name in figures."""
    return scene if part == "interleaved" else f"{scene}-{part}"


def held_out_line(names: Sequence[str], centers: ArrayLike, number: int = 0) -> NDArray[np.bool_]:
    """Mask (C,) of a whole line of the flight, of photographs named in its order with centres
    (C,3): line 0 is the one nearest the middle of all cameras, 1 the next nearest.

    Raises BadInput where the flight has fewer than two lines or no line of this number.
    """
    checked = check_array("centers", centers, (len(names), 3))
    order = np.array(sorted(range(len(names)), key=_in_flight(names).__getitem__), np.int64)
    lines = flight_lines(checked[order])
    if len(lines) < 2:
        raise BadInput(
            f"the photographs lie on {len(lines)} straight flight lines of {MIN_LINE} or more in the order of their names, but 2 are "
            "needed to hold a whole one out: hold out interleaved photographs alone."
        )
    if not 0 <= number < len(lines):
        raise BadInput(f"line {number} is to be held out, but the flight has {len(lines)}: ask for at most {len(lines)} splits.")
    middle = np.median(checked[:, :2], axis=0)
    away = [float(np.linalg.norm(checked[order[line], :2].mean(axis=0) - middle)) for line in lines]
    mask = np.zeros(len(names), bool)
    mask[order[lines[int(np.argsort(away, kind="stable")[number])]]] = True
    return mask


def _in_flight(names: Sequence[str]) -> list[str]:
    """Names as the camera gave them, without the folders of a set that brings its own split."""
    has_split = {"train", "val"} == {name.partition("/")[0] for name in names}
    return [name.partition("/")[2] for name in names] if has_split else list(names)
