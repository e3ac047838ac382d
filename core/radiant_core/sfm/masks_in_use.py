"""The folder of masks that structure from motion uses, with what is said of it. Once per source.

work/masks.turned/a/b.jpg.png     masks of which white was left out, with black left out instead
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from radiant_core.choices import MaskIgnores
from radiant_core.decisions import Decision
from radiant_core.io.photos.mask_folders import find_mask_folder, ignored_reason, match_masks, unmatched_warning
from radiant_core.io.photos.masks import find_masks, require_black_ignored, turn_masks

TURNED = "masks.turned"


@dataclass(frozen=True, kw_only=True)
class MasksInUse:
    """A folder whose masks leave out black, or None; warnings, with names and without."""

    folder: Path | None
    decisions: tuple[Decision, ...] = ()
    warnings: tuple[str, ...] = ()
    unnamed_warnings: tuple[str, ...] = ()


@contextmanager
def masks_in_use(
    folder: Path | None, ignores: MaskIgnores | None, photo_folder: Path, names: Sequence[str], work_folder: Path
) -> Iterator[MasksInUse]:
    """The masks in `folder` of photographs of these names, turned in `work_folder` where white is
    left out, as long as the context lasts.

    Raises BadInput where none fits, one fits two, or nothing says which colour is left out.
    """
    if folder is None:
        notes = () if ignores == "nothing" else find_mask_folder(photo_folder, names)[1]
        yield MasksInUse(folder=None, warnings=notes, unnamed_warnings=tuple("masks are named after no photograph." for _ in notes))
        return
    masks = find_masks(folder, names)
    matched = match_masks(folder, names)
    share = None if ignores is not None else require_black_ignored(folder, masks)
    turned = work_folder / TURNED
    shutil.rmtree(turned, ignore_errors=True)
    if ignores == "white":
        turn_masks(masks, turned)
    decision = Decision(
        stage="sfm",
        topic="colour of masks",
        choice=f"{ignores or 'black'} is left out, in {folder.name}/",
        figure=float(len(masks)) if share is None else 100 * (1 - share),
        unit="masks" if share is None else "% of their pixels ignored",
        reason=ignored_reason(ignores),
        forced=ignores is not None,
    )
    used = f"masks of {len(masks)} of {len(names)} photographs are used, {ignores or 'black'} is left out."
    yield MasksInUse(
        folder=turned if ignores == "white" else folder,
        decisions=(decision,),
        warnings=(f"{folder.name}/: {used}", *unmatched_warning(matched, folder, names)),
        unnamed_warnings=(used, *unmatched_warning(matched, folder, names, named=False)),
    )
    shutil.rmtree(turned, ignore_errors=True)
