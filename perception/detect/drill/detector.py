"""Detection of cordless drills that stand or lie on a level surface, by the engine for templates."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.detect.drill.standing import cluster_sites
from perception.detect.engine.hits import as_detection
from perception.detect.engine.search import search
from perception.detect.engine.supports import standing_sites
from perception.detect.engine.templates.drill import DRILL
from perception.detect.shared.detection import Detection
from perception.sightlines import SightIndex, sight_index
from perception.view import View

_TALL = (0.045, 0.3)  # height over the support in which a drill has points [m]


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
    starts = DRILL.starts
    assert starts is not None
    sites = standing_sites(view, DRILL, starts.postures, starts.lifts, starts.n_turns, _TALL, hint, starts.sizes)
    sites += cluster_sites(view, hint, index)
    return [as_detection(fit) for fit in search(DRILL, sites, index)]
