"""What a certificate assumes of the world and the robot, and which guard notices where it is not so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.execution.driver import RobotReading
from service.execution.reference import PlannedReference


@dataclass(frozen=True)
class Assumption:
    """An assumption of a certificate.

    Attributes:
        sentence: what is assumed.
        watched_by: the guard that notices where it is not so; empty where nothing does.
    """

    sentence: str
    watched_by: str


def list_assumptions(reference: PlannedReference, reading: RobotReading) -> tuple[Assumption, ...]:
    """Return what the certificate of a plan assumes, and what a robot with these sensors watches of it."""
    planted = {contact.link for phase in reference.phases for contact in phase.contacts}
    felt = planted & set(reading.foot_wrenches)
    has_torques, presses = bool(np.size(reading.torque)), any(phase.loads for phase in reference.phases)
    carries = any(carrier.link for phase in reference.motion.phases for carrier in phase.carriers)
    servos = "measured torques against the servo's law and the plan" if has_torques else "angles against the commands"
    assumed = [
        Assumption("the joints follow the commands, as their servos do", servos),
        Assumption("nothing else is where the scene has free space, and nothing in it moves", ""),
        Assumption(
            "masses and inertias of the links are those of the URDF",
            "measured torques against the plan, coarsely" if has_torques else "",
        ),
    ]
    sway = reference.motion.sway
    if sway:
        moved = f"{1e3 * sway.distance_m:g} mm and {sway.angle_deg:g} deg"
        watched = "" if reading.base_offset is None else "measured pose of the base"
        words = f"something else balances the robot and keeps its base within {moved} of its place"
        assumed.append(Assumption(words, watched))
    if planted:
        forces = "forces at the planted links, before the next phase begins" if felt == planted else ""
        pelvis = "inertial unit and soles against the command" if felt else ""
        assumed += [
            Assumption("planted links rest on their surfaces, which carry them", forces),
            Assumption("contacts do not slip: friction is at least that of the request", ""),
            Assumption("the floor is where the plan has it, level as planned", pelvis),
        ]
    if presses:
        hands = "force of the hand against cap and growth, from the arm's torques" if has_torques else ""
        assumed += [
            Assumption("what hands move resists no more than the request says", hands),
            Assumption("what hands move is where its model has it, within 4 mm", hands),
            Assumption("friction of hands is between the values of the request", ""),
        ]
    if carries:
        assumed.append(Assumption("carried objects have the given mass and do not slip in the fingers", ""))
    return tuple(assumed)
