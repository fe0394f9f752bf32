"""Pairs of links that are not checked against each other: why, and whether they overlap in the motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from jaxtyping import Float

from costs.robot.model import LinkBody
from service.verify.certificate import Basis, Check, Where
from service.verify.coverage import LeftOut
from service.verify.forward import Forward, Placements
from service.verify.link_tree import LinkTree
from service.verify.motion import Motion, Phase, RelativePoseTarget
from service.verify.narrow import Narrow
from service.verify.settings import VerifySettings
from service.verify.solid import Solid
from service.verify.timeline import time_of
from service.verify.track import Track

_SAMPLES = 200
# Two links with one between them that overlap in this share of the poses of the joints between them hardly have a pose
# in which they do not: that is how their shapes are, and says nothing of the motion.
_ALWAYS_SHARE, _POSES = 0.95, 300


def left_out_pairs(track: Track, tree: LinkTree, phases: Sequence[Phase]) -> tuple[LeftOut, ...]:
    """Every pair of the robot's own links with shapes that is not checked."""
    motion = track.motion
    own = sorted(tree.shaped - motion.mechanism_links)
    # Names out of order name no pair: so it stands in RobotModel, and so the pairs to be checked are chosen.
    ignored = {pair for pair in motion.robot.ignored_pairs if pair[0] < pair[1]}
    found, rest = [], []
    for pair in combinations(own, 2):
        if tree.joint[pair[0]] == tree.joint[pair[1]]:
            found.append(LeftOut(pair, "same joint", is_neighbour=False, deepest_m=float("nan")))
        elif pair in ignored and tree.are_neighbours(*pair):
            found.append(LeftOut(pair, "adjacent", is_neighbour=True, deepest_m=float("nan")))
        elif pair in ignored:
            rest.append(pair)
    kept = _kept_joints(motion, phases)
    for pair, depth, s in _depths(track, rest):
        if depth <= 0.0:
            found.append(LeftOut(pair, _reason(motion, pair), is_neighbour=False, deepest_m=0.0))
            continue
        is_kept = frozenset(tree.joint[link] for link in pair) in kept
        is_around = not is_kept and _is_around_a_joint(motion, tree, pair)
        reason = "kept" if is_kept else "around a joint" if is_around else _reason(motion, pair)
        found.append(LeftOut(pair, reason, is_around, depth, s, time_of(motion.law, s)))
    return tuple(sorted(found, key=lambda item: item.pair))


def overlap_checks(left_out: Sequence[LeftOut], settings: VerifySettings) -> Iterator[Check]:
    """One unproven check for each pair that is not checked although its links overlap in the motion."""
    for item in left_out:
        if item.is_neighbour or item.reason == "kept" or not item.deepest_m > settings.contact_tolerance_m:
            continue
        a, b = item.pair
        text = (
            f"{a} is {1e3 * item.deepest_m:.1f} mm inside {b}, a pair that is not checked ({item.reason}) "
            "and whose links are no joint neighbours"
        )
        where = Where(item.s or 0.0, item.time_s, None, item.pair)
        yield Check(f"coverage.overlap.{a}.{b}", True, -item.deepest_m, 0.0, "m", text, where, Basis.UNPROVEN)


def _reason(motion: Motion, pair: tuple[str, str]) -> str:
    told = motion.robot.ignored_reasons.get(pair, "given")
    # Neighbours and links of one joint were told apart above.
    return told if told.startswith("srdf") or told == "derived" else "given"


def _kept_joints(motion: Motion, phases: Sequence[Phase]) -> set[frozenset[int]]:
    """Pairs of joints whose relative pose is held, by a check, in every phase."""
    model = motion.robot.model

    def joint(frame: str | None) -> int:
        return int(model.frames[model.getFrameId(frame)].parentJoint) if frame and model.existFrame(frame) else 0

    held = [
        {
            frozenset((joint(target.frame), joint(target.reference)))
            for target in phase.targets
            if isinstance(target, RelativePoseTarget) and target.free_axis is None and target.reference is not None
        }
        for phase in phases
    ]
    return set.intersection(*held) if held else set()


def _depths(track: Track, pairs: Sequence[tuple[str, str]]) -> Iterator[tuple[tuple[str, str], float, float]]:
    """For each pair its depth at samples of the motion [m], 0 where it keeps apart, and the deepest one's place."""
    if not pairs:
        return
    knots = track.motion.curve.knots
    s = np.unique(np.concatenate([knots, np.linspace(knots[0], knots[-1], _SAMPLES)]))
    placed, rows = track.at(s)
    for pair in pairs:
        depth = _overlap(track.motion.robot.bodies, placed, rows, pair)
        worst = int(depth.argmax())
        yield pair, max(0.0, float(depth[worst])), float(s[worst])


def _overlap(
    bodies: Sequence[LinkBody], placed: Placements, rows: np.ndarray, pair: tuple[str, str]
) -> Float[np.ndarray, "S"]:
    """How deep the pair's bodies are in each other at each pose [m]; negative infinity where their spheres part."""
    depth, narrow = np.full(len(rows), -np.inf), Narrow()
    for one in (Solid.of_body(body) for body in bodies if body.link == pair[0]):
        for other in (Solid.of_body(body) for body in bodies if body.link == pair[1]):
            rotation, translation = placed.relative(other.joint, one.joint, rows)
            (centre, radius), (other_centre, other_radius) = one.sphere, other.sphere
            apart = np.linalg.norm(rotation @ centre + translation - other_centre, axis=1) - radius - other_radius
            near = np.flatnonzero(apart < 0.0)
            solids = [one.convex] * len(near), [other.convex] * len(near)
            distance, _ = narrow.closest(solids[0], rotation[near], translation[near], solids[1])
            depth[near] = np.maximum(depth[near], -distance)
    return depth


def _is_around_a_joint(motion: Motion, tree: LinkTree, pair: tuple[str, str]) -> bool:
    """Whether one link lies between the two, a neighbour of both, and they overlap however the joints between stand."""
    between = [c for c in tree.shaped - set(pair) if all(tree.are_neighbours(c, one) for one in pair)]
    if not between:
        return False
    robot = motion.robot
    q = np.zeros((_POSES, robot.n))
    rng = np.random.default_rng(0)
    for joint in tree.path(*pair):
        first, size = int(robot.model.joints[joint].idx_q), int(robot.model.joints[joint].nq)
        low = np.nan_to_num(robot.lower[first : first + size], neginf=-np.pi)
        high = np.nan_to_num(robot.upper[first : first + size], posinf=np.pi)
        q[:, first : first + size] = rng.uniform(low, high, (_POSES, size))
    depth = _overlap(robot.bodies, Forward(robot.model).at(q), np.arange(_POSES), pair)
    return bool(np.mean(depth > 0.0) >= _ALWAYS_SHARE)
