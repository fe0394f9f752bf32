"""Noise of the kinds of sensors, and which kind a cloud looks like."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from perception.cloud import Cloud
from perception.levelling.look import find_look
from perception.levelling.surfaces import find_surfaces

# Edges of the ranges in which the noise of a cloud is measured [m], and fewest patches in one.
_RANGES = (0.0, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 12.0)
_FEWEST = 6
# Flat surfaces are the smoothest of the patches.
_SMOOTHEST = 30.0
# Noise at 3 m that grows with the square of the range: a depth camera's [m].
_AT_3_M = 0.003
_SURVEY = 0.003


@dataclass(frozen=True)
class NoiseModel:
    """Range noise: its standard deviation is ``base + growth * range ** 2`` [m].

    Attributes:
        name: kind of sensor.
        is_smooth: whether neighbouring ranges share their error, as matching windows and steps of depth do; the mean of
            neighbours then is no better than one of them.
    """

    name: str
    base: float
    growth: float
    is_smooth: bool

    def sigma(self, ranges: Float[np.ndarray, "*N"]) -> Float[np.ndarray, "*N"]:
        """Return the standard deviation of ranges [m]."""
        return np.asarray(self.base + self.growth * ranges**2)

    def bulge(self, ranges: Float[np.ndarray, "*N"]) -> Float[np.ndarray, "*N"]:
        """Return by how much surfaces deviate that neighbours do not average out [m]."""
        return np.asarray((_BULGE * self.sigma(ranges)).clip(0.0, _MOST_BULGE) * self.is_smooth)


_BULGE, _MOST_BULGE = 0.5, 0.01
# Khoshelham and Elberink, Sensors 2012 (depth); data sheets of Azure Kinect (tof), HDL-64 (spinning), Livox Mid-360
# (solid) and Leica P40 (survey).
MODELS = {
    model.name: model
    for model in (
        NoiseModel("spinning", 0.01, 0.0, False),
        NoiseModel("depth", 0.001, 0.00143, True),
        NoiseModel("tof", 0.004, 0.0005, True),
        NoiseModel("solid", 0.01, 0.0, False),
        NoiseModel("survey", 0.002, 0.0, False),
    )
}
AUTO = "auto"


def find_noise(cloud: Cloud) -> NoiseModel:
    """Return the noise of a cloud: of its kind of sensor where that is known, else estimated from its flat surfaces."""
    return MODELS[cloud.sensor] if cloud.sensor in MODELS else estimate_noise(cloud)


def estimate_noise(cloud: Cloud) -> NoiseModel:
    """Return noise fitted to the roughness of flat patches over their range, and the kind of sensor that has it."""
    surfaces = find_surfaces(cloud.points, cloud.starts)
    ranges, roughness = [], []
    for near, far in pairwise(_RANGES):
        inside = (surfaces.range >= near) & (surfaces.range < far)
        if inside.sum() >= _FEWEST:
            ranges.append(float(np.median(surfaces.range[inside])))
            roughness.append(float(np.percentile(surfaces.roughness[inside], _SMOOTHEST)))
    if not ranges:
        return MODELS["spinning"]
    squares = np.square(ranges)
    growth = 0.0
    if len(ranges) > 1:
        growth = max(float(np.polyfit(squares, roughness, 1)[0]), 0.0)
    base = max(float(np.median(np.array(roughness) - growth * squares)), 0.0)
    if find_look(cloud).wide.any() and 9.0 * growth > _AT_3_M:
        return NoiseModel("depth", base, growth, True)
    return NoiseModel("survey" if base < _SURVEY else "spinning", base, growth, False)
