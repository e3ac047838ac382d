"""A file of arrays: safetensors with one entry of metadata that says schema, version and more.

Strict when read: another schema, version, name or number type is refused. Once per file.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save, save_file

from radiant_core.errors import BadInput, CannotWrite, StoreDamaged, way_to_write
from radiant_core.io.array_layout import require_layout
from radiant_core.io.run_store import atomic_path, parse_json, write_atomic

VERSION = "1"
METADATA_NAME = "radiant"


def save_arrays(path: Path, schema: str, arrays: Mapping[str, NDArray], about: Mapping[str, Any]) -> None:
    """Write `arrays` and what is said `about` them, atomically; raises as `write_atomic`."""
    write_atomic(path, save(dict(arrays), _metadata(schema, about)))


def stream_arrays(path: Path, schema: str, arrays: Mapping[str, NDArray], about: Mapping[str, Any]) -> None:
    """As `save_arrays`, without a copy of all arrays in memory on the way."""
    with atomic_path(path) as temporary:
        try:
            save_file(dict(arrays), temporary, _metadata(schema, about))
        except SafetensorError as error:
            # It wraps what the system said; its own complaints about arrays come as other types.
            raise CannotWrite(f"cannot write {path}: {error}: {way_to_write(error)}.") from error


def _metadata(schema: str, about: Mapping[str, Any]) -> dict[str, str]:
    # One entry only: safetensors writes several in an order that differs from process to process,
    # and keys hash these bytes.
    record = {"schema": schema, "version": VERSION, "about": dict(about)}
    return {METADATA_NAME: json.dumps(record, allow_nan=False, sort_keys=True)}


def _record(file: Any) -> Any:
    """What an opened file says it is; an empty object where it says nothing."""
    return parse_json((file.metadata() or {}).get(METADATA_NAME, "{}"))


def load_arrays(path: Path, schema: str, dtypes: Mapping[str, str] | None) -> tuple[dict[str, NDArray], dict[str, Any]]:
    """Arrays and the parsed "about" of a file with this schema, version, names and dtypes.

    `names` None: any. Raises StoreDamaged when the file is missing or broken, BadInput when it
    holds something else.
    """
    with _open_arrays(path) as file, name_file_in_errors(path):
        record = _record(file)
        require_schema(record, schema)
        types = {name: file.get_slice(name).get_dtype() for name in file.keys()}  # noqa: SIM118
        if dtypes is not None and types != dtypes:
            raise BadInput(f"it holds the arrays {types}, expected {dict(dtypes)}: write it anew with this version.")
        return {name: file.get_tensor(name) for name in types}, record["about"]


def schema_of(path: Path) -> str:
    """The schema that a file of `save_arrays` says it has; "" where it says none. Raises
    StoreDamaged when it is missing or broken."""
    with _open_arrays(path) as file, name_file_in_errors(path):
        record = _record(file)
        return str(record.get("schema", "")) if isinstance(record, dict) else ""


def header_of(path: Path) -> tuple[dict[str, Any], dict[str, tuple[int, ...]]]:
    """What a file of `save_arrays` says of itself, and the shapes of its arrays, which are not
    read; raises as `schema_of`."""
    with _open_arrays(path) as file, name_file_in_errors(path):
        record = _record(file)
        names = file.keys()
        shapes = {key: tuple(file.get_slice(key).get_shape()) for key in names}
        return (record if isinstance(record, dict) else {}), shapes


def require_schema(record: Any, schema: str) -> None:
    """Raise BadInput unless `record` says that it is `schema` in this version."""
    if not isinstance(record, dict):
        raise BadInput("it does not say what it holds: write it anew with this version.")
    stated = (record.get("schema"), record.get("version"))
    if stated != (schema, VERSION):
        raise BadInput(f"it says schema and version {stated}, expected {(schema, VERSION)}: check which file it is.")


@contextmanager
def name_file_in_errors(path: Path) -> Iterator[None]:
    """Turn whatever a wrong content raises into BadInput that names the file."""
    try:
        yield
    except StoreDamaged:
        raise
    except (BadInput, KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        reason = error if isinstance(error, BadInput) else f"its content is not as written ({type(error).__name__}: {error})."
        raise BadInput(f"cannot use {path}: {reason}") from error


@contextmanager
def _open_arrays(path: Path) -> Iterator[Any]:
    if not Path(path).is_file():
        raise StoreDamaged(f"cannot read {path}: there is no such file: run the stage that writes it again.")
    require_layout(path)
    try:
        with safe_open(os.fspath(path), framework="np") as file:
            yield file
    except (SafetensorError, OSError) as error:
        raise StoreDamaged(f"{path} is not a whole safetensors file: {error}: run the stage that writes it again.") from error
