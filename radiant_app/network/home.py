"""The folder of a machine's node, made by `radiant node init`. Once per process.

HOME/identity/      key pair of the node, and its certificate
     node.json      where it listens, if others join it
     upper.json     the node above: its address and certificate; which node this one is to it
     counter.json   no request was sent with a counter beyond
     hub.sqlite     who joined, tasks, results (`store.py`); of nodes that others join
     incoming/      parts of what arrives
     runs/<run>/    one folder per run, laid out as that of a run on one machine
"""

from __future__ import annotations

import base64
import json
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlsplit

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from radiant_app.network.certificate import key_of_certificate, make_certificate
from radiant_core.errors import BadInput
from radiant_core.io.run_store import RunLock, atomic_path, parse_json, read_bounded, read_json, write_json
from radiant_core.io.transport.signing import load_signing_key, make_signing_key

IDENTITY, NODE_NAME, UPPER_NAME, COUNTER_NAME, RUNS = "identity", "node.json", "upper.json", "counter.json", "runs"
JOIN_SCHEMA = "radiant.join 1"
MAX_JOIN_BYTES = 16384
RESERVED = 1024
"""Counters that are taken from the file at once."""
TOKEN_BYTES = 32
PRINTED_FIELDS = ("url", "node", "upper")
"""Of a join file, what a terminal shows, and whoever follows it agrees to."""
Identity = Literal["pinned", "signed"]
"""pinned: TLS to the upper node's own key; signed: TLS to whoever the system trusts, such as a
reverse proxy, which then reads all that passes. What is signed and sealed is so in both."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


@dataclass(frozen=True, kw_only=True)
class Listening:
    """Where a node is joined."""

    url: str
    """As other machines reach it: https://host:port."""
    host: str = "0.0.0.0"  # noqa: S104 - machines elsewhere are to reach it
    port: int = 8443
    plain: bool = False
    """Without TLS, behind a reverse proxy that has it."""

    def __post_init__(self) -> None:
        if not _is_address(self.url):
            raise BadInput(f"--url is {self.url[:200]!r}, expected https://HOST:PORT, as the machines that join will reach this one.")
        if not 0 <= self.port <= 65535:
            raise BadInput(f"the port is {self.port}, expected 0 to 65535.")


@dataclass(frozen=True, kw_only=True)
class Invitation:
    """A join file: who is invited, where to, and a word that counts once."""

    url: str
    certificate: str
    node: str
    """Which node the invited one will be, such as "devices/north-1"."""
    upper: str
    """Which node invites, such as "edges/north"."""
    token: str
    identity: Identity

    def __post_init__(self) -> None:
        Listening(url=self.url)
        key_of_certificate(self.certificate.encode())
        tier, _, name = self.node.partition("/")
        above = {"edges": "cloud", "devices": "edges"}.get(tier)
        if above is None or not _NAME.fullmatch(name) or self.upper.split("/")[0] != above or self.identity not in ("pinned", "signed"):
            raise BadInput(f"the join file invites {self.node[:80]!r} to {self.upper[:80]!r}, which is no pair of tiers: ask for another.")

    @property
    def key(self) -> Ed25519PublicKey:
        """The key of the node that invites."""
        return key_of_certificate(self.certificate.encode())


@dataclass(frozen=True, kw_only=True)
class Home:
    """A node's folder."""

    folder: Path

    @property
    def identity(self) -> Path:
        """Where its keys lie."""
        return self.folder / IDENTITY

    @property
    def key(self) -> Ed25519PrivateKey:
        """Its private key."""
        return load_signing_key(self.identity)

    def run_folder(self, run: str) -> Path:
        """Where its part of a run lies."""
        return self.folder / RUNS / run

    @property
    def node(self) -> str:
        """Which node it is: what its invitation says, or else the cloud."""
        return self.upper.node if (self.folder / UPPER_NAME).is_file() else "cloud"

    @property
    def upper(self) -> Invitation:
        """The invitation that it followed; BadInput where there is none."""
        path = self.folder / UPPER_NAME
        if not path.is_file():
            raise BadInput(f"{self.folder} has joined no node: radiant node join FILE, a file that `radiant node invite` wrote there.")
        return _invitation(read_json(path, max_bytes=MAX_JOIN_BYTES), path)

    @property
    def listening(self) -> Listening:
        """Where it is joined; BadInput where nobody can."""
        record = read_json(self.folder / NODE_NAME, ("listening",))["listening"]
        if record is None:
            raise BadInput(f"{self.folder} says not where this machine is reached: radiant node init --url https://HOST:PORT.")
        return Listening(**record)

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Held by the one process that acts for the node; BadInput where another one does."""
        lock = RunLock(self.folder)
        try:
            lock.__enter__()
        except BadInput:
            raise BadInput(f"{self.node} is at work already, in another process with {self.folder}: end that one first.") from None
        try:
            yield
        finally:
            lock.__exit__()

    def reserve_counters(self) -> tuple[int, int]:
        """The first counter that was never used, and the first one beyond those reserved now."""
        path = self.folder / COUNTER_NAME
        first = int(read_json(path, ("next",))["next"]) if path.is_file() else 1
        write_json(path, {"next": first + RESERVED})
        return first, first + RESERVED


def _is_address(url: str) -> bool:
    try:
        parts = urlsplit(url)
        # Python asks for the number of a port first where it is used.
        return parts.scheme == "https" and bool(parts.hostname) and parts.port != 0 and not (parts.query or parts.fragment)
    except ValueError:
        return False


def open_home(folder: Path) -> Home:
    """The node in a folder; BadInput where there is none."""
    if not (folder / NODE_NAME).is_file():
        raise BadInput(f"{folder} holds no node: radiant node init, or give the folder of one with --home.")
    return Home(folder=folder)


def require_cloud(home: Home) -> None:
    """Raise BadInput for a node that nobody can join, or that has joined another one."""
    if home.node != "cloud":
        raise BadInput(f"{home.folder} is {home.node}, which works for another machine: make a node for the cloud by radiant node init.")
    assert home.listening


def make_home(folder: Path, listening: Listening | None) -> Home:
    """Make a node with a key of its own, or change where one listens; raises as
    `make_signing_key`."""
    home = Home(folder=folder)
    make_private_folder(folder)
    make_signing_key(home.identity)
    stored = read_json(folder / NODE_NAME).get("listening") if (folder / NODE_NAME).is_file() else None
    write_json(folder / NODE_NAME, {"listening": stored if listening is None else asdict(listening)})
    return home


def make_private_folder(folder: Path) -> None:
    """Make the folder of a node, which others on this machine may not look into: it holds words
    that were not used yet, poses and models. BadInput where that cannot be done."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder.chmod(0o700)
    except OSError as error:
        raise BadInput(f"cannot make {folder}: {error.strerror}: choose a folder that can be written.") from error


def write_private(path: Path, data: bytes) -> None:
    """Write a file that nobody but its owner may read, at any moment; raises as `atomic_path`."""
    with atomic_path(path) as temporary, open(temporary, "xb", opener=lambda name, flags: os.open(name, flags, 0o600)) as file:
        file.write(data)


def new_invitation(home: Home, name: str, identity: Identity = "pinned") -> Invitation:
    """An invitation to join this node; BadInput for a name that no node can have."""
    if not _NAME.fullmatch(name):
        raise BadInput(f"{name[:80]!r} is no name of a node, expected its id in the system file: letters, digits, - and _.")
    upper = home.node
    tier = {"cloud": "edges", "edges": "devices"}.get(upper.split("/")[0])
    if tier is None:
        raise BadInput(f"this machine is {upper}, which nobody joins: devices join edges, edges the cloud.")
    certificate = make_certificate(home.key).decode()
    token = base64.urlsafe_b64encode(secrets.token_bytes(TOKEN_BYTES)).decode()
    return Invitation(url=home.listening.url, certificate=certificate, node=f"{tier}/{name}", upper=upper, token=token, identity=identity)


def invitation_text(invitation: Invitation) -> str:
    """A join file."""
    return json.dumps({"schema": JOIN_SCHEMA, **asdict(invitation)}, indent=1) + "\n"


def accept_invitation(home: Home, file: Path) -> Invitation:
    """Keep a join file in the node's folder; BadInput where it is none, or the node has joined
    another one."""
    try:
        record = parse_json(read_bounded(file, MAX_JOIN_BYTES))
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{file} is no join file ({error}): ask for one by `radiant node invite`.") from error
    invitation = _invitation(record, file)
    if (home.folder / UPPER_NAME).is_file() and (upper := home.upper).node != invitation.node:
        raise BadInput(f"this machine is {upper.node} already and the file invites {invitation.node}: make another home for that one.")
    write_json(home.folder / UPPER_NAME, record)
    return invitation


def _invitation(record: Any, path: Path) -> Invitation:
    names = {"url", "certificate", "node", "upper", "token", "identity"}
    if not isinstance(record, dict) or record.keys() != {"schema", *names} or record["schema"] != JOIN_SCHEMA:
        raise BadInput(f"{path} is no join file: ask for one by `radiant node invite`.")
    if not all(isinstance(record[name], str) for name in names):
        raise BadInput(f"{path} is no join file: ask for one by `radiant node invite`.")
    if not all(record[name].isprintable() for name in PRINTED_FIELDS):
        raise BadInput(f"{path} has characters that cannot be printed in what it names: ask for another by `radiant node invite`.")
    try:
        return Invitation(**{name: record[name] for name in names})
    except BadInput:
        raise
    except ValueError:
        # Half a character, or an address that is none.
        raise BadInput(f"{path} is no join file: ask for one by `radiant node invite`.") from None
