"""What stands beside a file that cannot hold its own place: NAME.georef.json and NAME.prj."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from radiant_core.errors import BadInput
from radiant_core.georef.crs import Crs
from radiant_core.georef.reference import Georeference
from radiant_core.io.run_store import write_atomic, write_json


def sidecar_paths(file: Path) -> tuple[Path, Path]:
    """The JSON and the .prj that belong to `file`."""
    return file.with_name(f"{file.stem}.georef.json"), file.with_name(f"{file.stem}.prj")


def require_no_sidecar(file: Path) -> None:
    """Raise BadInput where one of them is there already."""
    for path in sidecar_paths(file):
        if path.exists():
            raise BadInput(f"{path} exists, which would say where {file.name} lies: choose another name.")


def save_sidecar(file: Path, reference: Georeference) -> tuple[Path, Path]:
    """Write both, atomically; the paths written."""
    json_path, prj_path = sidecar_paths(file)[0], save_projection(file, reference.crs)
    write_json(json_path, {**reference.record(), "file": file.name})
    return json_path, prj_path


def save_projection(file: Path, crs: Crs) -> Path:
    """Write the .prj of a file in a projected system; the path written."""
    path = sidecar_paths(file)[1]
    write_atomic(path, f"{crs.wkt()}\n".encode())
    return path


def save_local_sidecar(file: Path, record: dict[str, Any]) -> Path:
    """Write the JSON of a file in the scene's own frame; the path written."""
    path = sidecar_paths(file)[0]
    write_json(path, {**record, "file": file.name})
    return path
