"""Approvals that do not hold: of another key, verdict, page or time, revoked, or of a plan that is not certified."""

from __future__ import annotations

import base64
import json
import os
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, PublicFormat

from benchmarks.attack import bases
from benchmarks.attack.files import add_bytes, list_anew, write_text
from benchmarks.attack.outcome import Answer, Attack
from service.errors import ResultError
from service.result.approval import (
    PAYLOAD_TYPE,
    REVOCATION_TYPE,
    Approval,
    Revocation,
    Signer,
    check_approval,
    read_public_key,
)
from service.result.manifest import hash_certificate, hash_file, list_files
from service.store import Decision, ReviewRefusedError, Store

NOW = 1.8e9  # time of the checks; an approval is given an hour before
DAY_S = 86400.0


class Desk:
    """A result folder with an approval, the keys of a server and of a stranger, and revocations that a robot keeps."""

    def __init__(self, scratch: Path, base: str = "arm") -> None:
        self.folder = bases.copy_of(base, scratch)
        self.kept = scratch / "kept"
        self.kept.mkdir()
        self.server, self.key = _make_key(scratch / "server.pem")
        self.stranger, _ = _make_key(scratch / "stranger.pem")
        files = {name: hash_file(path).removeprefix("sha256:") for name, path in list_files(self.folder).items()}
        data = json.loads((self.folder / "result.json").read_text(encoding="utf-8"))
        proof, page = hash_certificate(data).removeprefix("sha256:"), files["viewer.html"]
        hashes = ("a" * 64, "b" * 64, proof, page, files)
        self.approval = Approval("p1", data["verdict"], "ada", "", NOW - 3600.0, *hashes)
        self.sign()

    def sign(self, signer: Signer | None = None, **changes: Any) -> None:
        """Write the approval with some fields changed."""
        signed = (signer or self.server).sign(replace(self.approval, **changes))
        (self.folder / "approval.json").write_bytes(signed)

    def revoke(self, path: Path, signer: Signer | None = None, **changes: Any) -> None:
        """Write a revocation, given half an hour ago."""
        revocation = replace(Revocation("p1", "bob", "the scan was old", NOW - 1800.0), **changes)
        path.write_bytes((signer or self.server).sign_revocation(revocation))

    def edit(self, name: str, **changes: Any) -> None:
        """Change the statement in a signed file under its old signature."""
        envelope = json.loads((self.folder / name).read_bytes())
        statement = {**json.loads(base64.b64decode(envelope["payload"])), **changes}
        envelope["payload"] = base64.b64encode(json.dumps(statement).encode()).decode()
        (self.folder / name).write_text(json.dumps(envelope), encoding="utf-8")

    def check(self, now: float = NOW) -> tuple[Answer, str]:
        """Check the approval as ``scopt verify --trust`` does."""
        try:
            approval = check_approval(self.folder, self.key, now=now, revocations=[self.kept])
        except ResultError as error:
            return Answer.REFUSED, str(error).splitlines()[0].removeprefix(f"{self.folder}: ")
        return Answer.BELIEVED, f"approved by {approval.describe()}"


def attacks() -> list[Attack]:
    """Return approvals that do not hold, with a word that the answer must have, and honest ones."""
    return [
        *(Attack("approvals", name, partial(_lie, word, change)) for name, (word, change) in LIES.items()),
        *(Attack("approvals", name, partial(_review, word, more)) for name, (word, more) in REVIEWS.items()),
        *(Attack("harmless", f"approval: {name}", partial(_honest, change)) for name, change in HONEST.items()),
        Attack("harmless", "approval: despite its verdict", _despite),
    ]


def _make_key(path: Path) -> tuple[Signer, Any]:
    key = Ed25519PrivateKey.generate()
    path.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    path.chmod(0o600)
    public = path.with_suffix(".pub")
    public.write_bytes(key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    return Signer(path), read_public_key(public)


def _lie(word: str, change: Callable[[Desk], object], scratch: Path) -> tuple[Answer, str]:
    desk = Desk(scratch)
    change(desk)
    answer, text = desk.check()
    is_named = answer is Answer.BELIEVED or word in text
    return (answer, text) if is_named else (Answer.CRASHED, f"{word} is not in: {text}")


def _honest(change: Callable[[Desk], object], scratch: Path) -> tuple[Answer, str]:
    desk = Desk(scratch)
    change(desk)
    answer, text = desk.check()
    return (Answer.TRUE if answer is Answer.BELIEVED else Answer.ALARM), text


def _despite(scratch: Path) -> tuple[Answer, str]:
    """Approve a plan that was not found, by its very verdict."""
    desk = Desk(scratch, "missed")
    desk.sign(despite=desk.approval.verdict)
    answer, text = desk.check()
    return (Answer.TRUE if answer is Answer.BELIEVED and "despite" in text else Answer.ALARM), text


def _review(word: str, more: dict[str, Any], scratch: Path) -> tuple[Answer, str]:
    """Accept a stored plan by a review that is not bound to its verdict."""
    with Store(scratch / "store") as store:
        plan_id = store.plans.begin("ann", "r", "a" * 64, "goal").plan_id
        store.plans.finish(plan_id, more["stored"], b"reply", "p" * 64, "c" * 64)
        seen = {name: value for name, value in more.items() if name != "stored"}
        try:
            store.reviews.add(plan_id, Decision.ACCEPTED, "rev", "p" * 64, "c" * 64, **seen)
        except ReviewRefusedError as error:
            return (Answer.REFUSED if word in str(error) else Answer.CRASHED), str(error)
        return Answer.BELIEVED, "the store takes the review"


def _sign_as_before(desk: Desk) -> None:
    """Sign as release 0.3.0 did, without a validity."""
    fields = {name: value for name, value in asdict(desk.approval).items() if name not in ("despite", "expires_at")}
    envelope = desk.server.seal(PAYLOAD_TYPE, {"format": "scopt-approval/1", **fields})
    (desk.folder / "approval.json").write_bytes(envelope)


def _approve_as_revocation(desk: Desk) -> None:
    statement = {"format": "scopt-approval/2", **asdict(replace(desk.approval, expires_at=NOW + DAY_S))}
    (desk.folder / "approval.json").write_bytes(desk.server.seal(REVOCATION_TYPE, statement))


def _edit_revocation(desk: Desk) -> None:
    """Move a revocation before the approval, under its old signature."""
    desk.revoke(desk.folder / "revocation.json")
    desk.edit("revocation.json", revoked_at=NOW - DAY_S)


def _change_page(desk: Desk) -> None:
    add_bytes("viewer.html")(desk.folder)
    list_anew(desk.folder)


def _change_page_and_hashes(desk: Desk) -> None:
    """Show the reviewer's page hash, and sign another page by mistake."""
    _change_page(desk)
    files = {name: hash_file(path).removeprefix("sha256:") for name, path in list_files(desk.folder).items()}
    desk.sign(files={name: value for name, value in files.items() if name != "approval.json"})


LIES: dict[str, tuple[str, Callable[[Desk], object]]] = {
    "expired": ("expired on", lambda desk: desk.sign(approved_at=NOW - 31 * DAY_S)),
    "expired after an hour": ("expired on", lambda desk: desk.sign(expires_at=NOW - 1.0)),
    "its end moved under the old signature": ("not signed", lambda desk: desk.edit("approval.json", expires_at=9e9)),
    "of the future": ("of the future", lambda desk: desk.sign(approved_at=NOW + DAY_S)),
    "of release 0.3.0": ("counts as expired", _sign_as_before),
    "revoked beside it": ("was revoked by bob", lambda desk: desk.revoke(desk.folder / "revocation.json")),
    "revoked by a file that the robot keeps": ("was revoked by bob", lambda desk: desk.revoke(desk.kept / "p1.json")),
    "revoked, and the revocation edited": ("not signed", _edit_revocation),
    "a revocation beside it that is no JSON": (
        "no signed statement",
        lambda desk: write_text("revocation.json", "revoked")(desk.folder),
    ),
    "a revocation beside it of another key": (
        "not signed",
        lambda desk: desk.revoke(desk.folder / "revocation.json", desk.stranger),
    ),
    "of another key": ("not signed", lambda desk: desk.sign(desk.stranger)),
    "of another verdict": ("result.json says", lambda desk: desk.sign(verdict="TIME_LIMIT", despite="TIME_LIMIT")),
    "of another certificate": (
        "certificate in result.json",
        lambda desk: desk.sign(certificate_sha256="d" * 64),
    ),
    "without despite": ("does not say despite TIME_LIMIT", lambda desk: desk.sign(verdict="TIME_LIMIT")),
    "despite another verdict": (
        "does not say despite TIME_LIMIT",
        lambda desk: desk.sign(verdict="TIME_LIMIT", despite="NOT_FOUND"),
    ),
    "another page": ("viewer.html is not the approved one", lambda desk: add_bytes("viewer.html")(desk.folder)),
    "another page with its manifest": ("is not the approved one", _change_page),
    "another page than the reviewer's": ("not the page that the reviewer has seen", _change_page_and_hashes),
    "another trajectory": ("trajectory.csv is not the approved", lambda desk: add_bytes("trajectory.csv")(desk.folder)),
    "a file more": ("notes.txt is not part", lambda desk: write_text("notes.txt", "fine")(desk.folder)),
    "a file less": ("scene.glb is missing", lambda desk: (desk.folder / "scene.glb").unlink()),
    "a link for a file": ("scene.glb is not the approved", lambda desk: _put_link(desk.folder / "scene.glb")),
    "an approval as a revocation": ("payloadType", _approve_as_revocation),
    "a revocation as an approval": ("payloadType", lambda desk: desk.revoke(desk.folder / "approval.json")),
}
REVIEWS: dict[str, tuple[str, dict[str, Any]]] = {
    "a review of a late plan that saw CERTIFIED": ("verdict: ", {"stored": "TIME_LIMIT"}),
    "a review of a late plan without despite": ("despite: ", {"stored": "TIME_LIMIT", "verdict": "TIME_LIMIT"}),
    "a review despite another verdict": (
        "despite: ",
        {"stored": "TIME_LIMIT", "verdict": "TIME_LIMIT", "despite": "NOT_FOUND"},
    ),
    "a review of a plan that saw another verdict": (
        "verdict: ",
        {"stored": "CERTIFIED", "verdict": "NOT_FOUND"},
    ),
    "a review that is valid for 100 years": ("valid_s: ", {"stored": "CERTIFIED", "valid_s": 3e9}),
}
HONEST: dict[str, Callable[[Desk], object]] = {
    "as it was given": lambda desk: None,
    "on its last day": lambda desk: desk.sign(expires_at=NOW + 1.0),
    "of a clock that is a minute ahead": lambda desk: desk.sign(approved_at=NOW + 60.0),
    "beside the revocation of another plan": lambda desk: desk.revoke(desk.kept / "p2.json", plan_id="p2"),
    "beside a revocation of another server": lambda desk: desk.revoke(desk.kept / "p1.json", desk.stranger),
    "given again after a revocation": lambda desk: desk.revoke(desk.kept / "p1.json", revoked_at=NOW - 7200.0),
}


def _put_link(path: Path) -> None:
    target = path.parent.parent / path.name
    path.rename(target)
    os.symlink(target, path)
