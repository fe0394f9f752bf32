"""Parts of a detected object that a hand may press, with the rays of the scan at each of them."""

from __future__ import annotations

import numpy as np

from perception.cloud import Cloud
from perception.detect.door.model import DoorModel
from perception.detect.door.seen_parts import count_on_door
from perception.detect.shared.detection import Detection
from perception.detect.shared.seen_part import SeenPart, choose_distance
from perception.detect.valve.bodies import ValveDetection
from perception.detect.valve.lever_valve import LeverDetection
from perception.detect.valve.seen_parts import count_on_lever, count_on_wheel
from perception.sightlines import SightIndex, index_of, sight_rays

_BESIDE = 0.1  # rays that pass an object by this much are counted nowhere [m]


def count_seen_parts(cloud: Cloud, hit: Detection) -> tuple[SeenPart, ...]:
    """Return the parts of a valve or a door that a hand may press, with the rays of the scan at each; else none."""
    model = hit.model
    if isinstance(model, DoorModel):
        geometry = model.geometry
        middle = geometry.hinge + 0.5 * geometry.height * np.array([0.0, 0.0, 1.0])
        index = _index_about(cloud, middle, float(np.hypot(geometry.width, 0.5 * geometry.height)))
        return count_on_door(geometry, index, choose_distance(hit.residuals["rms"]))
    if isinstance(model, LeverDetection):
        return count_on_lever(model, _index_about(cloud, model.centre, model.length + model.grip_length))
    if isinstance(model, ValveDetection):
        return count_on_wheel(model, _index_about(cloud, model.centre, model.outer_radius))
    return ()


def _index_about(cloud: Cloud, centre: np.ndarray, size: float) -> SightIndex:
    """Return the rays that pass an object of a size about a point [m]."""
    return index_of(SightIndex(sight_rays(cloud), ()).passing(centre[None], size + _BESIDE))
