"""Demands of a task that moves a mechanism of a URDF: the mechanism, how a hand holds it, and the phases."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from costs.robot import (
    STOP_ROUNDING,
    Mechanism,
    Release,
    RobotError,
    UrdfMechanism,
    check_limits,
    read_mechanism,
)
from costs.rotation import pose_matrix
from costs.scene import ConvexPiece
from service.demands.moved_object.loads import JointLoad, MovedObject, Spring, choose_pace
from service.demands.moved_object.rest import check_rest
from service.errors import RequestError, shown, would_do
from service.request.tasks.mechanism import MECHANISM, STILL, MechanismRequest, is_urdf_text

LINE_OUT = 0.1  # of the line that leads to the handle, where the request gives none [m]
LEAST_TRAVEL = 1e-6  # of a joint that moves [rad, m]
LIMIT_DIGITS = 9  # of limits, which are kept with their rounding


@dataclass(frozen=True)
class Handle:
    """Where a hand holds the mechanism, with all joints at 0 in the frame of a link of the mechanism.

    Attributes:
        link: the mechanism's link.
        joint: that moves the link.
        place, axis, approach: of the tool, its direction (unit), and of the line that leads there [m].
        slide: the tool may be anywhere on ``place`` +- ``slide`` [m], or None.
        tilt: largest lean of the hand [rad].
        bodies: names of the bodies that the rod may touch.
    """

    link: str
    joint: str
    place: Float[np.ndarray, "3"]
    axis: Float[np.ndarray, "3"]
    approach: Float[np.ndarray, "3"]
    slide: Float[np.ndarray, "3"] | None
    tilt: float
    bodies: tuple[str, ...]


@dataclass(frozen=True)
class GivenMechanism:
    """A mechanism that a request gives by its URDF, checked against the request.

    Attributes:
        request: the task.
        read: what the URDF says.
        handle: where a hand holds it.
    """

    request: MechanismRequest
    read: UrdfMechanism
    handle: Handle

    @cached_property
    def moved(self) -> MovedObject:
        """What acts on the joints: the URDF's masses, damping and friction, and the request's springs.

        Friction that the request states for a joint counts instead of the URDF's.
        """
        stated = self.request.joints
        friction = {name: loads.friction for name, loads in stated.items() if loads.friction is not None}
        joints = tuple(replace(joint, friction=friction.get(joint.name, joint.friction)) for joint in self.read.joints)
        springs = {
            name: Spring(loads.preload, loads.stiffness)
            for name, loads in stated.items()
            if loads.preload > 0.0 or loads.stiffness > 0.0
        }
        releases = tuple(
            Release(release.joint, release.latch, release.at, release.free_beyond) for release in self.request.releases
        )
        whole = MovedObject(joints, springs, self.read.stops, releases)
        return replace(whole, joints=tuple(choose_pace(whole, self.list_moves())))

    @cached_property
    def mechanism(self) -> Mechanism:
        """The joints with the request's starts and latches, and the pace that their loads are made for."""
        return Mechanism(MECHANISM, self.moved.joints, self.moved.releases)

    def list_moves(self) -> list[tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]]:
        """Return the values of all joints before and after each move [rad, m]."""
        names = [joint.name for joint in self.read.joints]
        values = np.array([joint.start for joint in self.read.joints])
        ends = []
        for move in self.request.moves:
            last = values.copy()
            last[names.index(move.joint)] = move.to
            ends.append((values, last))
            values = last
        return ends

    def list_pace_notes(self) -> Iterator[str]:
        """Yield a sentence per moved joint with a pace that its loads assume, for motions whose pace nobody proves."""
        moving = {move.joint for move in self.request.moves}
        for joint in self.moved.joints:
            if joint.name in moving and (self.moved.has_masses or joint.damping > 0.0):
                unit = "m" if joint.kind == "prismatic" else "rad"
                yield (
                    f"task.mechanism: the loads of {joint.name} hold up to {joint.velocity:.3g} {unit}/s and "
                    f"{joint.acceleration:.3g} {unit}/s^2, which an untimed motion leaves open"
                )

    def list_joint_loads(self) -> tuple[tuple[JointLoad, ...], ...]:
        """Return per move what the hand must exert along the joints that carry its handle."""
        carriers = self.read.list_carriers(self.handle.joint)
        return tuple(self.moved.list_loads(first, last, carriers) for first, last in self.list_moves())

    @property
    def pieces(self) -> tuple[ConvexPiece, ...]:
        """Bodies that no joint moves, as pieces of the scene."""
        return tuple(ConvexPiece(name, points) for name, points in self.read.still.items())

    def place_bodies(self) -> list[Float[np.ndarray, "V 3"]]:
        """Return the vertices of all bodies in the world at the start [m]."""
        return [*self.read.still.values(), *self.place_moving(self.mechanism.start)]

    def place_moving(self, values: Float[np.ndarray, "k"]) -> list[Float[np.ndarray, "V 3"]]:
        """Return the vertices of all bodies that joints move, with the joints at ``values`` [m]."""
        return [points for _, points in self.place_named(values)]

    def place_named(self, values: Float[np.ndarray, "k"]) -> Iterator[tuple[str, Float[np.ndarray, "V 3"]]]:
        """Yield names and vertices of all bodies that joints move, with the joints at ``values`` [m]."""
        for joint in self.mechanism.joints:
            pose = self.locate(joint.name, values)
            for name, points in joint.bodies.items():
                yield name, (points - joint.origin) @ pose[:3, :3].T + pose[:3, 3]

    def locate(self, joint: str, values: Float[np.ndarray, "k"]) -> Float[np.ndarray, "4 4"]:
        """Return the pose of a joint's link in the world, with the joints at ``values`` [rad, m]."""
        return self.mechanism.locate(self.mechanism.joint(joint).link, values)


def read_given_mechanism(request: MechanismRequest) -> GivenMechanism:
    """Read a request's mechanism, whose URDF is given as text.

    Raises:
        RequestError: one line: the URDF cannot be used, a link or joint is unknown, or a value is past its limits.
        ValueError: the URDF is a path.
    """
    if not is_urdf_text(request.urdf):
        raise ValueError("expected the text of the URDF")
    field = "task.mechanism"
    meshes = {name: np.array(mesh.points) for name, mesh in request.meshes.items()}
    starts = {name: joint.start for name, joint in request.joints.items() if joint.start is not None}
    try:
        pose = pose_matrix(request.position, request.quaternion_wxyz)
        read = read_mechanism(request.urdf, "urdf", MECHANISM, STILL, pose, starts, meshes)
    except RobotError as error:
        raise RequestError(f"{field}.{' '.join(str(error).split())}") from None
    names = [joint.name for joint in read.joints]
    for name in request.joints:
        if name not in names:
            raise RequestError(
                f"{field}.joints: unknown joint {shown(name)}; the mechanism has {would_do(name, names)}"
                f"{_name_stopped(read)}"
            )
    for k, release in enumerate(request.releases):
        for key, name in (("joint", release.joint), ("latch", release.latch)):
            if name not in names:
                where = f"{field}.releases[{k}].{key}"
                raise RequestError(f"{where}: unknown joint {shown(name)}; expected {would_do(name, names)}")
    handle = _read_handle(request, read)
    _check_moves(request, read, handle)
    given = GivenMechanism(request, read, handle)
    moves = [(move.joint, *ends) for move, ends in zip(request.moves, given.list_moves(), strict=True)]
    check_rest(given.moved, moves, read.list_carriers, handle.joint, stays=request.stays)
    return given


def _read_handle(request: MechanismRequest, read: UrdfMechanism) -> Handle:
    handle, field = request.handle, "task.mechanism.handle"
    if handle.link not in read.links:
        raise RequestError(
            f"{field}.link: unknown link {shown(handle.link)}; the mechanism has {would_do(handle.link, read.links)}"
        )
    place = read.links[handle.link]
    if place.link is None:
        stopped = _name_stopped(read)
        raise RequestError(f"{field}.link: no joint moves {shown(handle.link)}; expected a link that moves{stopped}")
    joint = next(joint.name for joint in read.joints if joint.link == place.link)
    rotation, shift = place.pose[:3, :3], place.pose[:3, 3]
    axis = rotation @ np.array(handle.axis)
    axis = axis / np.linalg.norm(axis)
    approach = -LINE_OUT * axis if handle.approach is None else rotation @ np.array(handle.approach)
    slide = None if handle.slide is None else rotation @ np.array(handle.slide)
    at = rotation @ np.array(handle.place) + shift
    tilt = float(np.deg2rad(handle.tilt_deg))
    return Handle(place.link, joint, at, axis, approach, slide, tilt, place.bodies)


def _name_stopped(read: UrdfMechanism) -> str:
    """Return the notes about joints that the file stops, for messages that miss one; empty if there are none."""
    return "".join(f" ({note})" for note in read.notes if "velocity limit of 0:" in note)


def _check_moves(request: MechanismRequest, read: UrdfMechanism, handle: Handle) -> None:
    """Refuse moves of joints that the hand does not move, that go nowhere, or past a limit."""
    joints = {joint.name: joint for joint in read.joints}
    values = {name: joint.start for name, joint in joints.items()}
    carriers = read.list_carriers(handle.joint)
    for k, move in enumerate(request.moves):
        field = f"task.mechanism.moves[{k}]"
        if move.joint not in joints:
            # A joint that the file stops has a note about it.
            stopped = next((f" ({note})" for note in read.notes if f"joint '{move.joint}'" in note), "")
            known = would_do(move.joint, joints)
            raise RequestError(f"{field}.joint: unknown joint {shown(move.joint)}; the mechanism has {known}{stopped}")
        if move.joint not in carriers:
            raise RequestError(
                f"{field}.joint: {shown(move.joint)} does not move {shown(request.handle.link)}, which the hand holds; "
                f"expected {would_do(move.joint, carriers)}"
            )
        joint = joints[move.joint]
        low, high = (round(limit, LIMIT_DIGITS) for limit in (joint.lower + STOP_ROUNDING, joint.upper - STOP_ROUNDING))
        try:
            check_limits(joint.kind, move.to, low, high, f"{field}.to")
        except RobotError as error:
            raise RequestError(str(error)) from None
        if abs(move.to - values[move.joint]) < LEAST_TRAVEL:
            raise RequestError(f"{field}.to: {move.joint} is at {move.to:g} already; expected another value")
        for release in request.releases:
            is_released = values[release.latch] * np.sign(release.at) >= abs(release.at)
            if release.joint == move.joint and abs(values[move.joint]) <= release.free_beyond and not is_released:
                raise RequestError(
                    f"{field}.joint: {move.joint} is locked while {release.latch} is at {values[release.latch]:g}; "
                    f"expected a move of {release.latch} to {release.at:g} or beyond before it"
                )
        values[move.joint] = move.to
