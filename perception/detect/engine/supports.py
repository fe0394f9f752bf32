"""Places on level surfaces where an object may stand or lie."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from costs.stopping import poll
from perception.cleaning.clean import voxel_downsample
from perception.detect.engine.refine import Hypotheses, rate_ends
from perception.detect.engine.region import Mounting
from perception.detect.engine.search import Site
from perception.detect.engine.template import Template
from perception.detect.shared.arithmetic import sum_about
from perception.detect.shared.local import best_about
from perception.view import View

_VOXEL, _STEP = 0.012, 0.055  # of points, between places [m]
_ABOUT_HINT = 0.16  # [m]
_LEVEL_BAND = 0.015
_MOST_SITES, _MOST_HERE = 24, 12
_SCREENED, _FEW_POINTS = 4, 40  # one of so many hypotheses, and points, by which sites are compared
_LAYER, _CELL, _LEAST_CELLS, _APART = 0.01, 0.03, 40, 0.08


def standing_sites(
    view: View,
    template: Template,
    postures: Float[np.ndarray, "P 3 3"],
    lifts: Float[np.ndarray, "P"],
    n_yaws: int,
    height: tuple[float, float],
    hint: Float[np.ndarray, "3"] | None,
    sizes: Float[np.ndarray, "K S"],
) -> list[Site]:
    """Return the likeliest sites on level surfaces, each with its likeliest hypotheses, by points alone.

    Args:
        postures: orientations on the support, before the yaw.
        lifts: height of the origin over the support in each posture [m].
        height: over the support in which an object has points [m].
        sizes: sizes to begin with [m].
    """
    points, _ = voxel_downsample(view.obstacles, _VOXEL)
    if hint is not None:
        points = points[np.linalg.norm(points - hint, axis=1) < 0.8]
    if len(points) < 30:
        return []
    levels = level_heights(points)
    if view.floor is not None:
        levels.append(float(view.floor.height(points[:, :2].mean(axis=0, keepdims=True))[0]))
    rated: list[tuple[float, Site, Float[np.ndarray, "K 3"]]] = []
    for level in levels:
        poll()
        rated += _on_level(points, level, template, postures, lifts, n_yaws, height, hint, sizes)
    likely = sorted(rated, key=lambda one: -one[0])[:_MOST_SITES]
    return [_keep_likely(template, site, points) for _, site, points in likely]


def _keep_likely(template: Template, site: Site, points: Float[np.ndarray, "K 3"]) -> Site:
    """Return a site with the hypotheses that most of its points lie on."""
    best = np.argsort(-rate_ends(template, site.begun, points), kind="stable")[:_MOST_HERE]
    return Site(site.place, site.mounting, site.begun.select(best))


def _on_level(
    points: Float[np.ndarray, "N 3"],
    level: float,
    template: Template,
    postures: Float[np.ndarray, "P 3 3"],
    lifts: Float[np.ndarray, "P"],
    n_yaws: int,
    height: tuple[float, float],
    hint: Float[np.ndarray, "3"] | None,
    sizes: Float[np.ndarray, "K S"],
) -> list[tuple[float, Site, Float[np.ndarray, "K 3"]]]:
    """Return sites on one level with their ratings and points."""
    over = points[:, 2] - level
    layer = points[(over > 0.02) & (over < height[1])]
    board = points[np.abs(over) < _LEVEL_BAND]
    if len(layer) < 20 or len(board) < 20:
        return []
    cells = np.unique(np.round(layer[:, :2] / _STEP).astype(int), axis=0) * _STEP
    tree, foot = cKDTree(layer[:, :2]), cKDTree(board[:, :2])
    if hint is not None:
        cells = cells[np.linalg.norm(cells - hint[:2], axis=1) < _ABOUT_HINT]
    yaws = np.linspace(0.0, 2.0 * np.pi, n_yaws, endpoint=False)
    about_up = np.stack(
        [
            np.stack([np.cos(yaws), -np.sin(yaws), 0.0 * yaws], axis=-1),
            np.stack([np.sin(yaws), np.cos(yaws), 0.0 * yaws], axis=-1),
            np.tile([0.0, 0.0, 1.0], (n_yaws, 1)),
        ],
        axis=1,
    )
    rotation = np.einsum("yij,pjk->pyik", about_up, postures).reshape(-1, 3, 3)
    lift = np.tile(np.repeat(lifts, n_yaws), len(sizes))
    sizes = np.repeat(sizes, len(rotation), axis=0)
    rotation = np.tile(rotation, (len(sizes) // len(rotation), 1, 1))
    middle = np.einsum("bij,bj->bi", rotation, template.middle(template.named(sizes)))
    # Rough scores need a place within about 2 cm: move each to the middle of the points about it.
    cells = np.array([layer[tree.query_ball_point(cell, 0.5 * template.radius), :2].mean(axis=0) for cell in cells])
    if len(cells):
        cells = cells[best_about(cells, 0.5 * _STEP, 1)]
    sites = []
    for cell in cells:
        near = layer[tree.query_ball_point(cell, 0.6 * template.radius)]
        if len(near) < 12 or np.percentile(near[:, 2], 95) - level < height[0]:
            continue
        beside = board[foot.query_ball_point(cell, 1.2 * template.radius)]
        if len(beside) < 8:
            continue
        here = float(np.median(beside[:, 2]))
        sigma = float(np.clip(1.48 * np.median(np.abs(beside[:, 2] - here)), 0.002, 0.01))
        place = np.array([*cell, here])
        origin = np.column_stack([cell - middle[:, :2], here + lift])
        mounting = Mounting(np.eye(3), place, sigma)
        begun = Hypotheses.of(rotation, origin, sizes, np.array([0.0, 0.0, 1.0]))
        about = layer[tree.query_ball_point(cell, template.radius)]
        some = about[:: max(1, len(about) // _FEW_POINTS)]
        rating = rate_ends(template, begun.select(range(0, len(begun), _SCREENED)), some).max() * len(about) / len(some)
        sites.append((float(rating), Site(place + np.array([0.0, 0.0, 0.25 * height[1]]), mounting, begun), some))
    return sites


def level_heights(points: Float[np.ndarray, "N 3"]) -> list[float]:
    """Return heights at which points fill a level area of at least about 4 square decimetres, lowest first [m]."""
    poll()
    if not len(points):
        return []
    bottom = float(points[:, 2].min())
    layer = np.floor((points[:, 2] - bottom) / _LAYER).astype(np.int64)
    cells = np.floor(points[:, :2] / _CELL).astype(np.int64)
    distinct = np.unique(np.column_stack([layer, cells]), axis=0)
    area = np.bincount(distinct[:, 0], minlength=int(layer.max()) + 1).astype(float)
    # Range noise spreads a surface over two or three layers; walls fill all layers alike.
    thick = sum_about(area, (1.0, 1.0, 1.0))
    beyond = sum_about(area, (0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5))
    excess = thick - 1.5 * beyond
    heights: list[float] = []
    for i in np.argsort(-excess, kind="stable").tolist():
        if excess[i] < _LEAST_CELLS:
            break
        near = points[np.abs(points[:, 2] - bottom - (i + 0.5) * _LAYER) < 1.5 * _LAYER, 2]
        height = float(np.median(near))
        if all(abs(height - other) > _APART for other in heights):
            heights.append(height)
    return sorted(heights)
