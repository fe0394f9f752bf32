"""Detection of doors: leaves with their wall and handle, rated by all their evidence together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from perception.detect.door.bar import EXTENSIONS, expect_extension
from perception.detect.door.frame import Frame, find_frame
from perception.detect.door.geometry import UP
from perception.detect.door.handle import Handle, find_handle
from perception.detect.door.hang import find_ends
from perception.detect.door.leaf import Leaf, find_leaves
from perception.detect.door.model import USUAL_THICKNESS, DoorModel
from perception.detect.door.opening import judge_opening
from perception.detect.door.profile import Rays
from perception.detect.door.shut import shut_leaf
from perception.detect.door.upright import find_uprights
from perception.detect.shared.arithmetic import rising
from perception.detect.shared.detection import Detection
from perception.view import View

_REPORTED = 0.05
_EXAMINED = 12
_HINT_REACH = 0.4
_GUESSED_HEIGHT = 2.03
_USUAL_BACKSET = 0.065
_BACKSET_SPREAD = 0.02
_USUAL_EXTENSION = 0.02
_AT_EDGE = 0.035
_SURELY_AJAR = np.radians(6.0)
_HINGE_UNKNOWN = _HANDLE_UNKNOWN = 0.45
_CASING = 0.04
_OCCLUDED = 0.3
_SQUARE = (np.radians(70.0), np.radians(85.0))
_HINT_TRUST = 0.7
_SHOWN = 2000
# A handle beside its leaf, or a leaf much wider than its seen face, belongs to another object.
_OFF_LEAF, _WIDER_THAN_SEEN, _ASTRAY = 0.03, 0.4, 0.4
_FARTHEST_NOISE, _NOISE = 5.0, (0.03, 0.06)  # of a leaf's points, in standard deviations and as limits [m]
_ENOUGH = 60_000


@dataclass(frozen=True)
class _Candidate:
    """Leaf with its wall and handle; ``hinge`` is -1 at its low edge, 1 at its high edge."""

    leaf: Leaf
    frame: Frame | None
    handle: Handle | None
    hinge: int
    confidence: float
    knows_hinge: bool


def detect_door(
    view: View, hint: Float[np.ndarray, "3"] | None = None, hinge_on: Literal["left", "right"] | None = None
) -> list[Detection]:
    """Find doors, best first.

    The frame of a hit: origin on the hinge edge of the leaf's seen face at floor height, x from hinge to free edge
    along the leaf, z up.  Sizes: ``width``, ``height`` [m]; ``ajar``, the leaf's angle out of its wall [rad];
    ``side``, +1 when y points to the sensor, else -1; ``handle_x``, ``handle_y``, ``handle_z``, the
    position of the handle's bar at its pivot [m] (left out when no handle was seen); ``lever_direction``, -1 towards
    the hinge, +1 away, 0 for knobs and upright bars; of levers ``handle_length``, from pivot to free end [m], and
    ``handle_turn_rad``, the angle by which it is turned down [rad].  ``read_door`` returns the geometry of a hit.

    Args:
        hint: (3,) a point near the leaf or its handle [m].
        hinge_on: side of the hinges as seen by the sensor, for doors of which the scan does not show it.
    """
    ground = _ground(view)
    starts, ends = view.cloud.rays
    rays = _useful(Rays(starts, ends), view)
    origin = np.median(view.starts, axis=0) if len(view.starts) else np.zeros(3)
    rng = np.random.default_rng(0)
    few_rays, few_points = _thin(rays, rng), _some_points(view.obstacles, rng)
    uprights = find_uprights(view.obstacles, origin)
    leaves = find_leaves(view.obstacles, few_rays, origin, ground, uprights)
    if hint is not None:
        leaves = [leaf for leaf in leaves if _distance(leaf, np.asarray(hint, dtype=float)) < _HINT_REACH]
    candidates = [
        _weigh(
            leaf,
            find_frame(leaf, few_points, few_rays, origin, ground, uprights),
            rays,
            ground,
            hint,
            hinge_on,
        )
        for leaf in leaves[:_EXAMINED]
    ]
    candidates = [candidate for candidate in candidates if candidate.confidence >= _REPORTED]
    candidates.sort(key=lambda candidate: -candidate.confidence)
    return [_detection(candidate, rays, ground) for candidate in _drop_duplicates(candidates)]


def _ground(view: View) -> float:
    """Return world z of the floor in front of the robot; without a floor, of the lowest points, at most zero [m]."""
    if view.floor is not None:
        return float(view.floor.height(np.array([[view.reach.x, view.reach.y]]))[0])
    return min(float(np.percentile(view.near.points[:, 2], 1.0)), 0.0)


def _useful(rays: Rays, view: View) -> Rays:
    """Return the rays that end above the floor; without a floor, above the bottom of the view's reach."""
    floor = view.floor
    low = view.reach.bottom if floor is None else floor.height(rays.ends[:, :2]) + 0.02
    keep = rays.ends[:, 2] > low
    return Rays(rays.starts[keep], rays.ends[keep])


def _distance(leaf: Leaf, hint: Float[np.ndarray, "3"]) -> float:
    """Return the horizontal distance of the hint from the leaf's rectangle [m]."""
    along, _, out = leaf.plane.local(hint[None])[0]
    aside = max(leaf.low.at - along, along - leaf.high.at, 0.0)
    return float(np.hypot(aside, out))


def _thin(rays: Rays, rng: np.random.Generator) -> Rays:
    """Return a random sample of at most ``_ENOUGH`` rays."""
    if len(rays.ends) <= _ENOUGH:
        return rays
    chosen = np.sort(rng.permutation(len(rays.ends))[:_ENOUGH])
    return Rays(rays.starts[chosen], rays.ends[chosen])


def _some_points(points: Float[np.ndarray, "N 3"], rng: np.random.Generator) -> Float[np.ndarray, "M 3"]:
    """Return a random sample of at most ``_ENOUGH`` points."""
    return points if len(points) <= _ENOUGH else points[np.sort(rng.permutation(len(points))[:_ENOUGH])]


def _weigh(
    leaf: Leaf,
    frame: Frame | None,
    rays: Rays,
    ground: float,
    hint: Float[np.ndarray, "3"] | None,
    hinge_on: Literal["left", "right"] | None,
) -> _Candidate:
    """Return the leaf with its handle, hinge side and confidence of being a door."""
    sure_hinge = frame.hinge if frame is not None and frame.ajar > _SURELY_AJAR else 0
    # The search for a handle takes most of the time; it cannot make a door of a face that is none.
    most = _rate_leaf(leaf, frame)
    if (most if hint is None else most**_HINT_TRUST) < _REPORTED:
        return _Candidate(leaf, frame, None, sure_hinge or -1, 0.0, sure_hinge != 0)
    handle = find_handle(leaf.plane, leaf.low.at, leaf.high.at, leaf.rms, ground, rays, -sure_hinge)
    seen_hinge = sure_hinge or _hinge_by(handle, leaf) or (frame.hinge if frame is not None else 0)
    hinge = seen_hinge or _find_side(leaf, hinge_on)
    confidence = _confidence(leaf, frame, handle, hinge)
    if hint is not None:
        # An operator's hint rules out most other objects.
        confidence = confidence**_HINT_TRUST
        # A hint does not show the hinge side.
        confidence = confidence if hinge else min(confidence, _HINGE_UNKNOWN)
    return _Candidate(leaf, frame, handle, hinge or -1, confidence, seen_hinge != 0)


def _find_side(leaf: Leaf, hinge_on: Literal["left", "right"] | None) -> int:
    """Return the side of the hinges that a person states, -1 at the leaf's low edge or 1; 0 where nobody does."""
    if hinge_on is None:
        return 0
    is_high_right = float(np.cross(UP, leaf.plane.normal) @ leaf.plane.along) > 0.0
    return 1 if is_high_right == (hinge_on == "right") else -1


def _hinge_by(handle: Handle | None, leaf: Leaf) -> int:
    """Return the side away from the handle, -1 or 1; 0 without a handle or when it lies across the leaf."""
    if handle is None or handle.is_panic:
        return 0
    return -1 if handle.centre[0] > 0.5 * (leaf.low.at + leaf.high.at) else 1


def _rate_leaf(leaf: Leaf, frame: Frame | None) -> float:
    """Return the product of two ratings: face of a door's size with edges, and wall beside it."""
    ends = [leaf.low.strength, leaf.high.strength]
    if frame is not None and frame.hinge:
        # The hinge edge of an open leaf merges with its jamb; its contact with the wall is the better evidence.
        ends[0 if frame.hinge < 0 else 1] = 1.0
    elif frame is not None:
        # An object that stands out of the wall hides part of the face; its outline is no edge of the leaf.
        for k, edge in enumerate((leaf.low, leaf.high)):
            if edge.jump > max(frame.depth, 0.0) + _CASING:
                ends[k] = _OCCLUDED
    face = (
        rising(leaf.width, 0.5, 0.62)
        * rising(-leaf.width, -1.4, -1.25)
        * rising(-leaf.rms, -0.024, -0.017)
        * np.sqrt(ends[0] * ends[1])
        * (rising(leaf.top, 1.65, 1.85) if leaf.top_is_seen else 0.8 + 0.2 * rising(leaf.top, 1.5, 1.9))
        * rising(-leaf.top, -2.5, -2.35)
        * (rising(-leaf.bottom, -0.4, -0.15) if leaf.bottom_is_seen else 1.0 - 0.3 * rising(leaf.bottom, 0.3, 1.2))
    )
    wall = 0.3 if frame is None else 0.3 + 0.7 * rising(frame.support, 0.2, 0.7)
    return float(face * wall)


def _confidence(leaf: Leaf, frame: Frame | None, handle: Handle | None, hinge: int) -> float:
    """Return the rating of the leaf times that of its handle and gap."""
    grip = 0.0 if handle is None else handle.quality * (1.0 - 0.65 * rising(_unsure(handle, -hinge), 0.03, 0.09))
    if frame is not None and frame.ajar > _SURELY_AJAR:
        gap = max(frame.gap_share, (leaf.low if frame.hinge > 0 else leaf.high).open_share)
        # A face perpendicular to a wall may also be the side of a cupboard.
        open_mark = 0.55 * rising(gap, 0.2, 0.6) * (1.0 - 0.5 * rising(frame.ajar, *_SQUARE))
        marks = 1.0 - (1.0 - open_mark) * (1.0 - 0.85 * grip)
        if handle is None:
            # Without a handle there is nothing to grasp; seen edge-on, a leaf hides its handle.
            marks = min(marks, _HANDLE_UNKNOWN)
    else:
        marks = 0.2 + 0.8 * grip
    if not hinge:
        marks = min(marks, _HINGE_UNKNOWN)
    if handle is not None:
        # A door is opened by its handle, so the handle's position error limits the confidence.
        marks *= 1.0 - 0.45 * rising(_unsure(handle, -hinge), 0.045, 0.075)
    return _rate_leaf(leaf, frame) * float(marks)


def _unsure(handle: Handle, free_side: int) -> float:
    """Return the position error of the handle's end from which its pivot is derived [m]."""
    if handle.is_lever and free_side:
        return handle.slack[1 if free_side > 0 else 0]
    return 0.0 if handle.is_panic else max(handle.slack)


def _drop_duplicates(candidates: list[_Candidate]) -> list[_Candidate]:
    """Drop candidates whose middle lies within 15 cm of a leaf of higher confidence."""
    kept: list[_Candidate] = []
    for candidate in candidates:
        middle = candidate.leaf.plane.place(0.5 * (candidate.leaf.low.at + candidate.leaf.high.at))
        if all(_distance(other.leaf, middle) > 0.15 for other in kept):
            kept.append(candidate)
    return kept


def _detection(candidate: _Candidate, rays: Rays, ground: float) -> Detection:
    leaf, frame, handle = candidate.leaf, candidate.frame, candidate.handle
    hinge_at, free_at = find_ends(leaf, frame, candidate.hinge, rays, ground, USUAL_THICKNESS)
    width = abs(free_at - hinge_at)
    pose = np.eye(4)
    pose[:3, 0] = leaf.plane.along * (1.0 if free_at > hinge_at else -1.0)
    pose[:3, 1] = np.cross([0.0, 0.0, 1.0], pose[:3, 0])
    pose[:3, 3] = leaf.plane.place(hinge_at, ground)
    side = 1.0 if pose[:3, 1] @ leaf.plane.normal > 0.0 else -1.0
    sizes = {
        "width": width,
        "height": leaf.top if leaf.top_is_seen else max(leaf.top, _GUESSED_HEIGHT),
        "ajar": 0.0 if frame is None else frame.ajar,
        "side": side,
        "lever_direction": 0.0,
    }
    residuals = {"rms": leaf.rms, "yaw_rad": leaf.sigma}
    if frame is not None:
        residuals["behind_wall"] = frame.depth
    if handle is not None:
        (along, up), direction = _pivot(handle, free_at, hinge_at)
        if handle.is_lever and handle.bar is not None:
            far = handle.bar.ends[int(np.argmax(np.linalg.norm(handle.bar.ends - [along, up], axis=1)))]
            sizes["handle_turn_rad"] = float(np.arctan2(up - far[1], abs(along - far[0])))
            sizes["handle_length"] = float(np.hypot(along - far[0], up - far[1])) + handle.bar.radius
        sizes["lever_direction"] = direction
        sizes["handle_x"] = float(abs(along - hinge_at))
        sizes["handle_y"] = float(side * handle.out)
        sizes["handle_z"] = float(up - ground)
        residuals["handle_slack"] = _unsure(handle, -candidate.hinge)
    beyond = max(-sizes.get("handle_x", 0.0), sizes.get("handle_x", 0.0) - width)
    is_astray = beyond > _OFF_LEAF or width > leaf.width + _WIDER_THAN_SEEN
    confidence = candidate.confidence * (_ASTRAY if is_astray else 1.0)
    step = max(1, len(leaf.points) // _SHOWN)
    opens, certainty = judge_opening(leaf, frame, (hinge_at, free_at), rays, ground)
    noise = float(np.clip(_FARTHEST_NOISE * leaf.rms, *_NOISE))
    model = DoorModel(shut_leaf(leaf, frame, handle, pose, sizes, opens, ground), noise)
    residuals |= {"opens_share": certainty, "hinge_share": float(candidate.knows_hinge)}
    residuals["thickness_share"] = 0.0
    return Detection("door", pose, sizes, confidence, residuals, leaf.points[::step], model)


def _pivot(handle: Handle, free_at: float, hinge_at: float) -> tuple[Float[np.ndarray, "2"], float]:
    """Return the pivot's place along the plane and up [m], and the lever's direction: -1 to the hinge, +1 away, 0 none.

    Of other handles it is their middle.
    """
    bar = handle.bar
    if not handle.is_lever or bar is None or handle.extensions is None:
        return handle.centre, 0.0
    outwards = 1 if free_at > hinge_at else -1
    end = 1 if outwards > 0 else 0
    near, far = bar.ends[end], bar.ends[1 - end]
    if handle.pivot_side == -outwards and abs(free_at - near[0]) < _AT_EDGE:
        return far, 1.0
    backset = abs(free_at - near[0]) - np.abs(bar.axis[0]) * EXTENSIONS
    prior = -0.5 * ((backset - _USUAL_BACKSET) / _BACKSET_SPREAD) ** 2 - EXTENSIONS / _USUAL_EXTENSION
    longer, _ = expect_extension(handle.extensions[end], prior)
    return near + longer * outwards * bar.axis, -1.0
