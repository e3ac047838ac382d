"""Ed25519 keys of senders, as PEM files; the public one is registered with the receiver.

    <sender>/identity/signing_key.pem    private, PKCS 8, mode 0600; made once, never copied
    <sender>/identity/signing_key.pub    public; its copy <receiver>/senders/<sender>.pub registers

Once per sender and run. Scheme: RFC 8032, from the package cryptography.
"""

from __future__ import annotations

import os
import secrets
import stat
from pathlib import Path

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)

from radiant_core.errors import BadInput
from radiant_core.io.run_store import atomic_path, read_bounded, write_atomic

KEY_NAME, PUBLIC_NAME = "signing_key.pem", "signing_key.pub"
SIGNATURE_BYTES = 64
MAX_KEY_BYTES = 4096
OTHERS = 0o077
"""Rights of everybody but a file's owner."""


def make_signing_key(folder: Path) -> bool:
    """Make a key pair in `folder` (made with mode 0700); False where there is one, which stays.
    BadInput when it cannot be written."""
    private, public = folder / KEY_NAME, folder / PUBLIC_NAME
    if private.exists():
        write_atomic(public, _public_pem(load_signing_key(folder)))
        return False
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"cannot make {folder}: {error.strerror}: choose a folder that can be written.") from error
    key = Ed25519PrivateKey.generate()
    with atomic_path(private) as temporary, open(temporary, "xb", opener=lambda path, flags: os.open(path, flags, 0o600)) as file:
        file.write(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    write_atomic(public, _public_pem(key))
    return True


def load_signing_key(folder: Path) -> Ed25519PrivateKey:
    """The private key that `make_signing_key` left; BadInput where it is missing, no such key, or
    others than its owner may read it, which only a file system without modes excuses."""
    path = folder / KEY_NAME
    data = read_bounded(path, MAX_KEY_BYTES)
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & OTHERS and keeps_modes(folder):
        raise BadInput(f"{path} can be read by others (mode {mode:o}): chmod 600 it, or remove it for a new one and register that.")
    try:
        key = load_pem_private_key(data, None)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise BadInput(f"{path} holds no private key in PEM: remove it for a new one and register that.") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise BadInput(f"{path} holds another kind of key, expected Ed25519: remove it for a new one and register that.")
    return key


def keeps_modes(folder: Path) -> bool:
    """Whether a private file in `folder` stays so; NTFS, exFAT and many network drives do not."""
    probe = folder / f".mode-{secrets.token_hex(4)}"
    try:
        os.close(os.open(probe, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
        try:
            return not stat.S_IMODE(probe.stat().st_mode) & OTHERS
        finally:
            probe.unlink()
    except OSError:
        # Where nothing can be written: a key that others may read is then refused.
        return True


def load_public_key(path: Path) -> Ed25519PublicKey:
    """A sender's public key; BadInput where it is missing or no Ed25519 key in PEM."""
    data = read_bounded(path, MAX_KEY_BYTES)
    try:
        key = load_pem_public_key(data)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise BadInput(f"{path} holds no public key in PEM: register the sender's {PUBLIC_NAME} again.") from error
    if not isinstance(key, Ed25519PublicKey):
        raise BadInput(f"{path} holds another kind of key, expected Ed25519: register the sender's {PUBLIC_NAME} again.")
    return key


def is_signed_by(key: Ed25519PublicKey, signature: bytes, message: bytes) -> bool:
    """Whether the holder of `key` signed exactly this message."""
    try:
        key.verify(signature, message)
    except InvalidSignature:
        return False
    return True


def _public_pem(key: Ed25519PrivateKey) -> bytes:
    return key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
