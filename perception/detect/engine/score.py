"""Evidence of the rays for a template: what ended on it, what passed it, what lies beside it, and against rivals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from costs.stopping import poll
from perception.detect.engine.primitives import Box, Primitive
from perception.detect.engine.refine import Hypotheses
from perception.detect.engine.region import Region
from perception.detect.engine.template import Template

_STEPS = 16  # of sphere tracing
_CLOSE = 1e-3  # distance that counts as a hit [m]
_BEYOND = 0.3  # depth of clutter behind and before an object [m]
_P_HIT, _P_BEFORE, _P_PAST = 0.85, 0.1, 0.05  # shares of rays towards an object that end on it, before it, beyond it
_BESIDE = 0.035  # distance up to which a point beside the object is unexplained [m]
_CLOSED, _UNEXPLAINED = 1.5, 1.0  # what a ray that ends in a hollow or beside the object counts against it
_ENOUGH = 4.0  # rays towards a part from which its share counts fully


@dataclass(frozen=True)
class Traced:
    """Rays against B objects.

    Attributes:
        depth: (B, N) length at which each ray meets the object; infinite for a miss [m].
        closest: (B, N) least distance of each ray's line from the object, where it passes [m].
        part: (B, N) number of the part met or nearest.
        at_end: (B, N) distance of each ray's end from the object [m].
    """

    depth: Float[np.ndarray, "B N"]
    closest: Float[np.ndarray, "B N"]
    part: Int[np.ndarray, "B N"]
    at_end: Float[np.ndarray, "B N"]


def trace(template: Template, fits: Hypotheses, region: Region) -> Traced:
    """Follow rays to B objects by sphere tracing (Hart 1996)."""
    solids = template.solids(fits.sizes)
    start, way = fits.local(region.start), fits.turn(region.way)
    middle = template.middle(template.named(fits.sizes))[:, None]
    centre = np.einsum("bni,bni->bn", middle - start, way)
    aside = ((start + centre[..., None] * way - middle) ** 2).sum(axis=-1)
    half = np.sqrt(np.maximum(1.21 * template.radii(fits.sizes)[:, None] ** 2 - aside, 0.0))
    at, last = centre - half, centre + half
    closest = np.full(at.shape, np.inf)
    part = np.zeros(at.shape, dtype=int)
    for _ in range(_STEPS):
        poll()
        places = start + at[..., None] * way
        each = np.stack([solid.distance(places) for solid in solids])
        there = each.min(axis=0)
        counts = (at <= last) & (there < closest)
        part = np.where(counts, each.argmin(axis=0), part)
        closest = np.where(counts, there, closest)
        at = np.where((there > _CLOSE) & (at <= last), at + there, at)
    is_hit = closest <= 2.0 * _CLOSE
    ends = np.stack([solid.distance(fits.local(region.ends)) for solid in solids]).min(axis=0)
    return Traced(
        np.where(is_hit, at, np.inf), np.where(is_hit, _inside(solids, start, way, at, last), closest), part, ends
    )


def _inside(
    solids: Sequence[Primitive],
    start: Float[np.ndarray, "B N 3"],
    way: Float[np.ndarray, "B N 3"],
    at: Float[np.ndarray, "B N"],
    last: Float[np.ndarray, "B N"],
) -> Float[np.ndarray, "B N"]:
    """Return how deep each ray goes in the object, as a negative distance [m]."""
    deepest = np.zeros(at.shape)
    for ahead in (0.004, 0.01, 0.02, 0.035):
        places = start + np.minimum(at + ahead, last)[..., None] * way
        deepest = np.minimum(deepest, np.min([solid.distance(places) for solid in solids], axis=0))
    return deepest


FEATURES = (
    "solid_share",
    "past_share",
    "before_share",
    "explained_share",
    "open_share",
    "n_open",
    "rms",
    "part_share",
    "n_hits",
    "size_score",
    "gain",
    "flat_share",
    "flats_share",
    "margin",
    "lead",
)
"""Names of what a hit's confidence depends on, in order."""


@dataclass(frozen=True)
class Evidence:
    """Evidence of rays for B objects.

    Attributes:
        features: (B, F) in the order of ``FEATURES``, without the last four, which compare with rivals.
        gain: (B,) sum of the log-likelihood ratio of the rays against clutter.
        hit: (B, N) which rays ended on the object.
    """

    features: Float[np.ndarray, "B F"]
    gain: Float[np.ndarray, "B"]
    hit: Float[np.ndarray, "B N"]


def weigh(template: Template, fits: Hypotheses, region: Region) -> Evidence:
    """Return the evidence of a region's rays for each hypothesis."""
    traced = trace(template, fits, region)
    parts = template.build(template.named(fits.sizes))
    sigma = float(np.hypot(region.sigma, template.model_sigma))
    edge = 0.002 + 0.5 * region.pitch
    gap = region.length - traced.depth
    towards = np.isfinite(traced.depth)
    on = np.abs(traced.at_end) < 3.0 * sigma
    past = towards & ~on & (gap > 0.0)
    before = towards & ~on & (gap <= 0.0)
    firm = towards & (traced.closest < -edge)
    n_firm = np.maximum(firm.sum(axis=1), 1)
    n_seen = np.maximum((firm & ~before).sum(axis=1), 1)
    hit = towards & on
    solid = (hit & firm).sum(axis=1) / n_seen
    density = np.log(_P_HIT * _BEYOND / (sigma * np.sqrt(2.0 * np.pi)))
    near = np.where(on, density - 0.5 * np.minimum(traced.at_end / sigma, 3.0) ** 2, 0.0)
    gain = (
        np.where(hit, near, 0.0)
        + np.where(past & firm, np.log(_P_PAST), 0.0)
        + np.where(before & firm, np.log(_P_BEFORE), 0.0)
    )
    beside = ~region.is_other & (np.abs(traced.at_end) < _BESIDE) & ~(on & (np.abs(traced.at_end) < 3.0 * sigma))
    on_it = ~region.is_other & on
    explained = on_it.sum(axis=1) / np.maximum((on_it | beside).sum(axis=1), 1)
    open_share, n_open = _open(template, fits, region, traced, sigma)
    gain = gain - _UNEXPLAINED * beside
    rms = np.sqrt((np.minimum(traced.at_end, 0.03) ** 2 * hit).sum(axis=1) / np.maximum(hit.sum(axis=1), 1))
    features = np.stack(
        [
            solid,
            (past & firm).sum(axis=1) / n_firm,
            (before & firm).sum(axis=1) / n_firm,
            explained,
            open_share,
            np.log1p(n_open),
            rms / sigma,
            _least_part(parts, traced, firm & ~before, hit),
            np.log1p(np.minimum(hit.sum(axis=1), region.n_rays)),
            (((fits.sizes - template.usual) / template.spread) ** 2).mean(axis=1),
            gain.sum(axis=1) / np.maximum((firm | hit).sum(axis=1), 8),
        ],
        axis=1,
    )
    return Evidence(features, gain.sum(axis=1) - _CLOSED * (1.0 - open_share) * n_open, hit)


def _least_part(parts: Sequence[object], traced: Traced, seen: np.ndarray, hit: np.ndarray) -> Float[np.ndarray, "B"]:
    """Return the least share of rays towards a necessary part that ended on it; parts of few rays count less."""
    least = np.ones(len(seen))
    for i, part in enumerate(parts):
        if not getattr(part, "must_show", True):
            continue
        mine = traced.part == i
        n_seen, n_hit = (seen & mine).sum(axis=1), (hit & seen & mine).sum(axis=1)
        least = np.minimum(least, (n_hit + 0.7 * _ENOUGH) / (n_seen + _ENOUGH))
    return least


def _open(
    template: Template, fits: Hypotheses, region: Region, traced: Traced, sigma: float
) -> tuple[Float[np.ndarray, "B"], Float[np.ndarray, "B"]]:
    """Return the share of rays through the object's hollows that end beyond them, and their number."""
    boxes: tuple[Box, ...] = template.hollows(template.named(fits.sizes))
    n_through, n_beyond = np.zeros(len(fits)), np.zeros(len(fits))
    start, way = fits.local(region.start), fits.turn(region.way)
    way = np.where(np.abs(way) < 1e-9, 1e-9, way)
    for box in boxes:
        one = (box.centre[:, None] - box.half[:, None] - start) / way
        two = (box.centre[:, None] + box.half[:, None] - start) / way
        enters, leaves = np.minimum(one, two).max(axis=-1), np.maximum(one, two).min(axis=-1)
        through = (leaves - enters > 0.01) & (enters > 0.0) & (region.length > enters - sigma)
        # A ray that meets a part before it has left the hollow says nothing.
        through &= ~(traced.depth < leaves)
        n_through += through.sum(axis=1)
        n_beyond += (through & (region.length > leaves - sigma)).sum(axis=1)
    return np.where(n_through > 0, n_beyond / np.maximum(n_through, 1), 1.0), n_through
