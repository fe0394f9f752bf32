"""The demand part of turning a valve."""

from __future__ import annotations

from service.demands.hands import list_robot_hands
from service.demands.kind import DemandPart, Shown
from service.demands.recorded_task import MechanismDemand
from service.demands.resistance import MechanismPhysics, Resistance
from service.demands.task_demand import World
from service.demands.valve.demand import ValveDemand, make_valve_rest, turn_back
from service.demands.valve.wheel import GROWTH_M, make_wheel
from service.errors import RequestError
from service.request.tasks.valve import VALVE_JOINT, ValveRequest


class ValveDemandPart(DemandPart[ValveRequest]):
    """Turning a valve."""

    def make_demand(self, section: ValveRequest, world: World, shown: Shown, program: object) -> MechanismDemand:
        """Return the demands on the valve that the request gives or the scan shows."""
        from service.demands.valve.given import read_given_valve  # slow to import

        resume = world.request.resume
        given = read_given_valve(section)
        valve = given or next(iter(shown.valves), None)
        if valve is None:
            raise RequestError("task.valve: the scene shows no valve")
        wheel = make_wheel(
            turn_back(valve, resume), section, shown.seen if given is None and section.moved_m is None else None
        )
        hands, friction = list_robot_hands(world.robot), world.request.options.hand_friction[1]
        turning = ValveDemand(wheel, section, hands, friction)
        return MechanismDemand(turning if resume is None else make_valve_rest(turning, resume))

    def read_physics(self, section: ValveRequest) -> MechanismPhysics:
        """Return the request's torque as dry friction of the wheel."""
        is_gripped = section.mode == "grasp"
        wheel = {VALVE_JOINT: Resistance(friction=section.torque_nm)}
        return MechanismPhysics(wheel, GROWTH_M, is_gripped, has_assumed_spokes=not is_gripped)


PART = ValveDemandPart()
