"""Refinement of pose and sizes of many hypotheses together, on the ends of rays and on the space they passed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from costs.stopping import poll
from perception.detect.engine.primitives import Primitive, nearest, nearest_part
from perception.detect.engine.region import Region
from perception.detect.engine.template import Template

_STEP = 1e-4  # of finite differences [m]
_SAMPLES, _FEW_SAMPLES = 8, 4  # along a ray through an object
_COARSE = 0.012  # gates beyond which few samples do [m]
_ROUGHLY = 0.018  # distance of a point that lies on a rough fit [m]
_BESIDE = 0.045  # up to which a point lies beside it [m]
_FREE = 1e3  # standard deviation of what no mount holds
_DAMPING = 1e-2  # of Levenberg's steps, as a share of the information
_TURN_FLOOR, _SHIFT_FLOOR = 10.0, 100.0  # information added to a turn [1/rad^2] and a shift [1/m^2] in each step
_MOST_TURN, _MOST_SHIFT = 0.25, 0.03  # in one step: [rad], [m]
_BEFORE_END = 2.5  # standard deviations before a ray's end up to which it shows empty space
_TURNED = 3.0  # standard deviations from level from which an object counts as turned
_CORRELATED = 4.0  # neighbouring rays that err together


@dataclass(frozen=True)
class Hypotheses:
    """Objects of one template.

    Attributes:
        rotation: (B, 3, 3) from the object's frame to the world's.
        place: (B, 3) of the object's origin [m].
        sizes: (B, S) [m].
        start: (B, 3, 3) and (B, 3), pose against which the mount holds it.
        normal: (B, 3) unit normal of the mount.
    """

    rotation: Float[np.ndarray, "B 3 3"]
    place: Float[np.ndarray, "B 3"]
    sizes: Float[np.ndarray, "B S"]
    start: tuple[Float[np.ndarray, "B 3 3"], Float[np.ndarray, "B 3"]]
    normal: Float[np.ndarray, "B 3"]

    @staticmethod
    def of(
        rotation: Float[np.ndarray, "B 3 3"],
        place: Float[np.ndarray, "B 3"],
        sizes: Float[np.ndarray, "B S"],
        normal: Float[np.ndarray, "3"],
    ) -> Hypotheses:
        """Return hypotheses that a mount holds where they start."""
        return Hypotheses(rotation, place, sizes, (rotation, place), np.broadcast_to(normal, place.shape))

    def __len__(self) -> int:
        return len(self.place)

    def select(self, keep: Int[np.ndarray, "K"] | Sequence[int]) -> Hypotheses:
        """Return only these hypotheses."""
        keep = np.asarray(keep, dtype=int)
        return Hypotheses(
            self.rotation[keep],
            self.place[keep],
            self.sizes[keep],
            (self.start[0][keep], self.start[1][keep]),
            self.normal[keep],
        )

    def local(self, places: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "B N 3"]:
        """Return places of the world in each object's frame [m]."""
        return np.asarray((places[None] - self.place[:, None]) @ self.rotation)

    def turn(self, ways: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "B N 3"]:
        """Return directions of the world in each object's frame."""
        return np.asarray(ways[None] @ self.rotation)


def join(parts: Sequence[Hypotheses]) -> Hypotheses:
    """Return all hypotheses of several groups."""
    return Hypotheses(
        np.concatenate([part.rotation for part in parts]),
        np.concatenate([part.place for part in parts]),
        np.concatenate([part.sizes for part in parts]),
        (np.concatenate([part.start[0] for part in parts]), np.concatenate([part.start[1] for part in parts])),
        np.concatenate([part.normal for part in parts]),
    )


@dataclass(frozen=True)
class Refined:
    """Refined hypotheses.

    Attributes:
        cost: (B,) mean robust cost of the rays near each.
        information: (B, D, D) inverse covariance of rotation, place and sizes.
    """

    hypotheses: Hypotheses
    cost: Float[np.ndarray, "B"]
    information: Float[np.ndarray, "B D D"]


def refine(template: Template, begun: Hypotheses, region: Region, gates: Sequence[float]) -> Refined:
    """Return hypotheses after one Levenberg step per gate [m], and their costs."""
    fits = begun
    # Without a floor, a turn about an axis of symmetry would take the whole step.
    floor = np.array([*[_TURN_FLOOR] * 3, *[_SHIFT_FLOOR] * 3, *[1.0] * len(template.sizes)])
    information = np.zeros((len(fits), 6 + len(template.sizes), 6 + len(template.sizes)))
    cost = np.full(len(fits), np.inf)
    for gate in gates:
        poll()
        information, gradient, cost = _normal_equations(template, fits, region, gate)
        diagonal = _DAMPING * np.einsum("bii->bi", information) + floor
        damped = information + np.einsum("bi,ij->bij", diagonal, np.eye(len(floor)))
        step = -np.linalg.solve(damped, gradient[..., None])[..., 0]
        fits = _move(template, fits, step)
    if gates:
        information, _, cost = _normal_equations(template, fits, region, gates[-1])
    return Refined(fits, cost, information)


def rate_roughly(template: Template, fits: Hypotheses, region: Region) -> Float[np.ndarray, "B"]:
    """Return a rough score: ends on the object, less ends beside it and rays through it."""
    sigma = float(np.hypot(region.sigma, template.model_sigma))
    solids = template.solids(fits.sizes)
    _, depth = deepest(template, fits, solids, region, sigma, _FEW_SAMPLES)
    past = np.clip(-depth / _ROUGHLY, 0.0, 1.0)
    return np.asarray(rate_ends(template, fits, region.ends[~region.is_other]) - past.sum(axis=1))


def rate_ends(template: Template, fits: Hypotheses, ends: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "B"]:
    """Return the number of points on each object, less those beside it."""
    at_end = np.abs(nearest(template.solids(fits.sizes), fits.local(ends)))
    is_on = np.exp(-((at_end / _ROUGHLY) ** 2))
    beside = np.where(at_end < _BESIDE, 1.0 - is_on, 0.0)
    return np.asarray((is_on - 0.7 * beside).sum(axis=1))


def deepest(
    template: Template,
    fits: Hypotheses,
    solids: Sequence[Primitive],
    region: Region,
    sigma: float,
    n_samples: int = _SAMPLES,
) -> tuple[Float[np.ndarray, "B N 3"], Float[np.ndarray, "B N"]]:
    """Return, for each ray, the place before its end that is deepest in the object, and the distance there [m].

    Rays that end before the object count as far from it.
    """
    start, way = fits.local(region.start), fits.turn(region.way)
    middle = template.middle(template.named(fits.sizes))[:, None]
    centre = np.einsum("bni,bni->bn", middle - start, way)
    aside = ((start + centre[..., None] * way - middle) ** 2).sum(axis=-1)
    half = np.sqrt(np.maximum(template.radii(fits.sizes)[:, None] ** 2 - aside, 0.0))
    last = np.minimum(centre + half, region.length - _BEFORE_END * sigma)
    first = centre - half
    is_through = (last > first) & (half > 0.0)
    best_at = 0.5 * (first + last)
    best = np.full(centre.shape, np.inf)
    step = np.maximum(last - first, 0.0) / n_samples
    for i in range(n_samples):
        at = first + (i + 0.5) * step
        there = nearest(solids, start + at[..., None] * way)
        nearer = there < best
        best, best_at = np.where(nearer, there, best), np.where(nearer, at, best_at)
    for shrink in (0.5, 0.25) if n_samples == _SAMPLES else ():
        for side in (-1.0, 1.0):
            at = np.clip(best_at + side * shrink * step, first, np.maximum(last, first))
            there = nearest(solids, start + at[..., None] * way)
            nearer = there < best
            best, best_at = np.where(nearer, there, best), np.where(nearer, at, best_at)
    return start + best_at[..., None] * way, np.where(is_through, best, np.inf)


def _normal_equations(
    template: Template, fits: Hypotheses, region: Region, gate: float
) -> tuple[Float[np.ndarray, "B D D"], Float[np.ndarray, "B D"], Float[np.ndarray, "B"]]:
    """Return information, gradient and cost of all rows: ends of rays, space passed, usual sizes, mount."""
    sigma = float(np.hypot(region.sigma, template.model_sigma))
    solids = template.solids(fits.sizes)
    ends = fits.local(region.ends)
    at_end, end_part = nearest_part(solids, ends)
    through, depth = deepest(template, fits, solids, region, sigma, _FEW_SAMPLES if gate > _COARSE else _SAMPLES)
    kernel = max(gate, 2.0 * sigma)
    near = np.abs(at_end) < 3.0 * kernel
    weight_end = np.where(near & ~region.is_other, 1.0 / (1.0 + (at_end / kernel) ** 2) ** 2, 0.0)
    inside = np.minimum(depth + 0.5 * region.pitch, 0.0)
    inside = np.where(np.isfinite(inside), inside, 0.0)
    weight_in = np.where(inside < 0.0, 1.0 / (1.0 + (inside / (2.0 * kernel)) ** 2), 0.0)
    at = np.concatenate([ends, through], axis=1)
    residual = np.concatenate([at_end, inside], axis=1)
    weight = np.concatenate([weight_end, weight_in], axis=1) / (sigma**2 * _CORRELATED)
    part = np.concatenate([end_part, nearest_part(solids, through)[1]], axis=1)
    jacobian = _jacobian(template, fits, solids, at, part, weight > 0.0)
    weighted = jacobian * weight[..., None]
    information = weighted.transpose(0, 2, 1) @ jacobian
    gradient = (weighted.transpose(0, 2, 1) @ residual[..., None])[..., 0]
    _add_priors(template, fits, information, gradient)
    bound = np.concatenate([np.minimum(at_end**2, kernel**2) * (near & ~region.is_other), inside**2], axis=1)
    counted = near & ~region.is_other
    cost = bound.sum(axis=1) / np.maximum(counted.sum(axis=1), 12) / sigma**2
    return information, gradient, cost


def _jacobian(
    template: Template,
    fits: Hypotheses,
    solids: Sequence[Primitive],
    at: Float[np.ndarray, "B M 3"],
    part: Int[np.ndarray, "B M"],
    counts: Bool[np.ndarray, "B M"],
) -> Float[np.ndarray, "B M D"]:
    """Return the derivatives of the distance at places by turn, shift (both of the world) and sizes.

    Args:
        part: nearest part of each place, whose distance is derived.
        counts: places whose derivatives are needed; those of others are zero.
    """
    jacobian = np.zeros((*at.shape[:2], 6 + len(template.sizes)))
    larger = [template.solids(fits.sizes + _STEP * step) for step in np.eye(len(template.sizes))]
    for k, solid in enumerate(solids):
        rows, cells = np.nonzero(counts & (part == k))
        if not len(rows):
            continue
        places, mine = at[rows, cells][:, None], solid.take(rows)
        base = mine.distance(places)[:, 0]
        local = np.stack([(mine.distance(places + _STEP * axis)[:, 0] - base) / _STEP for axis in np.eye(3)], axis=-1)
        to_world = fits.rotation[rows]
        towards = np.einsum("kij,kj->ki", to_world, local)
        arm = np.einsum("kij,kj->ki", to_world, places[:, 0])
        jacobian[rows, cells, :3], jacobian[rows, cells, 3:6] = -np.cross(arm, towards), -towards
        for i, bigger in enumerate(larger):
            if _is_same(solid, bigger[k]):
                continue
            jacobian[rows, cells, 6 + i] = (bigger[k].take(rows).distance(places)[:, 0] - base) / _STEP
    return jacobian


def _is_same(one: Primitive, other: Primitive) -> bool:
    """Return whether two primitives have the same places and sizes."""
    return all(np.array_equal(value, vars(other)[name]) for name, value in vars(one).items())


def _add_priors(
    template: Template,
    fits: Hypotheses,
    information: Float[np.ndarray, "B D D"],
    gradient: Float[np.ndarray, "B D"],
) -> None:
    """Add the rows of the usual sizes and of the mount to the normal equations."""
    for i, spread in enumerate(template.spread):
        information[:, 6 + i, 6 + i] += spread**-2
        gradient[:, 6 + i] += (fits.sizes[:, i] - template.usual[i]) / spread**2
    if template.mount == "none":
        return
    if np.isfinite(template.looseness.level):
        x = fits.rotation[:, :, 0]
        off = x[:, 2] / template.looseness.level
        weight = (1.0 / (1.0 + (off / _TURNED) ** 2) / template.looseness.level) ** 2
        # A turn moves the x axis by its cross product with it.
        slope = np.stack([x[:, 1], -x[:, 0], np.zeros(len(x))], axis=1)
        information[:, :3, :3] += weight[:, None, None] * slope[:, :, None] * slope[:, None]
        gradient[:, :3] += (weight * x[:, 2])[:, None] * slope
    turned = Rotation.from_matrix(fits.rotation @ fits.start[0].transpose(0, 2, 1)).as_rotvec()
    across = np.eye(3) - fits.normal[:, :, None] * fits.normal[:, None]
    tilt = template.looseness.tilt**-2
    information[:, :3, :3] += tilt * across
    gradient[:, :3] += tilt * (across @ turned[..., None])[..., 0]
    along = fits.normal[:, :, None] * fits.normal[:, None]
    height = template.looseness.height**-2
    information[:, 3:6, 3:6] += height * along
    gradient[:, 3:6] += height * (along @ (fits.place - fits.start[1])[..., None])[..., 0]


def _move(template: Template, fits: Hypotheses, step: Float[np.ndarray, "B D"]) -> Hypotheses:
    """Return the hypotheses after a step, each bounded."""
    turn, shift = step[:, :3], step[:, 3:6]
    angle, length = np.linalg.norm(turn, axis=1), np.linalg.norm(shift, axis=1)
    scale = np.minimum(1.0, np.minimum(_MOST_TURN / np.maximum(angle, 1e-9), _MOST_SHIFT / np.maximum(length, 1e-9)))
    rotation = Rotation.from_rotvec(scale[:, None] * turn).as_matrix() @ fits.rotation
    return replace(
        fits,
        rotation=rotation,
        place=fits.place + scale[:, None] * shift,
        sizes=template.clip(fits.sizes + scale[:, None] * step[:, 6:]),
    )
