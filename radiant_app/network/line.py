"""The way from a node to the one above it: sealed requests outwards, tried until they are answered.

A request that got no answer, or one that nobody signed, is made again with a new counter: every
step may come twice. Waiting doubles up to `MAX_WAIT_S`, by no clock but this process's own. Parts
are halved when one is lost and double again after some that arrive: a slow or broken link loses
little with each. Once per request.
"""

from __future__ import annotations

import base64
import hashlib
import json
import random
import re
import ssl
import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from pydantic import Field

from radiant_app.network.arrivals import PART_BYTES
from radiant_app.network.certificate import pinned_context
from radiant_app.network.home import Home, Invitation
from radiant_app.network.reception import BODY, COUNTER, GONE, JOIN, NODE, OFFSET, REPLY, SEAL
from radiant_app.plain_text import plain_text
from radiant_app.strangers import UntrustedRecord, parse_record
from radiant_core import __version__
from radiant_core.errors import BadInput, StageFailed
from radiant_core.io.run_store import content_key, parse_json, read_json, write_json
from radiant_core.io.transport.delivery import MAX_FILE_BYTES, SentFile
from radiant_core.io.transport.envelope import Envelope, Request, envelope_bytes, sign_envelope
from radiant_core.io.transport.signing import is_signed_by

if TYPE_CHECKING:
    import httpx

JOINED_NAME = "joined.json"
TIMEOUT_S = 20.0
FIRST_WAIT_S, MAX_WAIT_S = 0.25, 10.0
"""The longest is what a node may be late when the one above is there again."""
MIN_PART_BYTES, FIRST_PART_BYTES = 1 << 16, 1 << 19
GROWS_AFTER, MAX_GROWS_AFTER = 4, 32
"""Parts in a row that arrive before the next are twice as long; each that is lost doubles this."""
MAX_ANSWER_BYTES = PART_BYTES + (4 << 20)
"""Longer is no answer of ours: a part of a file, or a task with its verdict."""
MAX_IN_VAIN = 8
"""Parts in a row that arrive and change nothing."""
PASSING = (429, 500, 502, 503, 504, 507)
"""Statuses that another try may not have; the first is of a server with too many requests."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """A signed answer of the node above."""

    status: int
    body: bytes
    headers: Mapping[str, str]

    @property
    def record(self) -> dict[str, Any]:
        """The body as JSON's object; empty where it is none."""
        try:
            content = parse_json(self.body)
        except (ValueError, RecursionError):
            return {}
        return content if isinstance(content, dict) else {}

    @property
    def reason(self) -> str:
        """Why something was refused."""
        return plain_text(str(self.record.get("reason", f"it answered {self.status}."))[:1000])


class _Offsets(UntrustedRecord):
    offsets: tuple[Annotated[int, Field(ge=0, le=MAX_FILE_BYTES)], ...]


class Withdrawn(Exception):
    """The node above waits for this no more."""


@dataclass(kw_only=True)
class Line:
    """Requests of one node to the one above it."""

    home: Home
    ended: threading.Event = field(default_factory=threading.Event)
    """Set to end waiting and trying."""
    say: Callable[[str], None] = lambda text: None
    """Hears when the other side cannot be reached, and when it can again."""
    max_wait_s: float = MAX_WAIT_S
    num_resumed: int = 0
    """Requests that had to be made again."""
    part_bytes: int = FIRST_PART_BYTES
    """Of the next part."""
    _in_a_row: int = 0
    _grows_after: int = GROWS_AFTER
    _trouble: str = "no answer"

    def __post_init__(self) -> None:
        self.upper: Invitation = self.home.upper
        self._key, self._upper_key = self.home.key, self.upper.key
        self._counter, self._beyond = self.home.reserve_counters()
        self._client: httpx.Client | None = None

    def close(self) -> None:
        """End the connection."""
        if self._client is not None:
            self._client.close()
            self._client = None

    def ask(self, method: str, target: str, body: bytes = b"", headers: Mapping[str, str] | None = None) -> Answer:
        """The answer to a request, tried until one comes.

        Raises:
            Withdrawn: nobody waits for it any more, or this process is to end.
            BadInput: it is refused, with the reason of the other side.
        """
        wait_s, troubled = FIRST_WAIT_S, False
        while not self.ended.is_set():
            answer = self.ask_once(method, target, body, headers)
            if answer is not None and answer.status not in PASSING:
                if troubled:
                    self.say(f"{self.upper.upper} answers again.")
                if answer.status == GONE:
                    raise Withdrawn
                return answer
            if wait_s >= 4 * FIRST_WAIT_S and not troubled:
                why = answer.reason if answer is not None else self._trouble
                self.say(f"{self.upper.upper} at {self.upper.url} does not answer ({why}); it is tried again until it does.")
                troubled = True
            self.num_resumed += 1
            # Devices that lost one server do not come back all at once.
            self.ended.wait(wait_s * random.uniform(0.5, 1.0))  # noqa: S311 - no secret
            wait_s = min(2 * wait_s, self.max_wait_s)
        raise Withdrawn

    def ask_once(self, method: str, target: str, body: bytes = b"", headers: Mapping[str, str] | None = None) -> Answer | None:
        """The signed answer to a request; None where none came."""
        import httpx

        digest = hashlib.sha256(body).hexdigest()
        request = Request(node=self.upper.node, counter=self._next_counter(), method=method, target=target, body_sha256=digest)
        sealed = seal_headers(request, self._key)
        seal = sealed[SEAL]
        # Nothing packed: a few bytes of somebody on the way could fill the memory.
        sealed["Accept-Encoding"] = "identity"
        try:
            client = self._client = self._client or self._connect()
            url = self.upper.url.rstrip("/") + target
            with client.stream(method, url, content=body, headers={**sealed, **(headers or {})}) as response:
                status, reply_headers, content = response.status_code, dict(response.headers), b""
                for piece in response.iter_raw():
                    content += piece
                    if len(content) > MAX_ANSWER_BYTES:
                        break
        except (httpx.TransportError, httpx.DecodingError, ssl.SSLError, OSError) as error:
            self._trouble = f"{type(error).__name__}: {error}"[:200]
            self.close()
            return None
        message = request.reply_message(seal, status, reply_headers.get(OFFSET.lower(), ""), content)
        if not is_signed_by(self._upper_key, _decoded(reply_headers.get(REPLY, "")), message):
            # A proxy's own page, or the answer of somebody else.
            self._trouble = f"an answer {status} that is not signed by it"
            self.close()
            return None
        return Answer(status=status, body=content, headers=reply_headers)

    def _connect(self) -> httpx.Client:
        import httpx

        verify: Any = pinned_context(self.upper.certificate.encode()) if self.upper.identity == "pinned" else ssl.create_default_context()
        return httpx.Client(verify=verify, timeout=TIMEOUT_S, http2=False, follow_redirects=False)

    @property
    def counter(self) -> int:
        """That of the next request."""
        return self._counter

    def _next_counter(self) -> int:
        if self._counter >= self._beyond:
            self._counter, self._beyond = self.home.reserve_counters()
        self._counter += 1
        return self._counter - 1

    def enter(self) -> None:
        """Join, unless that was done before by the same invitation; raises as `join`."""
        path, key = self.home.folder / JOINED_NAME, content_key(asdict(self.upper))
        if path.is_file() and read_json(path, ("invitation",))["invitation"] == key:
            return
        self.join()
        write_json(path, {"invitation": key})
        self.say(f"joined {self.upper.upper} as {self.upper.node}.")

    def join(self) -> None:
        """Register this node's key by the word of its invitation; BadInput where it is refused."""
        _accepted(self.ask("POST", JOIN, join_body(self.home)))

    def poll(self, body: Mapping[str, Any]) -> dict[str, Any]:
        """What the node above answers to what this one does; raises as `ask`."""
        return _accepted(self.ask("POST", "/poll", json.dumps(body).encode()))

    def fetch(self, envelope: Envelope, digest: str, folder: Path) -> None:
        """Get the files of a task into a folder, from where an earlier try ended; each takes its
        place once it has the bytes that were signed. Raises as `ask`."""
        for number, (name, file) in enumerate(sorted(envelope.files.items())):
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            if target.is_file() and target.stat().st_size == file.bytes and _sha256(target) == file.sha256:
                continue
            part = target.with_name(f".{target.name}.{file.sha256[:16]}.part")
            for stale in target.parent.glob(f".{target.name}.*.part"):
                if stale != part:
                    stale.unlink()  # of a task that was replaced
            self._fetch_file(f"/tasks/{digest}/{number}", part, file)
            part.replace(target)

    def _fetch_file(self, target: str, part: Path, file: SentFile) -> None:
        for _ in range(2):
            while (have := part.stat().st_size if part.is_file() else 0) < file.bytes:
                wanted = f"bytes={have}-{min(have + self.part_bytes, file.bytes) - 1}"
                answer = self.ask_once("GET", f"{target}?{wanted}", headers={"Range": wanted})
                self._learn(answer)
                if answer is None or answer.status in PASSING:
                    answer = self.ask("GET", f"{target}?{wanted}", headers={"Range": wanted})
                if answer.status == GONE:
                    raise Withdrawn
                if answer.status != 206 or not answer.body:
                    raise BadInput(f"a file of the task cannot be fetched: {answer.reason}")
                with part.open("ab") as out:
                    out.write(answer.body[: file.bytes - have])
            part.touch()
            if _sha256(part) == file.sha256:
                return
            part.unlink()
        raise StageFailed("a file of the task has other bytes than were signed: it was replaced meanwhile.")

    def send(self, result: Envelope, paths: Mapping[str, Path], sent: Callable[[int, int], None] = lambda num_done, total: None) -> None:
        """Announce a result and send its files, each from where the other side has it.

        Args:
            result: its signed list.
            paths: name → file.
            sent: hears bytes that are there, of how many.

        Raises:
            Withdrawn, BadInput: as `ask`.
        """
        text, signature = sign_envelope(result, self._key)
        assert text == envelope_bytes(result)
        files = sorted(result.files.items())
        for _ in range(2):
            offsets = self._announce(result, signature + text)
            if len(offsets) != len(files):
                raise BadInput("the answer to an announcement is none: use the same version of the software on both sides.")
            for number, (name, file) in enumerate(files):
                before = sum(file_of_list.bytes for _, file_of_list in files[:number])
                self._send_file(f"/results/{result.answers}/{number}", paths[name], offsets[number], file.bytes)
                sent(before + file.bytes, result.num_bytes)
            # What arrived with other bytes was dropped there, and is sent once more.
            again = self._announce(result, signature + text)
            if again == tuple(file.bytes for _, file in files):
                self.say(f"{result.stage}: {result.num_bytes:,} bytes are sent.")
                return
        raise BadInput("a result arrived with other bytes than were signed, twice: look at the disk of this machine.")

    def _announce(self, result: Envelope, data: bytes) -> tuple[int, ...]:
        """From where each file of an announced result goes on."""
        answer = _accepted(self.ask("POST", f"/results/{result.answers}", data))
        return parse_record(_Offsets, answer, "the answer to an announcement").offsets

    def _send_file(self, target: str, path: Path, offset: int, num_bytes: int) -> None:
        in_vain = 0
        with path.open("rb") as file:
            while offset < num_bytes and not self.ended.is_set():
                file.seek(offset)
                data = file.read(self.part_bytes)
                headers = {"Tus-Resumable": "1.0.0", OFFSET: str(offset), "Content-Type": "application/offset+octet-stream"}
                answer = self.ask_once("PATCH", f"{target}?offset={offset}", data, headers)
                self._learn(answer)
                if answer is None or answer.status in PASSING:
                    # Which bytes arrived is known there alone.
                    self.num_resumed += 1
                    answer = self.ask("HEAD", target)
                if answer.status == GONE:
                    raise Withdrawn
                before, offset = offset, _offset_in(answer)
                in_vain = 0 if offset != before else in_vain + 1
                if in_vain:
                    self.ended.wait(FIRST_WAIT_S)
                if in_vain > MAX_IN_VAIN and answer.status == 409:
                    raise BadInput("parts of a result arrive and are not taken: look at the disk of the machine above.")

    def _learn(self, answer: Answer | None) -> None:
        """Choose the length of the next part by what became of the last."""
        if answer is None:
            self.part_bytes, self._in_a_row = max(MIN_PART_BYTES, self.part_bytes // 2), 0
            self._grows_after = min(MAX_GROWS_AFTER, 2 * self._grows_after)
            return
        self._in_a_row += 1
        if self._in_a_row >= self._grows_after:
            self.part_bytes, self._in_a_row = min(PART_BYTES, self.part_bytes * 2), 0


def seal_headers(request: Request, key: Ed25519PrivateKey) -> dict[str, str]:
    """The headers that seal a request by its node's key."""
    seal = base64.b64encode(key.sign(request.message())).decode()
    return {NODE: request.node, COUNTER: str(request.counter), SEAL: seal, BODY: request.body_sha256}


def join_body(home: Home) -> bytes:
    """What a node's request to join carries: its public key and the word of its invitation."""
    raw = home.key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)
    body = {"token": home.upper.token, "key": base64.b64encode(raw).decode(), "software": __version__}
    return json.dumps(body).encode()


def _offset_in(answer: Answer) -> int:
    """Where a file goes on, as a signed answer says; BadInput where it says no such thing."""
    offset = answer.headers.get(OFFSET.lower(), "")
    if answer.status not in (200, 409) or not re.fullmatch(r"[0-9]{1,15}", offset):
        raise BadInput(f"a part of a result is refused: {answer.reason}")
    return int(offset)


def _accepted(answer: Answer) -> dict[str, Any]:
    if answer.status != 200:
        raise BadInput(f"{answer.reason}")
    return answer.record


def _decoded(text: str) -> bytes:
    try:
        return base64.b64decode(text, validate=True)
    except ValueError:
        return b""


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
