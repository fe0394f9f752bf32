"""Signed approvals: a statement about an accepted plan, and its check without the server.

``approval.json`` is an envelope of DSSE (https://github.com/secure-systems-lab/dsse, protocol 1.0.0): the statement in
base64 and an Ed25519 signature (RFC 8032) over type, length and bytes of the statement.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
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
from service.result.folder import APPROVAL_NAME
from service.trust.errors import TrustError

FORMAT = "scopt-approval/1"
PAYLOAD_TYPE = "application/vnd.scopt.approval+json"
MAX_FILE_BYTES = 4 * 2**20
_FORBIDDEN_MODE = 0o027  # the group may read, as for mounted secrets
_CHUNK_BYTES = 2**20


@dataclass(frozen=True)
class Approval:
    """Statement about an accepted plan.

    Attributes:
        plan_id: id of the plan on its server.
        verdict: verdict of the plan.
        reviewer: who accepted it.
        comment: the reviewer's comment.
        approved_at: [s since 1970].
        request_sha256: hash of the request's canonical form.
        trajectory_sha256, certificate_sha256: as in the messages ``Trajectory`` and ``Certificate``.
        page_sha256: hash of ``viewer.html``; empty for a plan without files.
        files: hash of every file in the result folder, by path; empty for a plan without files.
    """

    plan_id: str
    verdict: str
    reviewer: str
    comment: str
    approved_at: float
    request_sha256: str
    trajectory_sha256: str
    certificate_sha256: str
    page_sha256: str
    files: Mapping[str, str]


class Signer:
    """Ed25519 key of a server.

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
        self.key_id = _key_id(key.public_key())

    def sign(self, approval: Approval) -> bytes:
        """Return the content of ``approval.json``."""
        statement = json.dumps({"format": FORMAT, **asdict(approval)}, sort_keys=True).encode()
        signature = self._key.sign(_encode(statement))
        envelope = {
            "payloadType": PAYLOAD_TYPE,
            "payload": base64.b64encode(statement).decode(),
            "signatures": [{"keyid": self.key_id, "sig": base64.b64encode(signature).decode()}],
        }
        return json.dumps(envelope).encode()


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


def open_approval(envelope: bytes, key: Ed25519PublicKey) -> Approval:
    """Return the statement of an envelope that the key has signed.

    Raises:
        ResultError: the envelope is malformed, or none of its signatures is the key's.
    """
    try:
        data = json.loads(envelope)
        statement = base64.b64decode(data["payload"], validate=True)
        signatures = [base64.b64decode(entry["sig"], validate=True) for entry in data["signatures"]]
        payload_type = data["payloadType"]
    except (ValueError, KeyError, TypeError, RecursionError, binascii.Error):
        raise ResultError(f"{APPROVAL_NAME}: is no signed approval") from None
    if payload_type != PAYLOAD_TYPE:
        raise ResultError(f"{APPROVAL_NAME}: payloadType is {shown(payload_type)}; expected {PAYLOAD_TYPE!r}")
    if not any(_is_signed(key, signature, statement) for signature in signatures[:10]):
        raise ResultError(f"{APPROVAL_NAME}: is not signed by the trusted key {_key_id(key)}")
    return _read_statement(statement)


def check_approval(folder: Path, key: Ed25519PublicKey) -> Approval:
    """Return the approval of a result folder in which every file is the approved one.

    Raises:
        ResultError: there is no approval, or it is not signed by the key; or a file differs, is missing, or is not
            part of what was approved.
    """
    path = folder / APPROVAL_NAME
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ResultError(f"{path} has more than {MAX_FILE_BYTES} bytes")
        envelope = path.read_bytes()
    except OSError:
        raise ResultError(
            f"{folder}: there is no {APPROVAL_NAME}; an approved plan of a server with --sign-key has one "
            "(`scopt review PLAN_ID --out FOLDER`)"
        ) from None
    try:
        approval = open_approval(envelope, key)
    except ResultError as error:
        raise ResultError(f"{folder}: {error}") from None
    if not approval.files:
        raise ResultError(f"{folder}: the approval names no files; the plan was made without any")
    there = {
        path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir() or path.is_symlink()
    }
    problems = [f"{name} is missing" for name in sorted(set(approval.files) - there)]
    problems += [
        f"{name} is not part of what was approved" for name in sorted(there - {*approval.files, APPROVAL_NAME})
    ]
    for name in sorted(there & set(approval.files)):
        if (folder / name).is_symlink() or _hash_file(folder / name) != approval.files[name]:
            problems.append(f"{name} is not the approved one")
    if problems:
        raise ResultError("\n".join(f"{folder}: {problem}" for problem in problems[:10]))
    return approval


_EXPECTED_PRIVATE = "expected an unencrypted Ed25519 private key in PEM; `openssl genpkey -algorithm ed25519` makes one"
_EXPECTED_PUBLIC = "expected an Ed25519 public key in PEM; `openssl pkey -in PRIVATE_KEY -pubout` writes it"


def _encode(statement: bytes) -> bytes:
    """Return the signed bytes: DSSE's pre-authentication encoding."""
    return b"DSSEv1 %d %s %d %s" % (len(PAYLOAD_TYPE), PAYLOAD_TYPE.encode(), len(statement), statement)


def _is_signed(key: Ed25519PublicKey, signature: bytes, statement: bytes) -> bool:
    try:
        key.verify(signature, _encode(statement))
    except InvalidSignature:
        return False
    return True


def _read_statement(statement: bytes) -> Approval:
    """Read a signed statement."""
    data: dict[str, Any] = json.loads(statement)
    if data.pop("format", None) != FORMAT:
        raise ResultError(f"{APPROVAL_NAME}: expected the format {FORMAT!r}")
    names = {field.name for field in fields(Approval)}
    if not names <= set(data):
        raise ResultError(f"{APPROVAL_NAME}: lacks {', '.join(sorted(names - set(data)))}")
    return Approval(**{name: data[name] for name in names})


def _key_id(key: Ed25519PublicKey) -> str:
    """Return the first half of the sha256 of the raw public key."""
    return hashlib.sha256(key.public_bytes(Encoding.Raw, PublicFormat.Raw)).hexdigest()[:32]


def _hash_file(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK_BYTES):
            digest.update(chunk)
    return digest.hexdigest()


def _read(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(MAX_FILE_BYTES)
    except OSError as error:
        raise TrustError(f"{path}: cannot be read ({error.strerror})") from None
