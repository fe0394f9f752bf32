"""Confidence in an object's pose: how the rays and points of a scan agree with it and contradict it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from perception.errors import MeshError
from perception.solids.evidence import Evidence
from perception.solids.fit import MeshPose, PoseJudge, Surface
from perception.solids.mesh import Mesh, Solid

CONFIDENT = 0.5
_MISSING = (0.5, 0.9)  # share of the rays to a part that go on through it: rated 1, and rated 0
_BLURRED = (0.045, 0.08)  # distance of the points by the object's radius: rated 1, and rated 0
_ON_PLANES = (0.5, 0.7)  # share of the rays on a mesh that end on a wide plane: rated 1, and rated 0
# Of the evidence for an object whose place was not expected: rated 1, and rated 0 or as low as the third value.
_BESIDE, _CONFIRMED, _SEEN = (0.08, 0.2), (0.93, 0.84), (0.8, 0.3)
_TELLING, _CUT = (0.12, 0.04, 0.4), (0.15, 0.35, 0.4)


@dataclass(frozen=True)
class Limits:
    """What a pose needs to be believed; of pairs, the first value is rated 1 and the second 0.

    Attributes:
        enough: rays on the object; with fewer the confidence is lower.
        unexplained: points near the object that do not lie on it, by those on it.
        stray: the same without those at the one place where something may carry it; None: no matter how many.
    """

    enough: float
    unexplained: tuple[float, float]
    stray: tuple[float, float] | None


# Near an expected pose neighbours are no reason to doubt it; elsewhere what goes on beyond the object's ends is.
NEAR_EXPECTED, NEAR_FOUND = Limits(60.0, (0.2, 0.8), None), Limits(80.0, (0.2, 0.36), (0.03, 0.1))


@dataclass(frozen=True)
class MeshMatch:
    """A mesh located in a scan.

    Attributes:
        confidence: 0 to 1; 0.5 and more is reliable.
        residuals: ``rms`` and ``median`` distance of the points on the mesh [m]; ``seen_through``, share of the rays
            through the mesh that should have ended on it; ``missing``, the same of the part where it is largest;
            ``hidden``, share that ended before it; ``unexplained``, points close to its surface as a share of those on
            it; ``held``, the same of those at one part of it, where something may carry it; ``on_planes``, share of the
            rays on it that end on a plane wider than it; ``rival``, score of the best clearly different pose over this
            one's (near 1: the scan does not distinguish them); ``n_points`` on the mesh; for an object that was
            searched for, those of :class:`~perception.solids.evidence.Evidence` as well.
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
        whole = join_meshes([*self.solid.closed, *self.solid.open])
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


def measure_solid(solid: Solid) -> tuple[Surface, Float[np.ndarray, "3"], float]:
    """Return the whole surface, and centre and radius of the sphere around its box [m]."""
    whole = join_meshes([*solid.closed, *solid.open])
    lower, upper = whole.vertices.min(axis=0), whole.vertices.max(axis=0)
    return Surface(whole), 0.5 * (lower + upper), 0.5 * float(np.linalg.norm(upper - lower))


def rate_pose(
    pose: MeshPose,
    judge: PoseJudge,
    rival: float,
    solid: Solid,
    evidence: Evidence | None = None,
) -> MeshMatch:
    """Return the match of a pose; its evidence is None if the object was expected there."""
    limits = NEAR_EXPECTED if evidence is None else NEAR_FOUND
    verdict = judge.count(pose, len(judge.rays) or 1, len(judge.region.points) or 1)
    met = max(1, verdict.agreeing + verdict.through)
    _, _, radius = measure_solid(solid)
    through, missing = judge.share_through(pose)
    hidden = verdict.hidden / max(1, met + verdict.hidden)
    unexplained = verdict.unexplained / max(1, verdict.agreeing)
    on_planes = verdict.on_planes / max(1, verdict.agreeing + verdict.on_planes)
    held = verdict.held / max(1, verdict.agreeing)
    rms = float(np.sqrt(np.mean(verdict.distance**2))) if len(verdict.distance) else float("inf")
    residuals = {
        "rms": rms,
        "median": float(np.median(verdict.distance)) if len(verdict.distance) else float("inf"),
        "seen_through": through,
        "missing": missing,
        "hidden": hidden,
        "unexplained": unexplained,
        "held": held,
        "on_planes": on_planes,
        "rival": rival,
        "n_points": float(len(verdict.distance)),
    }
    confidence = (
        min(1.0, verdict.agreeing / limits.enough)
        * _ramp_down(through, 0.08, 0.25)
        * _ramp_down(missing, *_MISSING)
        * _ramp_down(hidden, 0.4, 0.9)
        * _ramp_down(unexplained, *limits.unexplained)
        * (1.0 if limits.stray is None else _ramp_down(unexplained - held, *limits.stray))
        * _ramp_down(on_planes, *_ON_PLANES)
        * _ramp_down(rms / radius, *_BLURRED)
    )
    if evidence is not None:
        confidence *= _believe(evidence)
        residuals |= {name: value for name, value in vars(evidence).items() if np.isfinite(value)}
    return MeshMatch(pose.matrix, float(confidence), residuals, solid, verdict.tolerance)


def _believe(evidence: Evidence) -> float:
    """Return 1 for evidence that leaves no doubt, less for a place that may show another object."""
    return (
        _ramp_down(evidence.beside, *_BESIDE)
        * _ramp_down(-evidence.confirmed, *(-limit for limit in _CONFIRMED))
        * _ramp_down(-evidence.seen, *(-limit for limit in _SEEN))
        * max(_TELLING[2], _ramp_down(-evidence.telling, -_TELLING[0], -_TELLING[1]))
        * max(_CUT[2], _ramp_down(evidence.cut, *_CUT[:2]))
    )


def join_meshes(meshes: Sequence[Mesh]) -> Mesh:
    if not meshes:
        raise MeshError("mesh: has no part to search for")
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    triangles = [mesh.triangles + start for mesh, start in zip(meshes, first, strict=True)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(triangles))


def _select_near(points: Float[np.ndarray, "N 3"], mesh: Mesh, by: float) -> Int[np.ndarray, "K"]:
    """Return indices of the points in the mesh's bounding box, grown by ``by`` [m]."""
    within = (points >= mesh.vertices.min(axis=0) - by) & (points <= mesh.vertices.max(axis=0) + by)
    return np.flatnonzero(within.all(axis=1))


def _ramp_down(value: float, good: float, bad: float) -> float:
    """Return 1 up to ``good``, 0 from ``bad`` on, linear between."""
    return float(np.clip((bad - value) / (bad - good), 0.0, 1.0))
