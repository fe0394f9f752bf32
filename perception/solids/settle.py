"""Fine fits of an object's pose to a scan, from rough poses, and the comparison with rival poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from perception.sightlines import sight_index
from perception.solids.evidence import FieldOfView, Shape, find_noise, weigh_pose
from perception.solids.fit import (
    MIN_AGREEING,
    MeshPose,
    PoseJudge,
    Region,
    Surface,
    WidePlanes,
    fit_pose,
    make_pose_judge,
)
from perception.solids.mesh import Solid
from perception.solids.rating import MeshMatch, rate_pose
from perception.view import View

_N_BEST = 10
_COARSE_POINTS, _COARSE_RAYS = 250, 500
_MOST_POINTS, _MOST_RAYS = 4000, 6000
_SOME_RAYS = 2000
_FROM_BEHIND, _SETTLE_GATES, _UNSETTLED = (0.0, 0.02), np.linspace(0.06, 0.025, 10), 0.025  # [m]
_N_NUDGED = 4
# Another pose at the same place is settled too if the first is not this sure, up to this many in all, and if its score
# is so near the first's; a tenth of its surface must be off the other pose's by more than the last value [m].
_SURE_HERE, _MOST_HERE, _RIVAL_HERE, _OUTERMOST, _OTHERWISE = 0.8, 3, 0.6, 0.9, 0.03
_NUDGES = (0.04, 0.025, 0.015)  # [m], and five times as many radians
_NUDGE_POINTS = 600
_NUDGE_GATES = np.concatenate([np.linspace(0.05, 0.025, 5), np.full(5, 0.025)])
_DIFFERENT_DEG, _DIFFERENT_M = 20.0, 0.05


def settle_poses(
    rough: Sequence[tuple[float, MeshPose]],
    solid: Solid,
    shape: Shape,
    view: View,
    wide: WidePlanes,
) -> list[MeshMatch]:
    """Return matches fitted from rough poses, without those that overlap a better one.

    Order: confidence times score, best first.

    Args:
        wide: planes of the scan that are wider than the object.
    """
    surface, centre, radius = shape.surface, shape.centre, shape.radius
    index = sight_index(view.cloud)
    field = FieldOfView.of(index.rays)
    fitted: list[tuple[float, MeshPose, PoseJudge]] = []
    for _, start in rough:
        judge = make_pose_judge(surface, index, view, start.to_world(centre), radius, wide)
        if len(judge.region.points) < MIN_AGREEING:
            continue
        few = judge.region.thin(_NUDGE_POINTS)
        away = start.to_world(centre) - few.starts.mean(axis=0)
        away /= np.linalg.norm(away)
        poses = [fit_pose(surface, few, start.translate(by * away), _SETTLE_GATES) for by in _FROM_BEHIND]
        fitted.append((*_rate_first(judge, poses), judge))
    fitted.sort(key=lambda candidate: -candidate[0])
    # An object that was first fitted the wrong way round stays so: what carries it looks like another part of it.
    for _, pose, judge in fitted[:_N_NUDGED]:
        few = judge.region.thin(_NUDGE_POINTS)
        poses = [fit_pose(surface, few, start, _SETTLE_GATES) for start in _turn_by_half(surface, few, pose)]
        if poses:
            fitted.append((*_rate_first(judge, poses), judge))
    fitted.sort(key=lambda candidate: -candidate[0])
    places: list[Place] = []
    for rank, (score, pose, judge) in enumerate(fitted):
        at = pose.to_world(centre)
        here = next((place for place in places if np.linalg.norm(at - place.centre) < radius), None)
        if rank >= _N_NUDGED if here is None else not here.may_be(score, pose, shape):
            continue
        best, settled = _nudge(surface, judge, judge.region.thin(_MOST_POINTS), (score, pose))
        rivals = [other for other, turned, _ in fitted if is_different(settled, turned, centre)]
        # About the place where the search began, points beyond the object's end may be left out.
        judge = make_pose_judge(surface, index, view, settled.to_world(centre), radius, wide)
        evidence = weigh_pose(settled, shape, judge, find_noise(view, wide, settled.to_world(centre)), field)
        match = rate_pose(settled, judge, compare_rivals(rivals, best), solid, evidence)
        if here is None:
            places.append(Place(settled.to_world(centre), score, settled, match, max(best, 0.0), 1))
        else:
            here.enter(settled, match, max(best, 0.0))
    return [place.shared for place in sorted(places, key=lambda place: -place.shared.confidence * place.score)]


@dataclass
class Place:
    """Place of an object, with the best of the poses that were settled there.

    Attributes:
        first: score of the pose that led to it, before it was settled.
        n_settled: number of poses that were settled here.
        rival: largest confidence of the others.
    """

    centre: Float[np.ndarray, "3"]
    first: float
    pose: MeshPose
    match: MeshMatch
    score: float
    n_settled: int
    rival: float = 0.0

    @property
    def shared(self) -> MeshMatch:
        """The match, its confidence shared with the best of the other poses: one of them at most is right."""
        sure = self.match.confidence
        return replace(self.match, confidence=sure * sure / (sure + self.rival)) if sure > 0.0 else self.match

    @property
    def rank(self) -> float:
        """Confidence times score."""
        return self.match.confidence * self.score

    def may_be(self, score: float, pose: MeshPose, shape: Shape) -> bool:
        """Return whether the object may be here in another pose, which is worth settling."""
        if self.match.confidence > _SURE_HERE or self.n_settled >= _MOST_HERE or score < _RIVAL_HERE * self.first:
            return False
        samples = self.pose.to_mesh(pose.to_world(shape.samples))
        off = np.linalg.norm(samples - shape.surface.nearest(samples)[0], axis=1)
        return bool(np.quantile(off, _OUTERMOST) > _OTHERWISE)

    def enter(self, pose: MeshPose, match: MeshMatch, score: float) -> None:
        """Keep the surer of two poses."""
        self.n_settled += 1
        loser = match
        if match.confidence * score > self.rank:
            loser, self.pose, self.match, self.score = self.match, pose, match, score
        self.rival = max(self.rival, loser.confidence)


def _rate_first(judge: PoseJudge, poses: Sequence[MeshPose]) -> tuple[float, MeshPose]:
    """Return the best of some poses that are not yet settled, with its score."""
    rated = [judge.count(pose, _SOME_RAYS, _NUDGE_POINTS, _UNSETTLED).score for pose in poses]
    first = int(np.argmax(rated))
    return rated[first], poses[first]


def _turn_by_half(surface: Surface, region: Region, pose: MeshPose) -> list[MeshPose]:
    """Return the pose turned by half about each principal axis of the points that lie on the object."""
    place, _ = surface.nearest(pose.to_mesh(region.points))
    on = region.points[np.linalg.norm(pose.to_world(place) - region.points, axis=1) < _UNSETTLED]
    if len(on) < MIN_AGREEING:
        return []
    middle = on.mean(axis=0)
    axes = np.linalg.eigh(np.cov((on - middle).T))[1].T
    return [pose.rotate(np.pi * axis, middle) for axis in axes]


def search_about(
    surface: Surface, judge: PoseJudge, region: Region, starts: Sequence[MeshPose], radius: float
) -> list[tuple[float, MeshPose]]:
    """Return scores and poses, fitted from every start on few points and then, for the best, on many."""
    few = region.thin(_COARSE_POINTS)
    gates = np.linspace(0.6 * radius, 0.05, 6)
    rough = [fit_pose(surface, few, start, gates) for start in starts]
    scores = [judge.count(pose, _COARSE_RAYS, _COARSE_POINTS).score for pose in rough]
    best = np.argsort(scores, kind="stable")[::-1][:_N_BEST]
    many = region.thin(_MOST_POINTS)
    gates = np.concatenate([np.linspace(0.06, 0.025, 12), np.full(12, 0.025)])
    fine = [fit_pose(surface, many, rough[i], gates) for i in best]
    scored = [(judge.count(pose, _MOST_RAYS, _MOST_POINTS).score, pose) for pose in fine]
    scored.sort(key=lambda candidate: -candidate[0])
    return [_nudge(surface, judge, many, best) for best in scored[:_N_NUDGED]] + scored[_N_NUDGED:]


def _nudge(surface: Surface, judge: PoseJudge, region: Region, best: tuple[float, MeshPose]) -> tuple[float, MeshPose]:
    """Return the best score and pose after refits from slightly moved poses; ICP stalls where faces slide."""
    few = region.thin(_NUDGE_POINTS)
    for step in _NUDGES:
        about = best[1].to_world(np.zeros(3))
        beside = [best[1].translate(sign * step * axis) for axis in best[1].rotation.T for sign in (-1.0, 1.0)]
        beside += [best[1].rotate(sign * 5.0 * step * axis, about) for axis in np.eye(3) for sign in (-1.0, 1.0)]
        poses = [fit_pose(surface, few, pose, _NUDGE_GATES) for pose in beside]
        best = max([best, *((judge.count(pose, _MOST_RAYS, _MOST_POINTS).score, pose) for pose in poses)],
                    key=lambda scored: scored[0])  # fmt: skip
    return best[0], fit_pose(surface, region, best[1], _NUDGE_GATES[-3:])


def make_starts(centre: Float[np.ndarray, "3"], initial: Float[np.ndarray, "4 4"]) -> list[MeshPose]:
    """Return start poses around an approximate one."""
    given = MeshPose(initial[:3, :3], initial[:3, 3])
    turns = [np.zeros(3), *(sign * 0.3 * axis for axis in np.eye(3) for sign in (-1, 1))]
    shifts = [np.zeros(3), *(sign * 0.08 * axis for axis in np.eye(3) for sign in (-1, 1))]
    about = given.to_world(centre)
    return [given.rotate(turn, about).translate(shift) for turn in turns for shift in shifts]


def compare_rivals(rivals: Sequence[float], best: float) -> float:
    """Return the score of the best rival over a pose's own; 1 for a pose without support."""
    return float(max(0.0, max(rivals, default=0.0)) / best) if best > 0.0 else 1.0


def is_different(pose: MeshPose, other: MeshPose, centre: Float[np.ndarray, "3"]) -> bool:
    angle = np.degrees(Rotation.from_matrix(pose.rotation.T @ other.rotation).magnitude())
    return bool(angle > _DIFFERENT_DEG or np.linalg.norm(pose.to_world(centre) - other.to_world(centre)) > _DIFFERENT_M)
