"""Objects of any kind where a person clicked: proposals from the points there, fitted and rated on the rays."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from perception.detect.engine.extend import extend_parts, spread_angles
from perception.detect.engine.refine import Hypotheses, rate_ends
from perception.detect.engine.region import Mounting
from perception.detect.engine.search import CLICK, PART, Fit, Site, begin, search
from perception.detect.engine.surroundings import CLICKED, Surroundings
from perception.detect.engine.template import Starts, Template
from perception.sightlines import SightIndex

_SCREENED = 120  # hypotheses left after a look at the points alone
_FEW_POINTS = 60
_FEWEST, _FEWEST_SLENDER = 8, 4
_GOLDEN = np.pi * (1.0 + np.sqrt(5.0))


def fit_at(template: Template, around: Surroundings, index: SightIndex) -> list[Fit]:
    """Return the fits of a template about a click that the rays support best, best first."""
    part = None if template.starts is None else template.starts.part
    if part is None:
        fits = search(template, propose(template, around), index, effort=CLICK)
    else:
        parts = [one for _, one in begin(part, propose(part, around), index, PART)]
        fits = extend_parts(template, parts, around.points, index)
    return [fit for fit in fits if np.linalg.norm(fit.middle - around.click) < CLICKED + 0.5 * template.radius]


def propose(template: Template, around: Surroundings) -> list[Site]:
    """Return a site for each plane that may hold the object, or one without, with hypotheses at the points there."""
    starts = template.starts
    if starts is None:
        return []
    if template.mount not in ("support", "face"):
        turned = _list_directions(starts)
        site = _make_site(template, around, None, around.points, turned, np.full(len(turned), np.nan))
        return [] if site is None else [site]
    sites = []
    for plane in around.supports if template.mount == "support" else around.faces:
        over = plane.height(around.points)
        loose = around.points[(over > max(starts.over[0], 3.0 * plane.sigma)) & (over < starts.over[1])]
        turns = Rotation.from_rotvec(np.outer(spread_angles(starts.n_turns), plane.frame[2])).as_matrix()
        turned = np.einsum("tij,jk,pkl->ptil", turns, plane.frame.T, starts.postures).reshape(-1, 3, 3)
        site = _make_site(template, around, plane, loose, turned, np.repeat(starts.lifts, starts.n_turns))
        if site is not None:
            sites.append(site)
    return sites


def _list_directions(starts: Starts) -> Float[np.ndarray, "D 3 3"]:
    """Return rotations that lead the spread axis of an object to directions all over the sphere, each spun about it."""
    i = np.arange(starts.n_turns) + 0.5
    z = 1.0 - 2.0 * i / starts.n_turns
    r = np.sqrt(1.0 - z * z)
    ways = np.column_stack([r * np.cos(_GOLDEN * i), r * np.sin(_GOLDEN * i), z])
    axis = np.eye(3)[starts.spread]
    lead = np.stack([Rotation.align_vectors(way[None], axis[None])[0].as_matrix() for way in ways])
    spins = Rotation.from_rotvec(np.outer(spread_angles(starts.n_spins), axis)).as_matrix()
    return np.asarray(np.einsum("dij,sjk->dsik", lead, spins).reshape(-1, 3, 3))


def _make_site(
    template: Template,
    around: Surroundings,
    plane: Mounting | None,
    loose: Float[np.ndarray, "K 3"],
    turned: Float[np.ndarray, "R 3 3"],
    lifts: Float[np.ndarray, "R"],
) -> Site | None:
    """Return a site with a hypothesis for each place, rotation and start sizes; None with few points.

    Args:
        loose: (K, 3) points that the object may explain [m].
        lifts: height of the origin over the plane for each rotation; NaN where the places have it [m].
    """
    starts = template.starts
    assert starts is not None
    places = around.places(loose, min(0.6 * template.radius, starts.near))
    some = loose[np.linalg.norm(loose - around.click, axis=1) < template.radius]
    if not len(places) or len(some) < _FEWEST:
        return None
    normal = np.array([0.0, 0.0, 1.0]) if plane is None else plane.frame[2]
    rotation, middles = np.tile(turned, (len(places), 1, 1)), np.repeat(places, len(turned), axis=0)
    lift = np.tile(lifts, len(places))
    if starts.is_slender:
        along, at = _follow_points(loose, places, starts, None if plane is None else normal)
        rotation, middles = np.concatenate([along, rotation]), np.concatenate([at, middles])
        lift = np.append(np.full(len(along), np.nan), lift)
    n_sizes, n_posed = len(starts.sizes), len(rotation)
    sizes = np.repeat(starts.sizes, n_posed, axis=0)
    rotation, lift = np.tile(rotation, (n_sizes, 1, 1)), np.tile(lift, n_sizes)
    middle = template.middle(template.named(sizes))
    place = np.tile(middles, (n_sizes, 1)) - np.einsum("bij,bj->bi", rotation, middle)
    if plane is not None:
        place = place + np.where(np.isnan(lift), 0.0, lift - plane.height(place))[:, None] * normal
    begun = Hypotheses.of(rotation, place, sizes, normal)
    off = np.linalg.norm(np.tile(middles, (n_sizes, 1)) - around.click, axis=1)
    begun = begun.select(np.flatnonzero(off < CLICKED + 0.5 * template.radius))
    rating = rate_ends(template, begun, some[:: max(1, len(some) // _FEW_POINTS)])
    best = np.argsort(-rating, kind="stable")[:_SCREENED]
    return Site(around.click, plane, begun.select(best))


def _follow_points(
    loose: Float[np.ndarray, "K 3"],
    places: Float[np.ndarray, "P 3"],
    starts: Starts,
    normal: Float[np.ndarray, "3"] | None,
) -> tuple[Float[np.ndarray, "R 3 3"], Float[np.ndarray, "R 3"]]:
    """Return rotations that lead a slender object's x along the points about each place, both ways, and the places.

    Args:
        normal: (3,) of the plane that holds it, which its z follows; None: z is turned about x.
    """
    rotations, at = [], []
    for place in places:
        near = loose[np.linalg.norm(loose - place, axis=1) < starts.near] - place
        if len(near) < _FEWEST_SLENDER:
            continue
        along = np.linalg.svd(near, full_matrices=False)[2][0]
        if normal is not None:
            along = along - (along @ normal) * normal
        along = along / max(float(np.linalg.norm(along)), 1e-9)
        across = np.cross(np.eye(3)[int(np.argmin(np.abs(along)))], along) if normal is None else normal
        across = across / np.linalg.norm(across)
        for sign in (1.0, -1.0):
            frame = np.column_stack([sign * along, np.cross(across, sign * along), across])
            spins = Rotation.from_rotvec(np.outer(spread_angles(starts.n_spins), [1.0, 0.0, 0.0])).as_matrix()
            rotations += [frame @ spin for spin in spins]
            at += [place] * len(spins)
    return np.reshape(rotations, (-1, 3, 3)), np.reshape(at, (-1, 3))
