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

from perception.detect.engine.doubts import list_doubts
from perception.detect.engine.hits import PREFIX, UNRATED, as_detection
from perception.detect.engine.judge import judge
from perception.detect.engine.kinds import KINDS, name_of, template_of
from perception.detect.engine.score import FEATURES
from perception.detect.engine.search import Fit
from perception.detect.shared.detection import CONFIDENT, Detection
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
# Beyond it an unusual size says nothing more: objects out there have sizes that no scan of the fit had.
_MOST_SIZE_SCORE = 2.5
_MOST_RATING, _MOST_LEAD = 3.0, 1.5
_UNSEEN = 0.05  # confidence of a hit that few rays pass


def rate(hit: Detection, index: SightIndex) -> Detection:
    """Return a detector's hit with its calibrated confidence, its doubts, and its features among the residuals."""
    if hit.kind not in KINDS:
        return hit
    searched = _features_of(hit)
    found = judge(template_of(hit), hit, index) if searched is None else searched
    doubts: tuple[str, ...]
    if found is None:
        confidence, shown, doubts = min(_UNSEEN, hit.confidence), {}, ("few rays pass it",)
    else:
        name = name_of(hit)
        confidence = confidence_of(name, found, hit.confidence)
        if searched is None:
            confidence = heed(confidence, hit.confidence)
        shown = {PREFIX + name: float(value) for name, value in zip(FEATURES, found, strict=True)}
        doubts = doubts_of(name, found, hit.confidence)
    model: Any = hit.model
    if hasattr(model, "confidence"):
        model = replace(model, confidence=confidence)
    residuals = {**hit.residuals, **shown, "rating_score": float(hit.confidence)}
    return replace(hit, confidence=confidence, residuals=residuals, model=model, doubts=doubts)


def heed(confidence: float, rating: float) -> float:
    """Return a confidence that does not exceed a low rating of the detector.

    The detector knows what the rays about a hit do not show: a wheel before a seat steers, a bar of a frame goes on.
    """
    return confidence if rating >= CONFIDENT else min(confidence, rating)


def rate_fit(name: str, fit: Fit) -> Detection:
    """Return a fit about a click as a detection with its calibrated confidence and its doubts.

    Args:
        name: of its row of weights.
    """
    confidence = confidence_of(name, fit.features, UNRATED)
    return replace(as_detection(fit), confidence=confidence, doubts=doubts_of(name, fit.features, UNRATED))


def confidence_of(name: str, features: Float[np.ndarray, "F"], rating: float) -> float:
    """Return the confidence that a template's features stand for, 0 to 1.

    Args:
        rating: the detector's own, used where its row has a weight for it, and alone where the template has no row.
    """
    weights = _read_table("weights.csv").get(name)
    if weights is None:
        return rating
    score = weights["bias"] + sum(weights[key] * value for key, value in inputs_of(features, rating).items())
    return float(1.0 / (1.0 + np.exp(-score)))


def doubts_of(name: str, features: Float[np.ndarray, "F"], rating: float) -> tuple[str, ...]:
    """Return what speaks against a hit; nothing for a template without a row."""
    weights, usual = _read_table("weights.csv").get(name), _read_table("usual.csv").get(name)
    if weights is None or usual is None:
        return ()
    by_name = dict(zip(FEATURES, features.tolist(), strict=True))
    return list_doubts(weights, usual, inputs_of(features, rating), by_name)


def _features_of(hit: Detection) -> Float[np.ndarray, "F"] | None:
    """Return the features that a hit of the engine's own search carries; None for others."""
    if PREFIX + FEATURES[0] not in hit.residuals:
        return None
    return np.array([hit.residuals[PREFIX + name] for name in FEATURES])


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
        "size_score": min(by_name["size_score"], _MOST_SIZE_SCORE),
        "gain": float(np.clip(by_name["gain"], -2.0, 3.0)),
        "flat_share": by_name["flat_share"],
        "flats_share": by_name["flats_share"],
        "margin": by_name["margin"],
        "lead": float(np.clip(by_name["lead"], -_MOST_LEAD, _MOST_LEAD)),
        "rating": float(np.clip(np.log(odds / (1.0 - odds)), -_MOST_RATING, _MOST_RATING)),
    }


@cache
def _read_table(name: str) -> Mapping[str, Mapping[str, float]]:
    """Return the values of a fitted table by template and input."""
    text = files("perception.detect.engine").joinpath(name).read_text()
    return {
        row["template"]: {key: float(value) for key, value in row.items() if key != "template"}
        for row in csv.DictReader(text.splitlines())
    }
