"""A robot's controller reads a trajectory only if a person has approved it: everything else is refused.

`python examples/07_approved_plans_only.py FOLDER PUBLIC_KEY`, for a folder of `scopt review PLAN_ID --out FOLDER`.
"""

import base64
import csv
import hashlib
import json
import sys
import time
from pathlib import Path

from cryptography.hazmat.primitives.serialization import load_pem_public_key

TYPE = b"application/vnd.scopt.approval+json"
MAX_AGE_S = 24 * 3600.0  # an older approval may have been withdrawn


def read_approved(folder: Path, key) -> list[dict[str, str]]:
    """Return the rows of an approved trajectory; any exception means that nothing may move."""
    envelope = json.loads((folder / "approval.json").read_bytes())
    statement = base64.b64decode(envelope["payload"], validate=True)
    signature = base64.b64decode(envelope["signatures"][0]["sig"], validate=True)
    key.verify(signature, b"DSSEv1 %d %s %d %s" % (len(TYPE), TYPE, len(statement), statement))
    approval = json.loads(statement)
    if (approval["format"], approval["verdict"]) != ("scopt-approval/1", "CERTIFIED"):
        raise ValueError("not a certified plan")
    if not 0.0 <= time.time() - approval["approved_at"] <= MAX_AGE_S:
        raise ValueError("approved too long ago, or in the future")
    data = (folder / "trajectory.csv").read_bytes()  # read once: what is checked is what is carried out
    if hashlib.sha256(data).hexdigest() != approval["files"]["trajectory.csv"]:
        raise ValueError("trajectory.csv is not the approved one")
    return list(csv.DictReader(data.decode().splitlines()))


if __name__ == "__main__":
    try:
        rows = read_approved(Path(sys.argv[1]), load_pem_public_key(Path(sys.argv[2]).read_bytes()))
    except Exception as error:
        sys.exit(f"refused: {type(error).__name__} {error}")
    print(f"{len(rows)} samples, the first: {dict(list(rows[0].items())[:4])}")
