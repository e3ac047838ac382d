"""The constraints file of `radiant plan --constraints`: what is decided before the planner.

plan = "before.json"                 # the plan to start from, beside this file; for locked regions
locked = ["north"]                   # edges that keep their photographs and get no others

[fixed_weights_m2]                   # on the scale of the plan to start from, or of the exact plan
south = 120.0

[pinned]                             # edge = the names of its photographs or waypoints
west = ["bridge_01.jpg", "bridge_02.jpg"]
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import Field, ValidationError

from radiant_app.files.toml_file import load_toml
from radiant_core.errors import BadInput
from radiant_core.io.records import load_plan
from radiant_core.io.strict import Strict, problem_sentence
from radiant_core.plan.plans import CloudPlan
from radiant_core.plan.regions.constraints import PlanConstraints


@dataclass(frozen=True, kw_only=True, eq=False)
class GivenConstraints:
    """Constraints and the plan they refer to."""

    constraints: PlanConstraints
    start: CloudPlan | None


class _File(Strict):
    plan: str | None = None
    locked: list[str] = Field(default_factory=list[str])
    fixed_weights_m2: dict[str, float] = Field(default_factory=dict[str, float])
    pinned: dict[str, list[str]] = Field(default_factory=dict[str, list[str]])


def load_constraints(path: Path, names: Sequence[str]) -> GivenConstraints:
    """The constraints in a TOML file for cameras with these names; BadInput names the place."""
    tables = load_toml(path, "constraints file")
    index_of = {name: index for index, name in enumerate(names)}
    try:
        file = _File.model_validate(tables)
        pinned: dict[int, str] = {}
        for edge, cameras in file.pinned.items():
            for name in cameras:
                if name not in index_of:
                    raise BadInput(f"{name!r} is pinned to edge {edge!r}, but is none of the {len(names)} positions that are planned.")
                if index_of[name] in pinned:
                    raise BadInput(f"{name!r} is pinned twice, to {pinned[index_of[name]]!r} and {edge!r}: choose one.")
                pinned[index_of[name]] = edge
        constraints = PlanConstraints(fixed_weights_m2=file.fixed_weights_m2, locked=tuple(file.locked), pinned=pinned)
        if not constraints:
            raise BadInput("it fixes, locks and pins nothing: give locked, fixed_weights_m2 or pinned.")
        if file.plan is not None and not (path.parent / file.plan).is_file():
            raise BadInput(f"there is no plan {file.plan} beside it: correct `plan`, the file to start from.")
    except ValidationError as error:
        raise BadInput(f"{path}: {problem_sentence(error, 'constraints file', model=_File)}") from error
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error
    start = None if file.plan is None else load_plan(path.parent / file.plan)[0]
    return GivenConstraints(constraints=constraints, start=start)


def dump_constraints(constraints: PlanConstraints, names: Sequence[str], plan: str) -> str:
    """Constraints on cameras with these names as TOML text that `load_constraints` reads back;
    `plan`: the file beside it that they refer to."""
    lines = [f"plan = {_quote(plan)}", f"locked = [{', '.join(map(_quote, constraints.locked))}]"]
    if constraints.fixed_weights_m2:
        lines += ["", "[fixed_weights_m2]"]
        lines += [f"{_quote(edge)} = {float(weight)!r}" for edge, weight in constraints.fixed_weights_m2.items()]
    if constraints.pinned:
        pinned: dict[str, list[str]] = {}
        for camera, edge in constraints.pinned.items():
            pinned.setdefault(edge, []).append(names[camera])
        lines += ["", "[pinned]", *(f"{_quote(edge)} = [{', '.join(map(_quote, cameras))}]" for edge, cameras in pinned.items())]
    return "\n".join(lines) + "\n"


def _quote(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
