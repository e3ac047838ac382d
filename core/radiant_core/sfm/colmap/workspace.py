"""The two ends of a work folder: what photographs go in, nothing left of an earlier attempt."""

from __future__ import annotations

import shutil
from collections import Counter
from pathlib import Path

from radiant_core.errors import BadInput
from radiant_core.io.photos.copies import copies_count, copies_warning
from radiant_core.io.photos.folders import folders_warning, unread_warning
from radiant_core.io.photos.listing import PhotoListing, doubts_warning, list_photographs, sea_warning, skipped_in_short
from radiant_core.panoramas import has_faces
from radiant_core.sfm.config import Report, SfmProgress

DATABASE_FILES = ("database.db", "database.db-shm", "database.db-wal", "database.json")
THOROUGH_FOLDER = "thorough"
WORK_FILES = ("pairs.txt",)
WORK_FOLDERS = (
    *("models", "sparse", "undistorted", "undistorted.part", "masks", "masks.part", "masks.given"),
    *("adjusted", "named", "triangulated"),
)
"""All that structure from motion puts into its work folder and removes there at the start."""


def list_usable(folder: Path, report: Report, names: tuple[str, ...] | None = None, *, stretch: bool = False) -> PhotoListing:
    """`list_photographs` with its progress, of `names` if given, without copies; raises alike, and
    for photographs of more than 8 bits where the caller does not `stretch` them."""
    listing = list_photographs(
        folder, lambda num_done, total: report(SfmProgress(phase="checking photographs", done=num_done, total=total)), names
    )
    if listing.stretches and not stretch:
        raise BadInput(
            f"in {folder} {listing.stretches[0].unstretched}, which are not stretched where poses are given: save them in 8 bits, "
            "all by one stretch."
        )
    return listing.without_copies()


def warn_of_unused(listing: PhotoListing, project_notes: tuple[str, ...] = (), *, named: bool = True) -> tuple[str, ...]:
    """Warnings about the files that are not used, where photographs lie and what is doubtful in
    them, and `project_notes`; counted where their names are private."""
    num_usable = len(listing.photographs) + len(listing.copies)
    doubts = {photo.name: photo.position_doubt for photo in listing.photographs}
    folders = () if has_faces(listing.content.names) else folders_warning(listing.content, named=named)
    common = (
        *folders,
        *unread_warning(listing.content.unread),
        *doubts_warning(doubts, len(listing.photographs), named=named),
        *sea_warning([photo.altitude_from_sea for photo in listing.photographs]),
        *(stretch.sentence for stretch in listing.stretches),
    )
    if named:
        skipped = tuple(f"{clause} and is skipped." for clause in skipped_in_short(listing.skipped))
        return (*skipped, *common, *project_notes, *copies_warning(listing.copies, num_usable))
    counts = Counter(skipped.reason for skipped in listing.skipped)
    total = num_usable + len(listing.skipped)
    counted = tuple(f"{count} of {total} files skipped, each of which {reason}." for reason, count in counts.items())
    return (*counted, *common, *project_notes, *copies_count(len(listing.copies), num_usable))


def start_clean(work_folder: Path, *, keep_database: bool = False) -> None:
    """Make the work folder and remove what an earlier attempt left of ours in it, except its
    database where that is to be kept."""
    work_folder.mkdir(parents=True, exist_ok=True)
    for name in (*WORK_FILES, *(() if keep_database else DATABASE_FILES)):
        (work_folder / name).unlink(missing_ok=True)
    for name in (*WORK_FOLDERS, *(() if keep_database else (THOROUGH_FOLDER,))):
        shutil.rmtree(work_folder / name, ignore_errors=True)
