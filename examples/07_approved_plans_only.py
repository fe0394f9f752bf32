"""A robot's controller reads a trajectory only if a person has approved it: everything else is refused.

`python examples/07_approved_plans_only.py FOLDER PUBLIC_KEY [REVOCATIONS]`, for a folder of
`scopt review PLAN_ID --out FOLDER` and a folder of revocations (`scopt review PLAN_ID --revoke`) that the robot keeps.
"""

import base64
import csv
import hashlib
import json
import sys
import time
from pathlib import Path

from cryptography.hazmat.primitives.serialization import load_pem_public_key

APPROVAL = b"application/vnd.scopt.approval+json", "scopt-approval/2"
REVOCATION = b"application/vnd.scopt.revocation+json", "scopt-revocation/1"


def read_signed(path: Path, key, kind: tuple[bytes, str]) -> dict:
    """Return a statement that the key has signed."""
    envelope = json.loads(path.read_bytes())
    statement = base64.b64decode(envelope["payload"], validate=True)
    signature = base64.b64decode(envelope["signatures"][0]["sig"], validate=True)
    key.verify(signature, b"DSSEv1 %d %s %d %s" % (len(kind[0]), kind[0], len(statement), statement))
    content = json.loads(statement)
    if content["format"] != kind[1]:
        raise ValueError(f"{path.name} is of the format {content['format']}, expected {kind[1]}")
    return content


def read_approved(folder: Path, key, revoked: Path | None = None, now: float | None = None) -> list[dict[str, str]]:
    """Return the rows of an approved trajectory; any exception means that nothing may move."""
    now = time.time() if now is None else now
    approval = read_signed(folder / "approval.json", key, APPROVAL)
    if approval["verdict"] != "CERTIFIED":
        raise ValueError("not a certified plan")
    if not approval["approved_at"] <= now < approval["expires_at"]:
        raise ValueError("approved too long ago, or in the future")
    own = folder / "revocation.json"
    for path in [*([own] if own.exists() else []), *([] if revoked is None else sorted(revoked.glob("*.json")))]:
        revocation = read_signed(path, key, REVOCATION)
        if revocation["plan_id"] == approval["plan_id"] and approval["approved_at"] <= revocation["revoked_at"]:
            raise ValueError(f"revoked by {revocation['reviewer']}: {revocation['comment']}")
    data = (folder / "trajectory.csv").read_bytes()  # read once: what is checked is what is carried out
    if hashlib.sha256(data).hexdigest() != approval["files"]["trajectory.csv"]:
        raise ValueError("trajectory.csv is not the approved one")
    return list(csv.DictReader(data.decode().splitlines()))


if __name__ == "__main__":
    try:
        key = load_pem_public_key(Path(sys.argv[2]).read_bytes())
        rows = read_approved(Path(sys.argv[1]), key, Path(sys.argv[3]) if len(sys.argv) > 3 else None)
    except Exception as error:
        sys.exit(f"refused: {type(error).__name__} {error}")
    print(f"{len(rows)} samples, the first: {dict(list(rows[0].items())[:4])}")
