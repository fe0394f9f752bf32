"""Detection of cordless drills that stand or lie on a level surface, by the engine for templates."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.detect.drill.standing import cluster_sites
from perception.detect.engine.score import FEATURES
from perception.detect.engine.search import Fit, search
from perception.detect.engine.supports import standing_sites
from perception.detect.engine.templates.drill import DRILL, LYING, SOLE, START_SIZES, lie
from perception.detect.shared.detection import Detection
from perception.sightlines import SightIndex, sight_index
from perception.view import View

_N_YAWS = 16
_TALL = (0.045, 0.3)  # height over the support in which a drill has points [m]
_MOST_POINTS = 200


def detect_drill(
    view: View, hint: Float[np.ndarray, "3"] | None = None, index: SightIndex | None = None
) -> list[Detection]:
    """Find drills, best first; origin the middle of the grip, z up along it, x along the chuck.

    Sizes are grip_length and body_length.

    Args:
        hint: (3,) a point near the drill [m]; only places within 0.16 m of it are searched.
        index: of the view's rays; None: they are indexed anew.
    """
    if not len(view.obstacles):
        return []
    index = index or sight_index(view.cloud)
    postures, lifts = np.stack([np.eye(3), lie(1.0), lie(-1.0)]), np.array([0.0, LYING, LYING])
    sites = standing_sites(view, DRILL, postures, lifts, _N_YAWS, _TALL, hint, START_SIZES)
    sites += cluster_sites(view, hint, index)
    return [_as_detection(fit) for fit in search(DRILL, sites, index)]


def _as_detection(fit: Fit) -> Detection:
    """Return a fitted drill as a detection; its confidence is set by ``perception.detect.engine.verdict``."""
    one = fit.hypotheses
    sizes = DRILL.named(one.sizes)
    grip = float(sizes["grip"][0])
    pose = np.eye(4)
    pose[:3, :3] = one.rotation[0]
    pose[:3, 3] = one.place[0] + (SOLE + 0.5 * grip) * one.rotation[0][:, 2]
    residuals = {f"ray_{name}": float(value) for name, value in zip(FEATURES, fit.features, strict=True)}
    residuals |= fit.spreads
    points = fit.points[:: max(1, len(fit.points) // _MOST_POINTS)]
    return Detection(
        "drill", pose, {"grip_length": grip, "body_length": float(sizes["body"][0])}, 0.5, residuals, points
    )
