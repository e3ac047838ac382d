"""Signed deliveries: what was sent arrives, all else is refused; only its owner can read a key."""

from __future__ import annotations

import hashlib
import json
import random
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from radiant_core.errors import BadInput
from radiant_core.io.transport.acceptance import Acceptance, Offer
from radiant_core.io.transport.delivery import (
    MAX_ATTEMPT,
    MAX_RECORD_BYTES,
    RECORD_NAME,
    SIGNATURE_NAME,
    Delivery,
    check_files,
    describe_files,
    load_delivery,
    save_delivery,
    verify_delivery,
)
from radiant_core.io.transport.signing import KEY_NAME, PUBLIC_NAME, keeps_modes, load_public_key, load_signing_key, make_signing_key
from tests.app.no_modes import without_modes
from tests.memory_folder import memory_folder

RUN = "0123456789abcdef" * 2
FILES = ("model.safetensors", "cameras.safetensors")


def sent(folder: Path, name: str = "north-1", run: str = RUN, attempt: int = 1, content: bytes = b"model") -> Path:
    """A sender's folder with two files, a key, and a signed record."""
    place = folder / f"{name}-{run[:4]}-{attempt}"
    place.mkdir(parents=True)
    for file in FILES:
        (place / file).write_bytes(content + file.encode())
    make_signing_key(folder / f"{name}-identity")
    delivery = Delivery(
        run=run,
        sender=f"devices/{name}",
        receiver="edges/north",
        kind="device_model",
        attempt=attempt,
        files=describe_files({file: place / file for file in FILES}),
    )
    assert save_delivery(place, delivery, folder / f"{name}-identity") == [RECORD_NAME, SIGNATURE_NAME]
    return place


def taken(folder: Path, public: Path, state: Acceptance) -> tuple[Acceptance, str]:
    """A receiver's checks: signature, files, protocol. Return the next state, and the refusal."""
    try:
        delivery = load_delivery(folder, load_public_key(public))
        check_files(delivery, folder)
    except BadInput as error:
        return state, str(error)
    offer = Offer(
        run=delivery.run,
        receiver=delivery.receiver,
        region=delivery.sender,
        sender=delivery.sender,
        attempt=delivery.attempt,
        digest=delivery.digest,
    )
    state, verdict = state.offer(offer)
    return state, verdict.status


def waiting() -> Acceptance:
    return Acceptance(run=RUN, receiver="edges/north", senders={"devices/north-1": "devices/north-1"})


def test_what_was_sent_arrives_once(tmp_path: Path) -> None:
    place = sent(tmp_path)
    state, status = taken(place, tmp_path / "north-1-identity" / PUBLIC_NAME, waiting())
    assert status == "accepted"
    assert taken(place, tmp_path / "north-1-identity" / PUBLIC_NAME, state) == (state, "duplicate")


def test_equal_files_have_one_digest_whoever_sends_them(tmp_path: Path) -> None:
    places = [sent(tmp_path, "a"), sent(tmp_path, "b", attempt=3), sent(tmp_path, "c", content=b"other")]
    keys = [load_public_key(tmp_path / f"{name}-identity" / PUBLIC_NAME) for name in "abc"]
    digests = [load_delivery(place, key).digest for place, key in zip(places, keys, strict=True)]
    assert digests[0] == digests[1] != digests[2]


def test_a_key_is_made_once_and_only_its_owner_reads_it(tmp_path: Path) -> None:
    assert make_signing_key(tmp_path / "identity")
    key, public = tmp_path / "identity" / KEY_NAME, tmp_path / "identity" / PUBLIC_NAME
    before = key.read_bytes()
    assert key.stat().st_mode & 0o777 == 0o600 and (tmp_path / "identity").stat().st_mode & 0o777 == 0o700
    public.unlink()
    assert not make_signing_key(tmp_path / "identity") and key.read_bytes() == before and public.is_file()
    assert keeps_modes(tmp_path)
    key.chmod(0o640)
    with pytest.raises(BadInput, match=r"can be read by others \(mode 640\): chmod 600"):
        load_signing_key(tmp_path / "identity")


SIGNS = """
import sys
from pathlib import Path
from radiant_core.io.transport.signing import load_signing_key, make_signing_key
folder = Path(sys.argv[1])
print(make_signing_key(folder), make_signing_key(folder), len(load_signing_key(folder).sign(b"x")), len(list(folder.iterdir())))
"""


def test_where_a_disk_keeps_no_modes_a_key_is_taken_as_it_is(tmp_path: Path) -> None:
    command = [sys.executable, "-c", SIGNS, str(tmp_path / "identity")]
    ended = subprocess.run(command, env=without_modes(tmp_path), capture_output=True, text=True, check=False)
    assert ended.stdout == "True False 64 2\n", ended.stderr


def test_what_is_no_key_is_refused_in_one_sentence(tmp_path: Path) -> None:
    from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

    other = X25519PrivateKey.generate()
    private = other.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    public = other.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    for data in (b"", b"no key", private[:60], private, b"x" * 5000):
        (tmp_path / KEY_NAME).write_bytes(data)
        (tmp_path / KEY_NAME).chmod(0o600)
        with pytest.raises(BadInput):
            load_signing_key(tmp_path)
    for data in (b"", b"no key", public, private, b"x" * 5000):
        (tmp_path / "key.pub").write_bytes(data)
        with pytest.raises(BadInput):
            load_public_key(tmp_path / "key.pub")
    with pytest.raises(BadInput):
        load_public_key(tmp_path / "missing.pub")


def test_a_record_that_says_something_else_is_refused_even_when_signed(tmp_path: Path) -> None:
    place = sent(tmp_path)
    right = load_delivery(place, load_public_key(tmp_path / "north-1-identity" / PUBLIC_NAME))
    wrongs = [{"run": "1"}, {"sender": "../x"}, {"sender": "/x"}, {"receiver": ""}, {"attempt": 0}, {"kind": "pickle"}, {"files": {}}]
    for wrong in wrongs:
        with pytest.raises(BadInput):
            replace(right, **wrong)
    more = {**right.files, "../scene.ply": right.files[FILES[0]]}
    with pytest.raises(BadInput, match="has the files"):
        replace(right, files=more)


def test_record_and_signature_are_what_the_format_says(tmp_path: Path) -> None:
    """Written out here, so that another program can be checked against it."""
    place = sent(tmp_path)
    record, signature = (place / RECORD_NAME).read_bytes(), (place / SIGNATURE_NAME).read_bytes()
    load_public_key(tmp_path / "north-1-identity" / PUBLIC_NAME).verify(signature, b"radiant.delivery 1\0" + record)
    files = {file: {"bytes": 5 + len(file), "sha256": hashlib.sha256(b"model" + file.encode()).hexdigest()} for file in FILES}
    whole = {"schema": "radiant.delivery", "version": 1, "run": RUN, "kind": "device_model", "attempt": 1, "files": files}
    assert json.loads(record) == {**whole, "sender": "devices/north-1", "receiver": "edges/north"}


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"schema": "radiant.run"}, "no record of radiant.delivery 1"),
        ({"version": 2}, "no record of radiant.delivery 1"),
        ({"more": 1}, "no record of radiant.delivery 1"),
        ({"run": ...}, "no record of radiant.delivery 1"),
        ({"run": 1}, "has another type"),
        ({"sender": None}, "has another type"),
        ({"receiver": ["cloud"]}, "has another type"),
        ({"kind": 2}, "has another type"),
        ({"attempt": True}, "has another type"),
        ({"attempt": 1.0}, "has another type"),
        ({"attempt": 0}, "is attempt 0, expected 1 to 1000000"),
        ({"attempt": MAX_ATTEMPT + 1}, "is attempt 1000001"),
        ({"files": [{"bytes": 1, "sha256": "a" * 64}]}, "has another type"),
        ({"files": {"model.safetensors": 1}}, "not described by bytes and sha256"),
        ({"files": {"model.safetensors": {"bytes": 1}}}, "not described by bytes and sha256"),
        ({"files": {"model.safetensors": {"bytes": "1", "sha256": "a" * 64}}}, "not described by bytes and sha256"),
        ({"files": {"model.safetensors": {"bytes": 1, "sha256": 5}}}, "not described by bytes and sha256"),
    ],
)
def test_a_signed_record_that_is_none_is_refused_by_the_first_thing_wrong(tmp_path: Path, changed: dict[str, Any], told: str) -> None:
    """The holder of a key may send anything."""
    place = sent(tmp_path)
    key = load_signing_key(tmp_path / "north-1-identity")
    fields = {**json.loads((place / RECORD_NAME).read_bytes()), **changed}
    record = json.dumps({name: value for name, value in fields.items() if value is not ...}).encode()
    with pytest.raises(BadInput, match=told):
        verify_delivery(record, key.sign(b"radiant.delivery 1\0" + record), key.public_key())


@pytest.mark.parametrize("record", [b"[]", b"null", b"7", b"{}", b"{", b""])
def test_signed_bytes_that_are_no_record_are_refused(tmp_path: Path, record: bytes) -> None:
    make_signing_key(tmp_path)
    key = load_signing_key(tmp_path)
    with pytest.raises(BadInput):
        verify_delivery(record, key.sign(b"radiant.delivery 1\0" + record), key.public_key())


def test_limits_of_a_delivery_are_where_they_are_said_to_be(tmp_path: Path) -> None:
    place = sent(tmp_path)
    right = load_delivery(place, load_public_key(tmp_path / "north-1-identity" / PUBLIC_NAME))
    model, other = (right.files[file] for file in FILES)
    for size, passes in ((0, True), (2 * 10**10, True), (-1, False), (2 * 10**10 + 1, False)):
        files = {FILES[0]: replace(model, bytes=size), FILES[1]: other}
        if passes:
            assert replace(right, files=files).files[FILES[0]].bytes == size
        else:
            with pytest.raises(BadInput, match="send it again"):
                replace(right, files=files)
    for attempt in (1, MAX_ATTEMPT):
        assert replace(right, attempt=attempt).attempt == attempt
    for digest in ("a" * 63, "a" * 65, "g" * 64, "A" * 64, "a" * 64 + "\n"):
        with pytest.raises(BadInput, match="hash"):
            replace(right, files={FILES[0]: replace(model, sha256=digest), FILES[1]: other})
    assert replace(right, sender="d" * 255).sender == "d" * 255
    for name in ("d" * 256, " d", "d/../e", "d\0", "d\n"):
        with pytest.raises(BadInput, match="names the node"):
            replace(right, sender=name)
    # What may be there, may be missing; an edge sends no cameras but virtual ones.
    frame = {**right.files, "frame.json": model}
    assert replace(right, files=frame).digest != right.digest
    edge = {"model.safetensors": model, "virtual_cameras.safetensors": other, "frame.json": model}
    for name in ("virtual_cameras.safetensors", "frame.json"):
        replace(right, kind="edge_model", files={other: file for other, file in edge.items() if other != name})
    with pytest.raises(BadInput, match="has the files"):
        replace(right, kind="edge_model", files={name: file for name, file in edge.items() if name != "model.safetensors"})
    with pytest.raises(BadInput, match="has the files"):
        replace(right, kind="edge_model", files={**edge, FILES[1]: other})


def test_no_tampered_or_replayed_upload_is_accepted() -> None:
    # `make stress` tries a hundred thousand.
    with memory_folder() as folder:
        assert tampered_uploads(folder, count=1000, seed=1) == []


def tampered_uploads(folder: Path, count: int, seed: int) -> list[str]:
    """Offer `count` uploads that an attacker without the key can make; return those accepted."""
    place = sent(folder)
    public = folder / "north-1-identity" / PUBLIC_NAME
    other_run = sent(folder, run="f" * 32)
    other_sender = sent(folder, "south-1")
    older = sent(folder, attempt=2, content=b"older")
    whole = {name: (place / name).read_bytes() for name in (*FILES, RECORD_NAME, SIGNATURE_NAME)}
    # All of it right, but signed by another key.
    (folder / "forged").mkdir()
    save_delivery(folder / "forged", load_delivery(place, load_public_key(public)), folder / "south-1-identity")
    rng = random.Random(seed)

    def any_file() -> str:
        return rng.choice(list(whole))

    def flipped(name: str) -> dict[str, bytes]:
        edited = bytearray(whole[name])
        edited[rng.randrange(len(edited))] ^= 1 << rng.randrange(8)
        return {name: bytes(edited)}

    def cut(name: str) -> dict[str, bytes]:
        return {name: whole[name][: rng.randrange(len(whole[name]))]}

    def longer(name: str) -> dict[str, bytes]:
        return {name: whole[name] + rng.randbytes(rng.randrange(1, 9))}

    def edited_record() -> dict[str, bytes]:
        record = json.loads(whole[RECORD_NAME])
        name = rng.choice(["attempt", "run", "receiver", "sender", "kind", "files"])
        edits = {"attempt": rng.randrange(2, 99), "run": f"{rng.getrandbits(128):032x}", "receiver": "cloud", "sender": "devices/x"}
        record[name] = edits.get(name, rng.choice([None, {}, [], "edge_model"]))
        return {RECORD_NAME: json.dumps(record).encode()}

    def of(source: Path, *names: str) -> dict[str, bytes]:
        return {name: (source / name).read_bytes() for name in names}

    signed = (RECORD_NAME, SIGNATURE_NAME)
    attacks: list[Callable[[], dict[str, bytes]]] = [
        lambda: flipped(any_file()),
        lambda: cut(any_file()),
        lambda: longer(any_file()),
        lambda: {SIGNATURE_NAME: rng.randbytes(64)},
        lambda: {RECORD_NAME: b"[" * rng.choice((9, MAX_RECORD_BYTES - 1, MAX_RECORD_BYTES + 1))},
        edited_record,
        lambda: of(folder / "forged", *signed),
        lambda: of(other_run, *signed),
        lambda: of(other_sender, *signed),
        lambda: of(older, RECORD_NAME),
        lambda: of(older, *signed),
        lambda: of(older, FILES[0]),
    ]
    # Of the same files nothing new comes, and what came first is there already.
    state, status = taken(place, public, waiting())
    assert status == "accepted"
    fresh = waiting()
    accepted = []
    for number in range(count):
        attack = rng.randrange(len(attacks))
        changed = attacks[attack]()
        for name, data in changed.items():
            (place / name).write_bytes(data)
        before = state if rng.random() < 0.2 else fresh
        after, status = taken(place, public, before)
        if status == "accepted" or after is not before:
            accepted.append(f"upload {number}, attack {attack}")
        for name in changed:
            (place / name).write_bytes(whole[name])
    # Nothing of it was refused because the receiver was broken.
    assert taken(place, public, fresh)[1] == "accepted"
    return accepted
