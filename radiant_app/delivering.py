"""Who a node is, whom it sends to and whose uploads it takes; what it sends is signed, what it takes is verified in its own process.

    <run>/run.json                    the run's number, drawn once: an upload is worth nothing in another run
    <node>/identity/                  post.json: run, node, receiver; the node's own key pair
    <node>/senders/<sender>.pub       public keys of those whose uploads it takes, registered before they begin
    <node>/deliveries/<sender>/       record and signature of what lies in inbox/<sender>/

The executors' dealer makes and registers keys by itself (`introduce`); by hand: copy a sender's signing_key.pub to its receiver.
Once per node.
"""

from __future__ import annotations

import secrets
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from radiant_core.errors import BadInput
from radiant_core.io.acceptance import Acceptance, Offer
from radiant_core.io.delivery import (
    MAX_RECORD_BYTES,
    RECORD_NAME,
    SIGNATURE_NAME,
    Delivery,
    Kind,
    check_files,
    load_delivery,
    save_delivery,
    sent_files,
)
from radiant_core.io.run_store import read_json, write_json
from radiant_core.io.signing import PUBLIC_NAME, load_public_key, make_signing_key

IDENTITY, SENDERS, DELIVERIES, POST_NAME = "identity", "senders", "deliveries", "post.json"
_KINDS: dict[str, Kind] = {"devices": "device_model", "edges": "edge_model"}


def run_number(run: Path) -> str:
    """The run's number, 32 hexadecimal digits; drawn by the first call."""
    path = run / "run.json"
    if not path.is_file():
        write_json(path, {"run": secrets.token_hex(16)})
    return str(read_json(path, ("run",), MAX_RECORD_BYTES)["run"])


def introduce(run: Path, node: str, receiver: str | None) -> None:
    """Tell a node of a run who it is and whom it sends to; make its key and register that with the receiver, where there is one.

    A key that was registered stays: a node whose key was changed by somebody is refused.
    """
    identity = run / node / IDENTITY
    identity.mkdir(mode=0o700, parents=True, exist_ok=True)
    write_json(identity / POST_NAME, {"run": run_number(run), "node": node, "receiver": receiver})
    if receiver is None:
        return
    made = make_signing_key(identity)
    registered = run / receiver / SENDERS / f"{Path(node).name}.pub"
    if made:
        # What an older key signed is worth nothing now: the seal no longer holds, and the node runs again.
        (run / node / SIGNATURE_NAME).unlink(missing_ok=True)
    if made or not registered.is_file():
        registered.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(identity / PUBLIC_NAME, registered)


def introduce_teacher(run: Path, teacher: str, edge: str, device: str) -> None:
    """A teacher is a part of its edge: it takes what is addressed to the edge, of its one device."""
    introduce(run, teacher, None)
    write_json(run / teacher / IDENTITY / POST_NAME, {"run": run_number(run), "node": edge, "receiver": None})
    (run / teacher / SENDERS).mkdir(exist_ok=True)
    shutil.copyfile(run / edge / SENDERS / f"{device}.pub", run / teacher / SENDERS / f"{device}.pub")


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
