"""The demand part of opening a door."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from costs.robot import RobotModel
from costs.scene import ConvexPiece
from service.demands.door.demand import DoorDemand, choose_door, make_door, make_door_rest, read_given_door, set_back
from service.demands.kind import DemandPart, Shown
from service.demands.plausible import list_door_problems
from service.demands.recorded_task import MechanismDemand
from service.demands.resistance import MechanismPhysics, Resistance
from service.demands.task_demand import World
from service.errors import RequestError
from service.request.tasks.door import HANDLE_JOINT, LEAF_JOINT, DoorRequest

LEVER_PRELOAD = 0.5  # share of a lever's torque that its spring has at rest


class DoorDemandPart(DemandPart[DoorRequest]):
    """Opening a door."""

    def make_demand(self, section: DoorRequest, world: World, shown: Shown, program: object) -> MechanismDemand:
        """Return the demands on the door that the request gives or the scan shows."""
        resume = world.request.resume
        geometry = choose_door(section, shown.doors, _find_base(world.robot, world.start), world.scene.pieces)
        if isinstance(geometry, str):
            raise RequestError(f"task.door: {geometry}")
        door = set_back(
            make_door(section, geometry, shown.seen if section.leaf is None and section.moved_m is None else None),
            resume,
        )
        opening = DoorDemand(door, section, world.robot)
        return MechanismDemand(opening if resume is None else make_door_rest(opening, resume))

    def list_given_problems(
        self, section: DoorRequest, robot: RobotModel, start: Float[np.ndarray, "n"], obstacles: Sequence[ConvexPiece]
    ) -> Iterator[str]:
        """Yield a line for a handle that is not on its leaf."""
        geometry = read_given_door(section, _find_base(robot, start))
        yield from () if geometry is None else list_door_problems(geometry)

    def read_physics(self, section: DoorRequest) -> MechanismPhysics:
        """Return the resistances of leaf and handle.

        A lever or push bar has a spring that needs the request's torque (force) where it releases. A leaf has the
        request's torque as dry friction; as a closer if the hand stays at it.
        """
        leaf = Resistance(preload=section.hinge_nm) if section.stays else Resistance(friction=section.hinge_nm)
        is_bar = section.handle is not None and section.handle.kind == "push_bar"
        most = section.push_bar_n if is_bar else section.lever_nm
        release = section.press_m if is_bar else math.radians(section.release_deg)
        spring = Resistance(preload=LEVER_PRELOAD * most, stiffness=(1.0 - LEVER_PRELOAD) * most / release)
        return MechanismPhysics({LEAF_JOINT: leaf, HANDLE_JOINT: spring})


def _find_base(robot: RobotModel, start: Float[np.ndarray, "n"]) -> Float[np.ndarray, "3"]:
    return start[:3] if robot.is_floating else np.zeros(3)


PART = DoorDemandPart()
