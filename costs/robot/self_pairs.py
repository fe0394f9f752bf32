"""Link pairs that need no check against each other, derived from the tree and from many sampled poses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

import coal
import numpy as np
import pinocchio as pin
from jaxtyping import Bool, Float

from costs.robot.model import LinkBody

N_POSES = 500
ALWAYS_FRACTION = 0.95
JOINT_SIZE_M = 0.25  # a part fixed to a link within this distance of its joint counts as part of the joint


def sort_pair(a: str, b: str) -> tuple[str, str]:
    """Return the pair's name: sorted."""
    return (a, b) if a < b else (b, a)


def find_same_joint_pairs(bodies: Sequence[LinkBody]) -> frozenset[tuple[str, str]]:
    """Find pairs of links that one joint carries: they never move against each other."""
    joint_of = {body.link: body.joint for body in bodies}
    return frozenset(sort_pair(a, b) for a, b in combinations(joint_of, 2) if joint_of[a] == joint_of[b])


def find_adjacent_pairs(model: pin.Model, bodies: Sequence[LinkBody]) -> frozenset[tuple[str, str]]:
    """Find joint neighbours: a link and the nearest link above it in the tree that has a body.

    A part fixed to either of the two counts as part of it only where all of it is near the joint.  A link fixed to the
    world is a neighbour only of the links it carries.
    """
    joint_of = {body.link: body.joint for body in bodies}
    above = find_carriers(model, joint_of)
    mounts = {link: _find_mount(above, link, joint_of) for link in joint_of}
    pairs = {sort_pair(link, mount) for link, mount in mounts.items() if mount is not None}
    for joint in sorted(set(joint_of.values()) - {0}):
        hinge, parent = joint, int(model.parents[joint])
        while parent > 0 and parent not in joint_of.values():
            hinge, parent = parent, int(model.parents[parent])
        if parent == 0:
            continue
        heads = {
            link: mount
            for link, mount in mounts.items()
            if joint_of[link] == joint and mount and joint_of[mount] == parent
        }
        near = _find_near(bodies, joint, np.zeros(3)) | set(heads)
        others = _find_near(bodies, parent, model.jointPlacements[hinge].translation) | set(heads.values())
        pairs.update(sort_pair(a, b) for a in near for b in others)
    return frozenset(pairs)


def _find_mount(above: Mapping[str, str | None], link: str, joint_of: Mapping[str, int]) -> str | None:
    """Find the nearest link above that has a body."""
    mount = above[link]
    while mount is not None and mount not in joint_of:
        mount = above[mount]
    return mount


def _find_near(bodies: Sequence[LinkBody], joint: int, origin: Float[np.ndarray, "3"]) -> set[str]:
    """Find links of a joint with all vertices near a point of its frame."""
    links = {body.link for body in bodies if body.joint == joint}
    far = {
        b.link for b in bodies if b.joint == joint and np.linalg.norm(b.vertices - origin, axis=1).max() > JOINT_SIZE_M
    }
    return links - far


def find_carriers(model: pin.Model, joint_of: Mapping[str, int]) -> dict[str, str | None]:
    """Find the link that carries each link, None for the root.

    Links are the model's body frames; a link of ``joint_of`` (joint by name) that has no frame is carried by the first
    one that moves with the nearest joint above.
    """
    above: dict[str, str | None] = {}
    frames = model.frames
    for frame in frames:
        if frame.type == pin.FrameType.BODY and frame.name != "universe":
            carrier = frames[frame.parentFrame]
            while carrier.type != pin.FrameType.BODY and carrier.name != "universe":
                carrier = frames[carrier.parentFrame]
            above[frame.name] = None if carrier.name == "universe" else str(carrier.name)
    first_at: dict[int, str] = {}
    for frame in frames:
        if frame.name in above:
            first_at.setdefault(int(frame.parentJoint), frame.name)
    for link, joint in joint_of.items():
        first_at.setdefault(joint, link)
    for link, joint in joint_of.items():
        if link in above:
            continue
        above[link] = first_at[joint] if first_at[joint] != link else None
        while above[link] is None and joint > 0:
            joint = int(model.parents[joint])
            above[link] = first_at.get(joint)
    return above


def count_contacts(
    model: pin.Model,
    bodies: Sequence[LinkBody],
    pairs: Iterable[tuple[str, str]],
    poses: Float[np.ndarray, "N n"],
    solids: Sequence[coal.Convex] | None = None,
) -> Mapping[tuple[str, str], int]:
    """Count in how many of ``poses`` each link pair overlaps; ``solids`` are the bodies' hulls, if made already."""
    counts = dict.fromkeys(pairs, 0)
    if not counts:
        return counts
    wanted = np.array([[sort_pair(a.link, b.link) in counts for b in bodies] for a in bodies], dtype=bool)
    wanted &= np.triu(np.ones_like(wanted), 1)
    boxes = np.array([[body.vertices.min(axis=0), body.vertices.max(axis=0)] for body in bodies])
    middle, half = 0.5 * (boxes[:, 0] + boxes[:, 1]), 0.5 * (boxes[:, 1] - boxes[:, 0])
    solids = [convex(body.vertices) for body in bodies] if solids is None else solids
    data = model.createData()
    for pose in poses:
        pin.forwardKinematics(model, data, pose)
        placements = [coal.Transform3s(data.oMi[b.joint].rotation, data.oMi[b.joint].translation) for b in bodies]
        overlapping: set[tuple[str, str]] = set()
        for i, j in np.argwhere(wanted & _boxes_meet(middle, half, placements)):
            pair = sort_pair(bodies[i].link, bodies[j].link)
            if pair not in overlapping and _overlap(solids[i], placements[i], solids[j], placements[j]):
                overlapping.add(pair)
        for pair in overlapping:
            counts[pair] += 1
    return counts


def draw_poses(
    model: pin.Model, lower: Float[np.ndarray, "n"], upper: Float[np.ndarray, "n"], count: int, seed: int = 0
) -> Float[np.ndarray, "N n"]:
    """Draw uniform poses within the limits; unbounded revolute joints over a turn, an unbounded base at zero."""
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
) -> Mapping[tuple[str, str], str]:
    """Derive link pairs not to check, with the reason: ``Adjacent``, or ``Always`` (overlap in nearly all poses)."""
    fixed = find_same_joint_pairs(bodies) | find_adjacent_pairs(model, bodies)
    reasons = dict.fromkeys(sorted(fixed), "Adjacent")
    links = sorted({body.link for body in bodies})
    rest = [pair for pair in (sort_pair(a, b) for a, b in combinations(links, 2)) if pair not in fixed]
    # A pair apart in one of the first poses can hardly overlap in nearly all: the many poses are for the few left.
    solids = [convex(body.vertices) for body in bodies]
    first = count_contacts(model, bodies, rest, draw_poses(model, lower, upper, 20), solids)
    suspects = [pair for pair in rest if first[pair] >= 0.8 * 20]
    counts = count_contacts(model, bodies, suspects, draw_poses(model, lower, upper, N_POSES, seed=1), solids)
    reasons.update((pair, "Always") for pair in suspects if counts[pair] >= ALWAYS_FRACTION * N_POSES)
    return reasons


def _boxes_meet(
    middle: Float[np.ndarray, "B 3"], half: Float[np.ndarray, "B 3"], placements: Sequence[coal.Transform3s]
) -> Bool[np.ndarray, "B B"]:
    """Return which bodies' boxes overlap, each the axis-aligned box of its turned box; half edge lengths are given."""
    rotation = np.array([placement.getRotation() for placement in placements]).reshape(-1, 3, 3)
    translation = np.array([placement.getTranslation() for placement in placements]).reshape(-1, 3)
    centre = np.einsum("bij,bj->bi", rotation, middle) + translation
    reach = np.einsum("bij,bj->bi", np.abs(rotation), half)
    low, high = centre - reach, centre + reach
    return np.asarray(((low[:, None] <= high) & (low <= high[:, None])).all(axis=2))


def _overlap(a: coal.Convex, pose_a: coal.Transform3s, b: coal.Convex, pose_b: coal.Transform3s) -> bool:
    return bool(coal.collide(a, pose_a, b, pose_b, coal.CollisionRequest(), coal.CollisionResult()))


def convex(vertices: Float[np.ndarray, "V 3"]) -> coal.Convex:
    """Make coal's hull of ``vertices``, with triangles that face outwards."""
    from scipy.spatial import ConvexHull  # slow to import

    hull = ConvexHull(vertices)
    a, b, c = vertices[hull.simplices].transpose(1, 0, 2)
    # Qhull does not orient its triangles; coal wants them counter-clockwise seen from outside.
    is_inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    corners = np.where(is_inward[:, None], hull.simplices[:, ::-1], hull.simplices)
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(list(np.asarray(vertices)))
    triangles.extend([coal.Triangle(*corner) for corner in corners.tolist()])
    return coal.Convex(points, triangles)
