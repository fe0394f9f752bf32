"""Detection of button panels: small faces with free edges and round buttons that protrude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import threadpool_limits

from perception.detect.panel.relief import Disc, find_discs
from perception.detect.shared.arithmetic import rising
from perception.detect.shared.detection import Detection
from perception.detect.shared.faces import Face, FaceRays, FacesInSight, face_rays, fit_face
from perception.sightlines import SightIndex
from perception.view import View

_SIZES = (0.07, 0.7)
_LEAST_GAIN = 13.0
_FAINT = 0.03
_LARGEST, _BETWEEN, _NEIGHBOURS = 0.05, 0.004, 0.05
_FEWEST_BETWEEN = 3
_LEAST_CLEAR = 0.6
_CLEAR_OF_NOISE = (0.7, 1.1)
_HEIGHTS = (0.005, 0.06)
_BESIDE = 0.08
_BEHIND, _ONWARD = 0.025, 0.05
_WITHIN = 0.008
_CLOSED = (0.85, 0.95)
_EDGES_SEEN = ((2.2, 4.0), (0.0, 3.0))  # without a hint and with one
# A face refitted without its buttons may show another edge, and be closed by this share more.
_GAIN_BY_REFIT = 0.1
# Corners of a face, as shares of its half sizes, and their closed share: a disc has none.
_AT_CORNER, _FEWEST_AT_CORNERS, _CORNERS_CLOSED = 0.8, 6, (0.45, 0.75)
_REPORTED = 0.05
_SAME_DEPTH = 0.1
_ROUNDS = 3
_MOST_OTHERS = 6  # reliefs that are no buttons, on a face that a refit may still make a panel
_COLLAR = 0.01
# Deviations of the scan's noise, height by which a button's middle exceeds its mean [m], share of rays above that.
_NOISE, _DOMED, _ABOVE = 3.0, 0.01, 0.12
_SMEAR = 0.1


@dataclass(frozen=True)
class _Edges:
    """Edges of a face: lower and upper corner [m], and for left, right, bottom, top whether rays passed beyond it."""

    low: Float[np.ndarray, "2"]
    high: Float[np.ndarray, "2"]
    seen: tuple[bool, bool, bool, bool]


def detect_panel(view: View, hint: Float[np.ndarray, "3"] | None, seen: FacesInSight) -> list[Detection]:
    """Find button panels, best first; origin the centre of the front face, z its normal to the sensor, y up.

    A button is a round relief of at least 5 mm that the scan's noise does not explain.

    Args:
        hint: (3,) a point near the panel [m]; with it fewer edges must be visible.
    """
    if not len(view.obstacles):
        return []
    with threadpool_limits(limits=1, user_api="blas"):
        examined = [_examine(face, seen.index, hint is not None) for face in seen.faces if _is_panel_sized(face)]
    panels = [panel for panel in examined if panel is not None and panel.confidence >= _REPORTED]
    # Of equally sure faces through the same panel, the one of less scatter comes first.
    return _drop_duplicates(sorted(panels, key=lambda panel: (-round(panel.confidence, 2), panel.residuals["sigma"])))


def _drop_duplicates(panels: list[Detection]) -> list[Detection]:
    """Drop panels whose centre is on a surer one; noise may split a panel into two faces."""
    kept: list[Detection] = []
    for panel in panels:
        centre = panel.pose_world_object[:3, 3]
        if not any(_covers(other, centre) for other in kept):
            kept.append(panel)
    return kept


def _covers(panel: Detection, place: Float[np.ndarray, "3"]) -> bool:
    """Return whether a point is on a panel, or at most 10 cm before or behind it."""
    local = panel.pose_world_object[:3, :3].T @ (place - panel.pose_world_object[:3, 3])
    half = 0.5 * np.array([panel.sizes["width"], panel.sizes["height"], 2.0 * _SAME_DEPTH])
    return bool((np.abs(local) < half).all())


def _is_panel_sized(face: Face) -> bool:
    return bool(face.size.min() > _SIZES[0] and face.size.max() < _SIZES[1])


def _examine(face: Face, index: SightIndex, is_hinted: bool) -> Detection | None:
    """Return the panel on a face; None when its size does not fit or it has no button."""
    edges, ends = _Edges(face.low, face.high, (False,) * 4), np.zeros((0, 3))
    relief, discs, buttons, closed = list[Disc](), list[Disc](), list[Disc](), 0.0
    for k in range(_ROUNDS):
        if k > 0:
            # Buttons bias the plane of a small face: refit it without them while its scatter falls.
            again = fit_face(face, ends[_bare(edges, relief, ends)])
            if again is None or again.sigma > face.sigma:
                break
            face = again
        seen = face_rays(face, index, _BESIDE)
        edges = _edges(face, seen)
        size = edges.high - edges.low
        if size.min() < _SIZES[0] or size.max() > _SIZES[1]:
            return None
        ends = seen.ends[((seen.ends[:, :2] > edges.low) & (seen.ends[:, :2] < edges.high)).all(axis=1)]
        closed = _closed_share(face, edges, seen)
        if sum(edges.seen) < _EDGES_SEEN[is_hinted][0] - 1.0 or closed < _CLOSED[0] - _GAIN_BY_REFIT:
            return None
        relief = _discs(face, edges, ends)
        # A relief much lower than the noise is an uneven face, however many points it has.
        discs = [disc for disc in relief if disc.height > _LEAST_CLEAR * face.sigma]
        buttons = [
            disc
            for disc in discs
            if _is_button(disc) and _is_level(disc, ends, face.sigma) and _stands_alone(disc, discs, ends)
        ]
        if len(discs) - len(buttons) > _MOST_OTHERS:
            return None
    if not buttons:
        return None
    return _as_detection(face, edges, buttons, len(discs) - len(buttons), closed, ends, is_hinted)


def _closed_share(face: Face, edges: _Edges, seen: FaceRays) -> float:
    """Return the share of rays within the face's edges that ended on it or before it; other objects have gaps.

    A round face has its gaps at the corners of its outline: it is rated by these alone where they are open.
    """
    within = ((seen.at > edges.low + _WITHIN) & (seen.at < edges.high - _WITHIN)).all(axis=1)
    past = _went_past(face, seen)
    from_middle = np.abs(seen.at - 0.5 * (edges.low + edges.high)) / (0.5 * (edges.high - edges.low))
    corners = within & (from_middle > _AT_CORNER).all(axis=1)
    closed = float(1.0 - past[within].mean()) if within.any() else 0.0
    if np.count_nonzero(corners) < _FEWEST_AT_CORNERS:
        return closed
    return closed * rising(float(1.0 - past[corners].mean()), *_CORNERS_CLOSED)


def _went_past(face: Face, seen: FaceRays) -> Bool[np.ndarray, "N"]:
    """Return which rays passed behind the face; for grazing rays, which stay near its plane, less depth is enough."""
    slope = -(seen.rays.direction @ face.frame[2])
    return np.asarray(seen.ends[:, 2] < -np.maximum(3.0 * face.sigma, np.minimum(_BEHIND, _ONWARD * slope)))


def _discs(face: Face, edges: _Edges, ends: Float[np.ndarray, "K 3"]) -> list[Disc]:
    """Return raised discs of a face, without those much fainter than the clearest and smears of clearer ones."""
    kept = ends[(ends[:, 2] > -_NOISE * face.sigma) & (ends[:, 2] < _HEIGHTS[1] + 0.05)]
    kept = np.column_stack([kept[:, :2], np.minimum(kept[:, 2], _HEIGHTS[1])])
    discs = find_discs(kept, edges.low, edges.high, face.sigma, _LEAST_GAIN)
    clearest = max((disc.gain for disc in discs), default=0.0)
    discs = [disc for disc in discs if disc.gain > _FAINT * clearest]
    return [disc for disc in discs if not any(_is_smear(disc, other) for other in discs)]


def _is_smear(disc: Disc, of: Disc) -> bool:
    """Return whether a relief is only the mixed returns at the edge of a clearer one."""
    touches = np.linalg.norm(of.centre - disc.centre) < of.radius + disc.radius
    return bool(touches and disc.gain < _SMEAR * of.gain and disc.height < 0.5 * of.height)


def _bare(edges: _Edges, discs: list[Disc], ends: Float[np.ndarray, "K 3"]) -> Bool[np.ndarray, "K"]:
    """Return which ray ends are outside all discs and not at the face's edges, where rays may hit its sides."""
    outside = ((ends[:, :2] > edges.low + _COLLAR) & (ends[:, :2] < edges.high - _COLLAR)).all(axis=1)
    for disc in discs:
        outside &= np.linalg.norm(ends[:, :2] - disc.centre, axis=1) > disc.radius + _COLLAR
    return np.asarray(outside)


def _is_button(disc: Disc) -> bool:
    return bool(
        _HEIGHTS[0] <= disc.height < 0.9 * _HEIGHTS[1]
        and disc.radius < _LARGEST
        and disc.roundness > 0.5
        and disc.around < 0.4
    )


def _is_level(disc: Disc, ends: Float[np.ndarray, "K 3"], sigma: float) -> bool:
    """Return whether hardly any ray ended well above a disc's mean height; over a bar before the face many did."""
    height = ends[np.linalg.norm(ends[:, :2] - disc.centre, axis=1) < disc.radius, 2]
    height = height[height > -_NOISE * sigma]
    return bool((height > disc.height + _NOISE * sigma + _DOMED).sum() <= _ABOVE * len(height))


def _stands_alone(disc: Disc, discs: list[Disc], ends: Float[np.ndarray, "K 3"]) -> bool:
    """Return whether the disc is far from every other relief, or the bare face is visible between them."""
    return all(other is disc or _is_apart(disc, other, ends) for other in discs)


def _is_apart(disc: Disc, other: Disc, ends: Float[np.ndarray, "K 3"]) -> bool:
    way = other.centre - disc.centre
    apart = float(np.linalg.norm(way))
    gap = apart - disc.radius - other.radius
    if not _BETWEEN < gap < _NEIGHBOURS:
        return gap >= _NEIGHBOURS
    offset = ends[:, :2] - disc.centre
    along, aside = offset @ way / apart, np.abs(offset @ np.array([-way[1], way[0]])) / apart
    height = ends[(along > disc.radius) & (along < apart - other.radius) & (aside < min(disc.radius, other.radius)), 2]
    return bool(len(height) >= _FEWEST_BETWEEN and np.median(height) < 0.5 * min(disc.height, other.height))


def _edges(face: Face, seen: FaceRays) -> _Edges:
    """Return the edges, each at the boundary between rays that ended on the face and rays that passed it."""
    low, high, known = face.low.copy(), face.high.copy(), []
    on = np.abs(seen.ends[:, 2]) < max(3.0 * face.sigma, 0.02)
    past = _went_past(face, seen)
    for i in (0, 1):
        across = 1 - i
        middle = (seen.at[:, across] > 0.85 * low[across] + 0.15 * high[across]) & (
            seen.at[:, across] < 0.15 * low[across] + 0.85 * high[across]
        )
        centre = 0.5 * (low[i] + high[i])
        ends = []
        for sign in (-1.0, 1.0):
            # A hit is located by its end, so that hits on the panel's side count at the edge.
            met, crossed = (sign * (where[:, i] - centre) for where in (seen.ends, seen.at))
            edge, is_seen = _edge(met[middle & on & (met > 0)], crossed[middle & past & (crossed > 0)])
            ends.append(centre + sign * edge)
            known.append(is_seen)
        low[i], high[i] = ends
    return _Edges(low, high, (known[0], known[1], known[2], known[3]))


def _edge(hits: Float[np.ndarray, "K"], passes: Float[np.ndarray, "M"]) -> tuple[float, bool]:
    """Return the distance that separates hits from passes with the fewest errors [m], and whether passes follow."""
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
    closed: float,
    ends: Float[np.ndarray, "K 3"],
    is_hinted: bool,
) -> Detection:
    """Return the panel with its confidence: edges seen, clear buttons, closed face, nothing else on it."""
    middle = 0.5 * (edges.low + edges.high)
    pose = np.eye(4)
    pose[:3, :3] = face.frame.T
    pose[:3, 3] = face.world(np.append(middle, 0.0)[None])[0]
    size = edges.high - edges.low
    sizes = {"width": float(size[0]), "height": float(size[1]), "n_buttons": float(len(buttons))}
    for i, disc in enumerate(sorted(buttons, key=lambda disc: (-disc.centre[1], disc.centre[0]))):
        x, y = disc.centre - middle
        sizes |= {f"button_{i}_x": float(x), f"button_{i}_y": float(y)}
        sizes |= {f"button_{i}_radius": disc.radius, f"button_{i}_height": disc.front}
    n_seen = sum(edges.seen)
    confidence = (
        rising(float(n_seen), *_EDGES_SEEN[is_hinted])
        * rising(min(disc.gain for disc in buttons), _LEAST_GAIN, 2.5 * _LEAST_GAIN)
        * rising(float(np.mean([disc.roundness for disc in buttons])), 0.6, 0.8)
        * rising(-float(size.max()), -_SIZES[1], -0.6)
        * rising(min(disc.height for disc in buttons) / face.sigma, *_CLEAR_OF_NOISE)
        * rising(closed, *_CLOSED)
        * 0.4 ** min(n_other, 3)
    )
    residuals = {
        "sigma": face.sigma,
        "relief": float(np.mean([disc.height for disc in buttons])),
        "n_edges_seen": float(n_seen),
        "closed_share": closed,
        "least_gain_ratio": min(disc.gain for disc in buttons),
        "n_others": float(n_other),
    }
    points = face.world(ends[:: max(1, len(ends) // 300)])
    return Detection("panel", pose, sizes, float(confidence), residuals, points)
