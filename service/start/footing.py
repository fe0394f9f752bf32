"""What planted feet stand on at the start: a scanned floor is moved to the soles, any other must be there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.scene import ConvexPiece
from service.verify.ground import GROUND_TOLERANCE_M, ground_gaps

FLOOR_KIND = "floor"
LARGEST_SHIFT_M = 0.03  # of a scanned floor: its height is that uncertain


def floor_at_soles(
    seen: Sequence[ConvexPiece], soles: Mapping[str, Float[np.ndarray, "C 3"]]
) -> tuple[tuple[ConvexPiece, ...], tuple[str, ...]]:
    """What a scan showed, its floor moved up or down to planted soles where it is near them, and a note about that.

    Args:
        seen: pieces of a scan.
        soles: for each planted link, the corners of its sole in the world [m].
    """
    floors = [piece for piece in seen if piece.kind == FLOOR_KIND]
    if not floors or not soles:
        return tuple(seen), ()
    gaps = ground_gaps(np.vstack(list(soles.values())), floors)
    shift = 0.5 * float(gaps.min() + gaps.max())
    if np.abs(gaps).max() <= GROUND_TOLERANCE_M or not np.abs(gaps).max() <= LARGEST_SHIFT_M:
        return tuple(seen), ()
    moved = tuple(
        replace(piece, vertices=piece.vertices + np.array([0.0, 0.0, shift])) if piece.kind == FLOOR_KIND else piece
        for piece in seen
    )
    way = "up" if shift > 0.0 else "down"
    note = (
        f"the scanned floor was moved {way} by {1e3 * abs(shift):.1f} mm to the soles of {', '.join(soles)}; "
        f"at most {1e3 * LARGEST_SHIFT_M:.0f} mm"
    )
    return moved, (note,)


def ground_problems(
    pieces: Sequence[ConvexPiece], soles: Mapping[str, Float[np.ndarray, "C 3"]]
) -> Iterator[tuple[str, str]]:
    """Each planted link that stands on nothing, with a line that says so."""
    for link, corners in soles.items():
        gaps = ground_gaps(corners, pieces)
        worst = float(gaps[np.abs(gaps).argmax()])
        if not np.isfinite(worst):
            yield link, f"nothing is below a corner of the sole of {link}; scene.floor or an obstacle there would do"
        elif abs(worst) > GROUND_TOLERANCE_M:
            side = "below" if worst > 0.0 else "above"
            yield (
                link,
                f"the floor is {1e3 * abs(worst):.1f} mm {side} the sole of {link}; at most "
                f"{1e3 * GROUND_TOLERANCE_M:.0f} mm would do: move start.base, or leave it out",
            )
