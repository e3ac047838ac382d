"""The groups of machines that train together, as plain values for plan.json. Once per plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, ValidationError

from radiant_core.errors import BadInput
from radiant_core.io.strict import Strict, problem_sentence
from radiant_core.plan.together.groups import GroupLevel, GroupPlan

GROUPS_KEY = "together"
_MAX_GROUPS = 100_000
_Seconds = Annotated[float, Field(ge=0, le=1e12)]
_Count = Annotated[int, Field(ge=1, le=10**9)]


class _Group(Strict):
    level: GroupLevel
    edges: Annotated[list[str], Field(min_length=1)]
    views: dict[str, _Count]
    num_photographs: _Count
    num_steps: _Count
    step_s: _Seconds
    start_s: _Seconds
    end_s: _Seconds
    overlaps: bool

    def build(self) -> GroupPlan:
        return GroupPlan(**{**self.model_dump(), "edges": tuple(self.edges)})


def groups_record(groups: Sequence[GroupPlan]) -> list[dict[str, Any]]:
    """The groups as JSON's values."""
    return [{**vars(group), "edges": list(group.edges), "views": dict(group.views)} for group in groups]


def groups_of_record(record: Any) -> tuple[GroupPlan, ...]:
    """What `groups_record` was made of; BadInput for anything else, and for a device in two
    groups."""
    try:
        groups = TypeAdapter(Annotated[list[_Group], Field(max_length=_MAX_GROUPS)]).validate_python(record)
    except ValidationError as error:
        raise BadInput(problem_sentence(error, "plan", GROUPS_KEY)) from error
    built = tuple(group.build() for group in groups)
    names = [device for group in built for device in group.views]
    twice = next((name for name in names if names.count(name) > 1), None) if len(set(names)) < len(names) else None
    if twice is not None:
        raise BadInput(f"device {twice!r} trains in two groups: plan again.")
    return built
