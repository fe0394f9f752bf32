"""Whether the faces of a bar end where the bar does, or run on as those of something larger."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from perception.detect.shared.bars import Bar
from perception.sightlines import Sightlines

# How far off a face's plane a ray's end may lie, and how much further for each unit of the slope it met it at [m].
_OFF, _OFF_BY_SLOPE = 0.01, 0.02
_REACH = 0.6
_SHARE, _ALONG = 0.5, 0.35


def in_line(bar: Bar, rays: Sightlines) -> Bool[np.ndarray, "N"]:
    """Which rays ended beside a bar, level with one of its faces that is seen; a round bar has none.

    Args:
        bar: of any section.
        rays: about it.
    """
    if bar.section == "round" or not len(rays):
        return np.zeros(len(rays), dtype=bool)
    half, frame = np.array(bar.half), bar.frame[1:]
    seen = np.sign((rays.start.mean(axis=0) - bar.centre) @ frame.T)
    across = (rays.ends - bar.centre) @ frame.T
    # Noise lies along the rays: those that graze a face end close to its plane, or on something else behind it.
    level = np.abs(across * seen - half) < _OFF + _OFF_BY_SLOPE * np.abs(rays.direction @ frame.T)
    beside = (np.abs(across) > half) & (np.abs(across) < half + _REACH)
    return np.asarray((level & beside[:, ::-1]).any(axis=1))


def runs_on(
    level: Bool[np.ndarray, "K"],
    free: Bool[np.ndarray, "K"],
    outside: Float[np.ndarray, "K"],
    part: Int[np.ndarray, "K"],
    n_parts: int,
) -> Bool[np.ndarray, "P"]:
    """In which parts of a bar's side most rays beside it met a surface level with its face, and met it
    before air.

    What looks like a board there is the rim of a panel, or the narrow side of a slab; where air comes first, few rays
    met it or it is along little of the bar, what is level with the face is another thing.

    Args:
        level: which of the rays ended level with a face.
        free: which of the others went on.
        outside: how far each passes the bar [m].
        part: of the bar's length that each passes.
        n_parts: how many there are.
    """
    n_level, n_free = (np.bincount(part[those], minlength=n_parts) for those in (level, free))
    of_level, of_free = (np.bincount(part[those], outside[those], n_parts) for those in (level, free))
    is_nearer = (n_free == 0) | (of_level * n_free <= of_free * n_level)
    larger = (n_level > 0) & (n_level >= _SHARE * (n_level + n_free)) & is_nearer
    # In a heap something or other is level with a face here and there.
    return np.asarray(larger & (larger.sum() >= _ALONG * ((n_level + n_free) > 0).sum()))
