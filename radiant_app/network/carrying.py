"""Work without a connection: a task that came by another carrier, a result that leaves by one.

    HOME/carried/task/          the newest task that was unpacked, as its pack came
                 result.json    list of the newest result, its signature, and where its files are

`CarriedWay` stands in for the line to the node above, so that the same errands are run: the list is
opened by the same key, the same checks refuse what is old or another's. Once per task.
"""

from __future__ import annotations

import base64
import hashlib
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from radiant_app.network.home import Home, Invitation
from radiant_app.network.line import join_body, seal_headers
from radiant_app.network.packs import Pack, clear_pack, copy_listed, has_list, open_pack, write_join, write_pack
from radiant_app.network.reception import JOIN
from radiant_core.errors import BadInput, StageFailed
from radiant_core.io.run_store import file_sha256, parse_json, read_json, write_json
from radiant_core.io.transport.envelope import Envelope, Request, open_envelope, sign_envelope

CARRIED, TASK, RESULT_NAME = "carried", "task", "result.json"
WAIT_S = 0.2


def keep_result(home: Home, result: Envelope, paths: Mapping[str, Path]) -> None:
    """Remember a result that is ready to leave, until there is a newer one."""
    text, signature = sign_envelope(result, home.key)
    (home.folder / CARRIED).mkdir(exist_ok=True)
    places = {name: str(path.absolute()) for name, path in paths.items()}
    record = {"text": base64.b64encode(text).decode(), "signature": base64.b64encode(signature).decode(), "paths": places}
    write_json(home.folder / CARRIED / RESULT_NAME, record)


def pack_own(home: Home, folder: Path) -> str:
    """Write what a node has for the one above: its newest result, and its request to join. Returns
    what that is; raises as `write_pack`."""
    path = home.folder / CARRIED / RESULT_NAME
    packed = f"the request of {home.node} to join {home.upper.upper}"
    if path.is_file():
        record = read_json(path, ("text", "signature", "paths"))
        text, signature = (base64.b64decode(record[name]) for name in ("text", "signature"))
        result = open_envelope(text, signature, home.key.public_key())
        write_pack(folder, text, signature, {name: (Path(record["paths"][name]), file) for name, file in result.files.items()})
        packed = f"the result of {result.stage}, {result.num_bytes:,} bytes,"
    else:
        clear_pack(folder)
    headers, body = sealed_join(home)
    write_join(folder, headers, body)
    return packed


def sealed_join(home: Home) -> tuple[dict[str, str], bytes]:
    """A node's request to join as it goes over a network: headers and body."""
    body, (counter, _) = join_body(home), home.reserve_counters()
    request = Request(node=home.node, counter=counter, method="POST", target=JOIN, body_sha256=hashlib.sha256(body).hexdigest())
    return {**seal_headers(request, home.key), "content-length": str(len(body))}, body


def keep_task(home: Home, pack: Pack) -> Envelope | None:
    """Keep a task whose list and files were checked, in place of an earlier one, which is returned
    where it was another one and is not done; raises as `write_pack`."""
    before = _waiting_task(home)
    write_pack(
        home.folder / CARRIED / TASK,
        pack.text,
        pack.signature,
        {name: (pack.files[name], file) for name, file in pack.envelope.files.items()},
    )
    return before if before is not None and before.digest != pack.envelope.digest else None


def _waiting_task(home: Home) -> Envelope | None:
    """The task that was unpacked and has no result yet."""
    place, result = home.folder / CARRIED / TASK, home.folder / CARRIED / RESULT_NAME
    if not has_list(place):
        return None
    try:
        task = open_pack(place, [home.upper.key]).envelope
    except BadInput:
        # Of a node above that had another key.
        return None
    if not result.is_file():
        return task
    answered = parse_json(base64.b64decode(read_json(result, ("text",))["text"]))["answers"]
    return None if answered == task.digest else task


@dataclass(kw_only=True)
class CarriedWay:
    """See `Way`: the one task that was unpacked, and the folder from which its result is packed."""

    home: Home
    say: Callable[[str], None] = lambda text: None
    ended: threading.Event = field(default_factory=threading.Event)
    upper: Invitation = field(init=False)
    counter: int = 1

    def __post_init__(self) -> None:
        self.upper = self.home.upper
        if not has_list(self.home.folder / CARRIED / TASK):
            raise BadInput(f"no task was unpacked at {self.home.folder}: radiant node unpack FOLDER, as {self.upper.upper} packed it.")
        self.pack = open_pack(self.home.folder / CARRIED / TASK, [self.upper.key])

    def enter(self) -> None:
        """A request to join goes with every result."""

    def close(self) -> None:
        """Nothing is open."""

    def poll(self, body: Mapping[str, Any]) -> dict[str, Any]:
        """The task; StageFailed, or BadInput, where it failed."""
        if body["ended"] is not None:
            kind = BadInput if body["ended"]["exit_code"] == BadInput.exit_code else StageFailed
            raise kind(body["ended"]["message"])
        text, signature = (base64.b64encode(data).decode() for data in (self.pack.text, self.pack.signature))
        return {"task": {"text": text, "signature": signature, "tries": 1}, "wait_s": WAIT_S}

    def fetch(self, envelope: Envelope, digest: str, folder: Path) -> None:
        """Copy the files of the task, each with the bytes that were signed."""
        del digest
        for name, file in envelope.files.items():
            target = folder / name
            if not (target.is_file() and target.stat().st_size == file.bytes and file_sha256(target) == file.sha256):
                copy_listed(self.pack.files[name], target, file)

    def send(self, result: Envelope, paths: Mapping[str, Path]) -> None:
        """Nothing more to do: the result is kept, and packed by hand."""
        del paths
        self.say(f"{result.stage}: its result of {result.num_bytes:,} bytes is ready: radiant node pack --out FOLDER.")
        self.ended.set()
