"""Pose search for a known mesh in a scan: ICP from many start poses, scored by the rays of the scan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from perception.convex.split import find_clusters
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
    lie_on_planes,
    make_pose_judge,
)
from perception.solids.mesh import Mesh, Solid, make_solid
from perception.view import View

CONFIDENT = 0.5
_N_ORIENTATIONS = 240
_N_BEST = 10
_COARSE_POINTS, _COARSE_RAYS = 250, 500
_MOST_POINTS, _MOST_RAYS = 4000, 6000
_MOST_CLUSTERS = 6
_N_NUDGED = 3
_NUDGES = (0.04, 0.025, 0.015)  # [m], and five times as many radians
_NUDGE_POINTS = 1000
_NUDGE_GATES = np.concatenate([np.linspace(0.05, 0.025, 5), np.full(5, 0.025)])
_DIFFERENT_DEG, _DIFFERENT_M = 20.0, 0.05


@dataclass(frozen=True)
class MeshMatch:
    """A mesh located in a scan.

    Attributes:
        confidence: 0 to 1; 0.5 and more is reliable.
        residuals: ``rms`` and ``median`` distance of the points on the mesh [m]; ``seen_through``, share of the rays
            through the mesh that should have ended on it; ``hidden``, share that ended before it; ``unexplained``,
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
        hint: (3,) a point on or near the object [m]; without it and ``initial``, every cluster of the object's size is
            tried, after removal of planes larger than the object.
        initial: (4, 4) approximate pose (within 20 degrees and 15 cm); only poses near it are tried.

    Raises:
        MeshError: the mesh cannot be used.
    """
    solid = mesh if isinstance(mesh, Solid) else make_solid(mesh)
    surface, centre, radius = _measure_solid(solid)
    index = sight_index(view.cloud)
    candidates: list[tuple[float, MeshPose, PoseJudge]] = []
    for place in _find_places(view, radius, centre, hint, initial):
        judge = make_pose_judge(surface, index, view, place, radius)
        region = judge.region
        if len(region.points) < MIN_AGREEING:
            continue
        starts = _make_starts(place, centre, radius, region, initial)
        candidates += [(score, pose, judge) for score, pose in _search(surface, judge, region, starts, radius)]
    if not candidates:
        return MeshMatch(np.eye(4) if initial is None else initial, 0.0, {"n_points": 0.0}, solid, 0.0)
    candidates.sort(key=lambda candidate: -candidate[0])
    best, pose, judge = candidates[0]
    rivals = [score for score, other, _ in candidates if _is_different(pose, other, centre)]
    rival = float(max(0.0, max(rivals, default=0.0)) / best) if best > 0.0 else 1.0
    return _make_match(pose, judge, rival, solid)


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


def _find_places(
    view: View,
    radius: float,
    centre: Float[np.ndarray, "3"],
    hint: Float[np.ndarray, "3"] | None,
    initial: Float[np.ndarray, "4 4"] | None,
) -> list[Float[np.ndarray, "3"]]:
    """Return candidate positions of the object's centre in the world [m]."""
    if initial is not None:
        return [initial[:3, :3] @ centre + initial[:3, 3]]
    if hint is not None:
        return [np.asarray(hint, dtype=float)]
    if not len(view.obstacles):
        return []
    # Tables and walls are removed, since they would connect the object with everything else on them.
    loose = ~lie_on_planes(view.obstacles, find_wide_planes(view.obstacles, view.starts, radius, view.seed))
    points, starts = view.obstacles[loose], view.starts[loose]
    groups = [points[members] for members in find_clusters(points, starts)] if len(points) else []
    fitting = [group for group in groups if 0.2 * radius < 0.5 * np.linalg.norm(np.ptp(group, axis=0)) < 1.5 * radius]
    return [group.mean(axis=0) for group in sorted(fitting, key=len, reverse=True)[:_MOST_CLUSTERS]]


def _make_starts(
    place: Float[np.ndarray, "3"],
    centre: Float[np.ndarray, "3"],
    radius: float,
    region: Region,
    initial: Float[np.ndarray, "4 4"] | None,
) -> list[MeshPose]:
    """Return start poses: around the initial one, or at the position in 240 random orientations."""
    if initial is not None:
        given = MeshPose(initial[:3, :3], initial[:3, 3])
        turns = [np.zeros(3), *(sign * 0.3 * axis for axis in np.eye(3) for sign in (-1, 1))]
        shifts = [np.zeros(3), *(sign * 0.08 * axis for axis in np.eye(3) for sign in (-1, 1))]
        about = given.to_world(centre)
        return [given.rotate(turn, about).translate(shift) for turn in turns for shift in shifts]
    core = region.points[np.linalg.norm(region.points - place, axis=1) <= radius]
    middle = np.median(core, axis=0) if len(core) >= MIN_AGREEING else place
    away = middle - region.starts.mean(axis=0)
    # Only the near side is seen: the object's centre lies behind the centre of its points.
    middle = middle + 0.2 * radius * away / max(float(np.linalg.norm(away)), 1e-9)
    rotations = Rotation.random(_N_ORIENTATIONS, rng=np.random.default_rng(0)).as_matrix()
    return [MeshPose(rotation, middle - rotation @ centre) for rotation in rotations]


def _is_different(pose: MeshPose, other: MeshPose, centre: Float[np.ndarray, "3"]) -> bool:
    angle = np.degrees(Rotation.from_matrix(pose.rotation.T @ other.rotation).magnitude())
    return bool(angle > _DIFFERENT_DEG or np.linalg.norm(pose.to_world(centre) - other.to_world(centre)) > _DIFFERENT_M)


def _make_match(pose: MeshPose, judge: PoseJudge, rival: float, solid: Solid) -> MeshMatch:
    verdict = judge.count(pose, len(judge.rays) or 1, len(judge.region.points) or 1)
    met = max(1, verdict.agreeing + verdict.through)
    through = verdict.through / met
    hidden = verdict.hidden / max(1, met + verdict.hidden)
    unexplained = verdict.unexplained / max(1, verdict.agreeing)
    rms = float(np.sqrt(np.mean(verdict.distance**2))) if len(verdict.distance) else float("inf")
    residuals = {
        "rms": rms,
        "median": float(np.median(verdict.distance)) if len(verdict.distance) else float("inf"),
        "seen_through": through,
        "hidden": hidden,
        "unexplained": unexplained,
        "rival": rival,
        "n_points": float(len(verdict.distance)),
    }
    enough = min(1.0, verdict.agreeing / (2.0 * MIN_AGREEING))
    confidence = (
        enough * _ramp_down(through, 0.08, 0.25) * _ramp_down(hidden, 0.4, 0.9) * _ramp_down(unexplained, 0.2, 0.8)
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
