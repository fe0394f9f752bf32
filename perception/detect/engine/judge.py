"""Evidence of the rays for objects that a detector has already placed and measured."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from perception.detect.engine.refine import Hypotheses
from perception.detect.engine.region import gather
from perception.detect.engine.rivals import flat_shares, lead_over_rivals
from perception.detect.engine.score import weigh
from perception.detect.engine.template import Template
from perception.detect.shared.detection import Detection
from perception.sightlines import SightIndex

_RAYS = 900
_ABOUT = 1.25
_SHIFTS = 0.003  # between the poses over which the evidence is averaged [m]


def judge(template: Template, hit: Detection, index: SightIndex) -> Float[np.ndarray, "F"] | None:
    """Return the features of a hit, averaged over poses near its own; None if few rays pass it."""
    sizes = np.array([[float(hit.sizes.get(size.name, size.usual)) for size in template.sizes]])
    middle = template.middle(template.named(sizes))[0]
    pose = hit.pose_world_object
    radius = min(float(template.radii(sizes)[0]), _ABOUT * _reach(hit, middle))
    region = gather(index, pose[:3, :3] @ middle + pose[:3, 3], radius, None, _RAYS)
    if len(region) < 12:
        return None
    fits = _vary(pose, sizes)
    evidence = weigh(template, fits, region)
    weight = np.exp(np.clip((evidence.gain - evidence.gain.max()) / 10.0, -30.0, 0.0))
    hits = region.ends[evidence.hit[0]]
    rivals = flat_shares(hits, float(np.hypot(region.sigma, template.model_sigma)))
    lead = lead_over_rivals(template, fits.select([0]), region)
    # A detector that places objects itself has compared both directions.
    return np.append(weight @ evidence.features / weight.sum(), (*rivals, 0.0, lead))


def _reach(hit: Detection, middle: Float[np.ndarray, "3"]) -> float:
    """Return the radius about an object's middle that holds it and what is beside it [m]."""
    if not len(hit.points):
        return 1.0
    place = hit.pose_world_object[:3, :3] @ middle + hit.pose_world_object[:3, 3]
    return float(np.percentile(np.linalg.norm(hit.points - place, axis=1), 95.0)) + 0.08


def _vary(pose: Float[np.ndarray, "4 4"], sizes: Float[np.ndarray, "1 S"]) -> Hypotheses:
    """Return the pose and others near it."""
    rotations, places = [pose[:3, :3]], [pose[:3, 3]]
    for axis in np.eye(3):
        for sign in (-1.0, 1.0):
            rotations.append(pose[:3, :3])
            places.append(pose[:3, 3] + sign * _SHIFTS * pose[:3, :3] @ axis)
    n = len(rotations)
    return Hypotheses.of(np.stack(rotations), np.stack(places), np.repeat(sizes, n, axis=0), np.array([0.0, 0.0, 1.0]))
