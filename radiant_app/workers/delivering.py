"""Who a node is, whom it sends to and whose word it takes; what it sends is signed, what it takes is verified in its own process.

    <run>/run.json                    the run's number, drawn once: a delivery is worth nothing in another run
    <node>/identity/                  post.json: run, node, receiver (who is above it); the node's own key pair
        above.pub                     public key of the one above it, whose tasks it takes
        taken.json                    the newest task it took, so that no older one comes back
        given/<node>/<kind>.json      number and hash of the newest task it gave to a node below
    <node>/senders/<sender>.pub       public keys of those whose uploads it takes, registered before they begin
    <node>/deliveries/<sender>/       record and signature of what lies in inbox/<sender>/
    <node>/given/                     record and signature of its own task and what belongs to it

Models go up (`deliver`, `refusals`), tasks come down (`give_task`, `take_task`). The executors' dealer makes and exchanges keys by itself
(`introduce`) and signs tasks by the key in their sender's folder; by hand: copy signing_key.pub to senders/ above and above.pub below.
Once per node.
"""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from radiant_core.errors import BadInput
from radiant_core.io.run_store import content_key, read_json, write_atomic, write_json
from radiant_core.io.transport.acceptance import Acceptance, LastTask, Offer
from radiant_core.io.transport.delivery import (
    MAX_RECORD_BYTES,
    RECORD_NAME,
    SIGNATURE_NAME,
    Delivery,
    Kind,
    check_files,
    load_delivery,
    require_nothing_else,
    save_delivery,
    sent_files,
)
from radiant_core.io.transport.signing import PUBLIC_NAME, load_public_key, make_signing_key

IDENTITY, SENDERS, DELIVERIES, GIVEN, POST_NAME = "identity", "senders", "deliveries", "given", "post.json"
ABOVE_NAME, TAKEN_NAME = "above.pub", "taken.json"
_KINDS: dict[str, Kind] = {"devices": "device_model", "edges": "edge_model"}


def run_number(run: Path) -> str:
    """The run's number, 32 hexadecimal digits; drawn by the first call."""
    path = run / "run.json"
    if not path.is_file():
        write_json(path, {"run": secrets.token_hex(16)})
    return str(read_json(path, ("run",), MAX_RECORD_BYTES)["run"])


def introduce(run: Path, node: str, above: str | None, below: Iterable[str] = ()) -> None:
    """Tell a node of a run who it is and who is above it, to whom it sends and from whom its tasks come; make its key and exchange keys
    with that one, who was introduced before. `below`: the nodes that are to register the key where it is a new one.

    A key that was registered stays: a node whose key was changed by somebody is refused.
    """
    identity = _post(run, node, node, above)
    if make_signing_key(identity):
        # What an older key signed is worth nothing now: the seal no longer holds, and the node runs again.
        (run / node / SIGNATURE_NAME).unlink(missing_ok=True)
        registrations = [run / child / IDENTITY / ABOVE_NAME for child in below]
        for stale in [*registrations, *([] if above is None else [_sender_key(run, node, above)])]:
            stale.unlink(missing_ok=True)
    if above is not None:
        _register(identity / PUBLIC_NAME, _sender_key(run, node, above))
        _register(run / above / IDENTITY / PUBLIC_NAME, identity / ABOVE_NAME)


def introduce_teacher(run: Path, teacher: str, edge: str, device: str) -> None:
    """A teacher is a part of its edge: it takes what is addressed to the edge, of its one device."""
    _post(run, teacher, edge, None)
    (run / teacher / SENDERS).mkdir(exist_ok=True)
    shutil.copyfile(run / edge / SENDERS / f"{device}.pub", run / teacher / SENDERS / f"{device}.pub")


def introduce_scoring(run: Path, scoring: str, device: str, edge: str) -> None:
    """The scoring is a part of its device: it takes tasks that are addressed to that."""
    identity = _post(run, scoring, device, edge)
    shutil.copyfile(run / device / IDENTITY / ABOVE_NAME, identity / ABOVE_NAME)


def _post(run: Path, place: str, node: str, above: str | None) -> Path:
    """Say in the folder `place` of a run as which node it sends and takes; that folder's identity/."""
    identity = run / place / IDENTITY
    identity.mkdir(mode=0o700, parents=True, exist_ok=True)
    write_json(identity / POST_NAME, {"run": run_number(run), "node": node, "receiver": above})
    return identity


def _sender_key(run: Path, sender: str, receiver: str) -> Path:
    return run / receiver / SENDERS / f"{Path(sender).name}.pub"


def _register(key: Path, place: Path) -> None:
    if not place.is_file():
        place.parent.mkdir(parents=True, exist_ok=True)
        # Half a key would stay registered for ever.
        write_atomic(place, key.read_bytes())


def give_task(run: Path, sender: str, receiver: str, kind: Kind, place: Path, names: Iterable[str]) -> None:
    """Sign, by the key of the node `sender`, the files `names` in the folder `place` as a task for `receiver`; other files than before
    make a new attempt. Record and signature are laid beside them, in given/."""
    files = sent_files({name: place / name for name in names})
    delivery = Delivery(run=run_number(run), sender=sender, receiver=receiver, kind=kind, attempt=1, files=files)
    counted = run / sender / IDENTITY / GIVEN / receiver / f"{kind}.json"
    if counted.is_file():
        last = read_json(counted, ("attempt", "digest"), MAX_RECORD_BYTES)
        delivery = replace(delivery, attempt=last["attempt"] + (last["digest"] != delivery.digest))
    counted.parent.mkdir(parents=True, exist_ok=True)
    # Counted first: no number is ever signed for two contents, whenever this process ends.
    write_json(counted, {"attempt": delivery.attempt, "digest": delivery.digest})
    (place / GIVEN).mkdir(exist_ok=True)
    save_delivery(place / GIVEN, delivery, run / sender / IDENTITY)


def take_task(folder: Path, kind: Kind) -> None:
    """Raise BadInput unless what lies in `folder` is the newest task that the one above signed for this node in this run; remember it."""
    post = read_json(folder / IDENTITY / POST_NAME, ("run", "node", "receiver"), MAX_RECORD_BYTES)
    delivery = load_delivery(folder / GIVEN, load_public_key(folder / IDENTITY / ABOVE_NAME))
    if delivery.kind != kind:
        raise BadInput(f"{folder / GIVEN} has a {delivery.kind}, expected a {kind}: send the task again.")
    check_files(delivery, folder)
    require_nothing_else(delivery, folder)
    last, verdict = _last_task(folder, post).offer(_offer(delivery.receiver, delivery))
    if verdict.status == "rejected":
        raise BadInput(f"the task in {folder} is refused: {verdict.reason}")
    write_json(folder / IDENTITY / TAKEN_NAME, {"key": _key_of_above(folder), "attempt": last.attempt, "digest": last.digest})


def _last_task(folder: Path, post: dict[str, Any]) -> LastTask:
    """The newest task taken; none where the one above has another key by now, which counts from 1 again."""
    last = LastTask(run=post["run"], receiver=post["node"], sender=post["receiver"])
    path = folder / IDENTITY / TAKEN_NAME
    if not path.is_file():
        return last
    taken = read_json(path, ("key", "attempt", "digest"), MAX_RECORD_BYTES)
    return replace(last, attempt=taken["attempt"], digest=taken["digest"]) if taken["key"] == _key_of_above(folder) else last


def _key_of_above(folder: Path) -> str:
    return content_key(folder / IDENTITY / ABOVE_NAME)


def deliver(folder: Path, paths: Mapping[str, Path]) -> list[str]:
    """Sign what the node in `folder` sends, name in its receiver's inbox → file here; returns the names of record and signature."""
    post = read_json(folder / IDENTITY / POST_NAME, ("run", "node", "receiver"), MAX_RECORD_BYTES)
    delivery = Delivery(
        run=post["run"],
        sender=post["node"],
        receiver=post["receiver"],
        kind=_KINDS[post["node"].split("/")[0]],
        attempt=_last_attempt(folder) + 1,
        files=sent_files(paths),
    )
    return save_delivery(folder, delivery, folder / IDENTITY)


def signed_upload(folder: Path, task: dict[str, Any]) -> list[str]:
    """Sign the model that a node sends and what its task says besides; the names written. Nothing where its task sends nothing."""
    if "sends" not in task:
        return []
    model = folder / ("model.safetensors" if task["upload"] == "float32" else "upload.safetensors")
    return deliver(folder, {"model.safetensors": model, **{name: folder / name for name in task["sends"]}})


def refusals(folder: Path, senders: Sequence[str], places: Mapping[str, Path]) -> dict[str, str]:
    """Senders whose upload the node in `folder` does not take, and why: not signed by the key registered for them, other bytes than
    they signed, of another run, addressed to another node, or a second one. `places`: sender → folder with its files."""
    post = read_json(folder / IDENTITY / POST_NAME, ("run", "node"), MAX_RECORD_BYTES)
    tier = "edges" if post["node"] == "cloud" else "devices"
    acceptance = Acceptance(run=post["run"], receiver=post["node"])
    for sender in senders:
        # Which cameras a sender was to deliver is the plan's to know: here each is one region.
        acceptance = acceptance.planned(sender, f"{tier}/{sender}", [sender])
    found = {}
    for sender in senders:
        try:
            delivery = load_delivery(folder / DELIVERIES / sender, load_public_key(folder / SENDERS / f"{sender}.pub"))
            if delivery.kind != _KINDS[tier]:
                raise BadInput(f"it sent a {delivery.kind}, expected a {_KINDS[tier]}.")
            check_files(delivery, places[sender])
        except BadInput as error:
            found[sender] = str(error)
            continue
        acceptance, verdict = acceptance.offer(_offer(sender, delivery))
        if verdict.status == "rejected":
            found[sender] = verdict.reason
    return found


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
    """The attempt that the node's last record names, 0 where it left none that can be read."""
    try:
        attempt = read_json(folder / RECORD_NAME, ("attempt",), MAX_RECORD_BYTES)["attempt"]
    except BadInput:
        return 0
    return attempt if type(attempt) is int and attempt > 0 else 0
