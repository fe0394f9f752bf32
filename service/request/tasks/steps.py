"""Section of a request that lists steps: motions of hands and body, paths on faces, presses, and where a plan ends."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass as plain_dataclass
from types import MappingProxyType
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass
from pydantic_core import PydanticCustomError

from service.request.fields import (
    SECTION,
    Coordinate,
    Label,
    Number,
    Point,
    Section,
    at_most,
    require_exactly_one,
)
from service.request.tasks.contacts import ContactsRequest
from service.request.tasks.hand_steps import (
    Degrees,
    FollowStep,
    MoveStep,
    PressStep,
    ScrewStep,
    Seconds,
    Shift,
    TouchStep,
)
from service.request.tasks.kind import MovedNames, TaskSection
from service.request.tasks.mechanism import MECHANISM, MechanismRequest
from service.request.tasks.step_objects import FitStep, GraspStep, HoldStep, ReleaseStep

MAX_STEPS = 64
ENDING = ("wait", "check", "look")
"""Steps at which a plan ends, and goes on from the state that is reached by then."""


@dataclass(config=SECTION)
class BodyStep(Section):
    """A motion of the body on its feet.

    Attributes:
        pelvis_m: translation of the pelvis in the world [m].
        pelvis_rpy_deg, torso_rpy_deg: turn of pelvis and torso about x, then y, then z of the world [deg].
        hands: whether the hands stay in the world or move along with the torso.
        duration_s: of the step.
    """

    pelvis_m: tuple[Shift, Shift, Shift] = (0.0, 0.0, 0.0)
    pelvis_rpy_deg: tuple[Degrees, Degrees, Degrees] = (0.0, 0.0, 0.0)
    torso_rpy_deg: tuple[Degrees, Degrees, Degrees] = (0.0, 0.0, 0.0)
    hands: Literal["stay", "along"] = "stay"
    duration_s: Seconds | None = None

    def __post_init__(self) -> None:
        if not any((*self.pelvis_m, *self.pelvis_rpy_deg, *self.torso_rpy_deg)):
            raise PydanticCustomError("body", "nothing moves; expected pelvis_m, pelvis_rpy_deg or torso_rpy_deg")


@dataclass(config=SECTION)
class WalkStep(Section):
    """Footsteps straight to a place on a level floor.

    Attributes:
        to: x and y of the middle between the feet at the end [m].
        yaw_deg: heading at the end; by default the one of the beginning [deg].
        stride_m: by which a foot goes at most [m].
        finish: posture to end in, as far as the feet allow.
    """

    to: tuple[Coordinate, Coordinate]
    yaw_deg: Degrees | None = None
    stride_m: Annotated[Number, Field(ge=0.05, le=0.5)] = 0.2
    finish: Label | None = None


@dataclass(config=SECTION)
class StepRequest(Section):
    """One step, in the field of its kind.

    Attributes:
        name: as messages and phases have it; by default its number and kind.
        wait, check, look: what the operator does, what is checked, and what is looked at: the plan ends before it.
    """

    name: Label | None = None
    move: MoveStep | None = None
    screw: ScrewStep | None = None
    follow: FollowStep | None = None
    touch: TouchStep | None = None
    press: PressStep | None = None
    mechanism: MechanismRequest | None = None
    body: BodyStep | None = None
    hold: HoldStep | None = None
    grasp: GraspStep | None = None
    release: ReleaseStep | None = None
    insert: FitStep | None = None
    withdraw: FitStep | None = None
    walk: WalkStep | None = None
    contacts: ContactsRequest | None = None
    wait: Label | None = None
    check: Label | None = None
    look: Label | None = None

    def __post_init__(self) -> None:
        require_exactly_one(self, STEP_KINDS)

    @property
    def kind(self) -> str:
        """The field that is given."""
        return next(kind for kind in STEP_KINDS if getattr(self, kind) is not None)

    @property
    def changes_contacts(self) -> bool:
        """Whether the robot changes what it stands on."""
        return self.walk is not None or self.contacts is not None

    @property
    def taken(self) -> GraspStep | HoldStep | None:
        """What a hand takes, or has taken."""
        return self.grasp or self.hold

    @property
    def fit(self) -> FitStep | None:
        """What goes into a hole or out of it."""
        return self.insert or self.withdraw


STEP_KINDS = (
    "move",
    "screw",
    "follow",
    "touch",
    "press",
    "mechanism",
    "body",
    "hold",
    "grasp",
    "release",
    "insert",
    "withdraw",
    "walk",
    "contacts",
    *ENDING,
)
Steps = Annotated[tuple[StepRequest, ...], at_most(MAX_STEPS)]


@plain_dataclass(frozen=True)
class StepsSection(TaskSection):
    """Steps one after the other.

    Attributes:
        steps: of the request.
    """

    steps: tuple[StepRequest, ...]
    effort_s = 120.0

    @property
    def names(self) -> Mapping[int, str]:
        """Name of each step by its index."""
        named = {k: step.name or f"{k + 1} {step.kind}" for k, step in enumerate(self.steps)}
        return MappingProxyType(named)

    @property
    def can_resume(self) -> bool:
        """No: the steps that are left are a request of their own."""
        return False

    @property
    def carried(self) -> tuple[str, ...]:
        """The objects that a step takes, or holds from the beginning."""
        return tuple(dict.fromkeys(step.taken.object for step in self.steps if step.taken is not None))

    @property
    def moved_names(self) -> MovedNames | None:
        """What hands push, where a step does."""
        return MovedNames(MECHANISM) if any(step.mechanism or step.press for step in self.steps) else None

    def list_points(self) -> Iterator[tuple[str, Point | None]]:
        """Yield the positions of all steps."""
        for k, step in enumerate(self.steps):
            if step.move is not None:
                for number, pose in enumerate(step.move.poses):
                    yield f"[{k}].move.poses[{number}].position", pose.position
                if step.move.arc is not None:
                    yield f"[{k}].move.arc.centre", step.move.arc.centre
            elif step.screw is not None:
                yield f"[{k}].screw.centre", step.screw.centre
            elif step.follow is not None:
                yield f"[{k}].follow.face.point", step.follow.face.point
            elif step.fit is not None:
                yield f"[{k}].{step.kind}.at", step.fit.at
            elif step.press is not None:
                yield f"[{k}].press.at", step.press.at
            elif step.mechanism is not None:
                yield f"[{k}].mechanism.position", step.mechanism.position

    def list_paths(self) -> Iterator[tuple[str, str]]:
        """Yield the URDFs that steps name."""
        for k, step in enumerate(self.steps):
            if step.mechanism is not None:
                for field_name, path in step.mechanism.list_paths():
                    yield f"[{k}].mechanism.{field_name}", path
