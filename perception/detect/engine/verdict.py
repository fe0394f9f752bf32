"""Confidence of a hit: a logistic curve of the engine's features, fitted to simulated and recorded scans.

``benchmarks/clouds/confidence.py`` fits the weights, which ``weights.csv`` holds: one row per template.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from jaxtyping import Float

from perception.detect.engine.judge import judge
from perception.detect.engine.kinds import name_of, template_of
from perception.detect.engine.score import FEATURES
from perception.detect.shared.detection import Detection
from perception.sightlines import SightIndex

INPUTS = (
    "solid_share",
    "past_share",
    "before_share",
    "explained_share",
    "closed",
    "rms_ratio",
    "part_share",
    "n_hits",
    "size_score",
    "gain",
    "flat_share",
    "flats_share",
    "margin",
    "lead",
    "rating",
)
"""Names of the inputs of the logistic curve, in order."""
PREFIX = "ray_"
"""Prefix of the features among a detection's residuals."""
_ODDS_OF_A_CLICK = 1.0  # by which a hint raises the logarithm of the odds: a person saw the object there
_MOST_RATING, _MOST_LEAD = 3.0, 1.5
_UNSEEN = 0.05  # confidence of a hit that few rays pass


def rate(hit: Detection, index: SightIndex, *, is_hinted: bool) -> Detection:
    """Return a hit with its calibrated confidence and its features among the residuals."""
    found = _features_of(hit)
    if found is None:
        found = judge(template_of(hit), hit, index)
    if found is None:
        confidence, shown = min(_UNSEEN, hit.confidence), {}
    else:
        confidence = confidence_of(name_of(hit), found, hit.confidence, is_hinted=is_hinted)
        shown = {PREFIX + name: float(value) for name, value in zip(FEATURES, found, strict=True)}
    model: Any = hit.model
    if hasattr(model, "confidence"):
        model = replace(model, confidence=confidence)
    residuals = {**hit.residuals, **shown, "rating_score": float(hit.confidence)}
    return replace(hit, confidence=confidence, residuals=residuals, model=model)


def confidence_of(name: str, features: Float[np.ndarray, "F"], rating: float, *, is_hinted: bool) -> float:
    """Return the confidence that a template's features stand for, 0 to 1.

    Args:
        rating: the detector's own, used where its row has a weight for it, and alone where the template has no row.
    """
    weights = _read_weights().get(name)
    if weights is None:
        return rating
    score = weights["bias"] + sum(weights.get(key, 0.0) * value for key, value in inputs_of(features, rating).items())
    return float(1.0 / (1.0 + np.exp(-(score + (_ODDS_OF_A_CLICK if is_hinted else 0.0)))))


def inputs_of(features: Float[np.ndarray, "F"], rating: float) -> dict[str, float]:
    """Return the inputs of the logistic curve by name."""
    by_name = dict(zip(FEATURES, features.tolist(), strict=True))
    odds = float(np.clip(rating, 1e-3, 1.0 - 1e-3))
    return {
        "solid_share": by_name["solid_share"],
        "past_share": by_name["past_share"],
        "before_share": by_name["before_share"],
        "explained_share": by_name["explained_share"],
        "closed": (1.0 - by_name["open_share"]) * min(by_name["n_open"], 3.0),
        "rms_ratio": by_name["rms"],
        "part_share": by_name["part_share"],
        "n_hits": by_name["n_hits"],
        "size_score": min(by_name["size_score"], 6.0),
        "gain": float(np.clip(by_name["gain"], -2.0, 3.0)),
        "flat_share": by_name["flat_share"],
        "flats_share": by_name["flats_share"],
        "margin": by_name["margin"],
        "lead": float(np.clip(by_name["lead"], -_MOST_LEAD, _MOST_LEAD)),
        "rating": float(np.clip(np.log(odds / (1.0 - odds)), -_MOST_RATING, _MOST_RATING)),
    }


def _features_of(hit: Detection) -> Float[np.ndarray, "F"] | None:
    """Return the features that a hit of the engine's own search carries; None for others."""
    if PREFIX + FEATURES[0] not in hit.residuals:
        return None
    return np.array([hit.residuals[PREFIX + name] for name in FEATURES])


@cache
def _read_weights() -> Mapping[str, Mapping[str, float]]:
    """Return the weights by template and input."""
    text = files("perception.detect.engine").joinpath("weights.csv").read_text()
    return {
        row["template"]: {key: float(value) for key, value in row.items() if key != "template"}
        for row in csv.DictReader(text.splitlines())
    }
