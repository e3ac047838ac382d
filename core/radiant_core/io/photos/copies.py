"""Files that are the same photograph under two names, as "IMG_1 (1).jpg". Once per folder.

Only files of equal length are read; of each set with the same bytes the first stays.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

from radiant_core.io.run_store import file_sha256

MAX_NAMED = 3


def sort_by_worth(names: Sequence[str]) -> list[int]:
    """Indices of `names` in the order in which the first of several copies stays: as given, but
    first val/ of a set with its own split, so that its copies in train/ go."""
    own_split = {name.split("/")[0] for name in names} == {"train", "val"}
    return sorted(range(len(names)), key=lambda index: (own_split and names[index].startswith("train/"), index))


def file_copies(paths: Mapping[str, Path]) -> dict[str, str]:
    """Copy → the photograph that stays, of those at `paths` by name with the same bytes."""
    names = list(paths)
    by_length: dict[int, list[str]] = defaultdict(list)
    for name in (names[index] for index in sort_by_worth(names)):
        if paths[name].is_file():
            by_length[paths[name].stat().st_size].append(name)
    copies: dict[str, str] = {}
    for alike in (alike for alike in by_length.values() if len(alike) > 1):
        first_with: dict[str, str] = {}
        for name in alike:
            first = first_with.setdefault(file_sha256(paths[name]), name)
            if first != name:
                copies[name] = first
    return copies


def copies_warning(copies: Mapping[str, str], num_photographs: int) -> tuple[str, ...]:
    """The warning about copies that were left out, in one sentence; none where there are none."""
    named = [f"{name} (of {first})" for name, first in sorted(copies.items())]
    listed = ", ".join(named[:MAX_NAMED]) + (" …" if len(named) > MAX_NAMED else "")
    return tuple(f"{count.removesuffix('.')}: {listed}." for count in copies_count(len(copies), num_photographs))


def copies_count(num_copies: int, num_photographs: int) -> tuple[str, ...]:
    """The same without names, which may be private."""
    if not num_copies:
        return ()
    return (
        f"{num_copies} of {num_photographs} photographs are copies of others and are left out, so that none is both trained on and scored.",
    )
