"""Detection of button panels: small faces that stand free, with round things that stand out of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from perception.detect.confidence import rising
from perception.detect.detection import Detection
from perception.detect.faces import Face, FaceRays, FacesInSight, face_rays
from perception.detect.relief import Disc, find_discs
from perception.detect.sightlines import SightIndex
from perception.view import View

_SIZES = (0.07, 0.7)
_LEAST_GAIN = 13.0
_FAINT = 0.03
_LARGEST, _BETWEEN = 0.05, 0.004
_HEIGHTS = (0.005, 0.06)
_BESIDE = 0.08
_BEHIND = 0.025
_REPORTED = 0.05
_SAME_DEPTH = 0.1


@dataclass(frozen=True)
class _Edges:
    """Where a face ends: corners, and on which of its four sides rays went past."""

    low: Float[np.ndarray, "2"]
    high: Float[np.ndarray, "2"]
    seen: tuple[bool, bool, bool, bool]


def detect_panel(
    view: View, hint: Float[np.ndarray, "3"] | None = None, seen: FacesInSight | None = None
) -> list[Detection]:
    """Button panels, best first; origin the centre of the front face, z its normal to the sensor, y up.

    A button is claimed where the scan shows a round relief of 5 mm or more that its noise does not explain.

    Args:
        view: the scan, made ready.
        hint: (3,) a point near the panel; fewer of its edges need be seen then [m].
        seen: faces of the view near the hint, where they are at hand.
    """
    if not len(view.obstacles):
        return []
    seen = seen or FacesInSight.of(view, hint)
    with threadpool_limits(limits=1, user_api="blas"):
        found = [_examined(face, seen.index, hint is not None) for face in seen.faces if _is_panel_sized(face)]
    panels = [one for one in found if one is not None and one.confidence >= _REPORTED]
    return _apart(sorted(panels, key=lambda one: -one.confidence))


def _apart(panels: list[Detection]) -> list[Detection]:
    """Without those whose centre lies on a surer one: noise may make two faces of one."""
    kept: list[Detection] = []
    for one in panels:
        centre = one.pose_world_object[:3, 3]
        if not any(_covers(other, centre) for other in kept):
            kept.append(one)
    return kept


def _covers(panel: Detection, place: Float[np.ndarray, "3"]) -> bool:
    """Whether a place lies on a panel or a hand's breadth before or behind it."""
    local = panel.pose_world_object[:3, :3].T @ (place - panel.pose_world_object[:3, 3])
    half = 0.5 * np.array([panel.sizes["width"], panel.sizes["height"], 2.0 * _SAME_DEPTH])
    return bool((np.abs(local) < half).all())


def _is_panel_sized(face: Face) -> bool:
    return bool(face.size.min() > _SIZES[0] and face.size.max() < _SIZES[1])


def _examined(face: Face, index: SightIndex, is_hinted: bool) -> Detection | None:
    """Edges and buttons of a face; None when nothing stands out of it."""
    seen = face_rays(face, index, _BESIDE)
    edges = _edges(face, seen)
    size = edges.high - edges.low
    if size.min() < _SIZES[0] or size.max() > _SIZES[1]:
        return None
    ends = seen.ends[(seen.ends[:, 2] > -3.0 * face.sigma) & (seen.ends[:, 2] < _HEIGHTS[1] + 0.05)]
    ends = ends[((ends[:, :2] > edges.low) & (ends[:, :2] < edges.high)).all(axis=1)]
    ends = np.column_stack([ends[:, :2], np.minimum(ends[:, 2], _HEIGHTS[1])])
    discs = find_discs(ends, edges.low, edges.high, face.sigma, _LEAST_GAIN)
    clearest = max((disc.gain for disc in discs), default=0.0)
    discs = [disc for disc in discs if disc.gain > _FAINT * clearest]
    buttons = [disc for disc in discs if _is_button(disc) and _stands_alone(disc, discs)]
    if not buttons:
        return None
    return _as_detection(face, edges, buttons, len(discs) - len(buttons), ends, is_hinted)


def _is_button(disc: Disc) -> bool:
    return bool(
        _HEIGHTS[0] <= disc.height < 0.9 * _HEIGHTS[1]
        and disc.radius < _LARGEST
        and disc.roundness > 0.5
        and disc.around < 0.4
    )


def _stands_alone(disc: Disc, discs: list[Disc]) -> bool:
    """Whether no other relief touches it, as the parts of one larger thing do."""
    return all(
        one is disc or np.linalg.norm(one.centre - disc.centre) > one.radius + disc.radius + _BETWEEN for one in discs
    )


def _edges(face: Face, seen: FaceRays) -> _Edges:
    """Each side moved to where rays that ended on the face give way to rays that went past it."""
    low, high, known = face.low.copy(), face.high.copy(), []
    on = np.abs(seen.ends[:, 2]) < max(3.0 * face.sigma, 0.02)
    past = seen.ends[:, 2] < -max(3.0 * face.sigma, _BEHIND)
    for i in (0, 1):
        across = 1 - i
        middle = (seen.at[:, across] > 0.85 * low[across] + 0.15 * high[across]) & (
            seen.at[:, across] < 0.15 * low[across] + 0.85 * high[across]
        )
        centre = 0.5 * (low[i] + high[i])
        ends = []
        for sign in (-1.0, 1.0):
            out = sign * (seen.at[:, i] - centre)
            hits, passes = out[middle & on & (out > 0)], out[middle & past & (out > 0)]
            edge, is_seen = _edge(hits, passes)
            ends.append(centre + sign * edge)
            known.append(is_seen)
        low[i], high[i] = ends
    return _Edges(low, high, (known[0], known[1], known[2], known[3]))


def _edge(hits: Float[np.ndarray, "K"], passes: Float[np.ndarray, "M"]) -> tuple[float, bool]:
    """Distance that parts hits from passes with the fewest on the wrong side, and whether passes follow."""
    if not len(hits):
        return 0.0, False
    if not len(passes):
        return float(np.percentile(hits, 99)), False
    places = np.sort(np.concatenate([hits, passes]))
    ordered_hits, ordered_passes = np.sort(hits), np.sort(passes)
    wrong = len(hits) - np.searchsorted(ordered_hits, places, side="right")
    wrong = wrong + np.searchsorted(ordered_passes, places, side="right")
    i = int(np.argmin(wrong))
    beyond = passes[(passes > places[i]) & (passes < places[i] + _BESIDE)]
    return float(places[i]), len(beyond) >= 3


def _as_detection(
    face: Face,
    edges: _Edges,
    buttons: list[Disc],
    n_other: int,
    ends: Float[np.ndarray, "K 3"],
    is_hinted: bool,
) -> Detection:
    """Surer with more edges seen, clearer buttons, and nothing else that stands out."""
    middle = 0.5 * (edges.low + edges.high)
    pose = np.eye(4)
    pose[:3, :3] = face.frame.T
    pose[:3, 3] = face.world(np.append(middle, 0.0)[None])[0]
    size = edges.high - edges.low
    sizes = {"width": float(size[0]), "height": float(size[1]), "n_buttons": float(len(buttons))}
    for i, disc in enumerate(sorted(buttons, key=lambda disc: (-disc.centre[1], disc.centre[0]))):
        x, y = disc.centre - middle
        sizes |= {f"button_{i}_x": float(x), f"button_{i}_y": float(y), f"button_{i}_radius": disc.radius}
    n_seen = sum(edges.seen)
    confidence = (
        rising(float(n_seen), 0.0 if is_hinted else 2.0, 3.0 if is_hinted else 4.0)
        * rising(min(disc.gain for disc in buttons), _LEAST_GAIN, 2.5 * _LEAST_GAIN)
        * rising(float(np.mean([disc.roundness for disc in buttons])), 0.5, 0.7)
        * rising(-float(size.max()), -_SIZES[1], -0.6)
        * 0.4 ** min(n_other, 3)
    )
    residuals = {
        "sigma": face.sigma,
        "relief": float(np.mean([disc.height for disc in buttons])),
        "edges_seen": float(n_seen),
        "least_gain": min(disc.gain for disc in buttons),
        "other_relief": float(n_other),
    }
    points = face.world(ends[:: max(1, len(ends) // 300)])
    return Detection("panel", pose, sizes, float(confidence), residuals, points)
