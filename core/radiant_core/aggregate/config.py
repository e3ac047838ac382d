"""`AggregateConfig`: how models are joined at an edge and at the cloud, and the presets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from radiant_core.errors import BadInput

AggregatePreset = Literal["default", "paper"]
"""default: ours; paper: concatenate and retrain everything at full rate, at the edges and then at the cloud, nothing skipped
(paper Sec. III-D)."""


@dataclass(frozen=True, kw_only=True)
class AggregateConfig:
    """How an edge joins its devices' models, and the cloud its edges'."""

    preset: AggregatePreset = "default"
    """Which tensors move. default: opacity and colour at full rate, scale and rotation at a tenth, centres fixed; paper: everything at
    full rate."""
    num_epochs: int = 10
    """How often each synthetic view is shown (paper Sec. IV-B: 10)."""
    max_num_steps: int | None = None
    """Upper limit of steps whatever the number of views; None for none."""
    retrain_single: bool = False
    """Whether a lone model is retrained on its own pictures too."""
    drop_unseen: bool = True
    """Whether a model's Gaussians that only another model's cameras see are left out; the paper concatenates all."""
    weight_by_alpha: bool = True
    """Whether a synthetic pixel counts as much as its teacher is opaque there; the paper takes the pictures as they are."""
    cloud: Literal["crop_merge", "retrain"] = "crop_merge"
    """crop_merge: the cloud cuts models at the plan's borders; retrain: it does what the edges do, on views from virtual cameras, and
    crop-merges where that would exceed its limits."""
    fill_blind_spots: bool = True
    """Whether crop-merge keeps a neighbour's Gaussian where the region's owner has nothing near it."""

    def __post_init__(self) -> None:
        if self.preset not in get_args(AggregatePreset):
            raise BadInput(f"aggregate preset {self.preset!r} is unknown: use 'default' or 'paper'.")
        if self.cloud not in ("crop_merge", "retrain"):
            raise BadInput(f"the cloud's aggregation is {self.cloud!r}, expected 'crop_merge' or 'retrain'.")
        if self.num_epochs < 1 or (self.max_num_steps is not None and self.max_num_steps < 1):
            raise BadInput("num_epochs and max_num_steps of the aggregation must be at least 1.")


def aggregate_preset(name: str) -> AggregateConfig:
    """The configuration of a preset; BadInput lists the names there are."""
    if name == "paper":
        return AggregateConfig(
            preset="paper", retrain_single=True, drop_unseen=False, weight_by_alpha=False, cloud="retrain", fill_blind_spots=False
        )
    if name != "default":
        raise BadInput(f"aggregate preset {name!r} is unknown: use one of {', '.join(get_args(AggregatePreset))}.")
    return AggregateConfig()
