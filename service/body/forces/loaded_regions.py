"""Where the ground holds the robot while its hands carry loads: regions of the centre of mass along a phase."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product

import numpy as np
from jaxtyping import Float

from costs.contact import GRAVITY, WorldContacts
from costs.contact_points import measure_weight
from costs.kinematics import KinematicsEngine, locate_frame, locate_links
from costs.mechanism_wrench import list_arc_wrenches, list_slide_wrenches
from costs.robot import RobotModel, read_joint_axis
from costs.static_region import StaticRegion, find_static_region
from costs.stopping import poll
from service.verify import Ground, HandLoad, PlantedContact, find_tilts, list_world_wrenches

LONGEST_STRETCH = np.deg2rad(45.0)  # of a revolute joint that one region covers
STILL = 1e-9


@dataclass(frozen=True)
class PlannedRegion:
    """Region of a stretch of waypoints.

    Attributes:
        first, last: waypoints at its ends.
        region: polygon with forces that prove it.
        shift_m: what drifting feet and hands take off the margin.
    """

    first: int
    last: int
    region: StaticRegion
    shift_m: float


def plan_regions(
    engine: KinematicsEngine,
    contacts: Sequence[PlantedContact],
    loads: tuple[HandLoad, ...],
    values: Float[np.ndarray, "T k"],
    q: Float[np.ndarray, "n"],
) -> tuple[PlannedRegion, ...]:
    """Return the regions of a phase in which at most one joint of the mechanism moves.

    Args:
        engine: of the robot augmented by the mechanism, whose joints are the last ``k`` coordinates.
        contacts: planted feet.
        loads: of the hands.
        values: mechanism at the waypoints [rad, m].
        q: (n,) any configuration; only the mechanism's coordinates count.

    Raises:
        StaticRegionError: some load can be held nowhere.
        Stopped: by surrounding work, see ``costs.stopping``.
    """
    weight = measure_weight(engine.robot)
    ground = WorldContacts(*Ground.under(tuple(contacts)))
    feet_drift = max(contact.tolerance_m for contact in contacts)
    drift = feet_drift + max(load.drift_m for load in loads)
    tilts = find_tilts(tuple(contacts))
    hands = sum(float(np.linalg.norm(load.force)) * load.drift_m for load in loads) / weight
    regions = []
    for first, last in _split_stretches(engine.robot, values):
        poll()  # a region takes some hundredths of a second
        wrenches = _list_wrenches(engine, loads, values[[first, last]], q)
        region = _find_region(_Question(ground, weight / GRAVITY, wrenches, drift, tilts))
        regions.append(PlannedRegion(first, last, region, region.shift_m * feet_drift / drift + hands))
    return tuple(regions)


def plan_world_region(
    robot: RobotModel, contacts: Sequence[PlantedContact], loads: tuple[HandLoad, ...], count: int
) -> PlannedRegion:
    """Return where the feet hold the robot on a phase of ``count`` waypoints while the world pushes its hands.

    Args:
        robot: the robot.
        contacts: planted feet.
        loads: on the world (``service.verify.WORLD``).
        count: of the waypoints.

    Raises:
        StaticRegionError: some load can be held nowhere.
    """
    weight = measure_weight(robot)
    drift = max(contact.tolerance_m for contact in contacts)
    corners = [list_world_wrenches(load) for load in loads]
    wrenches = [np.zeros(6)]
    for choice in product(*corners):
        for share in product((0.0, 1.0), repeat=len(loads)):
            wrenches.append(np.sum([s * part for s, part in zip(share, choice, strict=True)], axis=0))
    ground = WorldContacts(*Ground.under(tuple(contacts)))
    unique = np.unique(np.stack(wrenches), axis=0)
    region = _find_region(_Question(ground, weight / GRAVITY, unique, drift, find_tilts(tuple(contacts))))
    return PlannedRegion(0, count - 1, region, region.shift_m)


def plan_contact_region(robot: RobotModel, contacts: Sequence[PlantedContact]) -> PlannedRegion:
    """Return where contacts alone hold the robot, without loads.

    Raises:
        StaticRegionError: they hold it nowhere.
    """
    weight = measure_weight(robot)
    drift = max(contact.tolerance_m for contact in contacts)
    points = WorldContacts(*Ground.under(tuple(contacts)))
    question = _Question(points, weight / GRAVITY, np.zeros((1, 6)), drift, find_tilts(tuple(contacts)))
    region = _find_region(question)
    return PlannedRegion(0, 0, region, region.shift_m)


@dataclass(frozen=True, eq=False)
class _Question:
    """Arguments of a region, compared by their numbers: the same stretch is asked for many times."""

    ground: WorldContacts
    mass: float
    wrenches: Float[np.ndarray, "W 6"]
    drift: float
    tilts: Float[np.ndarray, "C"]

    @cached_property
    def key(self) -> tuple[object, ...]:
        """Everything that decides the answer."""
        ground = self.ground
        arrays = (ground.points, ground.normals, ground.friction, ground.caps, self.wrenches, self.tilts)
        return (self.mass, self.drift, *(array.tobytes() for array in arrays))

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Question) and self.key == other.key


@lru_cache(maxsize=256)
def _find_region(question: _Question) -> StaticRegion:
    return find_static_region(question.ground, question.mass, question.wrenches, question.drift, question.tilts)


def _split_stretches(robot: RobotModel, values: Float[np.ndarray, "T k"]) -> list[tuple[int, int]]:
    """Return the waypoints at the ends of stretches that are short enough for one region each."""
    travel = np.abs(values - values[0]).max(axis=1)
    column = robot.n - values.shape[1] + int(np.abs(values[-1] - values[0]).argmax())
    axis = read_joint_axis(robot, int(robot.model.getJointId(robot.joint_names[column])))
    if not np.any(axis[3:]) or travel[-1] <= STILL:
        return [(0, len(values) - 1)]
    count = max(int(np.ceil(travel[-1] / LONGEST_STRETCH)), 1)
    borders = np.unique([int(np.abs(travel - share).argmin()) for share in np.linspace(0.0, travel[-1], count + 1)])
    return list(zip(borders[:-1].tolist(), borders[1:].tolist(), strict=True))


def _list_wrenches(
    engine: KinematicsEngine, loads: tuple[HandLoad, ...], ends: Float[np.ndarray, "2 k"], q: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "W 6"]:
    """Return wrenches on the robot whose convex hull has those of all loads between two states of the mechanism."""
    robot, k = engine.robot, ends.shape[1]
    moving = int(np.abs(ends[1] - ends[0]).argmax())
    is_still = bool(np.abs(ends[1] - ends[0]).max() <= STILL)
    column = robot.n - k + moving
    at = q.copy()
    at[robot.n - k :] = ends[0]
    at[column] = ends[0][moving] if is_still else 0.0
    poses = locate_links(engine, at, [load.link for load in loads])
    kinematics = engine(at[None])
    joint = int(robot.model.getJointId(robot.joint_names[column]))
    axis, origin = read_joint_axis(robot, joint), kinematics.position[0, joint]
    turned = kinematics.rotation[0, joint] @ (axis[3:] if np.any(axis[3:]) else axis[:3])
    corners = []
    for load in loads:
        pose = poses[load.link]
        force = -pose[:3, :3] @ load.force
        slides = [np.zeros(3)] if load.slide is None else [-load.slide, load.slide]
        moves = not is_still and joint in list(robot.model.supports[locate_frame(robot, load.link)[0]])
        options = []
        for slide in slides:
            point = pose[:3, :3] @ (load.place + slide) + pose[:3, 3]
            fixed = np.concatenate([force, np.cross(point, force)])
            if is_still:
                options.append(fixed[None])
            elif not moves:
                options.append(np.tile(fixed, (_count(axis, ends[:, moving]), 1)))
            elif np.any(axis[3:]):
                options.append(list_arc_wrenches(force, point, turned, origin, *ends[:, moving].tolist()))
            else:
                options.append(list_slide_wrenches(force, point, turned, *ends[:, moving].tolist()))
        corners.append(options)
    wrenches = [np.zeros((1, 6))]
    for choice in product(*corners):
        for share in product((0.0, 1.0), repeat=len(loads)):
            if any(share):
                wrenches.append(np.sum([s * part for s, part in zip(share, choice, strict=True)], axis=0))
    return np.unique(np.concatenate(wrenches), axis=0)


def _count(axis: Float[np.ndarray, "6"], ends: Float[np.ndarray, "2"]) -> int:
    """Return the number of corners of a load that moves between two values of a joint."""
    if not np.any(axis[3:]):
        return 2
    z = np.array([0.0, 0.0, 1.0])
    return len(list_arc_wrenches(z, np.ones(3), z, np.zeros(3), *ends.tolist()))
