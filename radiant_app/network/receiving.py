"""What a node that others join packs for them, and takes of what they packed: by the same reception
as over the network. Once per task or result that is carried.

    join       the sealed request is admitted and answered as if it came by the socket
    result     announced, appended in parts, compared with its hashes; then it counts as received

The run or the edge that waits for it may go on meanwhile, in a process of its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from radiant_app.network.arrivals import INCOMING, PART_BYTES, Arrivals, DiskFull
from radiant_app.network.home import Home
from radiant_app.network.packs import Pack, open_pack, write_pack
from radiant_app.network.reception import JOIN, RECEIVED_STATES, HttpRequest, Reception, Refused
from radiant_app.network.store import HubStore, open_store
from radiant_core.errors import BadInput, CannotWrite
from radiant_core.io.run_store import parse_json
from radiant_core.io.transport.envelope import is_envelope_of, open_envelope


@dataclass(frozen=True, kw_only=True)
class Desk:
    """Where packs are handed in and out, at a node that others join."""

    home: Home
    store: HubStore
    reception: Reception

    def pack_task(self, node: str, folder: Path) -> str:
        """Write the task that a node below has to do; returns its stage. BadInput where there is
        none; raises as `write_pack`."""
        task = self.store.open_task(node)
        if task is None or task.state == "received":
            raise BadInput(f"{node} has nothing to do now: radiant node status says what became of its tasks.")
        envelope = open_envelope(task.text, task.signature, self.home.key.public_key())
        write_pack(folder, task.text, task.signature, {name: (task.folder / name, file) for name, file in envelope.files.items()})
        self.store.carry(task.digest)
        return f"{task.stage}, {envelope.num_bytes:,} bytes"

    def take_join(self, headers: dict[str, str], body: bytes) -> str:
        """Register the key of a node by its sealed request; BadInput where that is refused."""
        http_request = HttpRequest(method="POST", target=JOIN, headers=headers)
        reply = self.reception.admit(http_request)
        if reply is None:
            reply = self.reception.answer(HttpRequest(method="POST", target=JOIN, headers=headers, body=body))
        record = parse_json(reply.body)
        if reply.status != 200:
            raise BadInput(f"the request to join is refused: {record['reason']}")
        return str(record["node"])

    def open(self, folder: Path) -> Pack:
        """The result in a folder, signed by a node that joined and was not revoked; BadInput where
        it is none."""
        members = [member for member in self.store.members() if not member.revoked]
        pack = open_pack(folder, [member.key for member in members if member.key is not None])
        sender = self.store.member(pack.envelope.sender)
        if sender is None or sender.key is None or sender.revoked or not is_envelope_of(pack.text, pack.signature, sender.key):
            raise BadInput(f"{folder} is said to be of {pack.envelope.sender}, whose key did not sign it.")
        return pack

    def take_result(self, pack: Pack) -> str:
        """Take a result as over the network; what became of it.

        Raises:
            BadInput: its files are not those of its list, or nobody waits for it.
            CannotWrite: there is no room for it.
        """
        pack.check()
        envelope = pack.envelope
        try:
            task = self.reception.own_task(envelope.sender, envelope.answers, RECEIVED_STATES)
            self.reception.announce(task, pack.signature + pack.text)
            for number, (name, file) in enumerate(sorted(envelope.files.items())):
                with pack.files[name].open("rb") as content:
                    _, offset, _ = self.reception.take_part(task, number, None)
                    while offset < file.bytes:
                        content.seek(offset)
                        fitted, offset, _ = self.reception.take_part(task, number, (offset, content.read(PART_BYTES)))
                        if not fitted:
                            raise BadInput(f"{pack.folder} cannot be taken while the same result comes over the network: wait for that.")
        except Refused as refused:
            raise BadInput(f"the result of {envelope.stage} is refused: {refused.reason}") from None
        except DiskFull:
            raise CannotWrite(f"the disk of {self.home.folder} is full: {envelope.num_bytes:,} bytes are needed there.") from None
        received_task = self.store.task(envelope.answers)
        if received_task is None or received_task.state not in RECEIVED_STATES:
            raise BadInput(f"{pack.folder} changed while it was read: pack it again.")
        return f"the result of {envelope.stage}, {envelope.num_bytes:,} bytes, is {received_task.state}"


@contextmanager
def open_desk(home: Home) -> Iterator[Desk]:
    """The desk of a node, until the end of the block; raises as `open_store`."""
    (home.folder / INCOMING).mkdir(exist_ok=True)
    with open_store(home.folder) as store:
        reception = Reception(node=home.node, key=home.key, store=store, arrivals=Arrivals(folder=home.folder / INCOMING))
        yield Desk(home=home, store=store, reception=reception)
