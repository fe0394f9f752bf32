"""The demands of a problem where it is stuck: named constraints, obstacles, pairs of links, and the joint limits."""

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
from service.body.restore import change_contacts
from service.body.whole_body import CLEARANCE_TERMS, CLEARANCE_TOLERANCE, WholeBody
from service.explain.conflict import Demand, DemandKind, join_names

MOST_NAMED = 3  # links or joints that are named of one demand
NOTABLE = 0.02  # share of the largest multiplier from which a demand or a row counts
BALANCE = "balance"  # the constraint of that name is told in other words

GiveUp = Callable[[Problem[MotionState]], Problem[MotionState]]
"""Makes of a problem the one without a demand."""


@dataclass(frozen=True)
class Place:
    """Where a problem is stuck.

    Attributes:
        body: the robot in its scene.
        problem: what has no solution.
        x: (T, n) where its violation is least.
        state: of ``problem`` at ``x``.
        multipliers: there.
    """

    body: WholeBody
    problem: Problem[MotionState]
    x: Float[np.ndarray, "T n"]
    state: MotionState
    multipliers: Multipliers


@dataclass(frozen=True)
class Group:
    """A demand, and how to do without it."""

    demand: Demand
    give_up: GiveUp

    @property
    def key(self) -> tuple[DemandKind, str]:
        """What tells it from others."""
        return self.demand.kind, self.demand.name


def group_demands(place: Place) -> list[Group]:
    """All demands with a notable multiplier, the most loaded first.

    Planted links are where the robot stands: they are taken as given and are no demand.
    """
    found = [*_constraints(place), *_clearances(place), *_limits(place)]
    largest = max((group.demand.multiplier for group in found), default=0.0)
    if largest <= 0.0:
        return []
    shares = [replace(g, demand=replace(g.demand, multiplier=g.demand.multiplier / largest)) for g in found]
    return sorted((g for g in shares if g.demand.multiplier >= NOTABLE), key=lambda g: -g.demand.multiplier)


def _constraints(place: Place) -> list[Group]:
    """Every constraint by its name, clearances and planted links aside."""
    aside = {*CLEARANCE_TERMS, *(f"planted {foot.link}" for foot in place.body.planted)}
    known = place.multipliers.constraints
    return [_constraint(place, c) for c in place.problem.constraints if c.name in known and c.name not in aside]


def _constraint(place: Place, constraint: Constraint[MotionState]) -> Group:
    name = constraint.name
    load = np.abs(place.multipliers.constraints[name])
    rows = place.multipliers.rows[name]
    short = constraint.measure_violation(rows.value)
    waypoint = _waypoints(rows, len(place.x[0]))
    # Rows of one waypoint are components of one error, those of balance are the polygon's edges.
    together = np.zeros(len(place.x))
    if name == BALANCE:
        np.maximum.at(together, waypoint, short)
    else:
        np.add.at(together, waypoint, short**2)
        together = np.sqrt(together)
    worst = int(together.argmax()) if together.any() or not len(load) else int(waypoint[load.argmax()])
    amount = float(together.max(initial=0.0))
    is_missed = bool(short.max(initial=0.0) > constraint.tolerance)
    where = f" at waypoint {worst}" if len(place.x) > 1 else ""
    size = f"{amount:.3f}" if amount >= 5e-4 else f"{amount:.1g}"
    size = f"{size} {constraint.unit}".rstrip()
    if name == BALANCE:
        text = f"the centre of mass is {size} short of its balance margin{where}"
        text = text if is_missed else f"the centre of mass is at the edge of its balance margin{where}"
    else:
        text = f"{name} is missed by {size}{where}" if is_missed else f"{name} is only just kept{where}"

    def give_up(problem: Problem[MotionState]) -> Problem[MotionState]:
        return replace(problem, constraints=tuple(c for c in problem.constraints if c.name != name))

    demand = Demand(
        DemandKind.CONSTRAINT,
        name,
        float(load.sum()),
        amount if is_missed else 0.0,
        constraint.unit,
        text,
        waypoints=(worst, worst) if len(place.x) > 1 else None,
    )
    return Group(demand, give_up)


def _waypoints(rows: AffineRows, n: int) -> np.ndarray:
    """(m,) the last waypoint that each row touches; 0 for a row that touches none."""
    last = np.zeros(len(rows.value), dtype=int)
    row, column = rows.jacobian.nonzero()
    np.maximum.at(last, row, column // n)
    return last


def _clearances(place: Place) -> list[Group]:
    """Obstacles, each against all links, and pairs of links."""
    contacts = place.state.contacts
    load = np.zeros(len(contacts))
    for name, is_self in zip(CLEARANCE_TERMS, (False, True), strict=True):
        if name in place.multipliers.constraints:
            load[contacts.is_self == is_self] = place.multipliers.constraints[name]
    asked = _asked(place.body, contacts)
    rows_of: dict[tuple[DemandKind, str], list[int]] = {}
    for row in np.flatnonzero(load > 0.0).tolist():
        rows_of.setdefault(asked[row], []).append(row)
    return [_clearance(place, kind, name, load, np.array(rows)) for (kind, name), rows in rows_of.items()]


def _asked(body: WholeBody, contacts: Contacts) -> list[tuple[DemandKind, str]]:
    """Which demand each contact belongs to."""
    robot, pieces = body.robot, body.scene.pieces
    found = []
    for one, other, is_self in zip(
        contacts.body.tolist(), contacts.other.tolist(), contacts.is_self.tolist(), strict=True
    ):
        if not is_self:
            found.append((DemandKind.OBSTACLE, pieces[other].name))
            continue
        pair = sorted((robot.bodies[one].link, robot.bodies[other].link))
        moved = [link for link in pair if link in robot.mechanism_links]
        found.append((DemandKind.OBSTACLE, moved[0]) if moved else (DemandKind.LINKS, " and ".join(pair)))
    return found


def _clearance(place: Place, kind: DemandKind, name: str, load: Float[np.ndarray, "m"], rows: np.ndarray) -> Group:
    """One obstacle or pair of links, told by the pair that is worst."""
    contacts = place.state.contacts
    notable = rows[load[rows] >= NOTABLE * load[rows].max()]
    short = contacts.margin - contacts.distance
    worst = int(notable[short[notable].argmax()])
    own: dict[str, float] = {}
    for row in notable.tolist():
        for link in _links(place.body.robot, contacts, row):
            own[link] = own.get(link, 0.0) + float(load[row])
    links = tuple(sorted(own, key=lambda link: -own[link]))
    text = meeting(place.body, contacts, worst)
    told = _links(place.body.robot, contacts, worst)
    others = [link for link in links if link not in told]
    if others and kind is DemandKind.OBSTACLE:
        text += f" ({join_names(others)} {'meets' if len(others) == 1 else 'meet'} it too)"

    def others_only(met: Contacts) -> Contacts:
        return met.where(np.array([asked != (kind, name) for asked in _asked(place.body, met)], dtype=bool))

    def give_up(problem: Problem[MotionState]) -> Problem[MotionState]:
        return change_contacts(problem, others_only)

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
    return Group(demand, give_up)


def _links(robot: RobotModel, contacts: Contacts, row: int) -> list[str]:
    """The robot's own links in a contact."""
    members = [int(contacts.body[row])] + ([int(contacts.other[row])] if contacts.is_self[row] else [])
    return [link for member in members if (link := robot.bodies[member].link) not in robot.mechanism_links]


def meeting(body: WholeBody, contacts: Contacts, row: int) -> str:
    """How near two bodies, or a body and a piece, come to each other, in words."""
    other = int(contacts.other[row])
    first = _name(body.robot, int(contacts.body[row]))
    second = _name(body.robot, other) if contacts.is_self[row] else body.scene.pieces[other].name
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


def _name(robot: RobotModel, body: int) -> str:
    """Of a body: its link's, or the part's of what the task moves."""
    one = robot.bodies[body]
    return one.name if one.link in robot.mechanism_links else one.link


def _limits(place: Place) -> list[Group]:
    """The joint limits as one demand; the base has none."""
    robot, found = place.body.robot, place.multipliers
    first = len(BASE_NAMES) if robot.is_floating else 0
    by_side = {"lower": found.lower.sum(axis=0), "upper": found.upper.sum(axis=0)}
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

    def give_up(problem: Problem[MotionState]) -> Problem[MotionState]:
        lower, upper = problem.lower.copy(), problem.upper.copy()
        is_free = upper > lower
        is_free[:, :first] = False
        lower[is_free], upper[is_free] = -np.inf, np.inf
        return replace(problem, lower=lower, upper=upper)

    joints = tuple(robot.joint_names[index] for index in at_limit)
    demand = Demand(DemandKind.LIMITS, "joint limits", float(load.sum()), 0.0, "", text, joints=joints)
    return [Group(demand, give_up)]


def _unit(robot: RobotModel, index: int) -> str:
    """Unit of a coordinate: metres for a sliding joint."""
    slides = any(j.idx_v == index and j.shortname().startswith("JointModelP") for j in robot.model.joints)
    return "m" if slides else "rad"
