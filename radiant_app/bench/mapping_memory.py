"""By how much mapping lets a process grow: the constants of `sfm/memory.py`.

python -m radiant_app.bench.mapping_memory DATABASE PHOTOGRAPHS incremental|global [COUNT]

DATABASE is the `sfm/database.db` of a run, PHOTOGRAPHS their folder; COUNT takes the first so many by name alone (incremental only). Prints
photographs, keypoints and verified matches, growth in MB and bytes of it per feature asked for (4,096 a photograph).
"""

from __future__ import annotations

import shutil
import sqlite3
import sys
import tempfile
from pathlib import Path

from radiant_app.workers.memory import peak_bytes, reset_peak_bytes
from radiant_core.errors import BadInput
from radiant_core.sfm.colmap.calls import pycolmap
from radiant_core.sfm.config import SfmConfig

MAX_IMAGES = 2**31 - 1
"""A pair's number in COLMAP's database is this times the lower image's, plus the higher one's."""


def main(database: Path, photographs: Path, mapper: str, count: int | None = None) -> None:
    """Map a copy of the database and print what that took."""
    if mapper not in ("incremental", "global") or (mapper == "global" and count is not None):
        raise BadInput(f"mapper {mapper!r}: give incremental, with a count of photographs where only some are to be mapped, or global.")
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name) / "database.db"
        shutil.copyfile(database, copy)
        names, num_keypoints, num_matches = _counts(copy, count)
        before_bytes = reset_peak_bytes()
        num_placed = _mapped(copy, photographs, mapper, names)
    growth_bytes = peak_bytes() - before_bytes
    asked = len(names) * SfmConfig().max_num_features
    print(
        f"{mapper}, {len(names)} photographs ({num_placed} placed), {num_keypoints:,} keypoints, {num_matches:,} matches: "
        f"{growth_bytes / 1e6:.0f} MB, {growth_bytes / asked:,.0f} bytes a feature"
    )


def _counts(database: Path, count: int | None) -> tuple[list[str], int, int]:
    """Names of the photographs taken, their keypoints and verified matches."""
    store = sqlite3.connect(database)
    number_of = dict(sorted(store.execute("select name, image_id from images"))[:count])
    taken = set(number_of.values())
    keypoints = sum(rows for image, rows in store.execute("select image_id, rows from keypoints") if image in taken)
    matches = store.execute("select pair_id, rows from two_view_geometries")
    verified = sum(rows for pair, rows in matches if {pair % MAX_IMAGES, pair // MAX_IMAGES} <= taken)
    store.close()
    return list(number_of), keypoints, verified


def _mapped(database: Path, photographs: Path, mapper: str, names: list[str]) -> int:
    """Photographs of the best model."""
    if mapper == "incremental":
        options = pycolmap.IncrementalPipelineOptions()
        options.image_names = names
        models = pycolmap.incremental_mapping(database, photographs, database.parent, options=options)
    else:
        wide = pycolmap.GlobalPipelineOptions()
        wide.mapper.global_positioning.use_gpu = wide.mapper.bundle_adjustment.ceres.use_gpu = False
        models = pycolmap.global_mapping(database, photographs, database.parent, options=wide)
    return max((model.num_reg_images() for model in models.values()), default=0)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], int(sys.argv[4]) if len(sys.argv) > 4 else None)
