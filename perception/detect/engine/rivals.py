"""Rivals of a template: a box, a cylinder, the template with its hollows filled, and planes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from perception.detect.engine.primitives import Box, Cylinder, Primitive
from perception.detect.engine.refine import Hypotheses, refine
from perception.detect.engine.region import Region
from perception.detect.engine.score import Evidence, weigh
from perception.detect.engine.template import Looseness, Part, Size, Template, columns

_RAYS = 200
_GATES = (0.025, 0.015, 0.01)  # of the refinement of a rival [m]
_THIN = 0.008  # least half extent of a rival to begin with [m]
_LEAST, _MOST, _SPREAD = 0.004, 1.5, 1.0  # limits and spread of a rival's half extents, which have no usual value [m]
_FEWEST_RAYS = 8
_N_WAYS = 72
_FEWEST = 6


def _ways() -> Float[np.ndarray, "W 3"]:
    """Return directions spread evenly over a half sphere (Fibonacci lattice)."""
    i = np.arange(_N_WAYS) + 0.5
    z = i / _N_WAYS
    angle = np.pi * (1.0 + np.sqrt(5.0)) * i
    r = np.sqrt(1.0 - z * z)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])


_WAYS = _ways()


def flat_shares(points: Float[np.ndarray, "K 3"], sigma: float) -> tuple[float, float]:
    """Return the share of points on their best plane, and on that and a second one."""
    if len(points) < _FEWEST:
        return 1.0, 1.0
    first = _on_plane(points, sigma)
    rest = points[~first]
    second = int(_on_plane(rest, sigma).sum()) if len(rest) >= _FEWEST else len(rest)
    return float(first.mean()), float((first.sum() + second) / len(points))


def _on_plane(points: Float[np.ndarray, "K 3"], sigma: float) -> Bool[np.ndarray, "K"]:
    """Return which points lie within two standard deviations of their fullest plane."""
    width = 4.0 * sigma
    # Coarse: directions are 0.2 rad apart, so that a plane's points fill a slab that grows with their extent.
    extent = float(np.linalg.norm(points.std(axis=0)))
    heights = np.sort(points @ _WAYS.T, axis=0)
    n_within = [
        (np.searchsorted(column, column + width + 0.1 * extent, side="right") - np.arange(len(column)))
        for column in heights.T
    ]
    best = int(np.argmax([counts.max() for counts in n_within]))
    low = heights[int(np.argmax(n_within[best])), best]
    height = points @ _WAYS[best]
    near = (height >= low) & (height <= low + width + 0.1 * extent)
    for _ in range(4):
        if near.sum() < 4:
            break
        centre = points[near].mean(axis=0)
        _, _, axes = np.linalg.svd(points[near] - centre, full_matrices=False)
        near = np.abs((points - centre) @ axes[2]) < 0.5 * width
    return np.asarray(near)


def lead_over_rivals(template: Template, fit: Hypotheses, region: Region) -> float:
    """Return by how much a fit explains each ray better than its best rival does, as a log-likelihood ratio.

    Rivals begin where the fit's own points lie and are refined on the same rays: what is a box, a cylinder, or a block
    of the object's outline is explained by these at least as well.
    """
    few = region.thin(_RAYS)
    own = weigh(template, fit, few)
    points = few.ends[own.hit[0] & ~few.is_other]
    rivals: list[Evidence] = []
    if len(points) >= _FEWEST:
        for rival, begun in _solid_rivals(template, fit, points, region.radius):
            rivals.append(weigh(rival, refine(rival, begun, few, _GATES).hypotheses, few))
    if template.hollows(template.named(fit.sizes)):
        filled = _fill(template)
        rivals.append(weigh(filled, refine(filled, fit, few, _GATES).hypotheses, few))
    n_rays = max(int(own.hit[0].sum()), _FEWEST_RAYS)
    best = max((float(one.gain.max()) for one in rivals), default=0.0)
    return float((own.gain[0] - max(best, 0.0)) / n_rays)


def _fill(template: Template) -> Template:
    """Return a template whose hollows are solid."""

    def build(sizes: dict[str, Float[np.ndarray, "B"]]) -> tuple[Part, ...]:
        return (*template.build(sizes), *(Part("filling", box, False) for box in template.hollows(sizes)))

    return replace(template, build=build, hollows=lambda sizes: ())


def _solid_rivals(
    template: Template, fit: Hypotheses, points: Float[np.ndarray, "K 3"], radius: float
) -> list[tuple[Template, Hypotheses]]:
    """Return a box and a cylinder about a fit's points, along its own axes and along theirs."""
    centred = points - points.mean(axis=0)
    _, _, axes = np.linalg.svd(centred, full_matrices=False)
    axes[2] *= np.sign(np.linalg.det(axes))
    places, halves, frames = [], [], []
    for frame in (fit.rotation[0].T, axes):
        low, high = np.percentile(points @ frame.T, [2, 98], axis=0)
        places.append(0.5 * (low + high) @ frame)
        halves.append(np.maximum(0.5 * (high - low), _THIN))
        frames.append(frame.T)
    half = np.array(halves)
    box = Hypotheses.of(np.stack(frames), np.array(places), half, np.array([0.0, 0.0, 1.0]))
    long = half.argmax(axis=1)
    radii = np.array([np.delete(row, i).max() for row, i in zip(half, long, strict=True)])
    turned = np.stack([frame @ _TO_X[i] for frame, i in zip(frames, long, strict=True)])
    sizes = np.column_stack([half.max(axis=1), radii])
    cylinder = Hypotheses.of(turned, np.array(places), sizes, np.array([0.0, 0.0, 1.0]))
    return [(_rival(template, radius, "abc", _box), box), (_rival(template, radius, "ab", _cylinder), cylinder)]


_TO_X = [Rotation.align_vectors(axis[None], [[1.0, 0.0, 0.0]])[0].as_matrix() for axis in np.eye(3)]


def _box(s: dict[str, Float[np.ndarray, "B"]]) -> Primitive:
    return Box(columns(0.0 * s["a"], 0.0, 0.0), columns(s["a"], s["b"], s["c"]))


def _cylinder(s: dict[str, Float[np.ndarray, "B"]]) -> Primitive:
    return Cylinder(columns(-s["a"], 0.0, 0.0), columns(s["a"], 0.0, 0.0), s["b"])


def _rival(
    template: Template, radius: float, sizes: Sequence[str], solid: Callable[[dict[str, np.ndarray]], Primitive]
) -> Template:
    """Return a template of one solid whose half extents are free."""
    return Template(
        kind="rival",
        sizes=tuple(Size(name, _LEAST, _MOST, 0.5 * _SPREAD, _SPREAD, "free") for name in sizes),
        build=lambda s: (Part("solid", solid(s)),),
        hollows=lambda s: (),
        mount="none",
        looseness=Looseness(tilt=1.0, height=1.0),
        reach=radius,
        middle=lambda s: columns(0.0 * s["a"], 0.0, 0.0),
        model_sigma=template.model_sigma,
    )
