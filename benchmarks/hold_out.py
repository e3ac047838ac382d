"""What a benchmark of models holds out of a set. Once per benchmark.

The interleaved split asks how a model looks between its photographs, a whole flight line away from
them. What holds a line out bears it in its name, so that neither is read for the other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.options import HeldPart, HoldOut
from radiant_core.cameras import Cameras
from radiant_core.evaluate.split import held_out_mask
from radiant_core.plan.flight.lines import held_out_line


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
