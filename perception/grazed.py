"""Whether a point goes on with a surface that rays graze."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

_NEIGHBOURS = 24
_MOST_OFF = 0.005
_ON_PLANE = 0.008
_SHARE_ON_PLANE = 0.8
# What is so far off a plane counts a quarter when it is fitted; another surface has no say in the end.
_ROBUST = 0.004
_ROUNDS = 4
# Less steep surfaces show in the depths of the rays beside.
_STEEP = 0.12
# A curtain of mixed pixels lies in a plane with the place its rays started at.
_ASIDE = 0.02


def on_grazed_surface(
    points: Float[np.ndarray, "K 3"],
    rays: Float[np.ndarray, "K 3"],
    surface: Float[np.ndarray, "N 3"],
    apart: Float[np.ndarray, "K"],
) -> Bool[np.ndarray, "K"]:
    """Points at most 5 mm off a plane, steep to their rays, that four fifths of the 24 surface points nearest lie on.

    Rays that graze a surface end as far from each other as mixed pixels do, but in one plane, and that plane passes
    the place they started at.

    Args:
        points: (K, 3) which to judge [m].
        rays: (K, 3) from where their rays started to each [m].
        surface: (N, 3) points that are known to be of surfaces [m].
        apart: (K,) how far from the nearest of them each may be [m].
    """
    if len(surface) < _NEIGHBOURS or not len(points):
        return np.zeros(len(points), dtype=bool)
    nearest = np.arange(1, _NEIGHBOURS + 1)
    distance, neighbours = map(np.asarray, cKDTree(surface).query(points, k=nearest, workers=-1))
    around = surface[neighbours] - points[:, None]
    weight = 1.0 / (1.0 + 4.0 * (distance / np.maximum(distance[:, -1:], 1e-9)) ** 2) ** 2
    for _ in range(_ROUNDS):
        share = weight / weight.sum(axis=1, keepdims=True)
        centre = np.einsum("nk,nki->ni", share, around)
        relative = around - centre[:, None]
        normal = np.linalg.eigh(np.einsum("nk,nki,nkj->nij", share, relative, relative))[1][:, :, 0]
        off = np.einsum("nki,ni->nk", relative, normal)
        weight = 1.0 / (1.0 + (off / _ROBUST) ** 2) ** 2
    aside = np.abs(np.einsum("ni,ni->n", rays, normal))
    is_grazed = (aside < _STEEP * np.linalg.norm(rays, axis=1)) & (aside > _ASIDE)
    is_plane = (np.abs(off) < _ON_PLANE).mean(axis=1) >= _SHARE_ON_PLANE
    is_on = np.abs(np.einsum("ni,ni->n", centre, normal)) < _MOST_OFF
    return np.asarray(is_grazed & is_plane & is_on & (distance[:, 0] < apart))
