"""Limits of the cloud files that are read."""

from __future__ import annotations

# Of a cloud, the rays that met nothing included; a larger file is thinned to that while it is read.
MAX_POINTS = 2_000_000
# Of a file.
MAX_FILE_POINTS = 20_000_000
MAX_FILE_BYTES = 512 * 2**20
# Of what must be in memory as a whole: small files, text after thinning, and what is packed in one block.
MAX_WHOLE_BYTES = 64 * 2**20
MAX_INVALID_FRACTION = 0.95
# No coordinate is larger [m, or whatever unit a file is in].
LARGEST_COORDINATE = 1e9

# Of the process that parses a file.
MAX_PARSER_BYTES = 2**30
MAX_PARSER_CPU_S = 30
MAX_PARSER_WALL_S = 300.0
