"""How many pixels a training rendered, to compare methods at equal work. Once per training."""

from __future__ import annotations

from radiant_core.cameras import Cameras
from radiant_core.errors import BadInput
from radiant_core.train.config import TrainConfig
from radiant_core.train.view_loss import view_of_step


def training_pixels(cameras: Cameras, config: TrainConfig, num_steps: int) -> int:
    """Σ over the steps of width × height of the view that `fit_splats` shows of `cameras`, at the
    reduced size it begins with. Raises BadInput where a budget of time ends the run: the steps are
    not known then."""
    if config.budget_s is not None:
        raise BadInput("a training that ends by time does not tell its pixels beforehand: give it a number of steps.")
    full = cameras.sizes_wh.prod(axis=1)
    longest = int(cameras.sizes_wh.max(initial=1))
    small = cameras.scaled(max(1, round(config.start_scale * longest))).sizes_wh.prod(axis=1)
    pixels = 0
    for step in range(num_steps):
        at_full_size = config.start_scale >= 1 or step / config.num_steps >= config.full_size_from
        pixels += int((full if at_full_size else small)[view_of_step(step, len(cameras), config.seed)])
    return pixels
