"""What a problem says of standing: links held where they are throughout are planted, ``zmp`` asks for balance."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from costs.kinematics import KinematicsEngine, Topology, frame_of, planted_poses
from costs.robot import RobotModel
from service.start.standing import FEET_GROUP
from service.trajopt.demanded import pose_matrix
from service.trajopt.problem import PoseTerm, Problem, ZmpTerm

SHIFT, TURN = 1e-3, np.deg2rad(0.5)  # a foot that is to stay may be written as roughly as this [m, rad]


@dataclass(frozen=True)
class Standing:
    """How the robot stands.

    Attributes:
        planted: links that stay where they are at the start, throughout.
        is_balanced: whether ``zmp`` is asked with all of them at every waypoint after the start.
        problem: without the terms that this says already.
        notes, problems: one line each.
    """

    planted: tuple[str, ...]
    is_balanced: bool
    problem: Problem
    notes: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()


def standing(
    problem: Problem, robot: RobotModel, start: Float[np.ndarray, "n"], moving: Int[np.ndarray, "f"]
) -> Standing:
    """Which links of a robot with a free base are planted, and whether balance is asked of it.

    Args:
        problem: as read.
        robot: that stands.
        start: (n,) how it stands at first.
        moving: coordinates that the problem moves.
    """
    balances = [term for term in problem.terms if isinstance(term, ZmpTerm)]
    if not robot.is_floating:
        problems = tuple(
            f"{term.path}.type: zmp asks for a free base, and that of {robot.name} is fixed; leave it out, or give "
            "the robot a floating base"
            for term in balances
        )
        return Standing((), False, problem, problems=problems)
    held = {frame: terms for frame, terms in _held(problem).items() if _is_where_it_starts(robot, start, terms)}
    named = {link for term in balances for link in term.links}
    bodied = {body.link for body in robot.bodies}
    feet = robot.link_groups.get(FEET_GROUP, ())
    still = {link for link in feet if not _moves(robot, link, moving)}
    planted = tuple(sorted(link for link in {*held, *named, *still} if link in bodied))
    notes: list[str] = []
    for link in planted:
        if link in still:
            notes.append(f"{link} is planted: nothing in manip moves it")
        elif link in held:
            paths = [term.path for term in held[link]]
            notes.append(f"{link} is planted: {_listed(paths)} hold it where it starts, and so it is held in between")
        else:
            notes.append(f"{link} is planted: zmp names it, though no pose constraint holds it")
    if feet and not planted:
        notes.append(
            f"nothing in the file says that {' and '.join(feet)} stand: the floor is an obstacle to them, too (a pose "
            "constraint at every waypoint plants a foot)"
        )
    replaced = {term.path for link in planted for term in held.get(link, [])}
    everywhere = {term.step for term in balances if set(term.links) == set(planted)}
    is_balanced = bool(planted) and everywhere >= set(range(1, problem.basic.n_steps))
    if is_balanced:
        replaced |= {term.path for term in balances if set(term.links) == set(planted)}
    elif balances:
        notes.append("zmp is not asked of every waypoint with all planted links: balance is not part of the proof")
    rest = tuple(term for term in problem.terms if term.path not in replaced)
    return Standing(planted, is_balanced, replace(problem, terms=rest), tuple(notes))


def held_alike(problem: Problem) -> list[list[PoseTerm]]:
    """Pose constraints that ask the same of a frame at every waypoint after the start, in groups."""
    groups: dict[tuple[object, ...], list[PoseTerm]] = defaultdict(list)
    for term in problem.terms:
        if isinstance(term, PoseTerm) and not term.is_cost:
            axes = (*(c > 0.0 for c in term.pos_coeffs), *(c > 0.0 for c in term.rot_coeffs))
            where = (term.reference, term.xyz, term.wxyz, term.offset_xyz, term.offset_wxyz)
            groups[(term.frame, *where, *axes)].append(term)
    wanted = set(range(1, problem.basic.n_steps))
    return [terms for terms in groups.values() if {term.step for term in terms} >= wanted]


def _held(problem: Problem) -> dict[str, list[PoseTerm]]:
    """Pose constraints that hold a link in the world, whole, at every waypoint."""
    found: dict[str, list[PoseTerm]] = {}
    for terms in held_alike(problem):
        first = terms[0]
        if first.reference is None and all(c > 0.0 for c in (*first.pos_coeffs, *first.rot_coeffs)):
            found[first.frame] = terms
    return found


def _is_where_it_starts(robot: RobotModel, start: Float[np.ndarray, "n"], terms: list[PoseTerm]) -> bool:
    term = terms[0]
    pose = planted_poses(KinematicsEngine(robot), start, [term.frame])[term.frame]
    error = np.linalg.inv(pose_matrix(term.xyz, term.wxyz)) @ pose @ pose_matrix(term.offset_xyz, term.offset_wxyz)
    turn = Rotation.from_matrix(error[:3, :3]).magnitude()
    return bool(np.linalg.norm(error[:3, 3]) < SHIFT and turn < TURN)


def _moves(robot: RobotModel, link: str, moving: Int[np.ndarray, "f"]) -> bool:
    """Whether any of the coordinates moves a link."""
    joint = frame_of(robot, link)[0]
    return bool(Topology.of(robot.model).supports[joint][moving].any())


def _listed(paths: list[str]) -> str:
    return paths[0] if len(paths) == 1 else f"{paths[0]} to {paths[-1]}" if len(paths) > 2 else " and ".join(paths)
