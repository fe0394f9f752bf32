"""How much of a cloud file is read at most."""

from __future__ import annotations

MAX_POINTS = 2_000_000
MAX_FILE_BYTES = 64 * 2**20
MAX_INVALID_FRACTION = 0.95
