"""What stands in files that others write: checked to the last key, refused in one sentence."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, ValidationError

from radiant_core.errors import BadInput


class Strict(BaseModel):
    """Base of what stands in a file: no unknown keys, no numbers as text, nothing infinite."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def problem_sentence(error: ValidationError, kind: str, path: str = "") -> str:
    """The first problem below a key's `path` in a `kind` of file: where, what came, what should."""
    problem = error.errors(include_url=False)[0]
    key = "".join([path, *(f"[{part}]" if isinstance(part, int) else f".{part}" for part in problem["loc"])]).lstrip(".")
    if problem["type"] == "missing":
        return f"{key} is missing: add it."
    if problem["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"{key} is not a key of a {kind}: remove it or correct its spelling."
    cause = problem.get("ctx", {}).get("error")
    if isinstance(cause, BadInput):
        return f"{key}: {cause}"
    text = repr(problem["input"])
    expected = problem["msg"].replace("Input should be", "expected")
    return f"{key} is {text if len(text) <= 60 else text[:57] + '…'}; {expected[0].lower()}{expected[1:]}: correct it."
