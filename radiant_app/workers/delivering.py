"""Keys of nodes: what one sends is signed, what it receives is verified in its own process.

    <run>/run.json                    the run's number: a delivery is valid in this run only
    <node>/identity/                  post.json: run, node, receiver (its parent); own key pair;
                                      conducts: it makes its own tasks, as an edge over a network
        above.pub                     public key of its parent, whose tasks it accepts
        taken.json                    the newest task it accepted: no older one is accepted again
        given/<node>/<kind>.json      number and hash of the newest task it signed for a child
    <node>/senders/<sender>.pub       public keys of its children, registered before they start
    <node>/deliveries/<sender>/       record and signature of what lies in inbox/<sender>/
    <node>/given/                     record and signature of its own task and what belongs to it

Models go up (`deliver`, `find_refusals`), tasks come down (`sign_task`, `accept_task`). The dealer
of a run creates and exchanges keys (`exchange_keys`) and signs tasks with the key in their sender's
folder; over a network nodes have keys of their own (`identify_owned`, `register_sender`).
"""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from radiant_core.aggregate.tree import REFINE, scored_at
from radiant_core.errors import BadInput, StoreDamaged
from radiant_core.hierarchy.codec import sent_files as model_files
from radiant_core.io.run_store import content_key, read_json, write_atomic, write_json
from radiant_core.io.transport.acceptance import Acceptance, LastTask, Offer
from radiant_core.io.transport.delivery import (
    MAX_RECORD_BYTES,
    RECORD_NAME,
    SIGNATURE_NAME,
    Delivery,
    Kind,
    check_files,
    describe_files,
    load_delivery,
    require_nothing_else,
    save_delivery,
)
from radiant_core.io.transport.signing import KEY_NAME, PUBLIC_NAME, load_public_key, make_signing_key

IDENTITY, SENDERS, DELIVERIES, FROM_ABOVE, POST_NAME = "identity", "senders", "deliveries", "given", "post.json"
ABOVE_NAME, TAKEN_NAME = "above.pub", "taken.json"
_KINDS: dict[str, Kind] = {"devices": "device_model", "edges": "edge_model"}


def run_number(run: Path) -> str:
    """Return the run's number, 32 hexadecimal digits; the first call draws it."""
    path = run / "run.json"
    if not path.is_file():
        write_json(path, {"run": secrets.token_hex(16)})
    return str(read_json(path, ("run",), MAX_RECORD_BYTES)["run"])


def exchange_keys(run: Path, node: str, above: str | None, below: Iterable[str] = ()) -> None:
    """Write a node's identity and key, and exchange keys with its parent `above`, which has one.

    A new key is registered again by the nodes `below`; a registered one stays, so that a node whose
    key was replaced is refused.
    """
    identity = _write_identity(run, node, node, above)
    if make_signing_key(identity):
        # Signatures of the older key are invalid now: the seal fails, and the node runs again.
        for place in (run / node, run / scored_at(node), *(run / node).glob(f"{REFINE}*")):
            (place / SIGNATURE_NAME).unlink(missing_ok=True)
        registrations = [run / child / IDENTITY / ABOVE_NAME for child in below]
        for stale in [*registrations, *([] if above is None else [_sender_key(run, node, above)])]:
            stale.unlink(missing_ok=True)
    if above is not None:
        _register_key(identity / PUBLIC_NAME, _sender_key(run, node, above))
        _register_key(run / above / IDENTITY / PUBLIC_NAME, identity / ABOVE_NAME)


def identify_part(run: Path, part: str, node: str, above: str | None) -> None:
    """Let the folder `part` inside that of a node accept what is addressed to the node."""
    identity = _write_identity(run, part, node, above, conducts=conducts_itself(run / node))
    if above is not None:
        shutil.copyfile(run / node / IDENTITY / ABOVE_NAME, identity / ABOVE_NAME)


def identify_owned(run: Path, node: str, above: str | None, keys: Path, above_key: bytes | None, *, conducts: bool = False) -> None:
    """Let the folder of a node be that of the node whose own key pair lies in `keys`, which is not
    copied; `above_key`: the public key of its parent in PEM."""
    identity = _write_identity(run, node, node, above, conducts=conducts)
    for name in (KEY_NAME, PUBLIC_NAME):
        if not (identity / name).is_symlink():
            (identity / name).unlink(missing_ok=True)
            (identity / name).symlink_to((keys / name).resolve())
    if above_key is not None:
        write_atomic(identity / ABOVE_NAME, above_key)


def register_sender(run: Path, sender: str, receiver: str, key: bytes) -> None:
    """Let `receiver` take what the holder of this public key in PEM signs as `sender`; what
    `receiver` gives it is to be accepted by its own key."""
    place = _sender_key(run, sender, receiver)
    place.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(place, key)
    identity = _write_identity(run, sender, sender, receiver)
    write_atomic(identity / ABOVE_NAME, (run / receiver / IDENTITY / PUBLIC_NAME).read_bytes())


def use_run_number(run: Path, number: str) -> None:
    """Make a folder part of the run with this number; BadInput where it is of another one."""
    if not (run / "run.json").is_file():
        write_json(run / "run.json", {"run": number})
    if run_number(run) != number:
        raise BadInput(f"{run} belongs to another run: remove it.")


def conducts_itself(folder: Path) -> bool:
    """Whether a node makes the tasks of its folder itself: nobody else signs them."""
    path = folder / IDENTITY / POST_NAME
    return path.is_file() and read_json(path, ("run",), MAX_RECORD_BYTES).get("conducts", False) is True


def _write_identity(run: Path, place: str, node: str, above: str | None, *, conducts: bool = False) -> Path:
    """Write as which node the folder `place` sends and receives; returns its identity/."""
    identity = run / place / IDENTITY
    identity.mkdir(mode=0o700, parents=True, exist_ok=True)
    more = {"conducts": True} if conducts else {}
    write_json(identity / POST_NAME, {"run": run_number(run), "node": node, "receiver": above, **more})
    return identity


def _sender_key(run: Path, sender: str, receiver: str) -> Path:
    return run / receiver / SENDERS / f"{Path(sender).name}.pub"


def _register_key(key: Path, place: Path) -> None:
    if not place.is_file():
        place.parent.mkdir(parents=True, exist_ok=True)
        # A half-written key would stay registered.
        write_atomic(place, key.read_bytes())


def sign_task(run: Path, sender: str, receiver: str, kind: Kind, place: Path, names: Iterable[str]) -> None:
    """Sign the files `names` in `place` as a task of `sender` for `receiver`, into given/ there;
    changed files make a new attempt."""
    files = describe_files({name: place / name for name in names})
    delivery = Delivery(run=run_number(run), sender=sender, receiver=receiver, kind=kind, attempt=1, files=files)
    counted = run / sender / IDENTITY / FROM_ABOVE / receiver / f"{kind}.json"
    if counted.is_file():
        last = read_json(counted, ("attempt", "digest"), MAX_RECORD_BYTES)
        delivery = replace(delivery, attempt=last["attempt"] + (last["digest"] != delivery.digest))
    counted.parent.mkdir(parents=True, exist_ok=True)
    # Counted first: no number is signed for two contents, whenever this process ends.
    write_json(counted, {"attempt": delivery.attempt, "digest": delivery.digest})
    (place / FROM_ABOVE).mkdir(exist_ok=True)
    save_delivery(place / FROM_ABOVE, delivery, run / sender / IDENTITY)


def accept_task(folder: Path, kind: Kind) -> None:
    """Raise BadInput unless `folder` holds the parent's newest task for this node; record it."""
    post = read_json(folder / IDENTITY / POST_NAME, ("run", "node", "receiver"), MAX_RECORD_BYTES)
    delivery = _load_signed(folder / FROM_ABOVE, folder / IDENTITY / ABOVE_NAME, str(folder))
    if delivery.kind != kind:
        raise BadInput(f"{folder / FROM_ABOVE} is {delivery.kind!r}, expected {kind!r}: send the task again.")
    check_files(delivery, folder)
    require_nothing_else(delivery, folder)
    last, verdict = _last_task(folder, post).offer(_offer(delivery.receiver, delivery))
    if verdict.status == "rejected":
        raise BadInput(f"the task in {folder} is refused: {verdict.reason}{_way_on(delivery, post['run'], str(folder))}")
    write_json(folder / IDENTITY / TAKEN_NAME, {"key": _key_of_above(folder), "attempt": last.attempt, "digest": last.digest})


def _last_task(folder: Path, post: dict[str, Any]) -> LastTask:
    """The newest accepted task; none if the parent has a new key, which counts from 1 again."""
    last = LastTask(run=post["run"], receiver=post["node"], sender=post["receiver"])
    path = folder / IDENTITY / TAKEN_NAME
    if not path.is_file():
        return last
    record = read_json(path, ("key", "attempt", "digest"), MAX_RECORD_BYTES)
    return replace(last, attempt=record["attempt"], digest=record["digest"]) if record["key"] == _key_of_above(folder) else last


def _key_of_above(folder: Path) -> str:
    return content_key(folder / IDENTITY / ABOVE_NAME)


def deliver(folder: Path, paths: Mapping[str, Path], kind: Kind | None = None, home: Path | None = None) -> list[str]:
    """Sign the files that a node sends, `paths`: name in the receiver's inbox → file; returns the
    names of record and signature. A part of the node in `home` sends things of another kind than
    models."""
    post = read_json(folder / IDENTITY / POST_NAME, ("run", "node", "receiver"), MAX_RECORD_BYTES)
    delivery = Delivery(
        run=post["run"],
        sender=post["node"],
        receiver=post["receiver"],
        kind=kind or _KINDS[post["node"].split("/")[0]],
        attempt=_last_attempt(folder) + 1,
        files=describe_files(paths),
    )
    return save_delivery(folder, delivery, (home or folder) / IDENTITY)


def belongs_to_run(folder: Path) -> bool:
    """Whether a folder is that of a node of a run, which accepts and sends nothing unsigned."""
    return (folder / IDENTITY / POST_NAME).is_file()


def sign_upload(folder: Path) -> list[str]:
    """Sign the model that a node of a run sends; returns the names written, none in a folder made
    by hand."""
    return deliver(folder, model_files(folder)) if belongs_to_run(folder) else []


def find_refusals(
    folder: Path, senders: Sequence[str], places: Mapping[str, Path], kind: Kind | None = None, home: Path | None = None
) -> dict[str, str]:
    """Sender → why the node in `folder` refuses its upload in `places`: not signed by its
    registered key, other bytes than signed, of another run, for another node, or a second one. A
    part of the node in `home` takes things of another kind than models."""
    post = read_json(folder / IDENTITY / POST_NAME, ("run", "node"), MAX_RECORD_BYTES)
    tier = "edges" if post["node"] == "cloud" else "devices"
    expected = {sender: f"{tier}/{sender}" for sender in senders}
    wanted = kind or _KINDS[tier]
    acceptance = Acceptance(run=post["run"], receiver=post["node"], senders=expected)
    refusals = {}
    for sender in senders:
        try:
            delivery = _load_signed(folder / DELIVERIES / sender, (home or folder) / SENDERS / f"{sender}.pub", expected[sender])
            if delivery.kind != wanted:
                raise BadInput(f"it sent {delivery.kind!r}, expected {wanted!r}.")
            check_files(delivery, places[sender])
        except BadInput as error:
            refusals[sender] = str(error)
            continue
        acceptance, verdict = acceptance.offer(_offer(sender, delivery))
        if verdict.status == "rejected":
            refusals[sender] = verdict.reason + _way_on(delivery, post["run"], expected[sender])
    return refusals


def _load_signed(place: Path, key: Path, node: str) -> Delivery:
    """As `load_delivery`; a wrong signature says what to do with the folder of `node`."""
    try:
        return load_delivery(place, load_public_key(key))
    except StoreDamaged:
        raise
    except BadInput as error:
        raise BadInput(f"{error}{_way_on(None, '', node)}") from error


def _way_on(delivery: Delivery | None, run: str, node: str) -> str:
    if delivery is not None and delivery.run == run:
        return ""
    return f" If the folder {node} was put here from another run, remove it and go on with --resume."


def _offer(region: str, delivery: Delivery) -> Offer:
    return Offer(
        run=delivery.run,
        receiver=delivery.receiver,
        region=region,
        sender=delivery.sender,
        attempt=delivery.attempt,
        digest=delivery.digest,
    )


def _last_attempt(folder: Path) -> int:
    try:
        attempt = read_json(folder / RECORD_NAME, ("attempt",), MAX_RECORD_BYTES)["attempt"]
    except BadInput:
        return 0
    return attempt if type(attempt) is int and attempt > 0 else 0
