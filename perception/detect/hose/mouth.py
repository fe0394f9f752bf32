"""A tube's end settled by its own returns: the cylinder through them, and where along it they most likely end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares
from scipy.special import ndtr

from perception.detect.hose.tube import Tube, square_to
from perception.sightlines import Sightlines

_SIGMA_RANGE = 0.01
_LEAST_SIGMA = 0.003
_WALL = 0.009
_BEHIND, _AHEAD = 0.045, 0.03
_SHIFTS = np.arange(-0.03, 0.0201, 0.001)
_ON_RIM = np.array([0.02, 0.1, 0.2, 0.35, 0.5, 0.7])
_STRAY = 0.03
_LEAST_HITS = 15
# How far from the wall returns may lie in each round; of its thickness; of what a fit may change [m, rad].
_ROUNDS = (0.014, 0.009, 0.009)
_THICK = 0.003
_LEAST_SIGMA_ACROSS = 0.002
_SCATTERED, _MOST = 1.5, 3.0
_AS_BEFORE = np.array([0.1, 0.1, 0.01, 0.01, 0.006])


def settled(rays: Sightlines, tube: Tube) -> Tube:
    """The tube of least squares through the returns from its wall, as long as they most likely go.

    Args:
        rays: all that pass its end.
        tube: near it.
    """
    for near in _ROUNDS:
        tube = with_mouth_settled(rays, _through_returns(rays, tube, near))
    return tube


def _through_returns(rays: Sightlines, tube: Tube, near: float) -> Tube:
    """The tube turned, moved aside and widened to lie through the returns near its wall, each as sure as its ray is
    along the wall; those on its inside lie deeper than those on its outside."""
    across, over = square_to(tube.axis)
    ends = rays.ends - tube.mouth
    place = ends @ np.column_stack([across, over, tube.axis])
    way = rays.direction @ np.column_stack([across, over, tube.axis])
    reach = np.hypot(place[:, 0], place[:, 1])
    radial = (place[:, :2] * way[:, :2]).sum(axis=1) / np.maximum(reach, 1e-6)
    sigma = np.hypot(_SIGMA_RANGE * radial, _LEAST_SIGMA_ACROSS)
    mine = np.abs(reach - tube.radius) < near + _SCATTERED * sigma
    mine &= (place[:, 2] > -_BEHIND) & (place[:, 2] < 0.5 * _AHEAD)
    if mine.sum() < _LEAST_HITS:
        return tube
    place, radial, sigma = place[mine], radial[mine], sigma[mine]
    depth = np.where(radial > 0.0, _THICK, 0.0)

    def residuals(change: Float[np.ndarray, "5"]) -> Float[np.ndarray, "K"]:
        aside = place[:, :2] - change[2:4] - place[:, 2:] * change[:2]
        return np.asarray((np.hypot(aside[:, 0], aside[:, 1]) - tube.radius - change[4] + depth) / sigma)

    def with_prior(change: Float[np.ndarray, "5"]) -> Float[np.ndarray, "L"]:
        # Returns on one side alone leave some changes open: those stay small.
        return np.concatenate([residuals(change), change / _AS_BEFORE])

    change = least_squares(with_prior, np.zeros(5), loss="soft_l1", max_nfev=30).x
    if (np.abs(change) > _MOST * _AS_BEFORE).any():
        return tube
    axis = tube.axis + change[0] * across + change[1] * over
    mouth = tube.mouth + change[2] * across + change[3] * over
    return Tube(mouth, axis / np.linalg.norm(axis), tube.radius + float(change[4]))


def with_mouth_settled(rays: Sightlines, tube: Tube) -> Tube:
    """The tube moved along its axis to where its returns most likely end.

    Looked into, range noise carries returns of wall and rim beyond the mouth; a tube that reaches as far as they do
    would be too long.  Returns are taken to spread evenly over the wall, with some on the rim and few anywhere.
    """
    offset = rays.ends - tube.mouth
    along = offset @ tube.axis
    across = np.linalg.norm(offset - along[:, None] * tube.axis, axis=1)
    mine = (np.abs(across - tube.radius) < _WALL) & (along > -_BEHIND) & (along < _AHEAD)
    if mine.sum() < _LEAST_HITS:
        return tube
    place = along[mine]
    sigma = np.maximum(np.abs(rays.direction[mine] @ tube.axis) * _SIGMA_RANGE, _LEAST_SIGMA)
    z = (_SHIFTS[:, None] - place) / sigma
    wall = ndtr(z) / (_BEHIND + _SHIFTS[:, None])
    rim = np.exp(-0.5 * z**2) / (np.sqrt(2.0 * np.pi) * sigma)
    stray = _STRAY / (_BEHIND + _AHEAD)
    share = _ON_RIM[:, None, None]
    likelihood = np.log((1.0 - _STRAY) * (share * rim + (1.0 - share) * wall) + stray).sum(axis=2).max(axis=0)
    return replace(tube, mouth=tube.mouth + float(_SHIFTS[np.argmax(likelihood)]) * tube.axis)
