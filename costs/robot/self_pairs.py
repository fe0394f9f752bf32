"""Which link pairs need no check against each other, found by sampling many poses and never from one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Float
from scipy.spatial import ConvexHull

from costs.robot.model import LinkBody

N_POSES = 500
ALWAYS_FRACTION = 0.95


def link_pair(a: str, b: str) -> tuple[str, str]:
    """The pair's name: sorted."""
    return (a, b) if a < b else (b, a)


def same_joint_pairs(bodies: Sequence[LinkBody]) -> frozenset[tuple[str, str]]:
    """Pairs of links that one joint carries: they never move against each other."""
    joint_of = {body.link: body.joint for body in bodies}
    return frozenset(link_pair(a, b) for a, b in combinations(joint_of, 2) if joint_of[a] == joint_of[b])


def adjacent_pairs(model: pin.Model, bodies: Sequence[LinkBody]) -> frozenset[tuple[str, str]]:
    """Pairs of links joined by one joint, or by several with no body between them."""
    links_of: dict[int, set[str]] = {}
    for body in bodies:
        links_of.setdefault(body.joint, set()).add(body.link)
    pairs: set[tuple[str, str]] = set()
    for joint, links in links_of.items():
        parent = int(model.parents[joint]) if joint > 0 else 0
        while parent > 0 and parent not in links_of:
            parent = int(model.parents[parent])
        if joint > 0:
            pairs.update(link_pair(a, b) for a in links for b in links_of.get(parent, ()))
    return frozenset(pairs)


def contact_counts(
    model: pin.Model,
    bodies: Sequence[LinkBody],
    pairs: Iterable[tuple[str, str]],
    poses: Float[np.ndarray, "N n"],
) -> Mapping[tuple[str, str], int]:
    """In how many of ``poses`` each link pair overlaps."""
    data = model.createData()
    of_link: dict[str, list[int]] = {}
    for index, body in enumerate(bodies):
        of_link.setdefault(body.link, []).append(index)
    objects = [coal.CollisionObject(convex(body.vertices)) for body in bodies]
    counts = dict.fromkeys(pairs, 0)
    request = coal.CollisionRequest()
    for pose in poses:
        pin.forwardKinematics(model, data, pose)
        for body, item in zip(bodies, objects, strict=True):
            placement = data.oMi[body.joint]
            item.setTransform(coal.Transform3s(placement.rotation, placement.translation))
            item.computeAABB()
        for pair in counts:
            if any(_overlap(objects[i], objects[j], request) for i in of_link[pair[0]] for j in of_link[pair[1]]):
                counts[pair] += 1
    return counts


def random_poses(
    model: pin.Model, lower: Float[np.ndarray, "n"], upper: Float[np.ndarray, "n"], count: int, seed: int = 0
) -> Float[np.ndarray, "N n"]:
    """Uniform poses within the limits; unbounded revolute joints over a turn, an unbounded base at zero."""
    rng = np.random.default_rng(seed)
    low, high = lower.copy(), upper.copy()
    for joint in range(1, model.njoints):
        first, size = int(model.joints[joint].idx_q), int(model.joints[joint].nq)
        if not np.all(np.isfinite([low[first], high[first]])):
            low[first : first + size], high[first : first + size] = (0.0, 0.0) if size > 1 else (-np.pi, np.pi)
    return np.asarray(rng.uniform(low, high, (count, len(low))))


def derive_ignored_pairs(
    model: pin.Model,
    bodies: Sequence[LinkBody],
    lower: Float[np.ndarray, "n"],
    upper: Float[np.ndarray, "n"],
    n_poses: int = N_POSES,
) -> Mapping[tuple[str, str], str]:
    """Link pairs not to check, with the reason: ``Adjacent`` or ``Always`` (overlap in nearly all poses)."""
    fixed = same_joint_pairs(bodies) | adjacent_pairs(model, bodies)
    reasons = dict.fromkeys(sorted(fixed), "Adjacent")
    links = sorted({body.link for body in bodies})
    rest = [pair for pair in (link_pair(a, b) for a, b in combinations(links, 2)) if pair not in fixed]
    # A pair apart in one of the first poses can hardly overlap in nearly all: the many poses are for the few left.
    first = contact_counts(model, bodies, rest, random_poses(model, lower, upper, 20))
    suspects = [pair for pair in rest if first[pair] >= 0.8 * 20]
    counts = contact_counts(model, bodies, suspects, random_poses(model, lower, upper, n_poses, seed=1))
    reasons.update((pair, "Always") for pair in suspects if counts[pair] >= ALWAYS_FRACTION * n_poses)
    return reasons


def _overlap(a: coal.CollisionObject, b: coal.CollisionObject, request: coal.CollisionRequest) -> bool:
    if not a.getAABB().overlap(b.getAABB()):
        return False
    return bool(coal.collide(a, b, request, coal.CollisionResult()))


def convex(vertices: Float[np.ndarray, "V 3"]) -> coal.Convex:
    """The hull of ``vertices`` as coal sees it, with triangles that face outwards."""
    points = coal.StdVec_Vec3s()
    points.extend([np.asarray(vertex) for vertex in vertices])
    triangles = coal.StdVec_Triangle()
    hull = ConvexHull(vertices)
    for simplex, plane in zip(hull.simplices, hull.equations, strict=True):
        a, b, c = (int(index) for index in simplex)
        # Qhull does not orient its triangles; coal wants them counter-clockwise seen from outside.
        outward = np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a]) @ plane[:3] > 0.0
        triangles.append(coal.Triangle(a, b, c) if outward else coal.Triangle(a, c, b))
    return coal.Convex(points, triangles)
