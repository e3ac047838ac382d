"""What a node answers to those that joined it: pure of sockets, so that tests can ask anything.

    POST /join                       a key for a one-time word
    POST /poll                       what it does and heard; at most one task, a stop, a verdict
    GET  /tasks/DIGEST/NUMBER        a file of its own task, by Range
    POST /results/DIGEST             the signed list of what answers its task
    HEAD, PATCH /results/DIGEST/NUMBER?offset=   a part of one of those files, as tus 1.0 has it

`admit` comes before the body: a request has to be a known node's, sealed by its key, newer than all
before, and not too long, or nothing more of it is read. `answer` then holds the body against the
hash that was sealed. Every step may come again and changes nothing then. Refusals are one sentence.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
import sqlite3
import threading
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any
from urllib.parse import parse_qs

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from pydantic import Field, ValidationError

from radiant_app.network.arrivals import FULL, PART_BYTES, RESERVED, Arrivals, DiskFull
from radiant_app.network.kinds import result_problem
from radiant_app.network.promises import Arriving, Promises
from radiant_app.network.store import OPEN, HubStore, KnownTask
from radiant_app.plain_text import plain_text
from radiant_core import __version__
from radiant_core.errors import BadInput
from radiant_core.io.run_store import parse_json
from radiant_core.io.strict import Strict
from radiant_core.io.transport.delivery import SentFile
from radiant_core.io.transport.envelope import MAX_COUNTER, MAX_ENVELOPE_BYTES, Envelope, Request, open_envelope
from radiant_core.io.transport.signing import is_signed_by

MAX_BODY_BYTES, MAX_JOIN_BYTES = PART_BYTES, 4096
MAX_EVENTS, MAX_EVENT_CHARS = 500, 4000
MAX_RESULT_BYTES = 2 * 10**10
"""Most bytes of one node's result."""
NODE, COUNTER, SEAL, BODY, REPLY = "x-radiant-node", "x-radiant-counter", "x-radiant-seal", "x-radiant-body", "x-radiant-reply"
"""Headers: who asks, by which number, sealed how; the hash of the body; the seal of the answer."""
OFFSET = "Upload-Offset"
JOIN, GONE = "/join", 410
RECEIVED_STATES = ("received", "accepted")
"""States of a task whose result is there: what is asked again about it is answered the same."""
_FILE = re.compile(r"/(tasks|results)/([0-9a-f]{64})(?:/(\d{1,4}))?")
_NODE_ID = re.compile(r"(devices|edges)/[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


class JoinBody(Strict):
    """What `POST /join` carries."""

    token: str = Field(max_length=256)
    key: str = Field(max_length=64)
    software: str = Field(min_length=1, max_length=64)


class Ended(Strict):
    """That a node's work ended without a result."""

    message: str = Field(max_length=4000)
    exit_code: int = Field(ge=0, le=255)
    crashed: bool
    cannot_write: bool


class PollBody(Strict):
    """What `POST /poll` carries."""

    software: str = Field(min_length=1, max_length=64)
    task: str = Field(max_length=64)
    """Digest of the task that it works on; empty for none."""
    tries: int = Field(ge=0)
    doing: str = Field(max_length=80)
    ended: Ended | None
    batch: int = Field(ge=0, le=MAX_COUNTER)
    events: list[str] = Field(max_length=MAX_EVENTS)


@dataclass(frozen=True, kw_only=True)
class Reply:
    """An answer; `headers` are beside those of the signature."""

    status: int
    body: bytes = b""
    headers: Mapping[str, str] = field(default_factory=dict)


class Refused(Exception):
    """Why a request is refused, with its status."""

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status, self.reason = status, plain_text(reason)


@dataclass(frozen=True, kw_only=True)
class HttpRequest:
    """A request as it came."""

    method: str
    target: str
    headers: Mapping[str, str]
    """By names in lower case."""
    body: bytes = b""
    """Empty before it was read."""


@dataclass(frozen=True, kw_only=True)
class NodeMessage:
    """What a node said of its task, for who conducts."""

    digest: str
    events: tuple[str, ...] = ()
    is_taken: bool = False
    ended: Ended | None = None
    received: bool = False


@dataclass(kw_only=True)
class Reception:
    """Answers requests for one node."""

    node: str
    key: Ed25519PrivateKey
    store: HubStore
    arrivals: Arrivals
    heard: Callable[[NodeMessage], None] = lambda message: None
    """Called with what a node says, in any thread."""
    poll_s: float = 2.0
    """How long nodes wait between two polls."""
    heard_of: dict[str, int] = field(default_factory=dict)
    """Node → how many of its requests were admitted by this process."""
    promises: Promises = field(default_factory=Promises)
    _announcing: threading.Lock = field(default_factory=threading.Lock)
    _writing: dict[str, threading.Lock] = field(default_factory=dict)
    """Of each task that is written to: one result is checked while others go on to arrive."""

    def admit(self, http_request: HttpRequest) -> Reply | None:
        """The signed refusal of a request whose body was not read; None where it may come."""
        return self._guarded(http_request, self._admit)

    def answer(self, http_request: HttpRequest) -> Reply:
        """The signed answer to an admitted request with its body."""
        reply = self._guarded(http_request, self._answer_admitted)
        assert reply is not None
        return reply

    def _guarded(self, http_request: HttpRequest, act: Callable[[Request, HttpRequest], Reply | None]) -> Reply | None:
        request = Request(node="", counter=0, method="", target="", body_sha256="")
        try:
            request = _request_of(http_request)
            reply = act(request, http_request)
        except Refused as refused:
            reply = _json(refused.status, {"reason": refused.reason})
        except BadInput as error:
            reply = _json(400, {"reason": plain_text(str(error))})
        except DiskFull as error:
            reply = _json(507, {"reason": str(error)})
        except (OSError, sqlite3.Error) as error:
            # The owner of that machine is told by its own commands; who asks tries again.
            reply = _json(503, {"reason": f"{self.node} cannot use its folder ({_problem(error)}): it is tried again."})
        if reply is None:
            return None
        if http_request.method == "HEAD":
            reply = replace(reply, body=b"")
        message = request.reply_message(http_request.headers.get(SEAL, ""), reply.status, reply.headers.get(OFFSET, ""), reply.body)
        return replace(reply, headers={**reply.headers, REPLY: _text(self.key.sign(message))})

    def _admit(self, request: Request, http_request: HttpRequest) -> None:
        """Refuse what is not a member's, not sealed by its key, not new, or too long."""
        length, most = http_request.headers.get("content-length", "0"), MAX_JOIN_BYTES if http_request.target == JOIN else MAX_BODY_BYTES
        if "transfer-encoding" in http_request.headers or not re.fullmatch(r"\d{1,12}", length) or int(length) > most:
            raise Refused(413, f"a request's body is of length {length[:20]}, expected one that is said and at most {most}.")
        key = self._key_of(request)
        if http_request.target == JOIN:
            return  # the key that seals it stands in its body
        _require_seal(request, http_request, key)
        if not self.store.count(request.node, request.counter):
            refused = _not_new(request.node)
            self.store.note(request.node, f"refused: {refused.reason}")
            raise refused
        self.heard_of[request.node] = self.heard_of.get(request.node, 0) + 1

    def _key_of(self, request: Request) -> Ed25519PublicKey | None:
        member = self.store.member(request.node)
        if member is None or member.revoked:
            raise Refused(403, f"{request.node} is not known here, or no longer: ask for another join file.")
        return member.key

    def _answer_admitted(self, request: Request, http_request: HttpRequest) -> Reply:
        if hashlib.sha256(http_request.body).hexdigest() != request.body_sha256:
            # As of a bad gateway, after which it is asked again.
            raise Refused(502, f"a request of {request.node} arrived with another body than was sealed.")
        # It may have been revoked, or have asked anew, while the body came.
        key = self._key_of(request)
        if http_request.target == JOIN:
            _require_seal(request, http_request, _joining_key(http_request))
        elif key is None or self.store.last_counter(request.node) != request.counter:
            raise _not_new(request.node)
        try:
            return self._answer_node(request, http_request)
        except Refused as refused:
            # A request to join is sealed by whoever makes it.
            proved = http_request.target != JOIN or (key is not None and key == _joining_key(http_request))
            if key is not None and proved and refused.status != GONE:
                self.store.note(request.node, f"refused: {refused.reason}")
            raise

    def _answer_node(self, request: Request, http_request: HttpRequest) -> Reply:
        place = (http_request.method, http_request.target.partition("?")[0])
        if place == ("POST", JOIN):
            return self._join(request, http_request)
        if place == ("POST", "/poll"):
            return self._poll(request.node, http_request.body)
        match = _FILE.fullmatch(place[1])
        if match is not None:
            kind, digest, number = match.groups()
            task = self.own_task(request.node, digest, RECEIVED_STATES if kind == "results" else ())
            if (http_request.method, kind) == ("GET", "tasks") and number is not None:
                return _part_of_file(task, int(number), http_request)
            if (http_request.method, kind) == ("POST", "results") and number is None:
                return self.announce(task, http_request.body)
            if http_request.method in ("HEAD", "PATCH") and kind == "results" and number is not None:
                return self._upload(task, int(number), http_request)
        raise Refused(404, f"{http_request.method} {http_request.target[:80]} is nothing that is answered here.")

    def _join(self, request: Request, http_request: HttpRequest) -> Reply:
        body = _parsed(JoinBody, http_request.body)
        if not self.store.join(request.node, body.token, _decoded(body.key), plain_text(body.software), request.counter):
            raise Refused(403, f"the join file of {request.node} is used up or not the newest: ask for another one.")
        return _json(200, {"node": request.node})

    def _poll(self, node: str, data: bytes) -> Reply:
        body = _parsed(PollBody, data)
        if any(len(line) > MAX_EVENT_CHARS for line in body.events):
            raise Refused(400, f"an event of {node} is longer than {MAX_EVENT_CHARS} characters.")
        self.store.note(node, plain_text(body.doing), plain_text(body.software))
        reported_task = self.store.task(body.task)
        answer: dict[str, Any] = {"verdict": None, "task": None, "wait_s": self.poll_s}
        if reported_task is not None and reported_task.node == node:
            if reported_task.tries == body.tries and self.store.take_batch(node, body.batch):
                self._hear(reported_task, body)
            reported_task = self.store.task(body.task)
            assert reported_task is not None
            answer["verdict"] = {"state": reported_task.state, "reason": reported_task.reason, "tries": reported_task.tries}
        task = self.store.open_task(node)
        if task is not None and body.software != __version__:
            reason = f"this node has Radiant {body.software} and {self.node} has {__version__}: install the same version."
            raise Refused(409, reason)
        if task is not None:
            # A result that was refused is asked for once more: the node is to make it anew.
            refused = task.state == "offered" and task.reason != ""
            answer["task"] = {"text": _text(task.text), "signature": _text(task.signature), "tries": task.tries, "refused": refused}
        return _json(200, answer)

    def _hear(self, task: KnownTask, body: PollBody) -> None:
        is_taken = self.store.move_task(task.digest, "taken", ("offered",))
        if task.state not in OPEN:
            return
        ended = body.ended if body.ended is not None and self.store.move_task(task.digest, "failed", ("taken",)) else None
        ended = ended and ended.model_copy(update={"message": plain_text(ended.message)})
        self.heard(NodeMessage(digest=task.digest, events=tuple(body.events), is_taken=is_taken, ended=ended))

    def own_task(self, node: str, digest: str, also: Collection[str] = ()) -> KnownTask:
        """The node's task with this digest, open or in one of the states `also`; raises Refused."""
        task = self.store.task(digest)
        if task is None or task.node != node:
            raise Refused(404, f"{node} has no such task.")
        if task.state not in {*OPEN, *also}:
            raise Refused(GONE, f"the task is {task.state}{f': {task.reason}' if task.reason else ', nobody waits for it any more.'}")
        return task

    def announce(self, task: KnownTask, data: bytes) -> Reply:
        """Take the signed list of a result's files (signature, then text), or repeat what is there
        of them. Raises Refused, BadInput, DiskFull."""
        signature, text = data[:64], data[64:]
        member = self.store.member(task.node)
        if len(data) > MAX_ENVELOPE_BYTES or member is None or member.key is None:
            raise Refused(413, f"an announcement has {len(data)} bytes, expected at most {MAX_ENVELOPE_BYTES}.")
        envelope = open_envelope(text, signature, member.key)
        task_envelope = _asked_by(task)
        if problem := _result_problem(envelope, task_envelope, task):
            raise Refused(409, problem)
        with self._lock_of(task):
            before, state = self.store.result(task.digest), self.own_task(task.node, task.digest, RECEIVED_STATES).state
            if state not in RECEIVED_STATES:
                with self._announcing:
                    offsets = self._begin(task, envelope, anew=before is not None and before[0] != text)
                    self.store.put_result(task.digest, text, signature)
                    self.promises.announced(task.digest, sum(offsets))
            elif before is not None and before[0] == text:
                offsets = [file.bytes for _, file in sorted(envelope.files.items())]
            else:
                raise Refused(409, "another result of this task was received first.")
            self._finish(task, envelope)
        return _json(200, {"offsets": offsets})

    def _upload(self, task: KnownTask, number: int, http_request: HttpRequest) -> Reply:
        part = (_offset_of(http_request), http_request.body) if http_request.method == "PATCH" else None
        fitted, offset, file = self.take_part(task, number, part)
        headers = {"Tus-Resumable": "1.0.0", OFFSET: str(offset), "Upload-Length": str(file.bytes), "Cache-Control": "no-store"}
        body = b"" if http_request.method == "HEAD" else json.dumps({"offset": offset}).encode()
        return Reply(status=200 if fitted else 409, body=body, headers=headers)

    def take_part(self, task: KnownTask, number: int, part: tuple[int, bytes] | None) -> tuple[bool, int, SentFile]:
        """Take a part, its offset and bytes, of an announced file: whether it fitted, where the
        file goes on, and its entry in the list. None only asks. Raises Refused, DiskFull."""
        result = self.store.result(task.digest)
        member = self.store.member(task.node)
        if result is None or member is None or member.key is None:
            raise Refused(409, "the files of a result come after its announcement.")
        envelope = open_envelope(*result, member.key)
        if number >= len(envelope.files):
            raise Refused(404, f"the announcement lists {len(envelope.files)} files, there is no number {number}.")
        _, file = sorted(envelope.files.items())[number]
        with self._lock_of(task):
            fitted, state = True, self.own_task(task.node, task.digest, RECEIVED_STATES).state
            if part is not None and state not in RECEIVED_STATES:
                fitted = self._append(task, number, part, file)
                self._finish(task, envelope)
            offset = file.bytes if self._state(task) in RECEIVED_STATES else self.arrivals.offsets(task.digest, envelope)[number]
        return fitted, offset, file

    def _lock_of(self, task: KnownTask) -> threading.Lock:
        return self._writing.setdefault(task.digest, threading.Lock())

    def _begin(self, task: KnownTask, envelope: Envelope, *, anew: bool) -> list[int]:
        reserved_bytes = self.promises.reserved_bytes(task.digest, task.node, self._arriving(), self.arrivals.free_bytes)
        return self.arrivals.begin(task.digest, envelope, anew=anew, promised=reserved_bytes)

    def _append(self, task: KnownTask, number: int, part: tuple[int, bytes], file: SentFile) -> bool:
        arriving, free = self._arriving(), self.arrivals.free_bytes
        if not self.promises.may_grow(task.digest, len(part[1]), arriving, free):
            raise DiskFull(RESERVED if all(result.missing_bytes <= free for result in arriving if result.task == task.digest) else FULL)
        fitted = self.arrivals.append(task.digest, number, *part, file) is not None
        self.promises.arrived(task.digest, self.arrivals.num_bytes(task.digest))
        return fitted

    def _arriving(self) -> list[Arriving]:
        """What was announced and is not whole."""
        lists = [(task, parse_json(text)) for task, text in self.store.open_results()]
        arriving = [
            Arriving(
                task=task,
                member=listed["sender"],
                num_bytes=sum(file["bytes"] for file in listed["files"].values()),
                arrived_bytes=self.arrivals.num_bytes(task),
            )
            for task, listed in lists
        ]
        self.promises.forget_all_but(arriving)
        return arriving

    def _state(self, task: KnownTask) -> str:
        stored = self.store.task(task.digest)
        return "" if stored is None else stored.state

    def _finish(self, task: KnownTask, envelope: Envelope) -> None:
        """Mark a result as received where its files are whole; wrong ones come once more."""
        if self._state(task) in ("offered", "taken") and self.arrivals.damaged(task.digest, envelope) == []:
            self.store.move_task(task.digest, "received", ("offered", "taken"))
            self.heard(NodeMessage(digest=task.digest, received=True))


def _request_of(http_request: HttpRequest) -> Request:
    node, counter = http_request.headers.get(NODE, ""), http_request.headers.get(COUNTER, "")
    if not _NODE_ID.fullmatch(node) or not re.fullmatch(r"[1-9]\d{0,18}", counter) or int(counter) > MAX_COUNTER:
        raise Refused(400, "a request names no node and no counter: this is the door of a Radiant node, see docs/network.md.")
    if not re.fullmatch("[0-9a-f]{64}", http_request.headers.get(BODY, "")):
        raise Refused(400, f"a request of {node} does not say the hash of its body: use the same version on both sides.")
    return Request(
        node=node, counter=int(counter), method=http_request.method, target=http_request.target, body_sha256=http_request.headers[BODY]
    )


def _require_seal(request: Request, http_request: HttpRequest, key: Ed25519PublicKey | None) -> None:
    if key is None:
        raise Refused(403, f"{request.node} has not joined: radiant node join FILE.")
    if not is_signed_by(key, _decoded(http_request.headers.get(SEAL, "")), request.message()):
        raise Refused(403, f"a request of {request.node} is not sealed by its key: if it was made anew, ask for another join file.")


def _problem(error: OSError | sqlite3.Error) -> str:
    return str(error.strerror or error) if isinstance(error, OSError) else str(error)


def _not_new(node: str) -> Refused:
    return Refused(
        409,
        f"a request of {node} is not new: another process uses its key, or its folder was restored from a copy; end the "
        "one, or ask for another join file.",
    )


def _joining_key(http_request: HttpRequest) -> Ed25519PublicKey:
    """The key that a node joins by, which its request has to be sealed with."""
    data = _decoded(_parsed(JoinBody, http_request.body).key)
    if len(data) != 32:
        raise Refused(400, f"a key has {len(data)} bytes, expected 32.")
    return Ed25519PublicKey.from_public_bytes(data)


def _asked_by(task: KnownTask) -> Envelope:
    record = parse_json(task.text)
    names = ("run", "sender", "receiver", "kind", "stage", "attempt", "software")
    return Envelope(**{name: record[name] for name in names}, answers="", files={})


def _result_problem(envelope: Envelope, task_envelope: Envelope, task: KnownTask) -> str | None:
    """Why a result does not answer a task, one sentence."""
    ends = (envelope.run, envelope.sender, envelope.receiver) == (task_envelope.run, task_envelope.receiver, task_envelope.sender)
    work = (envelope.kind, envelope.stage, envelope.attempt) == (task_envelope.kind, task_envelope.stage, task_envelope.attempt)
    if not ends or not work or envelope.answers != task.digest:
        return "a result answers another task than the one that it was sent for."
    if envelope.software != task_envelope.software:
        return f"the result was made by Radiant {envelope.software} and asked for by {task_envelope.software}: install the same version."
    if envelope.num_bytes > MAX_RESULT_BYTES:
        return f"a result has {envelope.num_bytes:,} bytes, expected at most {MAX_RESULT_BYTES:,}."
    return result_problem(envelope.kind, envelope.files)


def _part_of_file(task: KnownTask, number: int, http_request: HttpRequest) -> Reply:
    """At most `PART_BYTES` of a task's file: the bytes that the sealed target names, and Range
    again."""
    files = sorted(parse_json(task.text)["files"].items())
    match = re.fullmatch(r"bytes=(\d{1,15})-(\d{1,15})", http_request.headers.get("range", ""))
    if number >= len(files) or match is None or http_request.target.partition("?")[2] != f"bytes={match[1]}-{match[2]}":
        raise Refused(404, f"the task has {len(files)} files; bytes=FIRST-LAST stands in the target and as Range.")
    name, about = files[number]
    first, last = int(match[1]), int(match[2])
    last = min(last, first + PART_BYTES - 1, about["bytes"] - 1)
    try:
        with (task.folder / name).open("rb") as file:
            file.seek(first)
            data = file.read(max(0, last - first + 1))
    except (FileNotFoundError, NotADirectoryError):
        data = b""
    if len(data) < last - first + 1:
        reason = f"{name} of the task {task.stage} is not there any more, or not whole: run it again there with --resume."
        raise Refused(404, reason)
    return Reply(status=206, body=data, headers={"Content-Range": f"bytes {first}-{first + len(data) - 1}/{about['bytes']}"})


def _offset_of(http_request: HttpRequest) -> int:
    """Where a part begins, as the sealed target says and tus's header repeats."""
    values = parse_qs(http_request.target.partition("?")[2]).get("offset", [])
    header = http_request.headers.get(OFFSET.lower(), "")
    if len(values) != 1 or not re.fullmatch(r"\d{1,15}", values[0]) or header != values[0]:
        raise Refused(400, "a part says no offset, once in its target and once as Upload-Offset.")
    if http_request.headers.get("content-type") != "application/offset+octet-stream":
        raise Refused(415, "a part is application/offset+octet-stream, as tus 1.0 has it.")
    return int(values[0])


def _parsed(kind: type[Any], data: bytes) -> Any:
    try:
        return kind.model_validate_json(data)
    except ValidationError as error:
        problem = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, problem["loc"]))
        reason = f"a request's {where or 'body'} cannot be used ({problem['msg']}): use the same version on both sides."
        raise Refused(400, reason) from None


def _decoded(text: str) -> bytes:
    try:
        return base64.b64decode(text, validate=True)
    except ValueError:
        return b""


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _json(status: int, record: Any) -> Reply:
    return Reply(status=status, body=json.dumps(record).encode(), headers={"Content-Type": "application/json"})
