"""Pose search for a known mesh in a scan: ICP from many start poses, scored by the rays of the scan."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from perception.sightlines import sight_index
from perception.solids.evidence import Shape
from perception.solids.fit import MIN_AGREEING, MeshPose, Region, find_wide_planes, make_pose_judge
from perception.solids.mesh import Mesh, Solid, make_solid
from perception.solids.nearest_field import NearestField
from perception.solids.places import find_candidates, list_beside, spread_samples
from perception.solids.rating import MeshMatch, join_meshes, measure_solid, rate_pose
from perception.solids.settle import compare_rivals, is_different, make_starts, search_about, settle_poses
from perception.view import View

# Search without an approximate pose: samples of the surface; points, steps and last gate [m] of the rough fits;
# different orientations kept at a place; rough poses to settle.
_SAMPLES, _ROUGH_POINTS, _ROUGH_STEPS, _LEAST_GATE, _KEPT_HERE = 256, 150, 8, 0.02, 4
_MOST_SETTLED = 20


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
    surface, centre, radius = measure_solid(solid)
    judge = make_pose_judge(surface, sight_index(view.cloud), view, initial[:3, :3] @ centre + initial[:3, 3], radius)
    found = []
    if len(judge.region.points) >= MIN_AGREEING:
        found = search_about(surface, judge, judge.region, make_starts(centre, initial), radius)
    if not found:
        return MeshMatch(initial, 0.0, {"n_points": 0.0}, solid, 0.0)
    best, pose = found[0]
    rivals = [score for score, other in found if is_different(pose, other, centre)]
    return rate_pose(pose, judge, compare_rivals(rivals, best), solid)


def find_matches(solid: Solid, view: View, hint: Float[np.ndarray, "3"] | None = None) -> list[MeshMatch]:
    """Return the poses at which the scan may show a solid, best supported first; no two of them overlap by half.

    Args:
        solid: the object, in its own frame [m].
        hint: (3,) a point on or near the object; None to search the whole scan [m].
    """
    if not len(view.obstacles):
        return []
    whole = join_meshes([*solid.closed, *solid.open])
    surface, centre, radius = measure_solid(solid)
    wide = find_wide_planes(view.obstacles, view.starts, radius, view.seed)
    loose = ~wide.hold(view.obstacles)
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
            if all(is_different(pose, other, centre) for other in kept):
                kept.append(pose)
                rough.append((float(scores[i]), pose))
            if len(kept) == _KEPT_HERE:
                break
    rough.sort(key=lambda scored: -scored[0])
    return settle_poses(rough[:_MOST_SETTLED], solid, Shape.of(whole, surface, centre, radius), view, wide)


def judge_placed(solid: Solid, view: View, pose_world_mesh: Float[np.ndarray, "4 4"]) -> MeshMatch:
    """Return how well the scan agrees with a mesh at a given pose; the residuals have no ``rival``.

    Args:
        solid: the object, in its own frame [m].
    """
    surface, centre, radius = measure_solid(solid)
    pose = MeshPose(pose_world_mesh[:3, :3], pose_world_mesh[:3, 3])
    judge = make_pose_judge(surface, sight_index(view.cloud), view, pose.to_world(centre), radius)
    match = rate_pose(pose, judge, 0.0, solid)
    return replace(match, residuals={name: value for name, value in match.residuals.items() if name != "rival"})
