"""What a mechanism opposes to the hand that moves it, as the request of a result describes it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from costs.robot import LinkInertia
from service.demands.mechanism.given import read_given_mechanism
from service.demands.valve.wheel import GROWTH_M
from service.request.schema import PlanRequest
from service.request.tasks.door import HANDLE_JOINT, LEAF_JOINT
from service.request.tasks.mechanism import MechanismRequest
from service.request.tasks.valve import VALVE_JOINT

SPRING_TRAVEL = 0.01  # in which the force of a preloaded spring comes, to either side of its rest [rad, m]
LEVER_PRELOAD = 0.5  # share of a lever's torque that its spring has at rest


@dataclass(frozen=True)
class Resistance:
    """Forces on a joint of a mechanism [N m, N].

    Attributes:
        friction: dry friction in either sense; it holds the joint where nobody pushes.
        preload: of the spring that pulls the joint back to its start, once it has left it.
        stiffness: increase of the spring's force per travel [N m/rad, N/m].
        damping: [N m s/rad, N s/m].
        rest: value at which the spring pulls no way; None for the value at the motion's start [rad, m].
    """

    friction: float = 0.0
    preload: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    rest: float | None = None


@dataclass(frozen=True)
class MechanismPhysics:
    """Physics of the mechanism of a result.

    Attributes:
        joints: resistance by joint; none where a joint is missing.
        growth_m: by which the recorded bodies are larger than the mechanism itself [m].
        is_gripped: whether a closed gripper holds the mechanism: it does not slip while its load acts.
        has_assumed_spokes: whether the hand presses a spoke that the plan assumes where the record shows none.
        inertias: by joint, mass of its link in the frame of the joint; the others have an assumed mass without weight.
    """

    joints: Mapping[str, Resistance]
    growth_m: float = 0.0
    is_gripped: bool = False
    has_assumed_spokes: bool = False
    inertias: Mapping[str, LinkInertia] = field(default_factory=dict)

    def has_spring(self, joint: str) -> bool:
        """Return whether a spring pulls a joint back."""
        resistance = self.joints.get(joint)
        return resistance is not None and bool(resistance.preload or resistance.stiffness)


def read_mechanism_physics(request: PlanRequest) -> MechanismPhysics:
    """Return the resistances of the mechanism that a request moves.

    A wheel has the request's torque as dry friction. A lever or push bar has a spring that needs the request's torque
    (force) where it releases. A leaf has the request's torque as dry friction; as a closer if the hand stays at it. The
    joints of a URDF have its masses and damping, and everything else as the plan's loads have it.
    """
    task = request.task
    if task is None:
        return MechanismPhysics({})
    if task.valve is not None:
        is_gripped = task.valve.mode == "grasp"
        wheel = {VALVE_JOINT: Resistance(friction=task.valve.torque_nm)}
        return MechanismPhysics(wheel, GROWTH_M, is_gripped, has_assumed_spokes=not is_gripped)
    if task.door is not None:
        door = task.door
        leaf = Resistance(preload=door.hinge_nm) if door.stays else Resistance(friction=door.hinge_nm)
        is_bar = door.handle is not None and door.handle.kind == "push_bar"
        most = door.push_bar_n if is_bar else door.lever_nm
        release = door.press_m if is_bar else math.radians(door.release_deg)
        spring = Resistance(preload=LEVER_PRELOAD * most, stiffness=(1.0 - LEVER_PRELOAD) * most / release)
        return MechanismPhysics({LEAF_JOINT: leaf, HANDLE_JOINT: spring})
    return MechanismPhysics({}) if task.mechanism is None else _read_given_physics(task.mechanism)


def _read_given_physics(request: MechanismRequest) -> MechanismPhysics:
    moved = read_given_mechanism(request).moved
    joints = {
        joint.name: Resistance(friction=joint.friction, damping=joint.damping, rest=joint.start)
        for joint in moved.joints
    }
    for name, spring in moved.springs.items():
        joints[name] = replace(joints[name], preload=spring.preload, stiffness=spring.stiffness)
    inertias = {
        joint.name: replace(joint.inertia, centre=joint.inertia.centre - joint.origin)
        for joint in moved.joints
        if joint.inertia is not None
    }
    return MechanismPhysics(joints, inertias=inertias)
