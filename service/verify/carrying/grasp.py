"""Proof that a carried object does not slip: pads lie on it, stay there, and hold its weight inside their cones.

They hold what it presses against as well: the loads of a phase whose tool is the object.  While an object is carried
nothing of the contact changes but the directions of gravity and of these forces, as seen from the object.  The
least force per finger that a wrench needs is a linear program; as a function of the wrench it is convex and grows in
proportion to it, so that its value between two poses is at most that at one of them plus what the difference needs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.robot import LinkBody
from costs.robot.carried import MovableObject
from costs.rotation import cross
from costs.work_space import borrow_data
from service.verify.carrying.carriers import Carrier, Grip
from service.verify.forces.hand_balance import meet
from service.verify.forces.hand_loads import list_offsets, list_parts, measure_most
from service.verify.forces.linear_program import LinearProgram
from service.verify.forces.pads import PATCH_DEPTH_M, find_patch
from service.verify.forces.rounded import list_round_contact, shrink_hull
from service.verify.frame_paths import FramePath
from service.verify.motion import WORLD, HandContact, HandLoad, Motion, VerifyError
from service.verify.prepared_motion import PreparedMotion

GRAVITY = 9.81
SIDES = 8  # of the pyramids inside friction cones
ARM_M = 0.05  # a moment of 1 N m counts like a force of 1 / 0.05 N in the program
LOAD_OFF_M = 4e-3  # farthest from an object's origin that what it presses against acts, across the force


@dataclass(frozen=True)
class Pad:
    """A finger's surface on an object, in the frame of the joint that carries the object.

    Attributes:
        finger: link.
        grip: by which it presses.
        gap: between the surfaces, negative inside [m].
        normal: (3,) unit, into the object.
        points: (P, 3) at which it presses [m].
    """

    finger: str
    grip: Grip
    gap: float
    normal: Float[np.ndarray, "3"]
    points: Float[np.ndarray, "P 3"]


class Held:
    """An object in the grips of its carrier during a phase."""

    def __init__(
        self, prepared: PreparedMotion, item: MovableObject, carrier: Carrier, loads: tuple[HandLoad, ...]
    ) -> None:
        """Prepare.

        Args:
            prepared: with the object as a link of the robot.
            item: the object.
            carrier: of the phase.
            loads: of the phase.

        Raises:
            VerifyError: the carrier names no grip, or a finger that the robot does not have; the object presses on a
                mechanism.
        """
        if not carrier.grips:
            raise VerifyError(f"'{carrier.link}' carries '{item.name}' without a grip")
        self.prepared, self.item, self.carrier = prepared, item, carrier
        self.loads = tuple(load for load in loads if load.tool == item.name)
        for load in self.loads:
            if load.link != WORLD:
                raise VerifyError(f"'{item.name}' presses on '{load.link}'; expected a load on the world")
        robot = prepared.motion.robot
        self.body = next(body for body in robot.bodies if body.name == item.name)
        self.frame = robot.model.frames[robot.model.getFrameId(item.name)]
        self.centre = self.frame.placement.act(item.inertia.centre)
        self.fingers = [
            (grip, body)
            for grip in carrier.grips
            for finger in grip.fingers
            for body in _find_bodies(prepared.motion, finger)
        ]

    def list_pads(self, s: float) -> tuple[Pad, ...]:
        """Return how each finger's nearest body lies on the object at a path parameter."""
        placed, rows = self.prepared.at(np.array([s]))
        pads: dict[str, Pad] = {}
        for grip, body in self.fingers:
            turned, moved = placed.relative(self.body.joint, body.joint, rows)
            pad = _lay(grip, body, self.body, (turned[0], moved[0]))
            if pad.finger not in pads or pad.gap < pads[pad.finger].gap:
                pads[pad.finger] = pad
        return tuple(pads.values())

    def list_paths(self, rounding: float) -> list[FramePath]:
        """Return the paths of the fingers' bodies as seen from the object."""
        model = self.prepared.motion.robot.model
        paths = []
        for _, body in self.fingers:
            placement = model.frames[model.getFrameId(body.link)].placement
            points = (body.vertices - placement.translation) @ placement.rotation
            paths.append(FramePath.of(self.prepared, body.link, points, rounding, self.item.name))
        return paths

    def find_down(self, s: Float[np.ndarray, "S"]) -> Float[np.ndarray, "S 3"]:
        """Return the direction of gravity in the frame of the joint that carries the object."""
        placed, rows = self.prepared.at(s)
        return np.asarray(-placed.rotation[rows, self.body.joint][:, 2])

    def list_pressing(self, s: Float[np.ndarray, "S"]) -> Float[np.ndarray, "K S 6"]:
        """Return corners of the wrenches with which the object presses, the first of which is none.

        Force and moment about its centre of mass, in the frame of the joint that carries the object [N, N m].  Each
        load has any size up to its largest, and acts anywhere within ``LOAD_OFF_M`` of the object's origin.
        """
        placed, rows = self.prepared.at(s)
        turn = placed.rotation[rows, self.body.joint]
        arm = self.frame.placement.translation - self.centre
        corners = [np.zeros((len(s), 6))]
        for load in self.loads:
            own = []
            for part in list_parts(load):
                force, twist = part[:3] @ turn, part[3:] @ turn
                for off in list_offsets(replace(load, drift_m=LOAD_OFF_M)):
                    own.append(np.hstack([force, np.cross(arm + off @ turn, force) + twist]))
            corners += [before + wrench for before in tuple(corners) for wrench in own]
        return np.stack(corners)

    def measure_turning(self, balance: GripBalance) -> float:
        """Return by how much the share that the grips need changes at most per angle that the object turns [1/rad]."""
        most = float(np.linalg.norm(balance.find_force_shares(GRAVITY * self.item.inertia.mass)))
        arm = self.frame.placement.translation - self.centre
        for load in self.loads:
            size = measure_most(load)
            farthest = float(np.linalg.norm(arm)) + np.sqrt(2.0) * LOAD_OFF_M
            forces, moments = (
                balance.find_force_shares(size),
                balance.find_moment_shares(size * farthest + load.twist_nm),
            )
            most += float(np.linalg.norm(forces) + np.linalg.norm(moments))
        return most

    def find_wrenches(
        self, q: Float[np.ndarray, "S n"], v: Float[np.ndarray, "S n"], a: Float[np.ndarray, "S n"]
    ) -> tuple[Float[np.ndarray, "S 6"], Float[np.ndarray, "S 6"]]:
        """Return the forces and moments about the centre of mass that states demand, and at rest [N, N m]."""
        model, joint = self.prepared.motion.robot.model, self.body.joint
        data, count = borrow_data(model), len(q)
        speed, spin, gain, turning, up = np.empty((5, count, 3))
        for k, state in enumerate(zip(q, v, a, strict=True)):
            pin.forwardKinematics(model, data, *state)
            speed[k], spin[k] = data.v[joint].linear, data.v[joint].angular
            gain[k], turning[k] = data.a[joint].linear, data.a[joint].angular
            up[k] = data.oMi[joint].rotation[2]
        turn = np.array(self.frame.placement.rotation)
        moments, centre = turn @ self.item.inertia.moments @ turn.T, self.centre[None]
        linear = gain + cross(spin, speed) + cross(turning, centre) + cross(spin, cross(spin, centre))
        weight = GRAVITY * self.item.inertia.mass * up
        moment = turning @ moments.T + cross(spin, spin @ moments.T)
        moving = np.concatenate([self.item.inertia.mass * linear + weight, moment], axis=1)
        return moving, np.concatenate([weight, np.zeros((count, 3))], axis=1)


class GripBalance:
    """Forces inside the cones of pads that hold a wrench, and the least share of the grips that they need.

    One linear program, solved for one wrench after the other from the last basis.
    """

    def __init__(self, pads: tuple[Pad, ...], centre: Float[np.ndarray, "3"]) -> None:
        """Prepare for wrenches about ``centre``, in the frame of the pads."""
        edges, presses = [], []
        for number, pad in enumerate(pads):
            basis = np.linalg.svd(pad.normal[None])[2][1:]
            angles = 2.0 * np.pi * np.arange(SIDES) / SIDES
            around = np.stack([np.cos(angles), np.sin(angles)], axis=1) @ basis
            forces = pad.normal + pad.grip.friction * around
            for point in pad.points:
                arms = np.cross(point - centre, forces)
                edges.append(np.concatenate([forces, arms / ARM_M], axis=1))
                press = np.zeros((SIDES, len(pads)))
                press[:, number] = 1.0 / pad.grip.force_n
                presses.append(press)
        self._edges = np.concatenate(edges).T if edges else np.zeros((6, 0))
        self._presses = np.concatenate(presses).T if presses else np.zeros((0, 0))

    def find_share(self, wrench: Float[np.ndarray, "6"]) -> float:
        """Return the least share of every finger's force that holds a wrench; infinite where none does."""
        if not self._edges.size:
            return float("inf")
        wanted = np.concatenate([wrench[:3], wrench[3:] / ARM_M])
        free = np.full(len(self._presses), -np.inf)  # no pad presses by more than the share
        found = self._program.solve(np.append(wanted, free), np.append(wanted, np.zeros(len(free))))
        return float("inf") if found is None else float((self._presses @ found[:-1]).max())

    @cached_property
    def _program(self) -> LinearProgram:
        count, n_pads = self._edges.shape[1], len(self._presses)
        rows = np.zeros((6 + n_pads, count + 1))
        rows[:6, :-1], rows[6:, :-1], rows[6:, -1] = self._edges, self._presses, -1.0
        return LinearProgram(np.append(np.zeros(count), 1.0), rows)

    def find_force_shares(self, force_n: float) -> Float[np.ndarray, "3"]:
        """Return the largest share that a force of a size needs along each axis, in either sense."""
        return self._find_shares(np.eye(6)[:3] * force_n)

    def find_moment_shares(self, moment_nm: float) -> Float[np.ndarray, "3"]:
        """Return the largest share that a moment of a size needs about each axis, in either sense."""
        return self._find_shares(np.eye(6)[3:] * moment_nm)

    def _find_shares(self, wrenches: Float[np.ndarray, "3 6"]) -> Float[np.ndarray, "3"]:
        return np.array([max(self.find_share(row), self.find_share(-row)) for row in wrenches])


def _lay(
    grip: Grip, finger: LinkBody, body: LinkBody, pose: tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]
) -> Pad:
    """Return how a finger's body lies on an object, given its pose in the frame of the object's joint."""
    core, radius = shrink_hull(finger.vertices)
    contact = HandContact(finger.link, "a finger", core, radius, body.link, body.name)
    met = meet(contact, body, pose, 1.0, ())
    strip = list_round_contact(body, met.normal, PATCH_DEPTH_M)
    spots = find_patch(core @ pose[0].T + pose[1], body.vertices if strip is None else strip, met.normal)
    if not len(spots):
        return Pad(finger.link, grip, met.gap, met.normal, met.point[None])
    level = (met.point @ met.normal - spots @ met.normal)[:, None] * met.normal
    return Pad(finger.link, grip, met.gap, met.normal, spots + level)


def _find_bodies(motion: Motion, finger: str) -> list[LinkBody]:
    """Return the bodies of a finger (VerifyError where it has none)."""
    bodies = [body for body in motion.robot.bodies if body.link == finger]
    if not bodies:
        raise VerifyError(f"the robot has no link '{finger}' with a shape, which is to hold an object")
    return bodies
