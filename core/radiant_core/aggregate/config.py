"""`AggregateConfig`: how edges and the cloud join models (`Join`), and how devices refine the scene
that comes of it (`Refine`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args, get_type_hints

from radiant_core.errors import BadInput
from radiant_core.regimes import JOINING, REFINING, Regime, require

AggregatePreset = Literal["default", "paper"]
"""default: ours; paper: concatenate and retrain everything at full rate, at the edges and then at
the cloud, nothing skipped (paper Sec. III-D)."""
JoinMethod = Literal["fade", "paper", "crop_merge"]
"""fade: models fade where others own the place, and all are fitted together at falling rates;
paper: all are retrained as they are, at the rates of 3DGS; crop_merge: they are cut at the borders
of the plan, at the cloud alone."""

MAX_TILES = 256
EDGE_EPOCHS, CLOUD_EPOCHS = 10, 5
"""Epochs of a join where nothing refines the scene, as in the paper, and after long trainings;
those of other runs are in `regimes.JOINING`."""
MAX_ROUNDS = 99
TIERS = ("edge", "cloud")
"""Fields of `AggregateConfig` that are joins."""


@dataclass(frozen=True, kw_only=True)
class Trainings:
    """How long so many devices trained, in the mean; what joining and refining make of it."""

    num_devices: int
    photograph_shows: float
    """How often a training shows each of its photographs."""
    num_steps: float

    @property
    def joining(self) -> Regime:
        """How tiers join models then, where devices refine what was joined."""
        return require(JOINING, self._figures)

    @property
    def refining(self) -> Regime:
        """How devices refine the scene then."""
        return require(REFINING, self._figures)

    @property
    def _figures(self) -> dict[str, float]:
        return {"devices": self.num_devices, "shows": self.photograph_shows, "steps": self.num_steps}


@dataclass(frozen=True, kw_only=True)
class Refine:
    """How devices refine the scene that was joined."""

    epochs: int | None = None
    """How often a device shows each of its photographs to the joined scene in a round, at most (see
    `hierarchy.refining_plan.MAX_STEPS`); 0: not at all. None: by how long devices trained
    (`Trainings.refining`)."""
    rounds: int | None = None
    """How often devices refine the scene, each time from somewhat beyond the mean of what all of
    them made of it before; the scene travels down and what changed in it up in each. Above ten,
    where the light of photographs differs, the scene's may run away (docs/experiments/
    aggregation.md, "Lost or unfinished?"). None: by how long devices trained
    (`Trainings.refining`)."""
    max_num_steps: int | None = None
    """Upper limit of a device's steps in a round; None for none."""

    def __post_init__(self) -> None:
        if self.epochs is not None and self.epochs < 0:
            raise BadInput(f"epochs of refining is {self.epochs}, expected 0 (the scene is not refined) or more.")
        if self.rounds is not None and not 1 <= self.rounds <= MAX_ROUNDS:
            raise BadInput(f"rounds of refining is {self.rounds}, expected 1 to {MAX_ROUNDS}: set its epochs to 0 to refine nothing.")

    @property
    def is_asked_for(self) -> bool:
        """Whether devices are to refine what was joined."""
        return self.epochs != 0

    def epochs_after(self, trainings: Trainings) -> int:
        """How often a device shows each of its photographs in a round after such trainings."""
        return trainings.refining.values["epochs"] if self.epochs is None else self.epochs

    def rounds_after(self, trainings: Trainings) -> int:
        """In how many rounds devices refine after such trainings."""
        return self.rounds or trainings.refining.values["rounds"]


@dataclass(frozen=True, kw_only=True)
class Join:
    """How models become one: at an edge, at the cloud, or of models that somebody brings together.

    Fields but `epochs`, `max_num_steps`, `retrain_single` and `weight_by_alpha` are of the method
    fade.
    """

    epochs: int | None = None
    """How often each synthetic view is shown (paper Sec. IV-B: 10); 0, at the cloud: models fade
    and nothing is fitted before devices refine them. None: `EDGE_EPOCHS` or `CLOUD_EPOCHS`, or
    where devices refine what was joined by how long they trained (`Trainings.joining`); a join
    outside of a run is like the cloud's."""
    method: JoinMethod = "fade"
    """What is made of models before they are fitted, or instead."""
    max_num_steps: int | None = None
    """Upper limit of steps whatever the number of views; None for none."""
    retrain_single: bool = False
    """Whether a lone model is retrained on its own pictures too."""
    foreign_opacity: float = 0.3
    """Factor of a Gaussian's first opacity where another model owns the place."""
    faint_opacity: float = 0.15
    """What fades below this opacity in another's place is left out; 0 keeps all."""
    agreement_db: float | None = 48.0
    """Models are only cut where their pictures agree with the cut's this well, about one step of 8
    bits; None: they are always retrained."""
    weight_by_alpha: bool = True
    """Whether a synthetic pixel counts as much as its teacher is opaque there."""

    def __post_init__(self) -> None:
        if self.method not in get_args(JoinMethod):
            raise BadInput(f"the method of joining is {self.method!r}: use one of {', '.join(get_args(JoinMethod))}.")
        if self.epochs is not None and (self.epochs < 0 or (self.epochs == 0 and self.method == "paper")):
            raise BadInput(f"a join by {self.method!r} shows its views {self.epochs} times: give 1 or more.")
        if not 0 < self.foreign_opacity <= 1 or not (self.agreement_db is None or self.agreement_db > 0):
            raise BadInput(
                f"foreign_opacity is {self.foreign_opacity} and agreement_db {self.agreement_db}: give a share and a level in dB."
            )
        if not 0 <= self.faint_opacity < 1:
            raise BadInput(f"faint_opacity is {self.faint_opacity}, expected at least 0 and less than 1.")
        if self.max_num_steps is not None and self.max_num_steps < 1:
            raise BadInput(f"max_num_steps of the aggregation is {self.max_num_steps}, expected 1 or more.")

    @property
    def most_tiles(self) -> int:
        """Into how many tiles a join may be divided where memory is short; the paper knows none."""
        return 1 if self.method == "paper" else MAX_TILES

    def num_steps(self, num_views: int) -> int:
        """Steps of a fit to so many views."""
        steps = (CLOUD_EPOCHS if self.epochs is None else self.epochs) * num_views
        return steps if self.max_num_steps is None else min(steps, self.max_num_steps)


@dataclass(frozen=True, kw_only=True)
class AggregateConfig:
    """How models become a scene."""

    edge: Join = Join()
    """How an edge joins its devices' models, which teaches the cloud."""
    cloud: Join = Join()
    """How the cloud joins the edges', on views from virtual cameras; it cuts them at their borders
    where that would exceed its limits."""
    refine: Refine = Refine()
    """How devices refine what was joined."""

    def __post_init__(self) -> None:
        if self.edge.epochs == 0:
            raise BadInput("edge.epochs of joining is 0, expected at least 1: an edge's model teaches the cloud.")
        if self.edge.method == "crop_merge":
            raise BadInput("edge.method is crop_merge, which is the cloud's alone: use fade or paper.")
        if self.cloud.epochs == 0 and not self.refine.is_asked_for:
            raise BadInput("0 epochs at the cloud leave the models to the devices that refine them: give 1 or more, or epochs of refining.")

    def epochs_after(self, trainings: Trainings | None) -> tuple[int, int]:
        """Epochs of an edge and of the cloud after such trainings; None: after long ones."""
        usual = trainings.joining.values if trainings is not None and self.refine.is_asked_for else {}
        edge = usual.get("edge_epochs", EDGE_EPOCHS) if self.edge.epochs is None else self.edge.epochs
        cloud = usual.get("cloud_epochs", CLOUD_EPOCHS) if self.cloud.epochs is None else self.cloud.epochs
        return edge, cloud

    def joining_after(self, trainings: Trainings | None) -> AggregateConfig:
        """The settings with the epochs of both joins, see `epochs_after`."""
        edge, cloud = self.epochs_after(trainings)
        return replace(self, edge=replace(self.edge, epochs=edge), cloud=replace(self.cloud, epochs=cloud))


def aggregate_preset(name: str) -> AggregateConfig:
    """The configuration of a preset; BadInput lists the names there are."""
    if name == "paper":
        join = Join(method="paper", epochs=10, retrain_single=True, weight_by_alpha=False)
        return AggregateConfig(edge=join, cloud=join, refine=Refine(epochs=0))
    if name != "default":
        raise BadInput(f"aggregate preset {name!r} is unknown: use one of {', '.join(get_args(AggregatePreset))}.")
    return AggregateConfig()


def joining_types() -> Mapping[str, Any]:
    """The type of every setting of both joins by its path, such as "edge.epochs"."""
    return {f"{tier}.{name}": hint for tier in TIERS for name, hint in get_type_hints(Join).items()}


def with_joins(config: AggregateConfig, of_joins: Mapping[str, Any], of_refining: Mapping[str, Any]) -> AggregateConfig:
    """The configuration with other values: of joins by such paths, of refining by name."""
    parts = {"refine": replace(config.refine, **of_refining)}
    for tier in TIERS:
        values = {path.removeprefix(f"{tier}."): value for path, value in of_joins.items() if path.startswith(f"{tier}.")}
        parts[tier] = replace(getattr(config, tier), **values)
    return replace(config, **parts)
