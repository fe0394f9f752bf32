"""Demands of a problem at a local minimum: named constraints, obstacles, pairs of links, and joint limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from costs.collision import Contacts
from costs.robot import BASE_NAMES, RobotModel
from costs.state import MotionState
from scopt import AffineRows, Constraint, Problem
from scopt.multipliers import Multipliers
from service.body.phases import change_contacts
from service.body.whole_body import CLEARANCE_TERMS, CLEARANCE_TOLERANCE, WholeBody
from service.explain.conflict import Demand, DemandKind, join_names

MOST_NAMED = 3  # links or joints in a demand's text
NOTABLE = 0.02  # share of the largest multiplier from which a demand or a row counts
BALANCE = "balance"  # name of the constraint that has its own wording

RemoveDemand = Callable[[Problem[MotionState]], Problem[MotionState]]
"""A function that removes a demand from a problem."""


@dataclass(frozen=True)
class LocalMinimum:
    """A point where the violation of a problem is least.

    Attributes:
        body: the robot in its scene.
        problem: without a solution nearby.
        x: (T, n) the point.
        state, multipliers: at ``x``.
    """

    body: WholeBody
    problem: Problem[MotionState]
    x: Float[np.ndarray, "T n"]
    state: MotionState
    multipliers: Multipliers


@dataclass(frozen=True)
class RemovableDemand:
    """A demand with the function that removes it."""

    demand: Demand
    remove: RemoveDemand

    @property
    def key(self) -> tuple[DemandKind, str]:
        """Kind and name, which identify it."""
        return self.demand.kind, self.demand.name


def group_demands(minimum: LocalMinimum) -> list[RemovableDemand]:
    """Return the demands with a notable multiplier, the most loaded first; planted links are no demand."""
    demands = [*_group_constraints(minimum), *_group_clearances(minimum), *_group_limits(minimum)]
    largest = max((group.demand.multiplier for group in demands), default=0.0)
    if largest <= 0.0:
        return []
    shares = [replace(g, demand=replace(g.demand, multiplier=g.demand.multiplier / largest)) for g in demands]
    return sorted((g for g in shares if g.demand.multiplier >= NOTABLE), key=lambda g: -g.demand.multiplier)


def _group_constraints(minimum: LocalMinimum) -> list[RemovableDemand]:
    """Return a demand per constraint, without clearances and planted links."""
    aside = {*CLEARANCE_TERMS, *(f"planted {foot.link}" for foot in minimum.body.planted)}
    known = minimum.multipliers.constraints
    return [
        _group_constraint(minimum, c) for c in minimum.problem.constraints if c.name in known and c.name not in aside
    ]


def _group_constraint(minimum: LocalMinimum, constraint: Constraint[MotionState]) -> RemovableDemand:
    name = constraint.name
    load = np.abs(minimum.multipliers.constraints[name])
    rows = minimum.multipliers.rows[name]
    short = constraint.measure_violation(rows.value)
    waypoint = _find_waypoints(rows, len(minimum.x[0]))
    # Rows of one waypoint are components of one error, those of balance are the polygon's edges.
    together = np.zeros(len(minimum.x))
    if name == BALANCE:
        np.maximum.at(together, waypoint, short)
    else:
        np.add.at(together, waypoint, short**2)
        together = np.sqrt(together)
    worst = int(together.argmax()) if together.any() or not len(load) else int(waypoint[load.argmax()])
    amount = float(together.max(initial=0.0))
    is_missed = bool(short.max(initial=0.0) > constraint.tolerance)
    where = f" at waypoint {worst}" if len(minimum.x) > 1 else ""
    size = f"{amount:.3f}" if amount >= 5e-4 else f"{amount:.1g}"
    size = f"{size} {constraint.unit}".rstrip()
    if name == BALANCE:
        text = f"the centre of mass is {size} short of its balance margin{where}"
        text = text if is_missed else f"the centre of mass is at the edge of its balance margin{where}"
    else:
        text = f"{name} is missed by {size}{where}" if is_missed else f"{name} is only just kept{where}"

    def remove(problem: Problem[MotionState]) -> Problem[MotionState]:
        return replace(problem, constraints=tuple(c for c in problem.constraints if c.name != name))

    demand = Demand(
        DemandKind.CONSTRAINT,
        name,
        float(load.sum()),
        amount if is_missed else 0.0,
        constraint.unit,
        text,
        waypoints=(worst, worst) if len(minimum.x) > 1 else None,
    )
    return RemovableDemand(demand, remove)


def _find_waypoints(rows: AffineRows, n: int) -> np.ndarray:
    """Return the last waypoint of each row (m,); 0 for a row without one."""
    last = np.zeros(len(rows.value), dtype=int)
    row, column = rows.jacobian.nonzero()
    np.maximum.at(last, row, column // n)
    return last


def _group_clearances(minimum: LocalMinimum) -> list[RemovableDemand]:
    """Return a demand per obstacle, against all links, and per pair of links."""
    contacts = minimum.state.contacts
    load = np.zeros(len(contacts))
    for name, is_self in zip(CLEARANCE_TERMS, (False, True), strict=True):
        if name in minimum.multipliers.constraints:
            load[contacts.is_self == is_self] = minimum.multipliers.constraints[name]
    demand_of = _name_demands(minimum.body, contacts)
    rows_of: dict[tuple[DemandKind, str], list[int]] = {}
    for row in np.flatnonzero(load > 0.0).tolist():
        rows_of.setdefault(demand_of[row], []).append(row)
    return [_group_clearance(minimum, kind, name, load, np.array(rows)) for (kind, name), rows in rows_of.items()]


def _name_demands(body: WholeBody, contacts: Contacts) -> list[tuple[DemandKind, str]]:
    """Return kind and name of each contact's demand."""
    robot, pieces = body.robot, body.scene.pieces
    demands = []
    for body_index, other, is_self in zip(
        contacts.body.tolist(), contacts.other.tolist(), contacts.is_self.tolist(), strict=True
    ):
        if not is_self:
            demands.append((DemandKind.OBSTACLE, pieces[other].name))
            continue
        pair = sorted((robot.bodies[body_index].link, robot.bodies[other].link))
        moved = [link for link in pair if link in robot.mechanism_links]
        demands.append((DemandKind.OBSTACLE, moved[0]) if moved else (DemandKind.LINKS, " and ".join(pair)))
    return demands


def _group_clearance(
    minimum: LocalMinimum, kind: DemandKind, name: str, load: Float[np.ndarray, "m"], rows: np.ndarray
) -> RemovableDemand:
    """Return the demand of an obstacle or pair of links, described at its worst contact."""
    contacts = minimum.state.contacts
    notable = rows[load[rows] >= NOTABLE * load[rows].max()]
    short = contacts.margin - contacts.distance
    worst = int(notable[short[notable].argmax()])
    own: dict[str, float] = {}
    for row in notable.tolist():
        for link in _list_links(minimum.body.robot, contacts, row):
            own[link] = own.get(link, 0.0) + float(load[row])
    links = tuple(sorted(own, key=lambda link: -own[link]))
    text = _describe_contact(minimum.body, contacts, worst)
    named = _list_links(minimum.body.robot, contacts, worst)
    others = [link for link in links if link not in named]
    if others and kind is DemandKind.OBSTACLE:
        text += f" ({join_names(others)} {'meets' if len(others) == 1 else 'meet'} it too)"

    def drop_contacts(full: Contacts) -> Contacts:
        return full.where(np.array([d != (kind, name) for d in _name_demands(minimum.body, full)], dtype=bool))

    def remove(problem: Problem[MotionState]) -> Problem[MotionState]:
        return change_contacts(problem, drop_contacts)

    is_short = bool(short[worst] > CLEARANCE_TOLERANCE)
    ends = (int(contacts.first[worst]), int(contacts.second[worst]))
    demand = Demand(
        kind,
        name,
        float(load[rows].sum()),
        float(short[worst]) if is_short else 0.0,
        "m",
        text,
        links=links,
        waypoints=ends if ends[0] != ends[1] else None,
    )
    return RemovableDemand(demand, remove)


def _list_links(robot: RobotModel, contacts: Contacts, row: int) -> list[str]:
    """Return the robot's own links in a contact."""
    members = [int(contacts.body[row])] + ([int(contacts.other[row])] if contacts.is_self[row] else [])
    return [link for member in members if (link := robot.bodies[member].link) not in robot.mechanism_links]


def _describe_contact(body: WholeBody, contacts: Contacts, row: int) -> str:
    """Return a clause about the distance of two bodies, or of a body and a piece."""
    other = int(contacts.other[row])
    first = _name_body(body.robot, int(contacts.body[row]))
    second = _name_body(body.robot, other) if contacts.is_self[row] else body.scene.pieces[other].name
    if contacts.is_self[row] and body.robot.bodies[int(contacts.body[row])].link in body.robot.mechanism_links:
        first, second = second, first
    distance, margin = float(contacts.distance[row]), float(contacts.margin[row])
    ends = (int(contacts.first[row]), int(contacts.second[row]))
    where = "" if ends[0] == ends[1] else f" between waypoints {ends[0]} and {ends[1]}"
    if abs(distance) < 5e-4:
        return f"{first} touches {second}{where}"
    if distance < 0.0:
        return f"{first} is {-1e3 * distance:.0f} mm inside {second}{where}"
    if margin - distance > CLEARANCE_TOLERANCE:
        return f"{first} is {1e3 * distance:.0f} mm from {second}{where}, too near"
    return f"{first} is held {1e3 * distance:.0f} mm off {second}{where}"


def _name_body(robot: RobotModel, index: int) -> str:
    """Return the name of a body's link, or of the part of a mechanism."""
    body = robot.bodies[index]
    return body.name if body.link in robot.mechanism_links else body.link


def _group_limits(minimum: LocalMinimum) -> list[RemovableDemand]:
    """Return the joint limits as a single demand, if any is loaded; the base has none."""
    robot, multipliers = minimum.body.robot, minimum.multipliers
    first = len(BASE_NAMES) if robot.is_floating else 0
    by_side = {"lower": multipliers.lower.sum(axis=0), "upper": multipliers.upper.sum(axis=0)}
    load = by_side["lower"] + by_side["upper"]
    load[:first] = 0.0
    if not load.any():
        return []
    at_limit = [int(i) for i in np.argsort(-load, kind="stable") if load[i] >= NOTABLE * load.max()]
    clauses = []
    for index in at_limit[:MOST_NAMED]:
        side = "upper" if by_side["upper"][index] > by_side["lower"][index] else "lower"
        limit = float(getattr(robot, side)[index])
        clauses.append(f"{robot.joint_names[index]} is at its {side} limit of {limit:.3f} {_unit(robot, index)}")
    more = len(at_limit) - len(clauses)
    text = join_names(
        clauses + ([f"{more} more {'joint is' if more == 1 else 'joints are'} at a limit"] if more else [])
    )

    def remove(problem: Problem[MotionState]) -> Problem[MotionState]:
        lower, upper = problem.lower.copy(), problem.upper.copy()
        is_free = upper > lower
        is_free[:, :first] = False
        lower[is_free], upper[is_free] = -np.inf, np.inf
        return replace(problem, lower=lower, upper=upper)

    joints = tuple(robot.joint_names[index] for index in at_limit)
    demand = Demand(DemandKind.LIMITS, "joint limits", float(load.sum()), 0.0, "", text, joints=joints)
    return [RemovableDemand(demand, remove)]


def _unit(robot: RobotModel, index: int) -> str:
    """Return the unit of a coordinate: metres for a sliding joint."""
    slides = any(j.idx_v == index and j.shortname().startswith("JointModelP") for j in robot.model.joints)
    return "m" if slides else "rad"
