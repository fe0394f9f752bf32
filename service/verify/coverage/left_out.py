"""Pairs of links that are not checked against each other: reason, and overlap during the motion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float, Int

from costs.robot.model import LinkBody, RobotModel
from service.verify.certificate import Basis, Check, LeftOut, Where
from service.verify.coverage.apart import SurfaceProofs
from service.verify.coverage.link_tree import JOINT_SIZE_M, LinkTree
from service.verify.motion import Motion, RelativePoseTarget
from service.verify.prepared_motion import ForwardKinematics, Placements, PreparedMotion
from service.verify.solids import CoalSolid, DistanceQuery
from service.verify.timeline import find_time

_SAMPLES = 32  # sampled first; pairs that overlap at no sample are proven apart, or reported
# Two links with one between them count as around a joint when they overlap in this share of the poses of the joints
# between them: their shapes overlap whatever the motion.
_ALWAYS_SHARE, _POSES = 0.9, 300
# A part of a link fixed to the world that was this far from a joint neighbour does not belong to the joint [m].
_APART_M = 0.05
_STILL_M = 1e-3  # of two links against each other: less than what a relative pose that is kept may be off
# Results of _is_around_a_joint by the first body of the pair, kept because they take longer than many proofs.
_AROUND: WeakKeyDictionary[LinkBody, dict[tuple[str, bytes, bytes], bool]] = WeakKeyDictionary()


@dataclass(frozen=True)
class LeftOutPairs:
    """Pairs of the robot's own links with shapes that are not checked, as far as samples of the motion tell.

    Attributes:
        prepared: the motion.
        tree: of the robot's links.
        settled: pairs of which nothing is to be shown: links of one joint, and neighbours.
        overlaps: pairs that overlap at some sample: deepest overlap [m], and where.
        open: pairs that overlap at none, by names in order.
    """

    prepared: PreparedMotion
    tree: LinkTree
    settled: tuple[LeftOut, ...]
    overlaps: Mapping[tuple[str, str], tuple[float, float]]
    open: tuple[tuple[str, str], ...]

    @staticmethod
    def of(prepared: PreparedMotion, tree: LinkTree) -> LeftOutPairs:
        """Collect the pairs of a motion."""
        motion = prepared.motion
        own = sorted(tree.shaped - motion.mechanism_links)
        # Names out of order denote no pair, as documented in RobotModel.
        ignored = {pair for pair in motion.robot.ignored_pairs if pair[0] < pair[1]}
        settled, rest = [], []
        samples = _Samples.of(prepared)
        for pair in combinations(own, 2):
            if tree.joint[pair[0]] == tree.joint[pair[1]]:
                settled.append(LeftOut(pair, "same joint", is_neighbour=False, deepest_m=float("nan")))
            elif pair in ignored and tree.are_neighbours(*pair):
                settled.append(_neighbour_pair(prepared, samples, tree, pair))
            elif pair in ignored:
                rest.append(pair)
        overlaps = _find_sampled_overlaps(samples, rest)
        return LeftOutPairs(
            prepared, tree, tuple(settled), overlaps, tuple(pair for pair in rest if pair not in overlaps)
        )

    def list_left_out(
        self, touching: Mapping[tuple[str, str], tuple[float, float]], proofs: SurfaceProofs
    ) -> tuple[LeftOut, ...]:
        """List every pair with its reason.

        Args:
            touching: those of ``open`` whose hulls are not shown to keep apart.
            proofs: about their surfaces, to which this adds.
        """
        motion, tree = self.prepared.motion, self.tree
        left_out = list(self.settled)
        left_out += [
            LeftOut(pair, _reason(motion, pair), is_neighbour=False, deepest_m=0.0)
            for pair in self.open
            if pair not in touching
        ]
        kept = _kept_joints(self.prepared)
        for pair, (depth, s) in {**self.overlaps, **touching}.items():
            is_kept = frozenset(tree.joint[link] for link in pair) in kept or _is_still(self.prepared, tree, pair)
            if not is_kept and proofs.keep_apart(pair, s):
                left_out.append(LeftOut(pair, _reason(motion, pair), is_neighbour=False, deepest_m=0.0))
                continue
            is_around = not is_kept and _is_around_a_joint(proofs, tree, pair, s)
            reason = "kept" if is_kept else "around a joint" if is_around else _reason(motion, pair)
            left_out.append(LeftOut(pair, reason, is_around, depth, s, find_time(motion.law, s)))
        return tuple(sorted(left_out, key=lambda item: item.pair))


def _neighbour_pair(prepared: PreparedMotion, samples: _Samples, tree: LinkTree, pair: tuple[str, str]) -> LeftOut:
    """Return a pair of joint neighbours.

    Its overlap is given where one link is fixed to the world and a far part of it meets the other.
    """
    if any(tree.joint[link] == 0 for link in pair):
        for depth in samples.depths([pair])[1]:
            worst = int(depth.argmax())
            if depth.min() < -_APART_M and depth[worst] > 0.0:
                deepest, place = float(depth[worst]), float(samples.s[worst])
                time_s = find_time(prepared.motion.law, place)
                return LeftOut(pair, "adjacent", is_neighbour=False, deepest_m=deepest, s=place, time_s=time_s)
    return LeftOut(pair, "adjacent", is_neighbour=True, deepest_m=float("nan"))


def check_overlaps(left_out: Sequence[LeftOut]) -> Iterator[Check]:
    """Yield an unproven check for each pair that is left out although its links overlap in the motion."""
    for item in sorted(left_out, key=lambda item: -item.deepest_m if item.deepest_m > 0.0 else 0.0):
        if item.is_neighbour or item.reason == "kept" or item.s is None:
            continue
        a, b = item.pair
        how = f"is {1e3 * item.deepest_m:.1f} mm inside" if item.deepest_m > 0.0 else "may touch"
        why = f"({item.reason}) and whose links are no joint neighbours"
        if item.reason == "adjacent":
            why = "as joint neighbours, although that part of a link fixed to the world was apart before"
        text = f"{a} {how} {b}, a pair that is left out {why}"
        where = Where(item.s, item.time_s, None, item.pair)
        yield Check(f"coverage.overlap.{a}.{b}", True, -item.deepest_m, 0.0, "m", text, where, Basis.UNPROVEN)


def _reason(motion: Motion, pair: tuple[str, str]) -> str:
    reason = motion.robot.ignored_reasons.get(pair, "given")
    return reason if reason.startswith("srdf") or reason == "derived" else "given"


def _kept_joints(prepared: PreparedMotion) -> set[frozenset[int]]:
    """Return pairs of joints whose relative pose is held, by a check, in every phase."""
    model = prepared.motion.robot.model

    def joint(frame: str | None) -> int:
        return int(model.frames[model.getFrameId(frame)].parentJoint) if frame and model.existFrame(frame) else 0

    held = [
        {
            frozenset((joint(target.frame), joint(target.reference)))
            for target in phase.targets
            if isinstance(target, RelativePoseTarget) and target.free_axis is None and target.reference is not None
        }
        for phase in prepared.phases
    ]
    return set.intersection(*held) if held else set()


def _is_still(prepared: PreparedMotion, tree: LinkTree, pair: tuple[str, str]) -> bool:
    """Return whether the joints between two links move them by less than ``_STILL_M``: they are as at the start."""
    low, high = prepared.range
    moved = high.max(axis=0) - low.min(axis=0)
    holder, mover = (tree.joint[link] for link in pair)
    points = [body.vertices for body in prepared.motion.robot.bodies if body.link == pair[1]]
    chain = prepared.tree.chain(holder, mover, np.concatenate(points))
    return float((chain.reach * chain.ratio * moved[chain.coordinates]).sum()) <= _STILL_M


@dataclass(frozen=True)
class _Samples:
    """Poses of the motion at which pairs that are left out are looked at: all knots, and more between.

    Attributes:
        s: (S,) path parameters; of poses without a path their numbers.
        placed, rows: joint placements, and which of them belong to these parameters.
        solids: the robot's bodies.
        centres, radii: (S, B, 3), (B,) their spheres in the world [m].
    """

    s: Float[np.ndarray, "S"]
    placed: Placements
    rows: Int[np.ndarray, "S"]
    solids: tuple[CoalSolid, ...]
    centres: Float[np.ndarray, "S B 3"]
    radii: Float[np.ndarray, "B"]

    @staticmethod
    def of(prepared: PreparedMotion) -> _Samples:
        knots = prepared.motion.curve.knots
        s = np.unique(np.concatenate([knots, np.linspace(knots[0], knots[-1], _SAMPLES)]))
        return _Samples.at(prepared.motion.robot.bodies, s, *prepared.at(s))

    @staticmethod
    def at(
        bodies: Sequence[LinkBody], s: Float[np.ndarray, "S"], placed: Placements, rows: Int[np.ndarray, "S"]
    ) -> _Samples:
        solids = tuple(CoalSolid.of_body(body) for body in bodies)
        where = rows[:, None], np.array([solid.joint for solid in solids], dtype=int)
        local = np.array([solid.sphere[0] for solid in solids]).reshape(-1, 3, 1)
        centres = (placed.rotation[where] @ local)[..., 0] + placed.translation[where]
        return _Samples(s, placed, rows, solids, centres, np.array([solid.sphere[1] for solid in solids]))

    def overlap(self, pair: tuple[str, str]) -> Float[np.ndarray, "S"]:
        """Return the overlap of a pair's links at each pose [m]; negative infinity where their spheres are apart."""
        return np.asarray(self.depths([pair])[1].max(axis=0))

    def depths(self, pairs: Sequence[tuple[str, str]]) -> tuple[Int[np.ndarray, "K"], Float[np.ndarray, "K S"]]:
        """Return the same for each pair of bodies of each pair of links, and the number of its pair of links."""
        of_link: dict[str, list[int]] = {}
        for body, solid in enumerate(self.solids):
            of_link.setdefault(solid.link, []).append(body)
        both = [(n, i, j) for n, (a, b) in enumerate(pairs) for i, j in product(of_link[a], of_link[b])]
        number, first, second = np.array(both, dtype=int).reshape(-1, 3).T  # of the links, and of their bodies
        between = self.centres[:, first] - self.centres[:, second]
        reach = self.radii[first] + self.radii[second]
        near, k = np.nonzero(np.einsum("skx,skx->sk", between, between) < reach * reach)
        depth = np.full((len(both), len(self.rows)), -np.inf)
        joint = np.array([solid.joint for solid in self.solids], dtype=int)
        rows, moved, held = self.rows[near], joint[first[k]], joint[second[k]]
        back = np.swapaxes(self.placed.rotation[rows, held], -1, -2)
        offset = self.placed.translation[rows, moved] - self.placed.translation[rows, held]
        movers, holders = ([self.solids[b].convex for b in side[k].tolist()] for side in (first, second))
        turned, shifted = back @ self.placed.rotation[rows, moved], (back @ offset[..., None])[..., 0]
        distance, _ = DistanceQuery().closest(movers, turned, shifted, holders)
        depth[k, near] = -distance
        return number, depth


def _find_sampled_overlaps(
    samples: _Samples, pairs: Sequence[tuple[str, str]]
) -> dict[tuple[str, str], tuple[float, float]]:
    """Return pairs that overlap at some sample of the motion: deepest overlap [m], and where."""
    number, depth = samples.depths(pairs)
    deepest = np.full((len(pairs), len(samples.rows)), -np.inf)
    np.maximum.at(deepest, number, depth)
    worst = deepest.argmax(axis=1)
    return {
        pair: (float(deepest[k, worst[k]]), float(samples.s[worst[k]]))
        for k, pair in enumerate(pairs)
        if deepest[k, worst[k]] > 0.0
    }


def _is_around_a_joint(proofs: SurfaceProofs, tree: LinkTree, pair: tuple[str, str], s: float) -> bool:
    """Return whether a link between the two is a neighbour of both, and they overlap in nearly all poses.

    With meshes, what is far from the joints between has to keep apart; the link between may then be a part of one.
    """
    motion = proofs.prepared.motion
    between = [c for c in tree.shaped - set(pair) if all(tree.are_neighbours(c, link) for link in pair)]
    path = tree.path(*pair)
    if not (between or len(path) == 2) or not _overlap_always(motion.robot, tree, pair):
        return False
    if not proofs.have_meshes(pair):
        return bool(between)
    model, centres = motion.robot.model, []
    for link in pair:
        own = tree.joint[link]
        below = [joint for joint in path if int(model.parents[joint]) == own]
        centres.append(np.zeros(3) if own in path else np.array(model.jointPlacements[below[0]].translation))
    return proofs.keep_apart_beyond(pair, s, centres, JOINT_SIZE_M)


def _overlap_always(robot: RobotModel, tree: LinkTree, pair: tuple[str, str]) -> bool:
    """Return whether the hulls of two links overlap in nearly all poses of the joints between them."""
    first = next(body for body in robot.bodies if body.link == pair[0])
    known = _AROUND.setdefault(first, {})
    key = (pair[1], robot.lower.tobytes(), robot.upper.tobytes())
    if key not in known:
        known[key] = _share_of_overlaps(robot, tree, pair) >= _ALWAYS_SHARE
    return known[key]


def _share_of_overlaps(robot: RobotModel, tree: LinkTree, pair: tuple[str, str]) -> float:
    """Return the share of random poses of the joints between two links in which they overlap."""
    q = np.zeros((_POSES, robot.n))
    rng = np.random.default_rng(0)
    for joint in tree.path(*pair):
        # A joint that follows another one has no coordinate of its own, and the index of the one it follows.
        first, size = int(robot.model.joints[joint].idx_q), max(int(robot.model.joints[joint].nq), 1)
        low = np.nan_to_num(robot.lower[first : first + size], neginf=-np.pi)
        high = np.nan_to_num(robot.upper[first : first + size], posinf=np.pi)
        q[:, first : first + size] = rng.uniform(low, high, (_POSES, size))
    poses = np.arange(_POSES)
    depth = _Samples.at(robot.bodies, poses.astype(float), ForwardKinematics(robot.model).at(q), poses).overlap(pair)
    return float(np.mean(depth > 0.0))
