"""Files of a run: written whole or not at all, sealed by hashes, held by one writer at a time.

A stage writes its files, then `seal` records its key (hash of all it was made from) and the SHA-256
of every file; a later run skips it where `is_sealed` holds. Once per stage and file.
"""

from __future__ import annotations

import dataclasses
import fcntl
import hashlib
import json
import math
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path, PurePosixPath
from typing import IO, Any, Self

import numpy as np

from radiant_core.errors import BadInput, CannotWrite, RadiantError, StoreDamaged, way_to_write

SEAL_NAME = "done.json"
SEAL_VERSION = 1
LOCK_NAME = ".lock"
MAX_JSON_BYTES = 64 * 2**20
"""Default limit of a JSON file: a plan of 100,000 cameras takes some 2 MB."""
FULL_BYTES = 1 << 20
"""With less than this left a disk counts as full, so that we say it and no library that writes
there has to."""
_HALVES = re.compile(rb"(?i)\\ud[89a-f]|\xed[\xa0-\xbf]|\x00")
"""What a JSON text has where a value may hold half a character: its escape, or its bytes; or a NUL,
as texts of 16 and 32 bits have."""


def disk_is_full(folder: Path) -> bool:
    """Whether the disk of a folder has no room left that is worth naming."""
    return shutil.disk_usage(folder).free < FULL_BYTES


def require_room(folder: Path) -> None:
    """Raise CannotWrite on a full disk, after a library wrote there that does not report it."""
    if disk_is_full(folder):
        raise CannotWrite(f"the disk of {folder} is full: free space or choose another output folder.")


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A name beside `path` for a library that writes files itself; what it wrote takes the place of
    `path` when the block ends well.

    Temporary file in the same folder, fsync, replace, fsync of the folder: after a power cut the
    old or the new file is there. Raises CannotWrite when the system refuses (disk full, no such
    folder, not allowed); the old file is then untouched.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        yield temporary
        force_to_disk(temporary)
        temporary.replace(path)
        force_to_disk(path.parent)
    except OSError as error:
        raise CannotWrite(f"cannot write {path}: {error.strerror or error}: {way_to_write(error)}.") from error
    finally:
        with suppress(OSError):
            temporary.unlink()


@contextmanager
def atomic_writer(path: Path) -> Iterator[IO[bytes]]:
    """A binary file that becomes `path` when the block ends well, else vanishes; raises as
    `atomic_path`."""
    with atomic_path(path) as temporary, temporary.open("xb") as file:
        yield file


def write_atomic(path: Path, data: bytes) -> None:
    """Write `data` as the whole of `path`, or leave what was there; raises as `atomic_writer`."""
    with atomic_writer(path) as file:
        file.write(data)


def write_json(path: Path, obj: Any) -> None:
    """Write `obj` as indented UTF-8 JSON with sorted keys; BadInput for what JSON cannot hold."""
    try:
        text = json.dumps(obj, sort_keys=True, indent=1, ensure_ascii=False, allow_nan=False)
        data = (text + "\n").encode()
    except (TypeError, ValueError, RecursionError) as error:
        raise BadInput(f"cannot write {path} as JSON: {error}: pass finite numbers, text, lists and mappings only.") from error
    write_atomic(path, data)


def open_without_waiting(path: str, flags: int) -> int:
    """Opener for `open`: without O_NONBLOCK a pipe in a foreign folder would block the reader."""
    return os.open(path, flags | os.O_NONBLOCK)


def read_bounded(path: Path, max_bytes: int) -> bytes:
    """The bytes of a regular file of at most `max_bytes`; StoreDamaged when it is missing, no
    regular file, or larger."""
    try:
        with open(path, "rb", opener=open_without_waiting) as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise StoreDamaged(f"{path} is not a file: name the file itself.")
            data = file.read(max_bytes + 1)
    except OSError as error:
        raise StoreDamaged(f"cannot read {path}: {error.strerror or error}: run the stage that writes it again.") from error
    if len(data) > max_bytes:
        raise StoreDamaged(f"{path} has {status.st_size} bytes, expected at most {max_bytes}: it is not a file of this kind.")
    return data


def read_json(path: Path, keys: Sequence[str] = (), max_bytes: int = MAX_JSON_BYTES) -> Any:
    """The value of a JSON file of at most `max_bytes`, an object with all `keys` if any are given.

    Raises StoreDamaged when it is missing, larger, malformed, has a number that is not finite, a
    key twice or one too few.
    """
    data = read_bounded(path, max_bytes)
    try:
        value = parse_json(data)
    except (ValueError, RecursionError) as error:
        raise StoreDamaged(f"{path} is not valid JSON ({error}): restore it or run the stage that writes it again.") from error
    if keys and not (isinstance(value, dict) and value.keys() >= set(keys)):
        raise StoreDamaged(f"{path} is no JSON object with {', '.join(keys)}: restore it or run the stage that writes it again.")
    return value


def parse_json(data: bytes | str) -> Any:
    """The value of a JSON text; ValueError or RecursionError where it is malformed, a number
    not finite, a key there twice, or a text there that holds half a character."""
    value = json.loads(data, parse_constant=_finite_float, parse_float=_finite_float, object_pairs_hook=_unique_keys)
    if _HALVES.search(data if isinstance(data, bytes) else data.encode(errors="surrogatepass")):
        # Such a text is in no file: whoever writes it again would fail.
        json.dumps(value, ensure_ascii=False).encode()
    return value


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes as 64 hexadecimal digits; StoreDamaged when it cannot be read."""
    try:
        with open(path, "rb", opener=open_without_waiting) as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise StoreDamaged(f"{path} is not a file: name the file itself.")
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, UnicodeEncodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise StoreDamaged(f"cannot read {path}: {reason}: run the stage that writes it again.") from error


def content_key(*parts: Any) -> str:
    """Stable SHA-256 (64 hexadecimal digits) of what a stage is made from, equal on every machine.

    Takes None, bool, int, float, str, bytes, lists, tuples, mappings with text keys (order does not
    matter), numpy arrays, dataclasses, and Paths: a file counts by its bytes, a folder by the names
    and bytes of its files, never by where it lies. Raises TypeError on anything else.
    """
    return _digest_of(_canonical_bytes(list(parts)))


def key_of_files(sha256_of: Mapping[str, str]) -> str:
    """`content_key` of a folder that holds files with these hashes, by their paths inside it."""
    return _digest_of(chain(_tag("list", b"1"), _tag("path", b""), _canonical_bytes(sha256_of)))


def _digest_of(pieces: Iterable[bytes]) -> str:
    digest = hashlib.sha256()
    for piece in pieces:
        digest.update(piece)
    return digest.hexdigest()


def seal(folder: Path, key: str, names: Sequence[str]) -> None:
    """Write folder/done.json: `key` and the SHA-256 of each file `names` (relative, with "/").

    Raises StoreDamaged when a file is missing, BadInput when a name leaves the folder, CannotWrite
    when something cannot be forced to disk.
    """
    folder = Path(folder)
    for name in names:
        if not stays_inside(name):
            raise BadInput(f"cannot seal {name!r} in {folder}: give a name inside the folder, relative to it.")
    files = {name: file_sha256(folder / name) for name in names}
    try:
        for name in names:
            force_to_disk(folder / name)
    except OSError as error:
        raise CannotWrite(f"cannot seal {folder}: {error.strerror or error}: {way_to_write(error)}.") from error
    write_json(folder / SEAL_NAME, {"version": SEAL_VERSION, "key": key, "files": files})


def seal_problem(folder: Path, key: str) -> str | None:
    """Why `folder` is not sealed under `key`, one sentence; None when key and hashes are right."""
    folder = Path(folder)
    if not (folder / SEAL_NAME).is_file():
        return f"{folder} is not finished: there is no {SEAL_NAME}."
    try:
        record = read_json(folder / SEAL_NAME)
        if not _is_seal(record):
            return f"{folder / SEAL_NAME} is not a seal of version {SEAL_VERSION}."
        if record["key"] != key:
            return f"{folder} was made from other inputs or settings."
        for name, digest in record["files"].items():
            if file_sha256(folder / name) != digest:
                return f"{folder / name} is not what was written: its hash differs."
    except RadiantError as error:
        return str(error)
    return None


def is_sealed(folder: Path, key: str) -> bool:
    """Whether `folder` is finished under `key` and every sealed file still has its bytes."""
    return seal_problem(folder, key) is None


class RunLock:
    """Held by the one process that writes a run folder: `with RunLock(folder): ...`. The kernel
    frees it however the process ends. Raises BadInput when another one holds it."""

    def __init__(self, folder: Path) -> None:
        self.path = Path(folder) / LOCK_NAME
        self._file: IO[str] | None = None

    def __enter__(self) -> Self:
        try:
            file = self.path.open("a+", encoding="ascii", errors="replace")
        except OSError as error:
            raise BadInput(f"cannot lock {self.path.parent}: {error.strerror}: choose a folder that can be written.") from error
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            file.seek(0)
            holder = file.read(20).strip() or "unknown"
            file.close()
            raise BadInput(
                f"another process ({holder}) is writing {self.path.parent}: wait for it or choose another output folder."
            ) from error
        file.truncate(0)
        file.write(f"{os.getpid()}\n")
        file.flush()
        self._file = file
        return self

    def __exit__(self, *exc_info: object) -> None:
        if self._file is not None:
            fcntl.flock(self._file, fcntl.LOCK_UN)
            self._file.close()
            self._file = None


def _canonical_bytes(value: Any) -> Iterator[bytes]:
    """Bytes that differ for different values: type and length stand before each content."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, np.ndarray):
        array = np.ascontiguousarray(value)
        if array.dtype.hasobject:
            raise TypeError("content_key got an array of Python objects: pass numbers.")
        yield from _tag("array", f"{array.dtype.newbyteorder('<').str}{value.shape}".encode())
        yield np.asarray(array, array.dtype.newbyteorder("<")).tobytes()
    elif isinstance(value, Path):
        yield from _tag("path", b"")
        yield from _canonical_bytes(_folder_hashes(value) if value.is_dir() else file_sha256(value))
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        yield from _tag("dataclass", type(value).__name__.encode())
        yield from _canonical_bytes({field.name: getattr(value, field.name) for field in dataclasses.fields(value)})
    elif isinstance(value, Mapping):
        yield from _tag("mapping", str(len(value)).encode())
        for key in sorted(value):
            yield from _tag("key", key.encode())
            yield from _canonical_bytes(value[key])
    elif isinstance(value, list | tuple):
        yield from _tag("list", str(len(value)).encode())
        for item in value:
            yield from _canonical_bytes(item)
    else:
        yield from _tag(type(value).__name__, _scalar_bytes(value))


def _scalar_bytes(value: Any) -> bytes:
    if isinstance(value, bytes):
        return value
    if isinstance(value, float):
        return value.hex().encode()
    if value is None or isinstance(value, bool | int | str):
        return str(value).encode(errors="surrogatepass")
    raise TypeError(f"content_key got a {type(value).__name__}: pass numbers, text, arrays, dataclasses or paths.")


def _tag(tag: str, content: bytes) -> Iterator[bytes]:
    yield f"{tag}:{len(content)}:".encode()
    yield content


def _folder_hashes(folder: Path) -> dict[str, str]:
    return {path.relative_to(folder).as_posix(): file_sha256(path) for path in folder.rglob("*") if not path.is_dir()}


def _is_seal(record: Any) -> bool:
    return (
        isinstance(record, dict)
        and set(record) == {"version", "key", "files"}
        and record["version"] == SEAL_VERSION
        and isinstance(record["files"], dict)
        and all(stays_inside(name) and isinstance(digest, str) for name, digest in record["files"].items())
    )


def stays_inside(name: str) -> bool:
    """Whether a name, relative with "/", leads to nothing outside the folder it is joined to."""
    parts = PurePosixPath(name).parts
    return bool(parts) and not name.startswith("/") and ".." not in parts and "\0" not in name


def force_to_disk(path: Path) -> None:
    """Wait until a file, or the names in a folder, would outlast a power cut."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _finite_float(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {text[:40]} is not finite")
    return value


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    unique = dict(pairs)
    if len(unique) != len(pairs):
        raise ValueError("a key comes twice")
    return unique
