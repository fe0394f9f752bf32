"""Points that go on with a surface that rays graze, as far as it leads on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from perception.cleaning.neighbours import nearest

_NEIGHBOURS = 24
_MOST_OFF = 0.005
_ON_PLANE = 0.008
_SHARE_ON_PLANE = 0.8
# What is so far off a plane counts a quarter when it is fitted; another surface has no say in the end.
_ROBUST = 0.004
_FITS = 4
# Less steep surfaces show in the depths of the rays beside.
_STEEP = 0.12
# A curtain of mixed pixels lies in a plane with the place its rays started at.
_ASIDE = 0.02
# Points of a surface that rays graze are found from those beside them, at least a few at a time.
_MOST_ROUNDS = 24


def on_grazed_surface(
    points: Float[np.ndarray, "K 3"],
    rays: Float[np.ndarray, "K 3"],
    surface: Float[np.ndarray, "N 3"],
    apart: Float[np.ndarray, "K"],
) -> Bool[np.ndarray, "K"]:
    """Points at most 5 mm off a plane, steep to their rays, that four fifths of the 24 surface points nearest lie on.

    Rays that graze a surface end as far from each other as mixed pixels do, but in one plane, and that plane passes
    the place they started at.  What is found so is of the surface for the points beside it.

    Args:
        points: (K, 3) which to judge [m].
        rays: (K, 3) from where their rays started to each [m].
        surface: (N, 3) points that are known to be of surfaces [m].
        apart: (K,) how far from the nearest of them each may be [m].
    """
    found = np.zeros(len(points), dtype=bool)
    if len(surface) < _NEIGHBOURS or not len(points):
        return found
    near = _Nearest.of(points, surface)
    asked = np.arange(len(points))
    for _ in range(_MOST_ROUNDS):
        asked = asked[near.distance[asked, 0] < apart[asked]]
        new = asked[_goes_on(points[asked], rays[asked], near.among(asked))]
        if not len(new):
            break
        found[new] = True
        asked = near.joined(points, np.flatnonzero(~found), points[new])
    return found


@dataclass
class _Nearest:
    """The surface points nearest to each of some points, ascending.

    Attributes:
        distance: (K, 24) [m].
        place: (K, 24, 3) [m].
    """

    distance: Float[np.ndarray, "K M"]
    place: Float[np.ndarray, "K M 3"]

    @classmethod
    def of(cls, points: Float[np.ndarray, "K 3"], surface: Float[np.ndarray, "N 3"]) -> _Nearest:
        tree = cKDTree(surface, balanced_tree=False, compact_nodes=False)
        distance, index = nearest(tree, points, np.arange(1, _NEIGHBOURS + 1))
        return cls(distance, surface[index])

    def among(self, chosen: Int[np.ndarray, "C"]) -> _Nearest:
        """Of the chosen points only."""
        return _Nearest(self.distance[chosen], self.place[chosen])

    def joined(
        self, points: Float[np.ndarray, "K 3"], chosen: Int[np.ndarray, "C"], new: Float[np.ndarray, "M 3"]
    ) -> Int[np.ndarray, "D"]:
        """Take in further points of the surface; which of the chosen ones have another set of nearest ones then."""
        k = np.arange(1, min(_NEIGHBOURS, len(new)) + 1)
        distance, index = nearest(cKDTree(new), points[chosen], k)
        nearer = distance[:, 0] < self.distance[chosen, -1]
        chosen = chosen[nearer]
        all_distances = np.concatenate([self.distance[chosen], distance[nearer]], axis=1)
        all_places = np.concatenate([self.place[chosen], new[index[nearer]]], axis=1)
        order = np.argsort(all_distances, axis=1, kind="stable")[:, :_NEIGHBOURS]
        self.distance[chosen] = np.take_along_axis(all_distances, order, axis=1)
        self.place[chosen] = np.take_along_axis(all_places, order[:, :, None], axis=1)
        return chosen


def _goes_on(points: Float[np.ndarray, "K 3"], rays: Float[np.ndarray, "K 3"], near: _Nearest) -> Bool[np.ndarray, "K"]:
    """Which points lie in one plane with the surface points nearest to them, steep to their rays."""
    if not len(points):
        return np.zeros(0, dtype=bool)
    around = near.place - points[:, None]
    weight = 1.0 / (1.0 + 4.0 * (near.distance / np.maximum(near.distance[:, -1:], 1e-9)) ** 2) ** 2
    for _ in range(_FITS):
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
    return np.asarray(is_grazed & is_plane & is_on)
