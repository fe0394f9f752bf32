"""What the hands of steps push: one mechanism of all parts that steps move, each part with its own joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from costs.robot import Mechanism, MechanismJoint
from service.demands.mechanism.given import GivenMechanism, read_given_mechanism
from service.demands.phase import TaskPhase
from service.demands.steps.extent import Extent
from service.errors import RequestError
from service.request.fields import find_repeated
from service.request.tasks.hand_steps import PressStep
from service.request.tasks.mechanism import (
    MECHANISM,
    MechanismHandleRequest,
    MechanismJointRequest,
    MechanismRequest,
    MoveRequest,
)
from service.request.tasks.steps import StepRequest, StepsSection

BEYOND_M = 1e-3  # from the end of a press to the stop of the part
FREE_M, LEAST_DEPTH_M = 2e-3, 1e-3  # behind a part that is pushed in; thickness of a part
OUT_M = 0.08  # of the line on which a hand comes to a part that it presses


@dataclass(frozen=True)
class MovedParts:
    """The parts that steps move.

    Attributes:
        parts: mechanism by index of its step, as it is when the step begins.
        firsts: index of the first step that moves the same mechanism, by index of a step.
    """

    parts: Mapping[int, GivenMechanism]
    firsts: Mapping[int, int]

    @staticmethod
    def of(section: StepsSection) -> MovedParts:
        """Return the parts of all steps that a plan does.

        Raises:
            RequestError: a mechanism cannot be used, or two of them have a joint or a link of one name.
        """
        parts, firsts = dict[int, GivenMechanism](), dict[int, int]()
        for named in Extent.of(section).done:
            if named.step.mechanism is None and named.step.press is None:
                continue
            field, request = f"task.steps[{named.index}]", _read_request(named.step, named.index)
            before = [index for index, given in parts.items() if _is_same(given.request, request)]
            firsts[named.index] = firsts[before[-1]] if before else named.index
            if before:
                request = _go_on(parts[before[-1]], request, field)
            parts[named.index] = _read(request, field, "press" if named.step.mechanism is None else "mechanism")
        made = MovedParts(parts, firsts)
        names = [joint.name for given in made.distinct.values() for joint in given.read.joints]
        links = [joint.link for given in made.distinct.values() for joint in given.read.joints]
        twice = find_repeated(names) or find_repeated(links)
        if twice:
            raise RequestError(
                f"task.steps: the mechanisms of two steps have a joint or a link '{twice[0]}'; expected a name for "
                "each, or the same mechanism in both, with equal urdf, position, joints and releases"
            )
        return made

    @property
    def distinct(self) -> Mapping[int, GivenMechanism]:
        """Every mechanism once, as it is at the start, by the index of the first step that moves it."""
        return {index: self.parts[index] for index in self.firsts.values()}

    @cached_property
    def mechanism(self) -> Mechanism | None:
        """All joints as one mechanism; None where no step moves any."""
        if not self.parts:
            return None
        paces = [joint for given in self.parts.values() for joint in given.mechanism.joints]
        joints = tuple(_slow_down(joint, paces) for given in self.distinct.values() for joint in given.mechanism.joints)
        releases = tuple(release for given in self.distinct.values() for release in given.mechanism.releases)
        return Mechanism(MECHANISM, joints, releases)

    def widen(
        self, specs: Sequence[TaskPhase], index: int, name: str, values: Float[np.ndarray, "k"]
    ) -> tuple[TaskPhase, ...]:
        """Return phases of one part as phases of the whole mechanism, named after their step.

        Args:
            specs: of the part.
            index: of its step.
            name: of its step.
            values: (k,) of all joints, of which those of other parts stay.
        """
        mechanism = self.mechanism
        assert mechanism is not None
        own = [joint.name for joint in self.parts[index].mechanism.joints]
        columns = [k for k, joint in enumerate(mechanism.joints) if joint.name in own]

        def place(part: Float[np.ndarray, "j"]) -> Float[np.ndarray, "k"]:
            whole = values.copy()
            whole[columns] = part
            return whole

        return tuple(
            replace(spec, name=f"{name}: {spec.name}", first=place(spec.first), last=place(spec.last)) for spec in specs
        )

    def advance(self, index: int, values: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        """Return the values of all joints after a step."""
        given, mechanism = self.parts[index], self.mechanism
        assert mechanism is not None
        after, columns = values.copy(), {joint.name: k for k, joint in enumerate(mechanism.joints)}
        for move in given.request.moves:
            after[columns[move.joint]] = move.to
        return after


def _read_request(step: StepRequest, index: int) -> MechanismRequest:
    return step.mechanism if step.mechanism is not None else make_pressed_part(step.press, index)  # type: ignore[arg-type]


def _is_same(one: MechanismRequest, other: MechanismRequest) -> bool:
    """Return whether two requests give the same mechanism, whatever is done with it and wherever it starts."""
    return _strip(one) == _strip(other)


def _strip(request: MechanismRequest) -> tuple[object, ...]:
    joints = {name: replace(joint, start=None) for name, joint in request.joints.items()}
    own = {name: joint for name, joint in joints.items() if joint != MechanismJointRequest()}
    return request.urdf, request.position, request.quaternion_wxyz, own, request.releases, request.meshes


def _go_on(before: GivenMechanism, request: MechanismRequest, field: str) -> MechanismRequest:
    """Return the request of a mechanism whose joints start where an earlier step has left them.

    Raises:
        RequestError: a spring has taken one of them back.
    """
    ends = dict(zip((joint.name for joint in before.read.joints), before.list_moves()[-1][1].tolist(), strict=True))
    for joint in before.read.joints:
        if joint.name in before.moved.springs and ends[joint.name] != joint.start:
            raise RequestError(
                f"{field}.mechanism: the spring of joint {joint.name} takes it back once the hand of an earlier step "
                "has gone; expected all moves that it has to stay for in one step, or a move of it back before"
            )
    joints = {name: replace(request.joints.get(name, MechanismJointRequest()), start=end) for name, end in ends.items()}
    return replace(request, joints=joints)


def _slow_down(joint: MechanismJoint, paces: Sequence[MechanismJoint]) -> MechanismJoint:
    """Return a joint with the slowest of the paces that the loads of the steps are made for."""
    own = [pace for pace in paces if pace.name == joint.name]
    return replace(
        joint, velocity=min(pace.velocity for pace in own), acceleration=min(pace.acceleration for pace in own)
    )


def _read(request: MechanismRequest, field: str, kind: str) -> GivenMechanism:
    """Return the mechanism of a step; its messages name the step."""
    try:
        return read_given_mechanism(request)
    except RequestError as error:
        lines = [problem.replace("task.mechanism", f"{field}.{kind}") for problem in error.problems]
        raise RequestError(lines) from None


def make_pressed_part(press: PressStep, index: int) -> MechanismRequest:
    """Return a part that slides into what is behind it, with friction of the given force."""
    normal = np.asarray(press.normal, dtype=float)
    inwards = -normal / np.linalg.norm(normal)
    side = np.eye(3)[int(np.abs(inwards).argmin())]
    x = side - (side @ inwards) * inwards
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(inwards, x), inwards], axis=1)
    w, i, j, k = Rotation.from_matrix(rotation).as_quat(scalar_first=True).tolist()
    height = press.travel_m + 0.005 if press.height_m is None else press.height_m
    depth = max(height - press.travel_m - FREE_M, LEAST_DEPTH_M)  # so that it is before its wall when it is pushed in
    part, joint = f"pressed_{index + 1}", f"press_{index + 1}"
    size = f"{press.size_m:.9g} {press.size_m:.9g} {depth:.9g}"
    urdf = (
        f'<robot name="{part}"><link name="{part}_base"/><link name="{part}">'
        f'<collision><origin xyz="0 0 {0.5 * depth:.9g}"/><geometry><box size="{size}"/></geometry></collision></link>'
        f'<joint name="{joint}" type="prismatic"><parent link="{part}_base"/><child link="{part}"/>'
        f'<axis xyz="0 0 1"/><limit lower="0" upper="{press.travel_m + BEYOND_M:.9g}" velocity="1" effort="1000"/>'
        "</joint></robot>"
    )
    handle = MechanismHandleRequest(part, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), "tip", (0.0, 0.0, -OUT_M))
    return MechanismRequest(
        urdf,
        handle,
        (MoveRequest(joint, press.travel_m),),
        press.at,
        (w, i, j, k),
        {joint: MechanismJointRequest(friction=press.force_n)},
        hand=press.hand,
    )
