"""`AggregateConfig`: how models are joined at edges and the cloud; `Join`: one of these joins."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Literal, get_args

from radiant_core.errors import BadInput
from radiant_core.regimes import JOINING, REFINING, Regime, require

AggregatePreset = Literal["default", "paper"]
"""default: ours; paper: concatenate and retrain everything at full rate, at the edges and then at
the cloud, nothing skipped (paper Sec. III-D)."""

MAX_TILES = 256
JOINING_EPOCHS = (10, 5)
"""Epochs at the edges and at the cloud where nothing refines the scene, as in the paper, and after
long trainings."""
MAX_ROUNDS = 99


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
class JoinRules:
    """What every join of a run has in common."""

    preset: AggregatePreset = "default"
    """default: models fade where others own the place and are fitted, here or by devices; paper:
    all are retrained."""
    max_num_steps: int | None = None
    """Upper limit of steps whatever the number of views; None for none."""
    retrain_single: bool = False
    """Whether a lone model is retrained on its own pictures too."""
    foreign_opacity: float = 0.3
    """Factor of a Gaussian's first opacity where another model owns the place; default only."""
    faint_opacity: float = 0.15
    """What fades below this opacity in another's place is left out; 0 keeps all; default only."""
    agreement_db: float | None = 48.0
    """Models are only cut where their pictures agree with the cut's this well, about one step of 8
    bits; None: they are always retrained. default only."""
    weight_by_alpha: bool = True
    """Whether a synthetic pixel counts as much as its teacher is opaque there; not in paper."""

    def __post_init__(self) -> None:
        if self.preset not in get_args(AggregatePreset):
            raise BadInput(f"aggregate preset {self.preset!r} is unknown: use 'default' or 'paper'.")
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
        return 1 if self.preset == "paper" else MAX_TILES


@dataclass(frozen=True, kw_only=True)
class Join(JoinRules):
    """One join: of an edge, of the cloud, or of models that somebody brings together."""

    num_epochs: int = JOINING_EPOCHS[1]
    """How often each synthetic view is shown (paper Sec. IV-B: 10); 0: models fade where others own
    the place, and nothing is fitted before devices refine them."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.num_epochs < 0 or (self.num_epochs == 0 and self.preset == "paper"):
            raise BadInput(f"a join by {self.preset!r} shows its views {self.num_epochs} times: give 1 or more.")


@dataclass(frozen=True, kw_only=True)
class AggregateConfig(JoinRules):
    """How an edge joins its devices' models, the cloud its edges', and how devices refine both."""

    edge_epochs: int | None = None
    """How often an edge, whose model teaches the cloud, shows each synthetic view (paper Sec. IV-B:
    10). None: as in `JOINING_EPOCHS`, or where devices are to refine what was joined by how long
    they trained (`Trainings.joining`); whether memory keeps them from it is not known yet then."""
    cloud_epochs: int | None = None
    """The same of the cloud; 0: models fade where others own the place, and nothing is fitted
    before devices refine them."""
    cloud: Literal["crop_merge", "retrain"] = "retrain"
    """retrain: the cloud does as the edges, on views from virtual cameras, and cuts models at their
    borders where that would exceed its limits; crop_merge: it always cuts them there."""
    refine: Refine = Refine()
    """How devices refine what was joined."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cloud not in ("crop_merge", "retrain"):
            raise BadInput(f"the cloud's aggregation is {self.cloud!r}, expected 'crop_merge' or 'retrain'.")
        limits = (self.cloud_epochs, 0), (self.edge_epochs, 1)
        if any(number is not None and number < least for number, least in limits):
            raise BadInput("edge_epochs of the aggregation must be at least 1, cloud_epochs at least 0.")
        if self.cloud_epochs == 0 and (self.preset == "paper" or not self.refine.is_asked_for):
            raise BadInput("0 epochs at the cloud leave the models to the devices that refine them: give 1 or more, or epochs of refining.")

    @property
    def at_edge(self) -> Join:
        """What an edge does."""
        return self._join(JOINING_EPOCHS[0] if self.edge_epochs is None else self.edge_epochs)

    @property
    def at_cloud(self) -> Join:
        """What the cloud does."""
        return self._join(JOINING_EPOCHS[1] if self.cloud_epochs is None else self.cloud_epochs)

    def _join(self, num_epochs: int) -> Join:
        return Join(num_epochs=num_epochs, **{rule.name: getattr(self, rule.name) for rule in fields(JoinRules)})

    def joining_after(self, trainings: Trainings) -> AggregateConfig:
        """The settings with the epochs of joining after such trainings."""
        if not self.refine.is_asked_for:
            return self
        case = trainings.joining.values
        edge = case.get("edge_epochs") if self.edge_epochs is None else self.edge_epochs
        cloud = case.get("cloud_epochs") if self.cloud_epochs is None else self.cloud_epochs
        return replace(self, edge_epochs=edge, cloud_epochs=cloud)


def aggregate_preset(name: str) -> AggregateConfig:
    """The configuration of a preset; BadInput lists the names there are."""
    if name == "paper":
        return AggregateConfig(
            preset="paper", cloud_epochs=10, edge_epochs=10, refine=Refine(epochs=0), retrain_single=True, weight_by_alpha=False
        )
    if name != "default":
        raise BadInput(f"aggregate preset {name!r} is unknown: use one of {', '.join(get_args(AggregatePreset))}.")
    return AggregateConfig()
