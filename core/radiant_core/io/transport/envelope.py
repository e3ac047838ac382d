"""What machines exchange over a network: lists of files signed by their sender, sealed requests.

    envelope   schema, version, run, sender, receiver, kind, stage, attempt, answers, software;
               files: name → bytes, sha256
    signature  Ed25519 of "radiant.envelope 1\\0" and the bytes of the envelope
    seal       Ed25519 of "radiant.request 2\\0" and node, counter, method, target, hash of the body
    reply      Ed25519 of "radiant.reply 2\\0" and hash of the request, its seal, status, offset,
               hash of the body

An envelope announces files before a byte of them is stored: a task that goes down, or the result
that answers it. What is inside is signed once more by who made it (`delivery.py`). A node counts
its requests: a counter that is not larger than the last one is a replay, whatever the clocks say.
Once per request; files are bound to their envelope by their hashes.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from radiant_core.errors import BadInput
from radiant_core.io.run_store import parse_json
from radiant_core.io.transport.delivery import MAX_ATTEMPT, MAX_FILE_BYTES, SentFile
from radiant_core.io.transport.signing import is_signed_by

SCHEMA, VERSION = "radiant.envelope", 1
MAX_ENVELOPE_BYTES = 1 << 20
MAX_FILES = 4096
MAX_COUNTER = 2**62
SOFTWARE_TEXT = 64
_ENVELOPE, _REQUEST, _REPLY = f"{SCHEMA} {VERSION}\0".encode(), b"radiant.request 2\0", b"radiant.reply 2\0"
_RUN, _HASH = re.compile("[0-9a-f]{32}"), re.compile("[0-9a-f]{64}")
_KIND = re.compile("[a-z][a-z_]{0,31}")
_PART = r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}"
_NODE = re.compile(rf"cloud|(devices|edges)/{_PART}")
_INNER = re.compile(rf"{_PART}(/{_PART}){{0,3}}")


@dataclass(frozen=True, kw_only=True)
class Envelope:
    """A signed list of files; checked when made."""

    run: str
    """32 hexadecimal digits, drawn when the run began."""
    sender: str
    receiver: str
    """Nodes by id, for example "devices/north-1" and "edges/north"."""
    kind: str
    """The kind of work that is asked for, or that was done."""
    stage: str
    """Its place in the run, below the node that works: its id, or its id and one name more."""
    attempt: int
    """1 at first; one more each time that the files of a stage's task are others."""
    answers: str
    """Digest of the task that a result answers; empty for a task."""
    software: str
    files: Mapping[str, SentFile]

    def __post_init__(self) -> None:
        if not _RUN.fullmatch(self.run):
            raise BadInput(f"an envelope names the run {self.run[:40]!r}, expected 32 hexadecimal digits.")
        for node in (self.sender, self.receiver):
            if not _NODE.fullmatch(node):
                raise BadInput(f"an envelope names the node {node[:40]!r}, expected an id such as devices/north-1.")
        if not _KIND.fullmatch(self.kind) or not 1 <= self.attempt <= MAX_ATTEMPT or not 1 <= len(self.software) <= SOFTWARE_TEXT:
            raise BadInput(f"an envelope has kind {self.kind[:40]!r} and attempt {self.attempt}: use the same version on both sides.")
        worker = self.sender if self.answers else self.receiver
        if self.stage != worker and not re.fullmatch(rf"{re.escape(worker)}/[a-z_]{{1,32}}[0-9]{{0,2}}", self.stage):
            raise BadInput(f"an envelope is for the stage {self.stage[:80]!r}, which is none of {worker}.")
        if self.answers and not _HASH.fullmatch(self.answers):
            raise BadInput("an envelope answers no task: send it again.")
        self._check_files()

    def _check_files(self) -> None:
        if len(self.files) > MAX_FILES:
            raise BadInput(f"an envelope lists {len(self.files)} files, expected at most {MAX_FILES}.")
        for name, file in self.files.items():
            if not is_inner_name(name):
                raise BadInput(f"an envelope lists the file {name[:80]!r}, expected a name inside the folder.")
            if not (0 <= file.bytes <= MAX_FILE_BYTES and _HASH.fullmatch(file.sha256)):
                raise BadInput(f"an envelope's {name} has {file.bytes} bytes and hash {file.sha256[:64]!r}: send it again.")

    @property
    def num_bytes(self) -> int:
        """Bytes of all files."""
        return sum(file.bytes for file in self.files.values())

    @property
    def digest(self) -> str:
        """SHA-256 of all that it says: equal for equal envelopes."""
        return hashlib.sha256(envelope_bytes(self)).hexdigest()

    def result(self, files: Mapping[str, SentFile], software: str) -> Envelope:
        """The envelope of the result that answers this task, which its receiver seals."""
        return replace(self, sender=self.receiver, receiver=self.sender, answers=self.digest, software=software, files=files)


def is_inner_name(name: str) -> bool:
    """Whether a name leads to a file inside a folder: plain words, at most four levels."""
    return _INNER.fullmatch(name) is not None


def envelope_bytes(envelope: Envelope) -> bytes:
    """The one text of an envelope, which is signed."""
    record = {"schema": SCHEMA, "version": VERSION, **asdict(envelope)}
    return json.dumps(record, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def sign_envelope(envelope: Envelope, key: Ed25519PrivateKey) -> tuple[bytes, bytes]:
    """The text of an envelope and its signature."""
    text = envelope_bytes(envelope)
    return text, key.sign(_ENVELOPE + text)


def is_envelope_of(text: bytes, signature: bytes, key: Ed25519PublicKey) -> bool:
    """Whether the holder of a key signed these bytes as an envelope."""
    return is_signed_by(key, signature, _ENVELOPE + text)


def open_envelope(text: bytes, signature: bytes, key: Ed25519PublicKey) -> Envelope:
    """The envelope in these bytes, which are parsed only once the signature is right; BadInput
    where it is wrong, they are too many, or no envelope of this schema."""
    if len(text) > MAX_ENVELOPE_BYTES:
        raise BadInput(f"an envelope has {len(text)} bytes, expected at most {MAX_ENVELOPE_BYTES}.")
    if not is_envelope_of(text, signature, key):
        raise BadInput("an envelope is not signed by the key that is registered for its sender.")
    try:
        record = parse_json(text)
    except (ValueError, RecursionError) as error:
        raise BadInput(f"an envelope is not valid JSON ({error}): send it again.") from error
    envelope = _parse(record)
    if envelope_bytes(envelope) != text:
        raise BadInput("an envelope is written in another way than ours: use the same version of the software on both sides.")
    return envelope


def _parse(record: Any) -> Envelope:
    texts = ("run", "sender", "receiver", "kind", "stage", "answers", "software")
    if not isinstance(record, dict) or record.keys() != {"schema", "version", *texts, "attempt", "files"}:
        raise BadInput(f"it is no {SCHEMA} {VERSION}: use the same version of the software on both sides.")
    if (record["schema"], record["version"]) != (SCHEMA, VERSION) or not all(isinstance(record[name], str) for name in texts):
        raise BadInput(f"it is no {SCHEMA} {VERSION}: use the same version of the software on both sides.")
    if type(record["attempt"]) is not int or not isinstance(record["files"], dict):
        raise BadInput("a field of an envelope has another type: use the same version of the software on both sides.")
    files = {}
    for name, file in record["files"].items():
        if not isinstance(file, dict) or file.keys() != {"bytes", "sha256"} or type(file["bytes"]) is not int:
            raise BadInput("a file of an envelope is not described by bytes and sha256: send it again.")
        if not isinstance(file["sha256"], str):
            raise BadInput("a file of an envelope is not described by bytes and sha256: send it again.")
        files[name] = SentFile(**file)
    return Envelope(**{name: record[name] for name in texts}, attempt=record["attempt"], files=files)


@dataclass(frozen=True, kw_only=True)
class Request:
    """What a sealed request says of itself, known before its body is read."""

    node: str
    counter: int
    """Larger than that of every earlier request of the node."""
    method: str
    target: str
    """Path and query."""
    body_sha256: str

    def message(self) -> bytes:
        """What is signed."""
        parts = [self.node, str(self.counter), self.method, self.target, self.body_sha256]
        return _REQUEST + "\n".join(parts).encode(errors="surrogateescape")

    def reply_message(self, seal: str, status: int, offset: str, body: bytes) -> bytes:
        """What the server signs that answers this request as it came, with `seal`: who altered one
        on its way cannot pass on the refusal as that of the genuine one. `offset` is where a part
        goes on, else empty."""
        parts = [hashlib.sha256(self.message()).hexdigest(), seal, str(status), offset, hashlib.sha256(body).hexdigest()]
        return _REPLY + "\n".join(parts).encode(errors="surrogateescape")
