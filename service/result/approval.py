"""Signed approvals and revocations: what they state, and their check without the server.

``approval.json`` and ``revocation.json`` are signed statements (:mod:`service.result.signing`).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from service.errors import ResultError, shown
from service.result.folder import APPROVAL_NAME, RESULT_NAME, REVOCATION_NAME, VIEWER_NAME, read_result
from service.result.manifest import hash_certificate, hash_file, list_files
from service.result.signing import MAX_FILE_BYTES, SigningKey, key_id, read_envelope, read_public_key
from service.store.reviews import CERTIFIED, VALID_S

__all__ = ["Approval", "Revocation", "Signer", "check_approval", "open_approval", "open_revocation", "read_public_key"]

FORMAT = "scopt-approval/2"
EARLIER_FORMAT = "scopt-approval/1"  # of release 0.3.0: without a validity
REVOCATION_FORMAT = "scopt-revocation/1"
PAYLOAD_TYPE = "application/vnd.scopt.approval+json"
REVOCATION_TYPE = "application/vnd.scopt.revocation+json"
CLOCK_TOLERANCE_S = 300.0  # by which a robot's clock may be behind its server's
MAX_REVOCATIONS = 10_000  # files that are read


@dataclass(frozen=True)
class Approval:
    """Statement about an accepted plan.

    Attributes:
        plan_id: id of the plan on its server.
        verdict: verdict of the plan, which the reviewer has seen.
        reviewer: who accepted it.
        comment: the reviewer's comment.
        approved_at: [s since 1970].
        request_sha256: hash of the request's canonical form.
        trajectory_sha256, certificate_sha256: as in the messages ``Trajectory`` and ``Certificate``.
        page_sha256: hash of ``viewer.html``, which the reviewer has seen; empty for a plan without files.
        files: hash of every file in the result folder, by path; empty for a plan without files.
        despite: the verdict once more where it is not ``CERTIFIED``, as the reviewer gave it; else empty.
        expires_at: end of its validity [s since 1970]; None for an approval of release 0.3.0, which has none.
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
    despite: str = ""
    expires_at: float | None = None

    def describe(self) -> str:
        """Return who approved which plan until when, in one clause."""
        until = "" if self.expires_at is None else f", valid until {format_time(self.expires_at)}"
        despite = f" despite {self.despite}" if self.despite else ""
        return f"{self.reviewer}{despite} on {format_time(self.approved_at)}{until}, plan {self.plan_id}"


@dataclass(frozen=True)
class Revocation:
    """Statement that all approvals of a plan until now are withdrawn.

    Attributes:
        plan_id: id of the plan on its server.
        reviewer: who withdrew them.
        comment: the reviewer's comment.
        revoked_at: [s since 1970].
    """

    plan_id: str
    reviewer: str
    comment: str
    revoked_at: float

    def applies_to(self, approval: Approval) -> bool:
        """Return whether an approval is withdrawn; one that is given later is not."""
        return self.plan_id == approval.plan_id and approval.approved_at <= self.revoked_at


class Signer(SigningKey):
    """Ed25519 key of a server that signs approvals and revocations."""

    def sign(self, approval: Approval) -> bytes:
        """Return the content of ``approval.json``; an approval without an end is valid for 30 days."""
        if approval.expires_at is None:
            approval = replace(approval, expires_at=approval.approved_at + VALID_S)
        return self.seal(PAYLOAD_TYPE, {"format": FORMAT, **asdict(approval)})

    def sign_revocation(self, revocation: Revocation) -> bytes:
        """Return the content of ``revocation.json``."""
        return self.seal(REVOCATION_TYPE, {"format": REVOCATION_FORMAT, **asdict(revocation)})


def open_approval(envelope: bytes, key: Ed25519PublicKey) -> Approval:
    """Return the statement of an approval that the key has signed; of release 0.3.0, too, which has no end.

    Raises:
        ResultError: the envelope is malformed, or none of its signatures is the key's.
    """
    statement = read_envelope(envelope, APPROVAL_NAME).open(PAYLOAD_TYPE, key, APPROVAL_NAME)
    if statement.get("format") == EARLIER_FORMAT:
        statement = {**statement, "format": FORMAT, "despite": "", "expires_at": None}
    return Approval(**_take_fields(statement, FORMAT, Approval, APPROVAL_NAME))


def open_revocation(envelope: bytes, key: Ed25519PublicKey, name: str = REVOCATION_NAME) -> Revocation:
    """Return the statement of a revocation that the key has signed.

    Raises:
        ResultError: the envelope is malformed, or none of its signatures is the key's; the message calls it ``name``.
    """
    statement = read_envelope(envelope, name).open(REVOCATION_TYPE, key, name)
    return Revocation(**_take_fields(statement, REVOCATION_FORMAT, Revocation, name))


def check_approval(
    folder: Path, key: Ed25519PublicKey, *, now: float | None = None, revocations: Sequence[Path] = ()
) -> Approval:
    """Return the valid approval of a result folder in which every file is the approved one.

    Args:
        folder: the result folder with ``approval.json`` and perhaps ``revocation.json``.
        key: the trusted key.
        now: time at which the approval has to be valid [s since 1970]; None for the computer's clock.
        revocations: files, or folders of files, with revocations that are known beside the one in the folder.  Those of
            other keys are passed over.

    Raises:
        ResultError: there is no approval, or it is not signed by the key, has expired, was revoked, is of a plan
            without ``CERTIFIED`` and does not say so, or shows another verdict or page; or a file differs, is missing,
            or is not part of what was approved.
    """
    try:
        approval = open_approval(_read_envelope_file(folder / APPROVAL_NAME), key)
    except FileNotFoundError:
        raise ResultError(
            f"{folder}: there is no {APPROVAL_NAME}; an approved plan of a server with --sign-key has one "
            "(`scopt review PLAN_ID --out FOLDER`)"
        ) from None
    except ResultError as error:
        raise ResultError(f"{folder}: {error}") from None
    for revocation in (*_read_own_revocation(folder, key), *_read_revocations(revocations, key)):
        if revocation.applies_to(approval):
            why = f": {shown(revocation.comment)}" if revocation.comment else ""
            who = f"{revocation.reviewer} on {format_time(revocation.revoked_at)}"
            raise ResultError(f"{folder}: the approval by {_name(approval)} was revoked by {who}{why}")
    problem = _find_lapse(approval, time.time() if now is None else now)
    if problem:
        raise ResultError(f"{folder}: {problem}")
    if not approval.files:
        raise ResultError(f"{folder}: the approval names no files; the plan was made without any")
    problems = [*_compare_files(folder, approval), *_compare_claims(folder, approval)]
    if problems:
        raise ResultError("\n".join(f"{folder}: {problem}" for problem in problems[:10]))
    return approval


def format_time(seconds: float) -> str:
    """Return a time since 1970 as date and minute, UTC."""
    try:
        return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M UTC")
    except (ValueError, OverflowError, OSError):
        return f"{seconds:g} s since 1970"


def _find_lapse(approval: Approval, now: float) -> str:
    """Return why an approval is not valid at a time; empty if it is."""
    given, now_is = f"the approval by {_name(approval)}", f"it is now {format_time(now)}"
    if approval.expires_at is None:
        return f"{given} is of release 0.3.0, has no validity and counts as expired; review the plan again"
    if now >= approval.expires_at:
        return f"{given} expired on {format_time(approval.expires_at)} ({now_is}); review the plan again"
    if now < approval.approved_at - CLOCK_TOLERANCE_S:
        return f"{given} is of the future ({now_is}); check this computer's clock"
    if approval.verdict != CERTIFIED and approval.despite != approval.verdict:
        return f"{given} is of a plan that is {approval.verdict}, and does not say despite {approval.verdict}"
    return ""


def _name(approval: Approval) -> str:
    return f"{approval.reviewer} on {format_time(approval.approved_at)}"


def _compare_files(folder: Path, approval: Approval) -> list[str]:
    there = list_files(folder)
    own = {APPROVAL_NAME, REVOCATION_NAME}
    problems = [f"{name} is missing" for name in sorted(set(approval.files) - set(there))]
    problems += [f"{name} is not part of what was approved" for name in sorted(set(there) - {*approval.files, *own})]
    for name in sorted(set(there) & set(approval.files)):
        path = there[name]
        if path.is_symlink() or not path.is_file() or hash_file(path) != f"sha256:{approval.files[name]}":
            problems.append(f"{name} is not the approved one")
    return problems


def _compare_claims(folder: Path, approval: Approval) -> list[str]:
    """Compare page, certificate and verdict that were shown to the reviewer with those of the approved files."""
    problems = []
    if approval.page_sha256 != approval.files.get(VIEWER_NAME, ""):
        problems.append(f"{VIEWER_NAME} is not the page that the reviewer has seen")
    if (folder / RESULT_NAME).is_file():
        data = read_result(folder)
        verdict, certificate = data.get("verdict", approval.verdict), hash_certificate(data)
        if certificate and certificate != f"sha256:{approval.certificate_sha256}":
            problems.append(f"the certificate in {RESULT_NAME} is not the approved one")
        if verdict != approval.verdict:
            problems.append(f"{RESULT_NAME} says {shown(verdict)}; the approved plan is {approval.verdict}")
    return problems


def _read_own_revocation(folder: Path, key: Ed25519PublicKey) -> list[Revocation]:
    """Return the revocation beside an approval; one that the key has not signed is an error."""
    try:
        return [open_revocation(_read_envelope_file(folder / REVOCATION_NAME), key)]
    except FileNotFoundError:
        return []
    except ResultError as error:
        raise ResultError(f"{folder}: {error}") from None


def _read_revocations(paths: Sequence[Path], key: Ed25519PublicKey) -> list[Revocation]:
    """Return the key's revocations in files and folders."""
    files = [file for path in paths for file in (sorted(path.rglob("*.json")) if path.is_dir() else [path])]
    if len(files) > MAX_REVOCATIONS:
        raise ResultError(f"{paths[0]}: holds {len(files)} revocations; at most {MAX_REVOCATIONS} are read")
    found = []
    for file in files:
        try:
            content = _read_envelope_file(file)
        except FileNotFoundError:
            raise ResultError(f"{file}: does not exist; expected a revocation, or a folder of revocations") from None
        ids = read_envelope(content, str(file)).key_ids
        if not ids or key_id(key) in ids:
            found.append(open_revocation(content, key, str(file)))
    return found


def _read_envelope_file(path: Path) -> bytes:
    """Return the content of a file.

    Raises:
        FileNotFoundError: there is none.
        ResultError: it cannot be read, or is too large.
    """
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ResultError(f"{path.name}: has more than {MAX_FILE_BYTES} bytes")
        return path.read_bytes()
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ResultError(f"{path.name}: cannot be read: {error.strerror}") from None


def _take_fields(statement: Mapping[str, Any], form: str, kind: type, name: str) -> dict[str, Any]:
    """Return the fields of a signed statement."""
    if statement.get("format") != form:
        raise ResultError(f"{name}: format is {shown(statement.get('format'))}; expected {form!r}")
    names = {field.name for field in fields(kind)}
    if not names <= set(statement):
        raise ResultError(f"{name}: lacks {', '.join(sorted(names - set(statement)))}")
    return {key: statement[key] for key in names}
