"""Fits of the engine as detections, with their features among the residuals."""

from __future__ import annotations

import numpy as np

from perception.detect.engine.score import FEATURES
from perception.detect.engine.search import Fit
from perception.detect.shared.detection import Detection

PREFIX = "ray_"
"""Prefix of the features among a detection's residuals."""
UNRATED = 0.5  # a confidence that ``verdict.rate`` replaces
_MOST_POINTS = 200


def as_detection(fit: Fit) -> Detection:
    """Return a fitted object as a detection in the frame and with the sizes that users see."""
    template, one = fit.template, fit.hypotheses
    sizes = template.named(one.sizes)
    pose = np.eye(4)
    pose[:3, :3] = one.rotation[0] @ template.axes(sizes)[0]
    pose[:3, 3] = one.place[0] + one.rotation[0] @ template.origin(sizes)[0]
    residuals = {PREFIX + name: float(value) for name, value in zip(FEATURES, fit.features, strict=True)}
    residuals |= fit.spreads
    points = fit.points[:: max(1, len(fit.points) // _MOST_POINTS)]
    shown = template.show({name: float(values[0]) for name, values in sizes.items()})
    return Detection(template.kind, pose, shown, UNRATED, residuals, points)
