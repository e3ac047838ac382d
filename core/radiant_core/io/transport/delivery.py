"""What crosses tiers: named files with lengths and hashes in a signed record. Once per upload.

    delivery.json   schema, version, run, sender, receiver, kind, attempt;
                    files: name → bytes, sha256
    delivery.sig    64 bytes: Ed25519 of "radiant.delivery 1\\0" and the bytes of delivery.json

kind          files (those in brackets may be absent)                               way
device_model  model.safetensors, cameras.safetensors, (frame.json)                  device → edge
edge_model    model.safetensors, (virtual_cameras.safetensors, frame.json)  edge → cloud
edge_task     task.json                                                             cloud → edge
device_task   task.json, scene.safetensors, photos/, (masks/)                       edge → device
field_task    task.json, (poses.safetensors), (poses/)                              edge → device
score_task    task.json, inbox/: scene.ply, plan.json,
              (joined.ply, cut.ply, lpips.safetensors)                              edge → device
refine_task   task.json, scene.ply                                                  edge → device
average_task  task.json, scene.ply                                                  cloud → edge
refinement    refined.safetensors, rows.safetensors                     device → edge → cloud
scores        scores.json                                                           device → edge

The signature covers run, receiver and attempt, so that a delivery is worth nothing in another run
or elsewhere; which attempt counts is decided by `acceptance.py`. A folder counts as one file: the
bytes of all its files, and the hash of their names and contents. Files are safetensors and JSON,
photographs and PLY, and go through their own strict readers afterwards.
"""

from __future__ import annotations

import hashlib
import re
import stat
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from radiant_core.errors import BadInput
from radiant_core.io.array_file import name_file_in_errors
from radiant_core.io.run_store import content_key, file_sha256, parse_json, read_bounded, write_atomic, write_json
from radiant_core.io.transport.signing import SIGNATURE_BYTES, is_signed_by, load_signing_key

RECORD_NAME, SIGNATURE_NAME = "delivery.json", "delivery.sig"
SCHEMA, VERSION = "radiant.delivery", 1
MAX_RECORD_BYTES = 16384
MAX_FILE_BYTES, MAX_FOLDER_BYTES = 2 * 10**10, 10**13
MAX_ATTEMPT = 10**6

Kind = Literal[
    "device_model",
    "edge_model",
    "edge_task",
    "device_task",
    "field_task",
    "score_task",
    "refine_task",
    "average_task",
    "refinement",
    "scores",
]
FILES: dict[Kind, tuple[frozenset[str], frozenset[str]]] = {
    "device_model": (frozenset({"model.safetensors", "cameras.safetensors"}), frozenset({"frame.json"})),
    "edge_model": (frozenset({"model.safetensors"}), frozenset({"virtual_cameras.safetensors", "frame.json"})),
    "edge_task": (frozenset({"task.json"}), frozenset()),
    "device_task": (frozenset({"task.json", "scene.safetensors", "photos"}), frozenset({"masks"})),
    "field_task": (frozenset({"task.json"}), frozenset({"poses.safetensors", "poses"})),
    "score_task": (
        frozenset({"task.json", "inbox/scene.ply", "inbox/plan.json"}),
        frozenset({"inbox/joined.ply", "inbox/cut.ply", "inbox/lpips.safetensors"}),
    ),
    "refine_task": (frozenset({"task.json", "scene.ply"}), frozenset()),
    "average_task": (frozenset({"task.json", "scene.ply"}), frozenset()),
    "refinement": (frozenset({"refined.safetensors", "rows.safetensors"}), frozenset()),
    "scores": (frozenset({"scores.json"}), frozenset()),
}
"""Files that a delivery has to have, and those it may have."""
FOLDERS = frozenset({"poses", "photos", "masks"})
"""Those that are folders."""
_DOMAIN = f"{SCHEMA} {VERSION}\0".encode()
_RUN = re.compile("[0-9a-f]{32}")
_HASH = re.compile("[0-9a-f]{64}")
_NODE = re.compile(r"[^\s/][^\n\0]{0,254}")


@dataclass(frozen=True, kw_only=True)
class SentFile:
    """Length and SHA-256 of a file; of a folder the bytes of its files and its `content_key`."""

    bytes: int
    sha256: str


@dataclass(frozen=True, kw_only=True)
class Delivery:
    """One delivery as its record says it; checked when made."""

    run: str
    """32 hexadecimal digits, drawn when the run began."""
    sender: str
    receiver: str
    """Nodes by id, for example "devices/north-1" and "edges/north"."""
    kind: Kind
    attempt: int
    """1 at first; each time the sender makes its files anew, one more."""
    files: Mapping[str, SentFile]

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise BadInput(f"a delivery of kind {self.kind!r} came, expected one of {', '.join(get_args(Kind))}.")
        if not _RUN.fullmatch(self.run):
            raise BadInput(f"a delivery names the run {self.run[:40]!r}, expected 32 hexadecimal digits.")
        for node in (self.sender, self.receiver):
            if not _NODE.fullmatch(node) or ".." in node.split("/"):
                raise BadInput(f"a delivery names the node {node[:40]!r}, expected an id such as devices/north-1.")
        if not 1 <= self.attempt <= MAX_ATTEMPT:
            raise BadInput(f"a delivery is attempt {self.attempt}, expected 1 to {MAX_ATTEMPT}.")
        needed, possible = FILES[self.kind]
        if not needed <= set(self.files) <= needed | possible:
            names = ", ".join(sorted(self.files))[:200]
            raise BadInput(f"a delivery of kind {self.kind} has the files {names}, expected {', '.join(sorted(needed))}.")
        for name, file in self.files.items():
            most_bytes = MAX_FOLDER_BYTES if name in FOLDERS else MAX_FILE_BYTES
            if not (0 <= file.bytes <= most_bytes and _HASH.fullmatch(file.sha256)):
                raise BadInput(f"a delivery's {name} has {file.bytes} bytes and hash {file.sha256[:64]!r}: send it again.")

    @property
    def digest(self) -> str:
        """SHA-256 of what was sent, independent of sender and attempt: equal for equal files."""
        listed = "".join(f"{name}\0{file.bytes}\0{file.sha256}\0" for name, file in sorted(self.files.items()))
        return hashlib.sha256(f"{self.kind}\0{listed}".encode()).hexdigest()


def describe_files(paths: Mapping[str, Path]) -> dict[str, SentFile]:
    """Sent name → length and hash of the file or folder; StoreDamaged where it cannot be read."""
    return {name: SentFile(bytes=_length(path), sha256=_hash(path)) for name, path in paths.items()}


def save_delivery(folder: Path, delivery: Delivery, identity: Path) -> list[str]:
    """Write record and signature, by the key in `identity`; returns their names. Raises as
    `load_signing_key`."""
    key = load_signing_key(identity)
    write_json(folder / RECORD_NAME, {"schema": SCHEMA, "version": VERSION, **asdict(delivery)})
    write_atomic(folder / SIGNATURE_NAME, key.sign(_DOMAIN + (folder / RECORD_NAME).read_bytes()))
    return [RECORD_NAME, SIGNATURE_NAME]


def load_delivery(folder: Path, key: Ed25519PublicKey) -> Delivery:
    """The delivery whose record and signature lie in `folder`; BadInput where either is missing,
    too long, not signed by `key`, or no record of this schema."""
    record = read_bounded(folder / RECORD_NAME, MAX_RECORD_BYTES)
    signature = read_bounded(folder / SIGNATURE_NAME, SIGNATURE_BYTES)
    return verify_delivery(record, signature, key, str(folder / RECORD_NAME))


def verify_delivery(record: bytes, signature: bytes, key: Ed25519PublicKey, where: str = "a delivery") -> Delivery:
    """The delivery in the bytes of a record, which are parsed only once the signature is right."""
    if not is_signed_by(key, signature, _DOMAIN + record):
        raise BadInput(f"{where} is not signed by the key that is registered for its sender: send it again, or register the new key.")
    with name_file_in_errors(Path(where)):
        return _parse_record(parse_json(record))


def check_files(delivery: Delivery, folder: Path) -> None:
    """Raise BadInput unless the files in `folder` are the delivery's, to the bit; lengths are
    compared before anything is read."""
    for name, file in delivery.files.items():
        path = folder / name
        try:
            is_right_kind = (stat.S_ISDIR if name in FOLDERS else stat.S_ISREG)(path.lstat().st_mode)
            length = _length(path)
        except OSError as error:
            raise BadInput(f"{path} of the delivery is missing: send it again.") from error
        if not is_right_kind or length != file.bytes:
            raise BadInput(f"{path} has {length} bytes, its sender signed {file.bytes}: send it again.")
        if _hash(path) != file.sha256:
            raise BadInput(f"{path} has other bytes than its sender signed: send it again.")


def require_nothing_else(delivery: Delivery, folder: Path) -> None:
    """Raise BadInput where a file lies in `folder` that such a delivery may have and that was not
    sent: its receiver would take it for sent."""
    for name in sorted(FILES[delivery.kind][1] - set(delivery.files)):
        if (folder / name).exists():
            raise BadInput(f"{folder / name} was not sent with the {delivery.kind}: remove it.")


def _length(path: Path) -> int:
    """Bytes of a file, or of all files in a folder; a link counts as what it leads to."""
    return sum(inner.stat().st_size for inner in path.rglob("*") if not inner.is_dir()) if path.is_dir() else path.stat().st_size


def _hash(path: Path) -> str:
    return content_key(path) if path.is_dir() else file_sha256(path)


def _parse_record(record: Any) -> Delivery:
    fields = {"schema", "version", "run", "sender", "receiver", "kind", "attempt", "files"}
    if not isinstance(record, dict) or record.keys() != fields or (record["schema"], record["version"]) != (SCHEMA, VERSION):
        raise BadInput(f"it is no record of {SCHEMA} {VERSION}: use the same version of the software on both sides.")
    texts, files = [record[name] for name in ("run", "sender", "receiver", "kind")], record["files"]
    if not all(isinstance(text, str) for text in texts) or type(record["attempt"]) is not int or not isinstance(files, dict):
        raise BadInput("a field of it has another type: use the same version of the software on both sides.")
    if not all(_is_described(file) for file in files.values()):
        raise BadInput("a file of it is not described by bytes and sha256: send it again.")
    run, sender, receiver, kind = texts
    described = {name: SentFile(**file) for name, file in files.items()}
    return Delivery(run=run, sender=sender, receiver=receiver, kind=kind, attempt=record["attempt"], files=described)


def _is_described(file: Any) -> bool:
    return isinstance(file, dict) and file.keys() == {"bytes", "sha256"} and type(file["bytes"]) is int and isinstance(file["sha256"], str)
