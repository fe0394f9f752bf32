"""Atomic replacement of files."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

SCRATCH_PREFIX = ".scopt-"


def replace_file(path: Path, data: bytes) -> None:
    """Write a file beside ``path`` and move it there, so that an interrupt leaves no partial file."""
    with tempfile.TemporaryDirectory(prefix=SCRATCH_PREFIX, dir=path.parent) as scratch:
        fresh = Path(scratch) / path.name
        fresh.write_bytes(data)
        os.replace(fresh, path)
