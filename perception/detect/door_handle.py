"""The handle on a face: a bar or knob standing out of it, weighed ray by ray."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from perception.detect.profile import Rays
from perception.detect.upright import Upright

_CELL = 0.01
_STANDOFFS = (0.04, 0.055, 0.07)
_HEIGHTS = (0.75, 1.3)
_REACH = (0.4, 1.7)
_DEEPEST = 0.12
_MOST = 3.0  # what one ray may say, in natural logarithms of odds
_BARS = ((0.05, 0.05), *((length, t) for length in (0.08, 0.11, 0.14, 0.18) for t in (0.02, 0.03, 0.05)))
_PANICS = tuple((share, t) for share in (0.45, 0.6, 0.75) for t in (0.03, 0.05))
_PULLS = tuple((t, length) for length in (0.16, 0.25, 0.35, 0.5) for t in (0.02, 0.03, 0.05))
_RING = 0.04
_JAMB = 0.025
_WENT_ON = 0.06
_LEAST = 6.0
_MOST_SLACK = 0.12
_PULL_END = 0.1
_FRONT = 0.75  # of its radius, what is seen of a bar lies before its middle line on average
_THIN, _BAR, _KNOB = 0.005, 0.012, 0.016  # least and largest radii [m]


@dataclass(frozen=True)
class Handle:
    """What stands out of a face where a handle would.

    Attributes:
        low, high: (2,) corners along the plane and up [m].
        out: how far the middle line of its bar stands out of the face [m].
        is_lever: wider than high.
        is_pull: a bar much higher than wide.
        is_panic: a bar across most of the face.
        evidence: how much better rays are explained by it than by the bare face [log odds].
        purity: share of the rays towards it that met it.
        alone: share of the rays just beside it that met the face behind; of a pull, also above and below it.
        n_rays: how many met it.
        pivot_side: -1 or 1 where a neck or rose was seen nearer to one end of a lever, else 0.
        slack: (2,) how far it may go on unseen beyond its low and high end along the plane [m].
    """

    low: Float[np.ndarray, "2"]
    high: Float[np.ndarray, "2"]
    out: float
    is_lever: bool
    is_pull: bool
    is_panic: bool
    evidence: float
    purity: float
    alone: float
    n_rays: int
    pivot_side: int
    slack: tuple[float, float]

    @property
    def centre(self) -> Float[np.ndarray, "2"]:
        """Along the plane and up [m]."""
        return np.asarray(0.5 * (self.low + self.high))

    @property
    def quality(self) -> float:
        """How surely it is something like a handle, 0 to 1."""
        return float(
            np.clip(self.evidence / 30.0, 0.0, 1.0)
            * np.clip((self.purity - 0.4) / 0.25, 0.0, 1.0)
            * np.clip((self.alone - 0.5) / 0.25, 0.0, 1.0)
            * np.clip((self.out - 0.022) / 0.008, 0.0, 1.0)
            * np.clip((0.094 - self.out) / 0.006, 0.0, 1.0)
        )


def find_handle(
    plane: Upright, low: float, high: float, rms: float, ground: float, rays: Rays, prefer: int = 0
) -> Handle | None:
    """The best handle near a side edge of a face, or a bar across it; None when nothing stands out.

    Args:
        plane: of the face.
        low, high: its side edges along the plane [m].
        rms: scatter of its points [m].
        ground: world z of the floor [m].
        rays: all of the scan.
        prefer: side on which it must be (-1 low, 1 high); 0 either.
    """
    sigma = float(np.clip(rms, 0.006, 0.02))
    width = high - low
    boxes: dict[str, _Box] = {}
    for out in _STANDOFFS:
        at, depth, mine = _towards(rays, plane, out, low, high, ground)
        grid_low = np.array([low, ground + _REACH[0]])
        shape = np.ceil([width / _CELL, (_REACH[1] - _REACH[0]) / _CELL]).astype(int) + 1
        cell = np.floor((at[mine] - grid_low) / _CELL).astype(int)
        grid = np.bincount(
            np.ravel_multi_index(tuple(cell.T), tuple(shape)), _votes(depth[mine], out, sigma), int(np.prod(shape))
        ).reshape(shape)
        for zone in _zones(prefer):
            found = _best_box(grid, width, zone)
            if found is not None and (zone not in boxes or found[0] > boxes[zone].evidence):
                corner = grid_low + np.array(found[1]) * _CELL
                far = corner + found[2]
                if zone == "across":
                    corner[0], far[0] = low + _JAMB, high - _JAMB
                boxes[zone] = _Box(found[0], out, corner, far)
    seen = [_measured(plane, low, high, sigma, ground, rays, box) for box in boxes.values() if box.evidence > _LEAST]
    return max(seen, key=lambda one: (one.quality, one.evidence), default=None)


@dataclass(frozen=True)
class _Box:
    """Where a handle may be: how much speaks for it, its standoff, its corners along the plane and up."""

    evidence: float
    out: float
    low: Float[np.ndarray, "2"]
    high: Float[np.ndarray, "2"]


def _zones(prefer: int) -> tuple[str, ...]:
    """Where on a face a handle may be."""
    sides = {-1: ("low",), 1: ("high",), 0: ("low", "high")}[prefer]
    return (*sides, "across")


def _towards(
    rays: Rays, plane: Upright, out: float, low: float, high: float, ground: float
) -> tuple[Float[np.ndarray, "R 2"], Float[np.ndarray, "R"], Bool[np.ndarray, "R"]]:
    """Crossings of the plane ``out`` before the face, how far out of the face rays ended, and which ones matter."""
    at, end, heading = rays.crossing(plane, out)
    depth = end + out
    inside = heading & (at[:, 0] > low) & (at[:, 0] < high)
    inside &= (at[:, 1] > ground + _REACH[0]) & (at[:, 1] < ground + _REACH[1])
    # What stopped far before the face tells nothing of it, nor does a jamb that stands before its edges; what went on
    # behind an open leaf tells that nothing stood out of it there.
    end_along = rays.ends @ plane.along
    inside &= ((end_along > low + _JAMB) & (end_along < high - _JAMB)) | (depth < -_WENT_ON)
    return at, depth, inside & (depth < _DEEPEST)


def _votes(depth: Float[np.ndarray, "K"], out: float, sigma: float) -> Float[np.ndarray, "K"]:
    """How much rather each ray ended ``out`` before the face than on it [log odds]."""
    return np.asarray(np.clip(out * (2.0 * np.minimum(depth, out + 0.01) - out) / (2.0 * sigma**2), -_MOST, _MOST))


def _best_box(
    grid: Float[np.ndarray, "U V"], width: float, zone: str
) -> tuple[float, tuple[int, int], Float[np.ndarray, "2"]] | None:
    """The box with the greatest sum among those where a handle can be: (sum, corner cell, size [m])."""
    sums = np.pad(np.cumsum(np.cumsum(grid, 0), 1), ((1, 0), (1, 0)))
    best: tuple[float, tuple[int, int], Float[np.ndarray, "2"]] | None = None
    sizes = [(share * width, t) for share, t in _PANICS] if zone == "across" else [*_BARS, *_PULLS]
    for size in sizes:
        a, b = round(size[0] / _CELL), round(size[1] / _CELL)
        if a >= grid.shape[0] or b >= grid.shape[1]:
            continue
        total = sums[a:, b:] - sums[:-a, b:] - sums[a:, :-b] + sums[:-a, :-b]
        along = np.arange(total.shape[0]) * _CELL
        middle = (np.arange(total.shape[1]) + 0.5 * b) * _CELL + _REACH[0]
        slack = 0.15 if size[1] > 0.1 else 0.0
        fits = (middle > _HEIGHTS[0] - slack) & (middle < _HEIGHTS[1] + slack)
        # Its outer end lies 2 to 18 cm from a side edge.
        from_low, from_high = along, width - along - size[0]
        if zone == "across":
            fits_along = (from_low > 0.03) & (from_high > 0.03)
        else:
            outer = from_low if zone == "low" else from_high
            fits_along = (outer > 0.02) & (outer < 0.18)
        total = np.where(fits_along[:, None] & fits[None, :], total, -np.inf)
        cell = np.unravel_index(int(np.argmax(total)), total.shape)
        value = float(total[cell])
        if np.isfinite(value) and (best is None or value > best[0]):
            best = (value, (int(cell[0]), int(cell[1])), np.array(size))
    return best


def _measured(
    plane: Upright,
    low: float,
    high: float,
    sigma: float,
    ground: float,
    rays: Rays,
    box: _Box,
) -> Handle:
    """Extent, standoff and surroundings of a box's handle, from the rays towards it."""
    out, corner, far = box.out, box.low, box.high
    for _ in range(2):
        at, depth, mine = _towards(rays, plane, out, low, high, ground)
        core = mine & ((at > corner - 0.015) & (at < far + 0.015)).all(axis=1) & (depth > 0.6 * out)
        if core.sum() < 3:
            break
        out = float(np.clip(np.median(depth[core]), 0.025, 0.1))
    at, depth, mine = _towards(rays, plane, out, low, high, ground)
    at, depth = at[mine], depth[mine]
    vote = _votes(depth, out, sigma)
    near = ((at > corner - 0.02) & (at < far + 0.02)).all(axis=1)
    met = near & (vote > 0.0)
    trim = 2.0 if met.sum() > 40 else 0.0
    if met.sum() >= 3:
        corner, far = np.percentile(at[met], [trim, 100.0 - trim], axis=0)
    inside = ((at >= corner) & (at <= far)).all(axis=1)
    ring = ((at > corner - _RING) & (at < far + _RING)).all(axis=1)
    ring &= ~((at > corner - 0.015) & (at < far + 0.015)).all(axis=1)
    size = far - corner
    is_panic = bool(size[0] > 0.4 * (high - low))
    is_lever = bool(not is_panic and size[0] > 0.065 and size[0] > 1.6 * size[1])
    is_pull = bool(size[1] > 0.12 and size[1] > 2.0 * size[0])
    on_face = np.abs(depth) < max(2.5 * sigma, 0.02)
    alone = float(np.mean(on_face[ring])) if ring.any() else 0.0
    if is_pull:
        # A pipe or post before the face goes on above and below.
        column = (at[:, 0] > corner[0]) & (at[:, 0] < far[0])
        ends = [
            column & (at[:, 1] > low_end) & (at[:, 1] < low_end + _PULL_END)
            for low_end in (corner[1] - 0.015 - _PULL_END, far[1] + 0.015)
        ]
        alone = min(alone, *(float(np.mean(on_face[end])) if end.any() else 0.0 for end in ends))
    is_bar = is_panic or is_lever or is_pull
    middle = out - _FRONT * float(np.clip(0.5 * size.min(), _THIN, _BAR if is_bar else _KNOB))
    ends = [corner, far]
    if met.sum() >= 3:
        # Rays from above meet a bar's near side higher up than they would cross the plane of its middle line.
        place = rays.crossing(plane, middle)[0][mine][met]
        ends = list(np.percentile(place, [trim, 100.0 - trim], axis=0))
    return Handle(
        ends[0],
        ends[1],
        middle,
        is_lever,
        is_pull,
        is_panic,
        box.evidence,
        float(np.mean(vote[inside] > 0.0)) if inside.any() else 0.0,
        alone,
        int((inside & (vote > 0.0)).sum()),
        _neck_side(at, depth, corner, far, out, sigma) if is_lever else 0,
        _slack(at, vote, corner, far, low, high),
    )


def _slack(
    at: Float[np.ndarray, "K 2"],
    vote: Float[np.ndarray, "K"],
    corner: Float[np.ndarray, "2"],
    far: Float[np.ndarray, "2"],
    low: float,
    high: float,
) -> tuple[float, float]:
    """From either end to the first ray that went past at the height of the bar, or to just before the edge [m]."""
    middle, half = 0.5 * (corner[1] + far[1]), max(0.35 * (far[1] - corner[1]), 0.005)
    past = at[(vote < 0.0) & (np.abs(at[:, 1] - middle) < half), 0]
    below, above = corner[0] - past[past < corner[0]], past[past > far[0]] - far[0]
    most = np.clip([corner[0] - low - _JAMB, high - far[0] - _JAMB], 0.0, _MOST_SLACK)
    return (
        float(min(below.min(initial=_MOST_SLACK), most[0])),
        float(min(above.min(initial=_MOST_SLACK), most[1])),
    )


def _neck_side(
    at: Float[np.ndarray, "K 2"],
    depth: Float[np.ndarray, "K"],
    corner: Float[np.ndarray, "2"],
    far: Float[np.ndarray, "2"],
    out: float,
    sigma: float,
) -> int:
    """The end near which more rays ended between bar and face: there is the neck; 0 when that is not clear."""
    middle = 0.5 * (corner + far)
    about = (np.abs(at[:, 1] - middle[1]) < 0.035) & (at[:, 0] > corner[0] - 0.03) & (at[:, 0] < far[0] + 0.03)
    between = about & (depth > 2.0 * sigma) & (depth < out - 1.5 * sigma)
    side = np.sign(at[:, 0] - middle[0])
    right, left = int((between & (side > 0)).sum()), int((between & (side < 0)).sum())
    if max(left, right) < 5 or max(left, right) < 2.5 * min(left, right):
        return 0
    return 1 if right > left else -1
