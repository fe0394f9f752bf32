"""How much of a cloud file is read at most."""

from __future__ import annotations

MAX_POINTS = 2_000_000
MAX_FILE_BYTES = 64 * 2**20
MAX_INVALID_FRACTION = 0.95

# Of the process that parses a file.
MAX_PARSER_BYTES = 2**30
MAX_PARSER_CPU_S = 30
MAX_PARSER_WALL_S = 300.0
