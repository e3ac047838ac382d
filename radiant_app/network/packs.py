"""A signed list and its files in a folder for any carrier, a USB disk too. Once per task or result.

    PACK/list.json      the envelope of a task or of a result, as it is signed
         list.sig       64 bytes; written last, so that a folder without it is not whole
         files/NAME     its files
         join.json      of a node: its request to join, sealed as one over the network

It is signed and not encrypted. Whoever opens it knows nothing of it before a key that is registered
proved to have signed the list, and stores nothing before every file has the bytes of the list.
"""

from __future__ import annotations

import base64
import hashlib
import shutil
import stat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from radiant_core.errors import BadInput, CannotWrite
from radiant_core.io.run_store import atomic_path, file_sha256, open_without_waiting, read_bounded, read_json, write_atomic, write_json
from radiant_core.io.transport.delivery import SentFile
from radiant_core.io.transport.envelope import MAX_ENVELOPE_BYTES, Envelope, is_envelope_of, open_envelope
from radiant_core.io.transport.signing import SIGNATURE_BYTES

LIST_NAME, SIGNATURE_NAME, FILES, JOIN_NAME = "list.json", "list.sig", "files", "join.json"
MAX_JOIN_BYTES = 16384
_PIECE = 1 << 20


@dataclass(frozen=True, kw_only=True)
class Pack:
    """A list whose signature is right, and the folder that is said to hold its files."""

    folder: Path
    text: bytes
    signature: bytes
    envelope: Envelope

    @property
    def files(self) -> Mapping[str, Path]:
        """Name → where the file should be."""
        return {name: self.folder / FILES / name for name in self.envelope.files}

    def check(self) -> None:
        """Raise BadInput unless every file has the length and the bytes of the list; lengths are
        compared before anything is read."""
        for name, file in self.envelope.files.items():
            path = self.files[name]
            try:
                status = path.lstat()
            except OSError:
                raise BadInput(f"{path} is missing: the folder is not whole, pack it again.") from None
            if not stat.S_ISREG(status.st_mode) or status.st_size != file.bytes:
                raise BadInput(f"{path} is no file of {file.bytes:,} bytes, which its sender signed: pack it again.")
        for name, file in self.envelope.files.items():
            if file_sha256(self.files[name]) != file.sha256:
                raise BadInput(f"{self.files[name]} has other bytes than its sender signed: pack it again.")


def write_pack(folder: Path, text: bytes, signature: bytes, files: Mapping[str, tuple[Path, SentFile]]) -> None:
    """Write a list and its files into a folder; the signature comes last.

    Args:
        folder: new, empty, or with an earlier pack, which is replaced.
        text, signature: of the list.
        files: name → the file, and what the list says of it.

    Raises:
        BadInput: the folder holds something else, or a file is not what the list says.
        CannotWrite: there is no room, or the folder cannot be written.
    """
    clear_pack(folder)
    require_room(folder, sum(file.bytes for _, file in files.values()))
    for name, (source, file) in sorted(files.items()):
        copy_listed(source, folder / FILES / name, file)
    write_atomic(folder / LIST_NAME, text)
    write_atomic(folder / SIGNATURE_NAME, signature)


def clear_pack(folder: Path) -> None:
    """Make a folder, or take an earlier pack out of it; BadInput where it holds anything else."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if strange := sorted({path.name for path in folder.iterdir()} - {LIST_NAME, SIGNATURE_NAME, FILES, JOIN_NAME}):
            raise BadInput(f"{folder} holds {strange[0][:80]!r}: give a folder that is new, empty, or an earlier pack.")
        if (folder / FILES).is_symlink() or ((folder / FILES).exists() and not (folder / FILES).is_dir()):
            # A link would lead the files of a pack, and their removal, to another place.
            raise BadInput(f"{folder} holds {FILES!r}, which is no folder of a pack: give a folder that is new, empty, or an earlier pack.")
        # Without its signature the earlier one is no pack, whenever this process ends.
        for name in (SIGNATURE_NAME, LIST_NAME, JOIN_NAME):
            (folder / name).unlink(missing_ok=True)
        if (folder / FILES).is_dir():
            shutil.rmtree(folder / FILES)
    except OSError as error:
        raise CannotWrite(f"cannot write {folder}: {error.strerror}: choose a folder that can be written.") from error


def require_room(folder: Path, num_bytes: int) -> None:
    """Raise CannotWrite where a disk has no room for so many bytes."""
    if (free := shutil.disk_usage(folder).free) < num_bytes:
        raise CannotWrite(f"{folder} has {free:,} bytes free and {num_bytes:,} are needed: free space or choose another disk.")


def open_pack(folder: Path, keys: Sequence[Ed25519PublicKey]) -> Pack:
    """The list in a folder, which one of `keys` has signed; its files were not looked at.
    BadInput where there is none, or somebody else signed it."""
    if not folder.is_dir():
        raise BadInput(f"{folder} is no folder: give the one that `radiant node pack` wrote.")
    if not has_list(folder):
        raise BadInput(f"{folder} holds no signed list: it is no pack, or its writing was cut short; pack it again.")
    text, signature = read_bounded(folder / LIST_NAME, MAX_ENVELOPE_BYTES), read_bounded(folder / SIGNATURE_NAME, SIGNATURE_BYTES)
    for key in keys:
        if is_envelope_of(text, signature, key):
            return Pack(folder=folder, text=text, signature=signature, envelope=open_envelope(text, signature, key))
    raise BadInput(f"{folder} is signed by nobody who is known here: it was packed for another machine, or altered on the way.")


def has_list(folder: Path) -> bool:
    """Whether a folder holds a list and its signature."""
    return (folder / LIST_NAME).is_file() and (folder / SIGNATURE_NAME).is_file()


def copy_listed(source: Path, target: Path, file: SentFile) -> None:
    """Copy a file that a list names; BadInput, and nothing at `target`, where its bytes are others:
    the carrier may change it while it is read. Raises as `atomic_path`."""
    if not source.is_file():
        raise BadInput(f"{source} is not there any more: run again what makes it, then pack it.")
    target.parent.mkdir(parents=True, exist_ok=True)
    digest, num_left = hashlib.sha256(), file.bytes
    with atomic_path(target) as temporary, temporary.open("xb") as out, open(source, "rb", opener=open_without_waiting) as original:
        while num_left and (piece := original.read(min(_PIECE, num_left))):
            out.write(piece)
            digest.update(piece)
            num_left -= len(piece)
        out.flush()
        if num_left or original.read(1) or digest.hexdigest() != file.sha256:
            raise BadInput(f"{source} has other bytes than the list says: it changed meanwhile, pack it again.")


def write_join(folder: Path, headers: Mapping[str, str], body: bytes) -> None:
    """Put a sealed request to join beside what is packed."""
    write_json(folder / JOIN_NAME, {"headers": dict(headers), "body": base64.b64encode(body).decode()})


def read_join(folder: Path) -> tuple[dict[str, str], bytes] | None:
    """The request to join in a folder, of which nothing is checked yet; None without one."""
    path = folder / JOIN_NAME
    if not path.is_file():
        return None
    record = read_json(path, ("headers", "body"), MAX_JOIN_BYTES)
    headers, body = record["headers"], record["body"]
    if not isinstance(headers, dict) or not isinstance(body, str) or not all(isinstance(value, str) for value in headers.values()):
        raise BadInput(f"{path} is no request to join: pack it again.")
    try:
        return headers, base64.b64decode(body, validate=True)
    except ValueError:
        raise BadInput(f"{path} is no request to join: pack it again.") from None
