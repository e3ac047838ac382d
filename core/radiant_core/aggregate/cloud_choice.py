"""Whether the cloud joins its edges' models, from predicted memory and time (paper Sec. III-D: else
they are cut). Once per run.

    memory = of joining by as many tiles as it takes (`join_memory`)       bytes
    time   = Σ_e T_e N / N_e                                               seconds

T_e seconds that edge e took (or is said to take) to join its N_e Gaussians of N: a step of dense
Adam touches all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from radiant_core.aggregate.join_memory import JoinMemory
from radiant_core.cameras import Cameras
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.plan.system import Cloud
from radiant_core.splats import Splats


@dataclass(frozen=True, kw_only=True)
class CloudNeeds:
    """What retraining at the cloud is predicted to take."""

    num_cameras: int
    memory_bytes: float
    time_s: float | None
    """None where no time of any edge is known."""


def cloud_needs(
    models: Sequence[Splats], cameras: Sequence[Cameras], memory: JoinMemory, edge_times_s: Sequence[float] | None
) -> CloudNeeds:
    """Needs of joining edge models at their virtual cameras; times (E,) of the edges."""
    counts = [len(model) for model in models]
    total = sum(counts)
    time_s = None
    if edge_times_s is not None:
        if len(edge_times_s) != len(models):
            raise BadInput(f"{len(edge_times_s)} times for {len(models)} edges: give one per edge.")
        time_s = sum(seconds * total / max(1, count) for seconds, count in zip(edge_times_s, counts, strict=True))
    return CloudNeeds(num_cameras=sum(map(len, cameras)), memory_bytes=memory.needed_bytes, time_s=time_s)


def choose_at_cloud(needs: CloudNeeds, cloud: Cloud, stage: str, *, memory_of: str = "the cloud's limit") -> tuple[bool, Decision]:
    """Whether the cloud retrains (else it cuts), by the figure nearest to its limit or beyond;
    `memory_of` says in words whose limit that of memory is."""
    limit_gb = None if cloud.memory_bytes is None else cloud.memory_bytes / 1e9
    most_views = None if cloud.max_cameras is None else float(cloud.max_cameras)
    label = "the cloud's limit"
    figures = [
        ("memory", needs.memory_bytes / 1e9, limit_gb, "GB", memory_of),
        ("time", needs.time_s, cloud.time_s, "s", label),
        ("views", float(needs.num_cameras), most_views, "cameras", label),
    ]
    limited = [
        (name, figure, limit, unit, owner) for name, figure, limit, unit, owner in figures if limit is not None and figure is not None
    ]
    if not limited:
        name, figure, unit = "memory", needs.memory_bytes / 1e9, "GB"
        retrains, reason = True, "its predicted memory; the system file sets no limit, so that the cloud's machine decides"
    else:
        name, figure, limit, unit, owner = max(limited, key=lambda item: item[1] / item[2] if item[2] else float("inf"))
        retrains = figure <= limit
        word = "is within" if retrains else "exceeds"
        reason = f"the predicted {name} of retraining, {figure:.3g} {unit}, {word} {owner} of {limit:.3g} {unit}"
    choice = "retraining all models together" if retrains else "models are cut at their borders instead of retrained"
    return retrains, Decision(stage=stage, topic="aggregation", choice=choice, figure=figure, unit=f"{unit} predicted", reason=reason)
