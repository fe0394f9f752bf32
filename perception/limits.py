"""Size limits of cloud files, and limits of the process that parses them."""

from __future__ import annotations

# Points of a cloud, including rays without a return; a larger file is thinned to this number while it is read.
MAX_POINTS = 2_000_000
# Size of a file.
MAX_FILE_POINTS = 50_000_000
MAX_FILE_BYTES = 512 * 2**20
# Data held in memory at once: a small file, text after thinning, or one compressed block.
MAX_WHOLE_BYTES = 64 * 2**20
MAX_INVALID_FRACTION = 0.95
# Largest valid coordinate [m, or the file's unit].
LARGEST_COORDINATE = 1e9

# Limits of the process that parses a file.
MAX_PARSER_BYTES = 2**30
MAX_PARSER_CPU_S = 30
MAX_PARSER_WALL_S = 300.0
