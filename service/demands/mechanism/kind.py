"""The demand part of moving a mechanism that the request gives."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from costs.robot import LinkInertia, RobotModel
from costs.scene import ConvexPiece
from service.demands.kind import DemandPart, Shown
from service.demands.mechanism.demand import GivenMechanismDemand, make_mechanism_rest
from service.demands.mechanism.given import GivenMechanism, read_given_mechanism
from service.demands.plausible import list_mechanism_problems
from service.demands.recorded_task import MechanismDemand
from service.demands.resistance import MechanismPhysics, Resistance
from service.demands.task_demand import World
from service.request.tasks.mechanism import MechanismRequest


class MechanismDemandPart(DemandPart[MechanismRequest]):
    """Moving a mechanism of a URDF."""

    def make_demand(self, section: MechanismRequest, world: World, shown: Shown, program: object) -> MechanismDemand:
        """Return the demands on the mechanism."""
        request = world.request
        moving = GivenMechanismDemand(read_given_mechanism(section), world.robot, request.options.hand_friction)
        return MechanismDemand(moving if request.resume is None else make_mechanism_rest(moving, request.resume))

    def list_given_problems(
        self,
        section: MechanismRequest,
        robot: RobotModel,
        start: Float[np.ndarray, "n"],
        obstacles: Sequence[ConvexPiece],
    ) -> Iterator[str]:
        """Yield a line for each moving part that is inside what stands still."""
        yield from list_mechanism_problems(read_given_mechanism(section), obstacles)

    def read_mechanisms(self, section: MechanismRequest) -> tuple[GivenMechanism, ...]:
        """Return the mechanism of the URDF."""
        return (read_given_mechanism(section),)

    def read_physics(self, section: MechanismRequest) -> MechanismPhysics:
        """Return masses and damping of the URDF, and everything else as the plan's loads have it."""
        return read_given_physics((read_given_mechanism(section),))


def read_given_physics(mechanisms: Iterable[GivenMechanism]) -> MechanismPhysics:
    """Return masses and damping of mechanisms, and everything else as the plan's loads have it."""
    joints: dict[str, Resistance] = {}
    inertias: dict[str, LinkInertia] = {}
    for given in mechanisms:
        moved = given.moved
        for joint in moved.joints:
            resistance = Resistance(friction=joint.friction, damping=joint.damping, rest=joint.start)
            spring = moved.springs.get(joint.name)
            if spring is not None:
                resistance = replace(resistance, preload=spring.preload, stiffness=spring.stiffness)
            joints[joint.name] = resistance
            if joint.inertia is not None:
                inertias[joint.name] = replace(joint.inertia, centre=joint.inertia.centre - joint.origin)
    return MechanismPhysics(joints, inertias=inertias)


PART = MechanismDemandPart()
