"""Search for the objects of one template: rough scores of many proposals, refinement of the best, their evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.stopping import poll
from perception.detect.engine.refine import Hypotheses, Refined, deepest, join, rate_roughly, refine
from perception.detect.engine.region import Mounting, Region, gather
from perception.detect.engine.rivals import flat_shares, lead_over_rivals
from perception.detect.engine.score import FEATURES, Evidence, weigh
from perception.detect.engine.template import Template
from perception.sightlines import SightIndex

_ROUGH_RAYS, _MIDDLE_RAYS, _FINE_RAYS, _AVERAGE_RAYS = 100, 1200, 600, 300
_WIDE_RAYS, _CLOSE = 2400, 0.06  # rays about a fit, and how near those of its evidence pass it [m]
_FEWEST, _FEWEST_RAYS = 8, 12
_FINE_GATES = (0.012, 0.01, 0.01, 0.008, 0.008)
_MOST_TURN, _MOST_SHIFT, _SOFT = 0.1, 0.01, 10.0  # of the poses averaged over: [rad], [m], units of gain
# Where a fit that points the other way begins, along the object [m], and the gates of its refinement [m].
_AHEAD, _TURNED_GATES = np.array([-0.03, 0.0, 0.03]), (0.025, 0.02, 0.015, 0.01)
_SAME_PLACE, _SAME_TURN = 0.03, 0.4  # [m], [rad]


@dataclass(frozen=True)
class Pass:
    """One refinement of all hypotheses.

    Attributes:
        n_rays: rays of each site on which hypotheses are refined.
        n_rated: rays of each site on which the refined ones are compared.
        n_kept: hypotheses that are refined.
        gates: of its steps [m].
    """

    n_rays: int
    n_rated: int
    n_kept: int
    gates: tuple[float, ...]


@dataclass(frozen=True)
class Effort:
    """How much a search tries.

    Attributes:
        kept_here: hypotheses of each site that are refined at all.
        n_fine: fits that are finished on all rays.
        both_ways: whether the fit that points the other way is an answer too, or only the better of both.
    """

    kept_here: int
    passes: tuple[Pass, ...]
    n_fine: int
    both_ways: bool


WHOLE = Effort(4, (Pass(100, 100, 48, (0.03, 0.025, 0.02)), Pass(200, 200, 14, (0.02, 0.015, 0.012, 0.01))), 5, False)
"""Of a search of many places in a scan."""
CLICK = Effort(48, (Pass(100, 300, 48, (0.03, 0.025, 0.02)), Pass(150, 600, 12, (0.02, 0.015, 0.012, 0.01))), 4, True)
"""Of a search about a click."""
LED = Effort(48, (Pass(100, 300, 32, (0.03, 0.025, 0.02)), Pass(150, 600, 10, (0.02, 0.015, 0.012, 0.01))), 3, True)
"""Of a search about one fitted part."""
PART = Effort(24, (Pass(100, 200, 24, (0.03, 0.025, 0.02, 0.015)), Pass(150, 400, 8, (0.015, 0.012, 0.01))), 8, False)
"""Of a search for a part of an object, from which fits of the whole begin."""


@dataclass(frozen=True)
class Site:
    """Place with what an object there hangs on or stands on, and the hypotheses to try.

    Attributes:
        place: (3,) centre of the region [m].
        begun: hypotheses.
    """

    place: Float[np.ndarray, "3"]
    mounting: Mounting | None
    begun: Hypotheses


@dataclass(frozen=True)
class Fit:
    """A fitted object.

    Attributes:
        hypotheses: the one fit.
        features: (F,) evidence.
        gain: log-likelihood ratio against clutter.
        covariance: (D, D) of turn, shift (both of the world) and sizes.
        points: (K, 3) ends of rays on it [m].
        region: its rays.
    """

    template: Template
    hypotheses: Hypotheses
    features: Float[np.ndarray, "F"]
    gain: float
    covariance: Float[np.ndarray, "D D"]
    points: Float[np.ndarray, "K 3"]
    region: Region
    site: Site

    @property
    def middle(self) -> Float[np.ndarray, "3"]:
        """(3,) centre in the world [m]."""
        fit, template = self.hypotheses, self.template
        return np.asarray(fit.place[0] + fit.rotation[0] @ template.middle(template.named(fit.sizes))[0])

    @property
    def spreads(self) -> dict[str, float]:
        """Predicted standard deviations of place [m], orientation [rad] and sizes [m]."""
        spread = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        named = {
            f"{size.name}_sigma": float(value) for size, value in zip(self.template.sizes, spread[6:], strict=True)
        }
        return {
            "place_sigma": float(np.linalg.norm(spread[3:6]) / np.sqrt(3.0)),
            "turn_sigma_rad": float(np.linalg.norm(spread[:3]) / np.sqrt(3.0)),
            **named,
        }


@dataclass(frozen=True)
class _Settled:
    """A fit on all rays about it.

    Attributes:
        lead: how much better it explains the rays than the one that points the other way.
    """

    refined: Refined
    lead: float
    evidence: Evidence
    region: Region
    site: Site

    @property
    def hypotheses(self) -> Hypotheses:
        """The one fit."""
        return self.refined.hypotheses

    @property
    def gain(self) -> float:
        """Log-likelihood ratio against clutter."""
        return float(self.evidence.gain[0])


_Any = TypeVar("_Any", _Settled, Fit)


def search(
    template: Template, sites: Sequence[Site], index: SightIndex, most: int = 6, effort: Effort = WHOLE
) -> list[Fit]:
    """Return the fits that the rays support best, at most ``most``, best first."""
    settled: list[_Settled] = []
    for i, one in begin(template, sites, index, effort):
        settled += _settle(template, one, sites[i], index, both_ways=effort.both_ways)
    # Evidence takes longer than the fit: only fits that are returned get it.
    apart = drop_same(sorted(settled, key=lambda one: -one.gain))[:most]
    return [_weigh_fit(template, one) for one in apart]


def begin(template: Template, sites: Sequence[Site], index: SightIndex, effort: Effort) -> list[tuple[int, Hypotheses]]:
    """Return the hypotheses that few rays support best, refined on these, each with its site's number, best first."""
    regions = {i: region for i, site in enumerate(sites) if (region := _gather(template, site, index)) is not None}
    scored: list[tuple[float, int, Hypotheses]] = []
    for i, region in regions.items():
        poll()
        scores = rate_roughly(template, sites[i].begun, region.balance(_ROUGH_RAYS))
        best = np.argsort(-scores, kind="stable")[: effort.kept_here]
        scored += [(float(scores[k]), i, sites[i].begun.select([k])) for k in best]
    for one_pass in effort.passes:
        scored = _refine_best(template, scored, regions, one_pass)
    return [(i, one) for _, i, one in scored[: effort.n_fine]]


def drop_same(fits: Sequence[_Any]) -> list[_Any]:
    """Return the fits without those that an earlier one repeats."""
    apart: list[_Any] = []
    for fit in fits:
        if not any(_is_same(fit.hypotheses, other.hypotheses) for other in apart):
            apart.append(fit)
    return apart


def _gather(template: Template, site: Site, index: SightIndex) -> Region | None:
    """Return the rays about a site; None if few ended on anything but what holds the object."""
    region = gather(index, site.place, 1.3 * float(template.radii(site.begun.sizes).max()), site.mounting, _MIDDLE_RAYS)
    return region if (~region.is_other).sum() >= _FEWEST else None


def _refine_best(
    template: Template,
    scored: list[tuple[float, int, Hypotheses]],
    regions: dict[int, Region],
    one_pass: Pass,
) -> list[tuple[float, int, Hypotheses]]:
    """Return the best hypotheses of each site refined, with their gains, best first."""
    scored = sorted(scored, key=lambda one: -one[0])[: one_pass.n_kept]
    better: list[tuple[float, int, Hypotheses]] = []
    for i in dict.fromkeys(i for _, i, _ in scored):
        region = regions[i].balance(one_pass.n_rays)
        begun = join([one for _, j, one in scored if j == i])
        fits = refine(template, begun, region, one_pass.gates).hypotheses
        region = region if one_pass.n_rated == one_pass.n_rays else regions[i].balance(one_pass.n_rated)
        # Near objects are thinned more than far ones: count all their rays.
        gains = weigh(template, fits, region).gain * regions[i].loose_share(region)
        better += [(float(gain), i, fits.select([k])) for k, gain in enumerate(gains)]
    return _keep_apart(sorted(better, key=lambda one: -one[0]))


def _keep_apart(scored: list[tuple[float, int, Hypotheses]]) -> list[tuple[float, int, Hypotheses]]:
    """Return scored hypotheses, best first, without those that a better one repeats."""
    if not scored:
        return []
    every = join([one for _, _, one in scored])
    offset = np.linalg.norm(every.place[:, None] - every.place[None], axis=2)
    traces = np.einsum("aij,bij->ab", every.rotation, every.rotation)
    is_same = (offset < _SAME_PLACE) & (traces > 1.0 + 2.0 * np.cos(_SAME_TURN))
    kept: list[int] = []
    for k in range(len(scored)):
        if not is_same[k, kept].any():
            kept.append(k)
    return [scored[k] for k in kept]


def _settle(template: Template, one: Hypotheses, site: Site, index: SightIndex, *, both_ways: bool) -> list[_Settled]:
    """Return the fit of a hypothesis on the rays about it; none without rays.

    Args:
        both_ways: return the best fit that points the other way, too, the better one first.
    """
    middle = one.place[0] + one.rotation[0] @ template.middle(template.named(one.sizes))[0]
    region = gather(index, middle, 1.2 * float(template.radii(one.sizes)[0]), site.mounting, _WIDE_RAYS)
    region = region.select(
        np.flatnonzero(deepest(template, one, template.solids(one.sizes), region, 0.0)[1][0] < _CLOSE)
    )
    region = region.thin(_FINE_RAYS)
    if len(region) < _FEWEST_RAYS:
        return []
    first = refine(template, one, region, _FINE_GATES)
    turned, lead = turn_back(template, first.hypotheses, region)
    second = refine(template, turned, region, _FINE_GATES) if both_ways or lead < 0.0 else None
    ways = [(first, lead), (second, -lead)] if lead >= 0.0 else [(second, -lead), (first, lead)]
    return [
        _Settled(refined, lead, weigh(template, refined.hypotheses, region), region, site)
        for refined, lead in (ways if both_ways else ways[:1])
        if refined is not None
    ]


def _weigh_fit(template: Template, settled: _Settled) -> Fit:
    """Return a settled fit with its covariance and all its evidence."""
    fit, evidence, region = settled.hypotheses, settled.evidence, settled.region
    hits = evidence.hit[0] & ~region.is_other
    information = settled.refined.information[0]
    covariance = np.linalg.inv(information + 1e-6 * np.eye(len(information)))
    flat = flat_shares(region.ends[hits], float(np.hypot(region.sigma, template.model_sigma)))
    margin = float(np.sign(settled.lead) * np.log1p(abs(settled.lead)))
    features = np.append(
        average_features(template, fit, covariance, region, evidence),
        (*flat, margin, lead_over_rivals(template, fit, region)),
    )
    return Fit(template, fit, features, settled.gain, covariance, region.ends[hits], region, settled.site)


def turn_back(template: Template, fit: Hypotheses, region: Region) -> tuple[Hypotheses, float]:
    """Return the best fit that points the other way, and how much better the rays are explained by the given one."""
    few = region.thin(_AVERAGE_RAYS)
    middle = fit.rotation[0] @ template.middle(template.named(fit.sizes))[0]
    back = fit.rotation @ np.diag([-1.0, -1.0, 1.0])
    ahead = fit.rotation[0][:, 0] * _AHEAD[:, None]
    place = fit.place + middle - back[0] @ fit.rotation[0].T @ middle + ahead
    n = len(place)
    begun = Hypotheses.of(np.repeat(back, n, axis=0), place, np.repeat(fit.sizes, n, axis=0), fit.normal[0])
    others = refine(template, begun, few, _TURNED_GATES).hypotheses
    gains = weigh(template, join([fit, others]), few).gain
    best = int(np.argmax(gains[1:]))
    return others.select([best]), float(gains[0] - gains[1 + best])


def average_features(
    template: Template, fit: Hypotheses, covariance: Float[np.ndarray, "D D"], region: Region, evidence: Evidence
) -> Float[np.ndarray, "F"]:
    """Return the features averaged over poses and sizes about a fit, each by its likelihood.

    The best pose alone makes a confidence depend on the last digits of the points.
    """
    spread = np.sqrt(np.maximum(np.diag(covariance)[:6], 0.0))
    steps = 0.5 * np.minimum(spread, [*[_MOST_TURN] * 3, *[_MOST_SHIFT] * 3])
    steps = np.concatenate([np.diag(steps), -np.diag(steps)])
    some = join([fit] * len(steps))
    turned = Rotation.from_rotvec(steps[:, :3]).as_matrix() @ some.rotation
    near = Hypotheses(turned, some.place + steps[:, 3:], some.sizes, some.start, some.normal)
    others = weigh(template, near, region.thin(_AVERAGE_RAYS))
    weight = np.exp(np.clip((others.gain - others.gain.max()) / _SOFT, -30.0, 0.0))
    share = 0.5 * weight.sum() / len(weight)
    mean = weight @ others.features / weight.sum()
    # The count of hits is that of all rays.
    mean[FEATURES.index("n_hits")] = evidence.features[0, FEATURES.index("n_hits")]
    mean[FEATURES.index("n_open")] = evidence.features[0, FEATURES.index("n_open")]
    return np.asarray((1.0 - share) * evidence.features[0] + share * mean)


def _is_same(one: Hypotheses, other: Hypotheses) -> bool:
    if np.linalg.norm(one.place[0] - other.place[0]) > _SAME_PLACE:
        return False
    turn = Rotation.from_matrix(one.rotation[0].T @ other.rotation[0]).magnitude()
    return bool(turn < _SAME_TURN)
