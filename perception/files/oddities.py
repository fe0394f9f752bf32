"""What rows of a file show of how it was made: no-returns written as zeros, coordinates rounded to float32."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from perception.errors import CloudError
from perception.files.scan import Scan
from perception.limits import LARGEST_COORDINATE, MAX_INVALID_FRACTION

# No coordinate is that large in any unit; drivers write such numbers, or infinity, where there was no return.
# Rounding that hides what a robot must not touch.
_COARSE_M = 0.001
_SAMPLE = 10_000


def without_empty_rows(scan: Scan, name: str) -> Scan:
    """Rows that cannot be points are NaN afterwards; those that are exactly 0 0 0, a driver's no-return, are dropped.

    A single one may be a point by chance; a scan never meets the same place twice to the last digit.

    Raises:
        CloudError: all are 0 0 0, or nearly all too large to be places.
    """
    points = _bounded(scan.points)
    n_beyond = int((np.isfinite(scan.points).all(axis=1) & ~np.isfinite(points).all(axis=1)).sum())
    if n_beyond > MAX_INVALID_FRACTION * len(points):
        raise CloudError(
            f"{name}: {n_beyond} of {len(points)} points lie beyond {LARGEST_COORDINATE:g}; are x, y, z other columns, "
            "or its bytes in another order?"
        )
    scan = replace(
        scan,
        points=points,
        misses=_bounded(scan.misses),
        starts=None if scan.starts is None else _bounded(scan.starts),
        miss_starts=None if scan.miss_starts is None else _bounded(scan.miss_starts),
    )
    zero: Bool[np.ndarray, "N"] = (points == 0.0).all(axis=1)
    n_zero = int(zero.sum())
    if n_zero < 2:
        return scan
    if n_zero == len(points):
        raise CloudError(f"{name}: all {n_zero} points are 0 0 0; coordinates are needed")
    starts = scan.starts if scan.starts is None or scan.starts.ndim == 1 else scan.starts[~zero]
    note = f"dropped {n_zero} points of {len(points)} that are exactly 0 0 0, as drivers write where nothing came back"
    return replace(scan, points=points[~zero], starts=starts, notes=(*scan.notes, note))


def _bounded(rows: Float[np.ndarray, "*N 3"]) -> Float[np.ndarray, "*N 3"]:
    return np.where(np.abs(rows) <= LARGEST_COORDINATE, rows, np.nan)


def rounding_note(points: Float[np.ndarray, "N 3"], metres: float) -> tuple[str, ...]:
    """Tell coordinates so far from zero that float32, in which they all are, rounds them coarsely.

    Args:
        points: as they stand in the file.
        metres: length of the file's unit [m].
    """
    sample = points[:: max(1, len(points) // _SAMPLE)]
    sample = sample[np.isfinite(sample).all(axis=1)]
    if not len(sample) or not np.array_equal(sample, sample.astype(np.float32)):
        return ()
    step = metres * float(np.spacing(np.abs(sample).max().astype(np.float32)))
    if step < _COARSE_M:
        return ()
    return (
        f"coordinates this far from zero are rounded to {step:.2g} m in float32, in which the file holds them; "
        "export it as double, or relative to a near place",
    )
