"""Pose search for a known mesh in a scan: ICP from many start poses, scored by the rays of the scan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from perception.errors import MeshError
from perception.sightlines import sight_index
from perception.solids.fit import (
    MIN_AGREEING,
    MeshPose,
    PoseJudge,
    Region,
    Surface,
    find_wide_planes,
    fit_pose,
    make_pose_judge,
)
from perception.solids.mesh import Mesh, Solid, make_solid
from perception.solids.nearest_field import NearestField
from perception.solids.places import find_candidates, list_beside, spread_samples
from perception.view import View

CONFIDENT = 0.5
_N_BEST = 10
_COARSE_POINTS, _COARSE_RAYS = 250, 500
_MOST_POINTS, _MOST_RAYS = 4000, 6000
# Search without an approximate pose: samples of the surface; points, steps and last gate [m] of the rough fits;
# different orientations kept at a place; rough poses and rays of the fits to follow.
_SAMPLES, _ROUGH_POINTS, _ROUGH_STEPS, _LEAST_GATE, _KEPT_HERE = 256, 150, 8, 0.02, 4
_MOST_SETTLED, _SOME_RAYS = 20, 2000
_FROM_BEHIND, _SETTLE_GATES, _UNSETTLED = (0.0, 0.02), np.linspace(0.06, 0.025, 10), 0.025  # [m]
_PART, _MISSING = 0.35, (0.5, 0.9)  # size of a part by the radius, and share of its rays that go on through it
_BLURRED = (0.045, 0.08)  # distance of the points by the object's radius: rated 1, and rated 0
# Points near the object that do not lie on it, by those on it: rated 1, and rated 0.  Near an expected pose neighbours
# are no reason to doubt it; elsewhere bars that go on beyond the object's ends are.
_NEAR_EXPECTED, _NEAR_FOUND = (0.2, 0.8), (0.2, 0.36)
_ON_PLANES = (0.6, 0.8)  # share of the rays on a mesh that end on a wide plane: rated 1, and rated 0
_N_NUDGED = 4
_NUDGES = (0.04, 0.025, 0.015)  # [m], and five times as many radians
_NUDGE_POINTS = 600
_NUDGE_GATES = np.concatenate([np.linspace(0.05, 0.025, 5), np.full(5, 0.025)])
_DIFFERENT_DEG, _DIFFERENT_M = 20.0, 0.05


@dataclass(frozen=True)
class MeshMatch:
    """A mesh located in a scan.

    Attributes:
        confidence: 0 to 1; 0.5 and more is reliable.
        residuals: ``rms`` and ``median`` distance of the points on the mesh [m]; ``seen_through``, share of the rays
            through the mesh that should have ended on it; ``missing``, the same of the part where it is largest;
            ``hidden``, share that ended before it; ``unexplained``,
            points close to its surface as a share of those on it; ``rival``, score of the best clearly different pose
            over this one's (near 1: the scan does not distinguish them); ``n_points`` on the mesh.
        solid: the mesh in its own frame.
        tolerance: largest distance of its points from its surface [m].
    """

    pose_world_mesh: Float[np.ndarray, "4 4"]
    confidence: float
    residuals: Mapping[str, float]
    solid: Solid
    tolerance: float

    def explains(self, points: Float[np.ndarray, "M 3"], times: float = 1.0) -> Bool[np.ndarray, "M"]:
        """Return which world points are within ``times`` the tolerance of its surface or inside its closed parts."""
        tolerance = times * self.tolerance
        pose = MeshPose(self.pose_world_mesh[:3, :3], self.pose_world_mesh[:3, 3])
        points = pose.to_mesh(points)
        whole = _join_meshes([*self.solid.closed, *self.solid.open])
        explained = np.zeros(len(points), dtype=bool)
        near = _select_near(points, whole, tolerance)
        if len(near):
            offset = points[near] - Surface(whole).nearest(points[near])[0]
            explained[near] = np.linalg.norm(offset, axis=1) <= tolerance
        for part in self.solid.closed:
            # One by one, since parts may overlap and joint crossing counts would then be wrong.
            rest = _select_near(points, part, 0.0)
            rest = rest[~explained[rest]]
            if len(rest):
                explained[rest] = Surface(part).contains(points[rest])
        return explained


@dataclass(frozen=True)
class KnownMesh:
    """An object of known shape, with its exact, approximate or unknown pose.

    Attributes:
        solid: its shape in its own frame [m].
        pose_world_mesh: (4, 4), exact if ``is_placed``, else within 20 degrees and 15 cm; None if unknown.
        hint: (3,) a point on or near an object without a pose; None to search the whole scan [m].
        is_placed: whether its pose is exact and stays as it is, whatever the scan shows.
    """

    name: str
    solid: Solid
    pose_world_mesh: Float[np.ndarray, "4 4"] | None = None
    hint: Float[np.ndarray, "3"] | None = None
    is_placed: bool = False


def locate(known: KnownMesh, view: View) -> MeshMatch:
    """Return an object's pose in the scan; a placed object keeps its pose, and only the agreement is measured."""
    if known.is_placed and known.pose_world_mesh is not None:
        return judge_placed(known.solid, view, known.pose_world_mesh)
    return match_mesh(known.solid, view, hint=known.hint, initial=known.pose_world_mesh)


def match_mesh(
    mesh: Mesh | Solid,
    view: View,
    hint: Float[np.ndarray, "3"] | None = None,
    initial: Float[np.ndarray, "4 4"] | None = None,
) -> MeshMatch:
    """Return the pose at which the scan's points lie on the mesh and no ray passes through it.

    Only surfaces that a ray could hit count, so a scan from one side is enough.

    Args:
        mesh: the object, in its own frame [m]; a solid if it is already checked.
        hint: (3,) a point on or near the object [m]; without it and ``initial``, the whole scan is searched, without
            planes larger than the object.
        initial: (4, 4) approximate pose (within 20 degrees and 15 cm); only poses near it are tried.

    Raises:
        MeshError: the mesh cannot be used.
    """
    solid = mesh if isinstance(mesh, Solid) else make_solid(mesh)
    if initial is None:
        matches = find_matches(solid, view, hint)
        return matches[0] if matches else MeshMatch(np.eye(4), 0.0, {"n_points": 0.0}, solid, 0.0)
    surface, centre, radius = _measure_solid(solid)
    judge = make_pose_judge(surface, sight_index(view.cloud), view, initial[:3, :3] @ centre + initial[:3, 3], radius)
    found = []
    if len(judge.region.points) >= MIN_AGREEING:
        found = _search(surface, judge, judge.region, _make_starts(centre, initial), radius)
    if not found:
        return MeshMatch(initial, 0.0, {"n_points": 0.0}, solid, 0.0)
    best, pose = found[0]
    rivals = [score for score, other in found if _is_different(pose, other, centre)]
    return _make_match(pose, judge, _compare_rivals(rivals, best), solid)


def find_matches(solid: Solid, view: View, hint: Float[np.ndarray, "3"] | None = None) -> list[MeshMatch]:
    """Return the poses at which the scan may show a solid, best supported first; no two of them overlap by half.

    Args:
        solid: the object, in its own frame [m].
        hint: (3,) a point on or near the object; None to search the whole scan [m].
    """
    if not len(view.obstacles):
        return []
    whole = _join_meshes([*solid.closed, *solid.open])
    surface, centre, radius = _measure_solid(solid)
    loose = ~find_wide_planes(view.obstacles, view.starts, radius, view.seed).hold(view.obstacles)
    samples, normals = spread_samples(whole, _SAMPLES)
    samples -= centre
    beside = list_beside(surface, samples + centre, normals, radius) - centre
    likely = find_candidates(view, loose, (samples, beside), radius, hint)
    if likely is None:
        return []
    cells, candidates = likely
    field = NearestField.of(surface, whole.vertices.min(axis=0), whole.vertices.max(axis=0), radius)
    points, starts = view.obstacles[loose], view.starts[loose]
    rough: list[tuple[float, MeshPose]] = []
    for candidate in candidates:
        near = np.linalg.norm(points - candidate.place, axis=1) <= 1.3 * radius + 0.03
        region = Region(points[near], starts[near]).thin(_ROUGH_POINTS)
        if near.sum() < MIN_AGREEING:
            continue
        shifts = candidate.place - candidate.rotations @ centre
        gates = np.linspace(0.6 * radius, max(0.15 * radius, _LEAST_GATE), _ROUGH_STEPS)
        rotations, shifts, near_it = field.fit(
            candidate.rotations, shifts, region.points, region.starts.mean(axis=0), gates
        )
        scores = cells.rate(samples + centre, beside + centre, rotations, shifts) + near_it
        kept: list[MeshPose] = []
        for i in np.argsort(-scores, kind="stable"):
            pose = MeshPose(rotations[i], shifts[i])
            if all(_is_different(pose, other, centre) for other in kept):
                kept.append(pose)
                rough.append((float(scores[i]), pose))
            if len(kept) == _KEPT_HERE:
                break
    rough.sort(key=lambda scored: -scored[0])
    return _settle(rough[:_MOST_SETTLED], solid, surface, centre, radius, view)


def _settle(
    rough: Sequence[tuple[float, MeshPose]],
    solid: Solid,
    surface: Surface,
    centre: Float[np.ndarray, "3"],
    radius: float,
    view: View,
) -> list[MeshMatch]:
    """Return matches fitted from rough poses, without those that overlap a better one.

    Order: confidence times score, best first.
    """
    index = sight_index(view.cloud)
    fitted: list[tuple[float, MeshPose, PoseJudge]] = []
    for _, start in rough:
        judge = make_pose_judge(surface, index, view, start.to_world(centre), radius)
        if len(judge.region.points) < MIN_AGREEING:
            continue
        few = judge.region.thin(_NUDGE_POINTS)
        away = start.to_world(centre) - few.starts.mean(axis=0)
        away /= np.linalg.norm(away)
        poses = [fit_pose(surface, few, start.translate(by * away), _SETTLE_GATES) for by in _FROM_BEHIND]
        rated = [judge.count(pose, _SOME_RAYS, _NUDGE_POINTS, _UNSETTLED).score for pose in poses]
        first = int(np.argmax(rated))
        fitted.append((rated[first], poses[first], judge))
    fitted.sort(key=lambda candidate: -candidate[0])
    matches: list[MeshMatch] = []
    scores: list[float] = []
    for score, pose, judge in fitted[:_N_NUDGED]:
        place = pose.to_world(centre)
        if any(np.linalg.norm(place - _centre_of(other, centre)) < radius for other in matches):
            continue
        best, settled = _nudge(surface, judge, judge.region.thin(_MOST_POINTS), (score, pose))
        rivals = [other for other, turned, _ in fitted if _is_different(settled, turned, centre)]
        matches.append(_make_match(settled, judge, _compare_rivals(rivals, best), solid, _NEAR_FOUND))
        scores.append(max(best, 0.0))
    order = sorted(range(len(matches)), key=lambda i: (-matches[i].confidence * scores[i], -matches[i].confidence))
    return [matches[i] for i in order]


def _centre_of(match: MeshMatch, centre: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    return np.asarray(match.pose_world_mesh[:3, :3] @ centre + match.pose_world_mesh[:3, 3])


def _compare_rivals(rivals: Sequence[float], best: float) -> float:
    """Return the score of the best rival over a pose's own; 1 for a pose without support."""
    return float(max(0.0, max(rivals, default=0.0)) / best) if best > 0.0 else 1.0


def judge_placed(solid: Solid, view: View, pose_world_mesh: Float[np.ndarray, "4 4"]) -> MeshMatch:
    """Return how well the scan agrees with a mesh at a given pose; the residuals have no ``rival``.

    Args:
        solid: the object, in its own frame [m].
    """
    surface, centre, radius = _measure_solid(solid)
    pose = MeshPose(pose_world_mesh[:3, :3], pose_world_mesh[:3, 3])
    judge = make_pose_judge(surface, sight_index(view.cloud), view, pose.to_world(centre), radius)
    match = _make_match(pose, judge, 0.0, solid)
    return replace(match, residuals={name: value for name, value in match.residuals.items() if name != "rival"})


def _measure_solid(solid: Solid) -> tuple[Surface, Float[np.ndarray, "3"], float]:
    """Return the whole surface, and centre and radius of the sphere around its box [m]."""
    whole = _join_meshes([*solid.closed, *solid.open])
    lower, upper = whole.vertices.min(axis=0), whole.vertices.max(axis=0)
    return Surface(whole), 0.5 * (lower + upper), 0.5 * float(np.linalg.norm(upper - lower))


def _search(
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


def _make_starts(centre: Float[np.ndarray, "3"], initial: Float[np.ndarray, "4 4"]) -> list[MeshPose]:
    """Return start poses around an approximate one."""
    given = MeshPose(initial[:3, :3], initial[:3, 3])
    turns = [np.zeros(3), *(sign * 0.3 * axis for axis in np.eye(3) for sign in (-1, 1))]
    shifts = [np.zeros(3), *(sign * 0.08 * axis for axis in np.eye(3) for sign in (-1, 1))]
    about = given.to_world(centre)
    return [given.rotate(turn, about).translate(shift) for turn in turns for shift in shifts]


def _is_different(pose: MeshPose, other: MeshPose, centre: Float[np.ndarray, "3"]) -> bool:
    angle = np.degrees(Rotation.from_matrix(pose.rotation.T @ other.rotation).magnitude())
    return bool(angle > _DIFFERENT_DEG or np.linalg.norm(pose.to_world(centre) - other.to_world(centre)) > _DIFFERENT_M)


def _make_match(
    pose: MeshPose,
    judge: PoseJudge,
    rival: float,
    solid: Solid,
    unexplained_limits: tuple[float, float] = _NEAR_EXPECTED,
) -> MeshMatch:
    verdict = judge.count(pose, len(judge.rays) or 1, len(judge.region.points) or 1)
    met = max(1, verdict.agreeing + verdict.through)
    _, _, radius = _measure_solid(solid)
    through, missing = judge.share_through(pose, _PART * radius)
    hidden = verdict.hidden / max(1, met + verdict.hidden)
    unexplained = verdict.unexplained / max(1, verdict.agreeing)
    on_planes = verdict.on_planes / max(1, verdict.agreeing + verdict.on_planes)
    rms = float(np.sqrt(np.mean(verdict.distance**2))) if len(verdict.distance) else float("inf")
    residuals = {
        "rms": rms,
        "median": float(np.median(verdict.distance)) if len(verdict.distance) else float("inf"),
        "seen_through": through,
        "missing": missing,
        "hidden": hidden,
        "unexplained": unexplained,
        "rival": rival,
        "n_points": float(len(verdict.distance)),
    }
    enough = min(1.0, verdict.agreeing / (2.0 * MIN_AGREEING))
    confidence = (
        enough
        * _ramp_down(through, 0.08, 0.25)
        * _ramp_down(missing, *_MISSING)
        * _ramp_down(hidden, 0.4, 0.9)
        * _ramp_down(unexplained, *unexplained_limits)
        * _ramp_down(on_planes, *_ON_PLANES)
        * _ramp_down(rms / radius, *_BLURRED)
    )
    return MeshMatch(pose.matrix, float(confidence), residuals, solid, verdict.tolerance)


def _select_near(points: Float[np.ndarray, "N 3"], mesh: Mesh, by: float) -> Int[np.ndarray, "K"]:
    """Return indices of the points in the mesh's bounding box, grown by ``by`` [m]."""
    within = (points >= mesh.vertices.min(axis=0) - by) & (points <= mesh.vertices.max(axis=0) + by)
    return np.flatnonzero(within.all(axis=1))


def _ramp_down(value: float, good: float, bad: float) -> float:
    """Return 1 up to ``good``, 0 from ``bad`` on, linear between."""
    return float(np.clip((bad - value) / (bad - good), 0.0, 1.0))


def _join_meshes(meshes: Sequence[Mesh]) -> Mesh:
    if not meshes:
        raise MeshError("mesh: has no part to search for")
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    triangles = [mesh.triangles + start for mesh, start in zip(meshes, first, strict=True)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(triangles))
