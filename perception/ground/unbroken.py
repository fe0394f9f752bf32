"""Parts of a level that are one surface to stand on, and not slices through things side by side."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage

from perception.ground.floor import FloorPlane

_CELL = 0.05
_AROUND = np.ones((3, 3), dtype=bool)
_MARGIN = 3
_NEAR, _OFF, _OVER = 0.025, 0.04, 0.15  # [m]
_LEAST_INNER = 0.02  # [m^2]
_LEAST_SHARE = 0.85


def is_unbroken(
    points: Float[np.ndarray, "N 3"], own: Float[np.ndarray, "K 3"], plane: FloorPlane
) -> Bool[np.ndarray, "K"]:
    """Return which points of a level belong to wide parts with hardly anything just under or over them.

    Beams in a heap have their upper faces at much the same height here and there, but between them one sees what lies
    lower, and across them what lies higher.  Five centimetres along the border do not count: there are risers.

    Args:
        own: (K, 3) those of the level [m].
    """
    lower = np.floor(own[:, :2].min(axis=0) / _CELL).astype(int) - _MARGIN
    shape = np.floor(own[:, :2].max(axis=0) / _CELL).astype(int) - lower + _MARGIN + 1

    def counted(places: Float[np.ndarray, "M 3"]) -> np.ndarray:
        cells = np.floor(places[:, :2] / _CELL).astype(int) - lower
        cells = cells[((cells >= 0) & (cells < shape)).all(axis=1)]
        return np.bincount(cells @ [shape[1], 1], minlength=shape.prod()).reshape(shape)

    above = plane.above(points)
    n_off = counted(points[(above < -_OFF) | ((above > _OFF) & (above < _OVER))])
    n_on = counted(points[np.abs(above) < _NEAR])
    # Gaps between scan lines are no gaps of the level; where something else is seen it has one.
    closed = ndimage.binary_closing(counted(own) > 0, structure=_AROUND, iterations=2) & (n_on >= n_off)
    label, n_parts = ndimage.label(ndimage.binary_erosion(closed, structure=_AROUND), structure=_AROUND)
    size, on, off = (
        np.bincount(label.ravel(), weights=weights, minlength=n_parts + 1)
        for weights in (np.ones(label.size), n_on.ravel(), n_off.ravel())
    )
    wide = (size * _CELL**2 > _LEAST_INNER) & (on > _LEAST_SHARE * (on + off))
    wide[0] = False
    with_border = ndimage.binary_dilation(wide[label], structure=_AROUND, iterations=3)
    return np.asarray(with_border[tuple((np.floor(own[:, :2] / _CELL).astype(int) - lower).T)])
