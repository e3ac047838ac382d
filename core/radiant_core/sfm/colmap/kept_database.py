"""What an interrupted attempt left in its database, for the next one to go on with.

    database.json   key: hash of photographs, masks and settings; boot: of the machine, its start

COLMAP writes features and matches in transactions: a process that is killed leaves whole ones. It
does not wait for the disk: nothing is kept once the machine went down. What cannot be read is not
kept either, nor what COLMAP fails on, but for a full disk. Mapping is done anew. Once per attempt.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

from radiant_core.errors import RadiantError, StageFailed
from radiant_core.io.photos.listing import Photograph
from radiant_core.io.run_store import content_key, read_json, require_room, write_json
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.colmap.workspace import start_clean
from radiant_core.sfm.config import SfmConfig

RECORD_NAME = "database.json"
BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
"""Another one after every start of the machine (Linux); where there is none, nothing is kept."""


def database_key(photographs: Sequence[Photograph], config: SfmConfig, masks: Path | None) -> str:
    """Hash of all that features depend on: photographs, masks, settings, COLMAP's version."""
    settings = {name: value for name, value in asdict(config).items() if name not in ("num_threads", "memory_bytes")}
    pictures = [[photo.name, photo.path, photo.camera] for photo in photographs]
    return content_key(pycolmap.__version__, settings, pictures, masks if masks is not None and masks.is_dir() else None)


@contextmanager
def prepare_database(work_folder: Path, key: str) -> Iterator[Path]:
    """The path of the database in `work_folder`, made, or cleaned of all but one with this key."""
    database, record = work_folder / "database.db", work_folder / RECORD_NAME
    made_from = {"key": key, "boot": BOOT_ID.read_text().strip() if BOOT_ID.is_file() else None}
    start_clean(work_folder, keep_database=_is_record(record, made_from) and _is_whole(database))
    write_json(record, made_from)
    try:
        yield database
    except StageFailed:
        require_room(work_folder)
        record.unlink(missing_ok=True)
        raise


def _is_record(record: Path, made_from: dict[str, str | None]) -> bool:
    try:
        return made_from["boot"] is not None and read_json(record) == made_from
    except RadiantError:
        return False


def _is_whole(database: Path) -> bool:
    """Whether COLMAP can open the database and read what it needs."""
    if not database.is_file():
        return False
    try:
        with pycolmap.Database.open(database) as store:
            for image in store.read_all_images():
                if store.exists_keypoints(image.image_id):
                    store.read_descriptors(image.image_id)
            store.read_two_view_geometries()
    except (RuntimeError, ValueError, RadiantError):
        return False
    return True
