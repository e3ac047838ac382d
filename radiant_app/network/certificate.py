"""TLS 1.3 pinned to a node's own Ed25519 key, without any authority. Once per process.

A node's certificate is signed by its own key and says nothing else: it has no name and does not
end, so that a wrong clock refuses nobody. Made again from the same key it has the same bytes. Who
joins gets it in the join file and trusts nothing beside it: the handshake proves the key.
"""

from __future__ import annotations

import datetime
import ssl
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

from radiant_core.errors import BadInput
from radiant_core.io.run_store import read_bounded, write_atomic
from radiant_core.io.transport.signing import KEY_NAME, load_signing_key

CERTIFICATE_NAME = "certificate.pem"
MAX_CERTIFICATE_BYTES = 4096
_ALWAYS = (datetime.datetime(1950, 1, 1), datetime.datetime(9999, 12, 31, 23, 59, 59))
"""From before 1970, where a machine begins whose clock has no battery, on."""


def make_certificate(key: Ed25519PrivateKey) -> bytes:
    """The certificate of a key in PEM; equal for equal keys."""
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "radiant node")])
    begin, end = _ALWAYS
    builder = x509.CertificateBuilder(subject_name=name, issuer_name=name, public_key=key.public_key(), serial_number=1)
    builder = builder.not_valid_before(begin).not_valid_after(end)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    return builder.sign(key, None).public_bytes(Encoding.PEM)


def key_of_certificate(pem: bytes) -> Ed25519PublicKey:
    """The key that a certificate is of; BadInput unless it is one that `make_certificate` made."""
    try:
        certificate = x509.load_pem_x509_certificate(pem)
        key = certificate.public_key()
        certificate.verify_directly_issued_by(certificate)
    except (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm, x509.InvalidVersion) as error:
        raise BadInput(f"a certificate cannot be used ({error}): ask for another join file.") from error
    if not isinstance(key, Ed25519PublicKey):
        raise BadInput("a certificate is of another kind of key, expected Ed25519: ask for another join file.")
    return key


def server_context(identity: Path) -> ssl.SSLContext:
    """TLS of a server with the key in `identity`; writes its certificate there."""
    path = identity / CERTIFICATE_NAME
    pem = make_certificate(load_signing_key(identity))
    if not path.is_file() or read_bounded(path, MAX_CERTIFICATE_BYTES) != pem:
        write_atomic(path, pem)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.load_cert_chain(path, identity / KEY_NAME)
    return context


def pinned_context(certificate: bytes) -> ssl.SSLContext:
    """TLS of a client that accepts the holder of this certificate's key, and nobody else."""
    key_of_certificate(certificate)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.check_hostname = False
    context.verify_mode = ssl.CERT_REQUIRED
    context.load_verify_locations(cadata=certificate.decode("ascii"))
    return context
