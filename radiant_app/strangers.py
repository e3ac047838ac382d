"""Records that other machines sent, parsed where they are read. Once per record.

    record ── parse_record ──→ a frozen value of its kind, or BadInput

Nothing of a record but the value goes on: what passes is what is used.
"""

from __future__ import annotations

import json
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from radiant_core.errors import BadInput

Kind = TypeVar("Kind", bound=BaseModel)
WRONG = "use the same version of the software on both sides, or look at the disk of that machine"
_WIDTH = 60
_TAGS = ("constrained-int", "constrained-float")
"""Which part of a union was tried is nobody's business."""


class UntrustedRecord(BaseModel):
    """Base of what another machine tells: no unknown keys, no numbers as text, nothing infinite,
    and nothing that changes later."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


def parse_record(kind: type[Kind], record: Any, subject: str) -> Kind:
    """The value of a record that stands in JSON; BadInput, calling it `subject`, for any other."""
    try:
        return kind.model_validate_json(json.dumps(record))
    except ValidationError as error:
        raise BadInput(f"{subject} cannot be used: {_problem_of(error)}: {WRONG}.") from None
    except (ValueError, TypeError, RecursionError) as error:
        raise BadInput(f"{subject} is no JSON ({type(error).__name__}): {WRONG}.") from None


def _problem_of(error: ValidationError) -> str:
    """The first thing that is wrong: where it stands, what came, what was expected."""
    problem = error.errors(include_url=False)[0]
    cause = problem.get("ctx", {}).get("error")
    if not problem["loc"] and cause is not None:
        return str(cause)
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in problem["loc"] if part not in _TAGS).lstrip(".")[:_WIDTH]
    # It is printed, and a stranger may have called it anything.
    key = "".join(letter if letter.isprintable() else " " for letter in key)
    if problem["type"] in ("missing", "extra_forbidden"):
        return f"{key} is {'missing' if problem['type'] == 'missing' else 'no field of it'}"
    value = repr(problem["input"])
    expected = problem["msg"].replace("Input should be", "expected")
    return f"{key or 'it'} is {value if len(value) <= _WIDTH else value[: _WIDTH - 1] + '…'}, {expected[0].lower()}{expected[1:]}"
