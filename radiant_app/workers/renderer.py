"""The renderer of a task on the machine that runs it, which may not be the one that planned it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from radiant_app.reporting import EventReporter
from radiant_core.decisions import Decision
from radiant_core.errors import BadInput
from radiant_core.hierarchy.messages import EdgeTask


def with_renderer_here(task: Any, reporter: EventReporter) -> Any:
    """The task as it is; for gsplat without a CUDA device, with the CPU's renderer and a decision.

    Raises:
        BadInput: its machine trains one model with others, whose steps are the same bits.
    """
    if getattr(task, "backend", None) != "gsplat":
        return task
    from radiant_core.render.gsplat_backend import missing_for_gsplat

    missing = missing_for_gsplat()
    if missing is None:
        return task
    group = getattr(task, "group", None)
    if isinstance(task, EdgeTask) and group is not None and group.has_relays:
        return task  # It has no model.
    if group is not None or getattr(task, "seat", None) is not None:
        raise BadInput(
            f"this machine trains one model with others on CUDA and has {missing}: add --within-edge joined --between-edges joined, "
            "or leave the machine out of the system file."
        )
    reporter.decide(
        Decision(
            stage=reporter.stage,
            topic="renderer",
            choice="native, on the CPU",
            figure=None,
            unit="",
            reason=f"the run renders on CUDA devices, and this machine has {missing}",
        )
    )
    return replace(task, backend="native")
