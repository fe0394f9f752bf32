"""Signed statements: envelopes of DSSE with an Ed25519 signature, and the keys that make and check them.

An envelope (https://github.com/secure-systems-lab/dsse, protocol 1.0.0) has the statement in base64 and a signature
(RFC 8032) over type, length and bytes of the statement.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    PublicFormat,
    load_pem_private_key,
    load_pem_public_key,
)

from service.errors import ResultError, shown
from service.trust.errors import TrustError

MAX_FILE_BYTES = 4 * 2**20
MAX_SIGNATURES = 10
_FORBIDDEN_MODE = 0o027  # the group may read, as for mounted secrets
_EXPECTED_PRIVATE = "expected an unencrypted Ed25519 private key in PEM; `openssl genpkey -algorithm ed25519` makes one"
_EXPECTED_PUBLIC = "expected an Ed25519 public key in PEM; `openssl pkey -in PRIVATE_KEY -pubout` writes it"


class SigningKey:
    """Ed25519 key that signs statements.

    Args:
        path: unencrypted private key (PEM, PKCS 8), as ``openssl genpkey -algorithm ed25519`` writes it.

    Raises:
        TrustError: it is no such key, or others may read it.
    """

    def __init__(self, path: Path) -> None:
        try:
            key = load_pem_private_key(_read(path), password=None)
        except (ValueError, TypeError, UnsupportedAlgorithm):
            raise TrustError(f"{path}: {_EXPECTED_PRIVATE}") from None
        if not isinstance(key, Ed25519PrivateKey):
            raise TrustError(f"{path}: {_EXPECTED_PRIVATE}")
        if path.stat().st_mode & _FORBIDDEN_MODE:
            raise TrustError(f"{path}: others may read the private key; run chmod 600")
        self._key = key
        self.key_id = key_id(key.public_key())

    def seal(self, payload_type: str, statement: Mapping[str, Any]) -> bytes:
        """Return the envelope of a statement."""
        payload = json.dumps(statement, sort_keys=True).encode()
        signature = self._key.sign(_encode(payload_type, payload))
        envelope = {
            "payloadType": payload_type,
            "payload": base64.b64encode(payload).decode(),
            "signatures": [{"keyid": self.key_id, "sig": base64.b64encode(signature).decode()}],
        }
        return json.dumps(envelope).encode()


@dataclass(frozen=True)
class Envelope:
    """A statement with its signatures, not yet checked."""

    payload_type: str
    payload: bytes
    signatures: tuple[bytes, ...]
    key_ids: tuple[str, ...]

    def open(self, payload_type: str, key: Ed25519PublicKey, name: str) -> dict[str, Any]:
        """Return the statement that the key has signed.

        Raises:
            ResultError: it is of another type, none of its signatures is the key's, or it is no object.
        """
        if self.payload_type != payload_type:
            raise ResultError(f"{name}: payloadType is {shown(self.payload_type)}; expected {payload_type!r}")
        signed = _encode(payload_type, self.payload)
        if not any(_is_signed(key, signature, signed) for signature in self.signatures):
            raise ResultError(f"{name}: is not signed by the trusted key {key_id(key)}")
        statement = json.loads(self.payload)
        if not isinstance(statement, dict):
            raise ResultError(f"{name}: holds no statement")
        return statement


def read_envelope(content: bytes, name: str) -> Envelope:
    """Read an envelope; its statement may be anybody's until it is opened with a key.

    Raises:
        ResultError: it is malformed; the message calls it ``name``.
    """
    try:
        data = json.loads(content)
        signatures = data["signatures"][:MAX_SIGNATURES]
        return Envelope(
            payload_type=data["payloadType"],
            payload=base64.b64decode(data["payload"], validate=True),
            signatures=tuple(base64.b64decode(entry["sig"], validate=True) for entry in signatures),
            key_ids=tuple(str(entry.get("keyid", "")) for entry in signatures),
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, binascii.Error):
        raise ResultError(f"{name}: is no signed statement") from None


def read_public_key(path: Path) -> Ed25519PublicKey:
    """Read a trusted public key (PEM), as ``openssl pkey -pubout`` writes it.

    Raises:
        TrustError: it is no Ed25519 public key.
    """
    try:
        key = load_pem_public_key(_read(path))
    except (ValueError, TypeError, UnsupportedAlgorithm):
        raise TrustError(f"{path}: {_EXPECTED_PUBLIC}") from None
    if not isinstance(key, Ed25519PublicKey):
        raise TrustError(f"{path}: {_EXPECTED_PUBLIC}")
    return key


def key_id(key: Ed25519PublicKey) -> str:
    """Return the first half of the sha256 of the raw public key."""
    return hashlib.sha256(key.public_bytes(Encoding.Raw, PublicFormat.Raw)).hexdigest()[:32]


def _encode(payload_type: str, payload: bytes) -> bytes:
    """Return the signed bytes: DSSE's pre-authentication encoding."""
    return b"DSSEv1 %d %s %d %s" % (len(payload_type), payload_type.encode(), len(payload), payload)


def _is_signed(key: Ed25519PublicKey, signature: bytes, signed: bytes) -> bool:
    try:
        key.verify(signature, signed)
    except InvalidSignature:
        return False
    return True


def _read(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(MAX_FILE_BYTES)
    except OSError as error:
        raise TrustError(f"{path}: cannot be read ({error.strerror})") from None
