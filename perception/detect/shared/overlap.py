"""Rules for hits on the same points: the surer one stands, or a person chooses between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from perception.detect.shared.detection import CONFIDENT, Detection

_NEAR = 0.02
_MOSTLY = 0.5
_CLEARLY = 0.1
_RIVAL = 0.8


def settle_overlaps(hits: Sequence[Detection]) -> list[Detection]:
    """Return the hits without those that a surer one explains, in the same order.

    Two hits of one kind overlap if most points of either lie within 2 cm of the other's: the less sure one is dropped.
    Hits of different kinds overlap if that is so of both, since a handle is part of a door: the less sure one gets a
    confidence below 0.5 if the other one is clearly surer, and stays as it is if it is nearly as sure.
    """
    order = sorted(range(len(hits)), key=lambda i: -hits[i].confidence)
    trees = [cKDTree(hit.points) if len(hit.points) else None for hit in hits]
    settled: dict[int, Detection] = {}
    for i in order:
        hit = hits[i]
        for j, other in settled.items():
            mine, its = _share(hits[i], trees[j]), _share(hits[j], trees[i])
            if hit.kind == other.kind and max(mine, its) > _MOSTLY:
                break
            if min(mine, its) > _MOSTLY and other.confidence > max(hit.confidence + _CLEARLY, CONFIDENT):
                hit = replace(hit, confidence=min(hit.confidence, _RIVAL * CONFIDENT))
        else:
            settled[i] = hit
    return [settled[i] for i in sorted(settled)]


def offer_alternatives(fits: Sequence[Detection], others: Sequence[Detection]) -> list[Detection]:
    """Return fits of one kind from which a person chooses, and other hits of the kind, surest first.

    Fits on the same points stay, each less sure than what a surer one leaves: they cannot all be right.  Of other hits
    those stay that ``settle_overlaps`` leaves.
    """
    standing = {id(hit) for hit in settle_overlaps([*fits, *others])}
    offered: list[Detection] = []
    for hit in sorted([*fits, *(hit for hit in others if id(hit) in standing)], key=lambda hit: -hit.confidence):
        tree = cKDTree(hit.points) if len(hit.points) else None
        left = [1.0 - other.confidence for other in offered if _share(other, tree) > _MOSTLY]
        offered.append(replace(hit, confidence=min([hit.confidence, *left])))
    return sorted(offered, key=lambda hit: -hit.confidence)


def _share(hit: Detection, tree: cKDTree | None) -> float:
    """Return the share of a hit's points within 2 cm of another's."""
    if tree is None or not len(hit.points):
        return 0.0
    return float(np.isfinite(tree.query(hit.points, distance_upper_bound=_NEAR)[0]).mean())
