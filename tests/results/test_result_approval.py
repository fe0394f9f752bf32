"""Signed approvals are checked without the server; `scopt verify` and a controller refuse forged ones."""

from __future__ import annotations

import base64
import hashlib
import importlib.util
import json
import shutil
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_pem_private_key,
)

from service.errors import ResultError
from service.result.approval import (
    PAYLOAD_TYPE,
    Approval,
    Revocation,
    Signer,
    check_approval,
    open_approval,
    read_public_key,
)
from service.result.signing import SigningKey
from service.trust import TrustError

CONTROLLER = Path(__file__).parents[2] / "examples" / "07_approved_plans_only.py"
DAY_S = 86400.0
FILES = {
    "result.json": b'{"format": "scopt-result/1"}',
    "trajectory.csv": b"time,l_arm_elx\n0.0,0.1\n0.5,0.2\n",
    "viewer.html": b"<html>a page</html>",
    "robot/robot.urdf": b"<robot/>",
}


def _write_key(folder: Path, name: str) -> Signer:
    key = Ed25519PrivateKey.generate()
    private, public = folder / f"{name}.pem", folder / f"{name}.pub"
    private.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    private.chmod(0o600)
    public.write_bytes(key.public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))
    return Signer(private)


def _approve(**changes: Any) -> Approval:
    hashes = {name: hashlib.sha256(data).hexdigest() for name, data in FILES.items()}
    page = hashes["viewer.html"]
    approval = Approval("p1", "CERTIFIED", "ada", "fine", time.time(), "a" * 64, "b" * 64, "c" * 64, page, hashes)
    return replace(approval, **changes)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A result folder, its approval, and two keys; "ours" is the trusted one."""
    ours = _write_key(tmp_path, "ours")
    _write_key(tmp_path, "theirs")
    result = tmp_path / "result"
    for name, data in FILES.items():
        (result / name).parent.mkdir(parents=True, exist_ok=True)
        (result / name).write_bytes(data)
    (result / "approval.json").write_bytes(ours.sign(_approve()))
    return result


def _read_by_controller(folder: Path) -> list[dict[str, str]]:
    spec = importlib.util.spec_from_file_location("controller", CONTROLLER)
    assert spec is not None
    assert spec.loader is not None
    controller = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(controller)
    rows: list[dict[str, str]] = controller.read_approved(folder, read_public_key(folder.parent / "ours.pub"))
    return rows


def _envelope(folder: Path) -> dict[str, Any]:
    data: dict[str, Any] = json.loads((folder / "approval.json").read_bytes())
    return data


def _store(folder: Path, envelope: Any) -> None:
    (folder / "approval.json").write_text(json.dumps(envelope))


def _sign_anew(folder: Path, key: str, **changes: Any) -> None:
    (folder / "approval.json").write_bytes(Signer(folder.parent / f"{key}.pem").sign(_approve(**changes)))


def _edit_statement(folder: Path, **changes: Any) -> None:
    envelope = _envelope(folder)
    statement = {**json.loads(base64.b64decode(envelope["payload"])), **changes}
    _store(folder, {**envelope, "payload": base64.b64encode(json.dumps(statement).encode()).decode()})


def _edit_signature(folder: Path, change: Callable[[bytes], bytes]) -> None:
    envelope = _envelope(folder)
    envelope["signatures"][0]["sig"] = base64.b64encode(
        change(base64.b64decode(envelope["signatures"][0]["sig"]))
    ).decode()
    _store(folder, envelope)


def _sign_bytes(folder: Path, encode: Callable[[bytes], bytes]) -> None:
    """Sign other bytes of the same statement with the trusted key."""
    envelope = _envelope(folder)
    key = load_pem_private_key((folder.parent / "ours.pem").read_bytes(), None)
    assert isinstance(key, Ed25519PrivateKey)
    signature = key.sign(encode(base64.b64decode(envelope["payload"])))
    envelope["signatures"][0]["sig"] = base64.b64encode(signature).decode()
    _store(folder, envelope)


def _change_file(folder: Path, name: str, old: bytes, new: bytes) -> None:
    data = (folder / name).read_bytes()
    assert old in data
    (folder / name).write_bytes(data.replace(old, new, 1))


def _approve_other_trajectory(folder: Path, key: str) -> None:
    """Change a number, and state the new hash."""
    _change_file(folder, "trajectory.csv", b"0.2", b"2.2")
    sha = hashlib.sha256((folder / "trajectory.csv").read_bytes()).hexdigest()
    files = {**_approve().files, "trajectory.csv": sha}
    if key:
        _sign_anew(folder, key, files=files)
    else:
        _edit_statement(folder, files=files)


FORGERIES: dict[str, Callable[[Path], object]] = {
    "no approval": lambda folder: (folder / "approval.json").unlink(),
    "an empty approval": lambda folder: (folder / "approval.json").write_bytes(b""),
    "no JSON": lambda folder: (folder / "approval.json").write_bytes(b"approved by ada"),
    "a list": lambda folder: _store(folder, [_envelope(folder)]),
    "the statement alone": lambda folder: _store(folder, json.loads(base64.b64decode(_envelope(folder)["payload"]))),
    "no signature": lambda folder: _store(folder, {**_envelope(folder), "signatures": []}),
    "a signature of zeros": lambda folder: _edit_signature(folder, lambda _: bytes(64)),
    "a cut signature": lambda folder: _edit_signature(folder, lambda signature: signature[:63]),
    "a signature with one other bit": lambda folder: _edit_signature(
        folder, lambda signature: bytes([signature[0] ^ 1]) + signature[1:]
    ),
    "an approval that has expired": lambda folder: _sign_anew(folder, "ours", approved_at=time.time() - 31 * DAY_S),
    "an approval with an edited end": lambda folder: _edit_statement(folder, expires_at=time.time() + 999 * DAY_S),
    "a revocation beside it": lambda folder: _revoke(folder, folder / "revocation.json"),
    "a revocation that another key has signed": lambda folder: _revoke(folder, folder / "revocation.json", "theirs"),
    "a revocation that is no JSON": lambda folder: (folder / "revocation.json").write_bytes(b"revoked"),
    "an approval of release 0.3.0": lambda folder: _sign_as_before(folder),
    "a verdict that is not the plan's": lambda folder: _sign_anew(folder, "ours", verdict="TIME_LIMIT"),
    "another key": lambda folder: _sign_anew(folder, "theirs"),
    "another key for another trajectory": lambda folder: _approve_other_trajectory(folder, "theirs"),
    "an edited hash under the old signature": lambda folder: _approve_other_trajectory(folder, ""),
    "an edited verdict": lambda folder: _edit_statement(folder, verdict="CERTIFIED "),
    "an edited time": lambda folder: _edit_statement(folder, approved_at=time.time() + 1.0),
    "an edited reviewer": lambda folder: _edit_statement(folder, reviewer="eve"),
    "a signature of the statement without its type": lambda folder: _sign_bytes(folder, lambda statement: statement),
    "a signature for another type": lambda folder: _sign_bytes(
        folder, lambda statement: b"DSSEv1 4 mail %d %s" % (len(statement), statement)
    ),
    "a changed trajectory": lambda folder: _change_file(folder, "trajectory.csv", b"0.2", b"2.2"),
    "a longer trajectory": lambda folder: _change_file(folder, "trajectory.csv", b"0.2\n", b"0.2\n1.0,9.9\n"),
    "no trajectory": lambda folder: (folder / "trajectory.csv").unlink(),
    "the approval of another plan": lambda folder: _sign_anew(
        folder, "ours", files={**_approve().files, "trajectory.csv": "d" * 64}
    ),
    "an approval without files": lambda folder: _sign_anew(folder, "ours", files={}),
}


def _revoke(folder: Path, path: Path, key: str = "ours", **changes: Any) -> None:
    path.parent.mkdir(exist_ok=True)
    revocation = replace(Revocation("p1", "bob", "the scan was old", time.time()), **changes)
    path.write_bytes(Signer(folder.parent / f"{key}.pem").sign_revocation(revocation))


def _sign_as_before(folder: Path) -> None:
    """Sign an approval as release 0.3.0 did."""
    statement = {key: value for key, value in asdict(_approve()).items() if key not in ("despite", "expires_at")}
    key = SigningKey(folder.parent / "ours.pem")
    (folder / "approval.json").write_bytes(key.seal(PAYLOAD_TYPE, {"format": "scopt-approval/1", **statement}))


@pytest.mark.parametrize("forgery", list(FORGERIES))
def test_a_forged_approval_is_refused_by_verify_and_by_a_controller(folder: Path, forgery: str) -> None:
    key = read_public_key(folder.parent / "ours.pub")
    assert check_approval(folder, key).reviewer == "ada"
    assert [row["l_arm_elx"] for row in _read_by_controller(folder)] == ["0.1", "0.2"]
    FORGERIES[forgery](folder)
    with pytest.raises(ResultError, match=str(folder)):
        check_approval(folder, key)
    with pytest.raises((OSError, ValueError, KeyError, TypeError, IndexError, InvalidSignature)):
        _read_by_controller(folder)


@pytest.mark.parametrize(
    "changes", [{"approved_at": 0.0}, {"approved_at": 4e9}, {"verdict": "FEASIBLE_AT_SAMPLES"}], ids=str
)
def test_a_controller_refuses_signed_statements_that_are_old_or_about_no_certified_plan(
    folder: Path, changes: dict[str, Any]
) -> None:
    _sign_anew(folder, "ours", **changes)
    with pytest.raises(ValueError, match=r"approved too long ago|not a certified plan"):
        _read_by_controller(folder)


def test_verify_names_every_file_that_is_not_the_approved_one(folder: Path) -> None:
    _change_file(folder, "viewer.html", b"a page", b"A page")
    (folder / "robot" / "robot.urdf").unlink()
    (folder / "robot" / "other.urdf").write_text("<robot/>")
    shutil.move(folder / "result.json", folder.parent / "result.json")
    (folder / "result.json").symlink_to(folder.parent / "result.json")
    with pytest.raises(ResultError) as refused:
        check_approval(folder, read_public_key(folder.parent / "ours.pub"))
    assert str(refused.value).splitlines() == [
        f"{folder}: robot/robot.urdf is missing",
        f"{folder}: robot/other.urdf is not part of what was approved",
        f"{folder}: result.json is not the approved one",
        f"{folder}: viewer.html is not the approved one",
    ]


def test_a_key_that_cannot_be_used_is_refused_by_its_file(folder: Path) -> None:
    ours = folder.parent / "ours.pem"
    elliptic = folder.parent / "elliptic.pem"
    key = generate_private_key(SECP256R1())
    elliptic.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    elliptic.chmod(0o600)
    with pytest.raises(TrustError, match=r"elliptic\.pem: expected an unencrypted Ed25519 private key in PEM"):
        Signer(elliptic)
    (folder.parent / "ours.pub").chmod(0o600)
    with pytest.raises(TrustError, match=r"ours\.pub: expected an unencrypted Ed25519 private key"):
        Signer(folder.parent / "ours.pub")
    with pytest.raises(TrustError, match=r"ours\.pem: expected an Ed25519 public key in PEM"):
        read_public_key(ours)
    with pytest.raises(TrustError, match=r"nothing\.pem: cannot be read"):
        read_public_key(folder / "nothing.pem")
    ours.chmod(0o644)
    with pytest.raises(TrustError, match="others may read the private key; run chmod 600"):
        Signer(ours)


def _check_at(folder: Path, days: float, *revocations: Path) -> Approval:
    """Check an approval of 2026-12-01 some days later."""
    now = 1796083200.0 + days * DAY_S
    return check_approval(folder, read_public_key(folder.parent / "ours.pub"), now=now, revocations=revocations)


@pytest.mark.parametrize(
    ("changes", "days", "words"),
    [
        ({}, 30.0, r"by ada on 2026-12-01 00:00 UTC expired on 2026-12-31 00:00 UTC \(it is now 2026-12-31"),
        ({"expires_at": 1796083200.0 + DAY_S}, 1.01, r"expired on 2026-12-02 00:00 UTC"),
        ({}, -0.01, r"is of the future \(it is now 2026-11-30 23:45 UTC\); check this computer's clock"),
        ({"verdict": "TIME_LIMIT"}, 1.0, r"is of a plan that is TIME_LIMIT, and does not say despite TIME_LIMIT"),
        ({"verdict": "TIME_LIMIT", "despite": "CERTIFIED"}, 1.0, r"and does not say despite TIME_LIMIT"),
        ({"page_sha256": "e" * 64}, 1.0, r"viewer\.html is not the page that the reviewer has seen"),
    ],
    ids=["expired", "expired after a day", "of the future", "despite missing", "despite another verdict", "other page"],
)  # fmt: skip
def test_an_approval_that_does_not_hold_now_is_refused_with_the_reason(
    folder: Path, changes: dict[str, Any], days: float, words: str
) -> None:
    _sign_anew(folder, "ours", approved_at=1796083200.0)
    assert _check_at(folder, 29.9).describe() == (
        "ada on 2026-12-01 00:00 UTC, valid until 2026-12-31 00:00 UTC, plan p1"
    )
    _sign_anew(folder, "ours", **{"approved_at": 1796083200.0, **changes})
    with pytest.raises(ResultError, match=words):
        _check_at(folder, days)


def test_an_approval_despite_its_verdict_holds_for_a_plan_with_that_verdict_only(folder: Path) -> None:
    text = b'{"format": "scopt-result/1", "verdict": "TIME_LIMIT"}'
    (folder / "result.json").write_bytes(text)
    files = {**_approve().files, "result.json": hashlib.sha256(text).hexdigest()}
    late = {"approved_at": 1796083200.0, "files": files, "verdict": "TIME_LIMIT", "despite": "TIME_LIMIT"}
    _sign_anew(folder, "ours", **late)
    assert _check_at(folder, 1.0).describe().startswith("ada despite TIME_LIMIT on ")
    _sign_anew(folder, "ours", **{**late, "verdict": "CERTIFIED", "despite": ""})
    with pytest.raises(ResultError, match=r"result\.json says 'TIME_LIMIT'; the approved plan is CERTIFIED"):
        _check_at(folder, 1.0)


def test_revocations_that_the_robot_keeps_count_and_a_later_approval_holds(folder: Path) -> None:
    kept = folder.parent / "kept"
    _sign_anew(folder, "ours", approved_at=1796083200.0)
    _revoke(folder, kept / "other.json", revoked_at=1796083300.0, plan_id="p2")
    _revoke(folder, kept / "theirs.json", "theirs", revoked_at=1796083300.0)  # of another server
    assert _check_at(folder, 1.0, kept).plan_id == "p1"
    _revoke(folder, kept / "own.json", revoked_at=1796083300.0)
    for revocations in (kept, kept / "own.json"):
        with pytest.raises(ResultError, match="was revoked by bob on 2026-12-01 00:01 UTC: 'the scan was old'"):
            _check_at(folder, 1.0, revocations)
    _sign_anew(folder, "ours", approved_at=1796083301.0)
    assert _check_at(folder, 1.0, kept).plan_id == "p1"
    (kept / "own.json").write_text("revoked")
    with pytest.raises(ResultError, match=r"own\.json: is no signed statement"):
        _check_at(folder, 1.0, kept)
    with pytest.raises(ResultError, match=r"nothing\.json: does not exist; expected a revocation"):
        _check_at(folder, 1.0, kept / "nothing.json")


def test_an_approval_of_release_0_3_0_is_read_and_counts_as_expired(folder: Path) -> None:
    _sign_as_before(folder)
    key = read_public_key(folder.parent / "ours.pub")
    approval = open_approval((folder / "approval.json").read_bytes(), key)
    assert (approval.reviewer, approval.expires_at) == ("ada", None)
    with pytest.raises(ResultError, match=r"is of release 0\.3\.0, has no validity and counts as expired"):
        check_approval(folder, key)


def test_a_revocation_is_no_approval(folder: Path) -> None:
    _revoke(folder, folder / "approval.json")
    with pytest.raises(ResultError, match=r"approval\.json: payloadType is 'application/vnd\.scopt\.revocation\+json'"):
        check_approval(folder, read_public_key(folder.parent / "ours.pub"))


def test_an_approval_of_another_certificate_is_refused(folder: Path) -> None:
    text = b'{"format": "scopt-result/1", "certificate": {"status": "CERTIFIED"}}'
    (folder / "result.json").write_bytes(text)
    files = {**_approve().files, "result.json": hashlib.sha256(text).hexdigest()}
    own = hashlib.sha256(b'{"status":"CERTIFIED"}').hexdigest()
    _sign_anew(folder, "ours", approved_at=1796083200.0, files=files, certificate_sha256=own)
    assert _check_at(folder, 1.0).certificate_sha256 == own
    _sign_anew(folder, "ours", approved_at=1796083200.0, files=files)
    with pytest.raises(ResultError, match=r"the certificate in result\.json is not the approved one"):
        _check_at(folder, 1.0)
