"""Photographs as a list names them, and as they are here: with a folder, or in other letters. Once
per list."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import PureWindowsPath

FORMS: tuple[Callable[[str], str], ...] = (
    lambda name: name.replace("\\", "/"),
    lambda name: name.replace("\\", "/").casefold(),
    lambda name: PureWindowsPath(name).name,
    lambda name: PureWindowsPath(name).name.casefold(),
)
"""What names have in common, the strictest first: a Windows path also splits at slashes."""


def match_names(listed: Iterable[str], photographs: Sequence[str]) -> dict[str, str]:
    """Listed name → the photograph that it means: itself, or the only one that is the same without
    its folder or in other letters. What is not there, or fits two, stays as it is."""
    there, wanted = set(photographs), list(dict.fromkeys(listed))
    matched = {name: name for name in wanted if name in there}
    for form in FORMS:
        counts = Counter(form(name) for name in photographs)
        by_form = {form(name): name for name in photographs if counts[form(name)] == 1}
        matched |= {name: by_form[form(name)] for name in wanted if name not in matched and form(name) in by_form}
    # Two names of a list that would become one photograph are two things.
    num_claims = Counter(matched.values())
    return {name: matched[name] if name in matched and num_claims[matched[name]] == 1 else name for name in wanted}


def matched_warning(matched: dict[str, str]) -> tuple[str, ...]:
    """What was matched by more than its name, with an example; nothing where nothing was."""
    others = [(name, photograph) for name, photograph in matched.items() if name != photograph]
    if not others:
        return ()
    name, photograph = others[0]
    return (f"{len(others)} photographs of the list have another folder or other letters here: {name!r} is taken for {photograph!r}.",)
