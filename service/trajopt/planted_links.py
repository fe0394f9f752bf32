"""Planted links and balance of a problem, derived from its pose constraints and ``zmp`` terms."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from costs.kinematics import KinematicsEngine, Topology, locate_frame, locate_links
from costs.robot import RobotModel
from service.start.standing import FEET_GROUP
from service.trajopt.problem import PoseTerm, ProblemFile, ZmpTerm

SHIFT, TURN = 1e-3, np.deg2rad(0.5)  # largest deviation of a planted link's pose in the file from its start [m, rad]


@dataclass(frozen=True)
class PlantedLinks:
    """Planted links of a problem.

    Attributes:
        planted: links that keep their start pose during the whole motion.
        is_balanced: whether ``zmp`` terms name all of them at every waypoint after the start.
        problem: the problem without the terms that ``planted`` and ``is_balanced`` replace.
        notes: one line per assumption.
        problems: one line per error.
    """

    planted: tuple[str, ...]
    is_balanced: bool
    problem: ProblemFile
    notes: tuple[str, ...] = ()
    problems: tuple[str, ...] = ()


def find_planted_links(
    problem: ProblemFile, robot: RobotModel, start: Float[np.ndarray, "n"], moving: Int[np.ndarray, "f"]
) -> PlantedLinks:
    """Find the planted links of a robot with a free base, at configuration ``start``; ``moving`` may change."""
    balances = [term for term in problem.terms if isinstance(term, ZmpTerm)]
    if not robot.is_floating:
        problems = tuple(
            f"{term.path}.type: zmp needs a free base, and that of {robot.name} is fixed; leave it out, or give "
            "the robot a floating base"
            for term in balances
        )
        return PlantedLinks((), False, problem, problems=problems)
    held = {frame: terms for frame, terms in _find_held_links(problem) if _is_at_start(robot, start, terms[0])}
    named = {link for term in balances for link in term.links}
    with_shape = {body.link for body in robot.bodies}
    feet = robot.link_groups.get(FEET_GROUP, ())
    still = {link for link in feet if not _moves(robot, link, moving)}
    planted = tuple(sorted(link for link in {*held, *named, *still} if link in with_shape))
    notes: list[str] = []
    for link in planted:
        if link in still:
            notes.append(f"{link} is planted: nothing in manip moves it")
        elif link in held:
            paths = [term.path for term in held[link]]
            notes.append(
                f"{link} is planted: {_list_paths(paths)} hold it where it starts, so it is held between waypoints, too"
            )
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
        notes.append("no zmp with all planted links at every waypoint: balance is not part of the proof")
    rest = tuple(term for term in problem.terms if term.path not in replaced)
    return PlantedLinks(planted, is_balanced, replace(problem, terms=rest), tuple(notes))


def group_equal_poses(problem: ProblemFile) -> list[list[PoseTerm]]:
    """Return groups of pose constraints that hold a frame at the same pose at every waypoint after the start."""
    groups: dict[tuple[object, ...], list[PoseTerm]] = defaultdict(list)
    for term in problem.terms:
        if isinstance(term, PoseTerm) and not term.is_cost:
            poses = (term.xyz, term.wxyz, term.offset_xyz, term.offset_wxyz)
            groups[(term.frame, term.reference, *poses, term.position_axes, term.rotation_axes)].append(term)
    steps = set(range(1, problem.basic.n_steps))
    return [terms for terms in groups.values() if {term.step for term in terms} >= steps]


def _find_held_links(problem: ProblemFile) -> Iterator[tuple[str, list[PoseTerm]]]:
    """Yield each link whose full pose in the world is held at every waypoint, with its terms."""
    for terms in group_equal_poses(problem):
        if terms[0].reference is None and all((*terms[0].position_axes, *terms[0].rotation_axes)):
            yield terms[0].frame, terms


def _is_at_start(robot: RobotModel, start: Float[np.ndarray, "n"], term: PoseTerm) -> bool:
    """Return whether a term's target is the frame's pose at the start."""
    pose = locate_links(KinematicsEngine(robot), start, [term.frame])[term.frame]
    error = np.linalg.inv(term.target) @ pose @ term.offset
    turn = Rotation.from_matrix(error[:3, :3]).magnitude()
    return bool(np.linalg.norm(error[:3, 3]) < SHIFT and turn < TURN)


def _moves(robot: RobotModel, link: str, moving: Int[np.ndarray, "f"]) -> bool:
    """Return whether any of the coordinates moves a link."""
    joint = locate_frame(robot, link)[0]
    return bool(Topology.of(robot.model).supports[joint][moving].any())


def _list_paths(paths: list[str]) -> str:
    return paths[0] if len(paths) == 1 else f"{paths[0]} to {paths[-1]}" if len(paths) > 2 else " and ".join(paths)
