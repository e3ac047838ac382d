"""CUDA devices for the processes of nodes: which nodes need one, and which one each gets here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from radiant_app.executors.protocol import NodeTask
from radiant_core.hierarchy.codec import task_setting

VISIBLE = "CUDA_VISIBLE_DEVICES"
"""Variable that lists the devices a process may use; its first one is what torch calls "cuda"."""


def needs_card(task: NodeTask) -> bool:
    """Whether a node renders on a CUDA device."""
    return task_setting(task.folder, "backend") == "gsplat"


def visible_cards(environment: Mapping[str, str]) -> tuple[str, ...]:
    """The devices of this machine that a process with these variables may use, as `VISIBLE` names
    them."""
    import torch

    count = torch.cuda.device_count()
    listed = environment.get(VISIBLE)
    return tuple(map(str, range(count))) if listed is None else tuple(name.strip() for name in listed.split(","))[:count]


def choose_card(cards: Sequence[str], taken: Sequence[str | None]) -> str | None:
    """The device that the fewest processes use, the first of several; None where there is no
    choice."""
    return min(cards, key=taken.count) if len(cards) > 1 else None
