"""Damages a cloud file in many seeded ways and reads each: ``python cloud_mutations.py FILE FIRST COUNT``.

A process of its own, since libraries may end the one that they run in.  Each number from FIRST on is printed before its
file is read, and what came of it after: ``read``, ``memory``, or the line that refuses it.
"""

from __future__ import annotations

import resource
import sys
from pathlib import Path

import numpy as np

from perception.errors import CloudError
from perception.files.parse import parse_file

MAX_BYTES = 2**30


def damaged(content: bytes, seed: int) -> bytes:
    """Cut off somewhere, or with up to three bytes changed, half of the time near the beginning."""
    rng = np.random.default_rng(seed)
    if rng.integers(4) == 0:
        return content[: rng.integers(len(content))]
    changed = bytearray(content)
    end = len(content) if rng.integers(2) else min(400, len(content))
    for at in rng.integers(end, size=rng.integers(1, 4)):
        changed[at] = rng.choice([0, 1, 127, 128, 255, rng.integers(256)])
    return bytes(changed)


def outcome(path: Path) -> str:
    """What reading the file comes to."""
    try:
        parse_file(path)
    except CloudError as error:
        return str(error)
    except MemoryError:
        return "memory"
    return "read"


def main() -> None:
    """See the module."""
    original = Path(sys.argv[1])
    content = original.read_bytes()
    path = original.with_name(f"damaged{original.suffix}")
    resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for seed in range(int(sys.argv[2]), int(sys.argv[2]) + int(sys.argv[3])):
        path.write_bytes(damaged(content, seed))
        print(seed, flush=True)
        print(outcome(path), flush=True)


if __name__ == "__main__":
    main()
