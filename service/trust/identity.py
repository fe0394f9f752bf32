"""Who calls, and which roles the RPCs need."""

from __future__ import annotations

from collections.abc import Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType


class Role(StrEnum):
    """What an identity may do; none includes another."""

    PLAN = "plan"
    REVIEW = "review"
    ADMIN = "admin"


@dataclass(frozen=True)
class Identity:
    """A client that is known by its token or its certificate."""

    name: str
    roles: frozenset[Role]


@dataclass(frozen=True)
class Caller:
    """Who made the call that is being answered.

    Attributes:
        identity: None for calls that need none.
        key: what its limits are counted under: the identity's name, or else the peer's address.
    """

    identity: Identity | None
    key: str

    @property
    def name(self) -> str:
        """Of the identity; the key of a caller without one."""
        return self.key if self.identity is None else self.identity.name


# Where nobody has to say who they are, everybody is this one.
LOCAL = Identity("local", frozenset(Role))

_PLANNER = "/planner.v1.PlannerService"
_REFLECTION = "/grpc.reflection.v1{}.ServerReflection/ServerReflectionInfo"

# A probe has no token, and learns only whether the server serves.
OPEN_TO_ALL = frozenset({"/grpc.health.v1.Health/Check"})

# A watch holds a place, and reflection tells what there is: both need a role wherever roles are given. What is listed
# nowhere nobody may call.
# Any one of those that stand with a method will do; who reviews a plan must see it.
ROLE_NEEDED: Mapping[str, tuple[Role, ...]] = MappingProxyType(
    {
        f"{_PLANNER}/Plan": (Role.PLAN,),
        f"{_PLANNER}/UploadCloud": (Role.PLAN,),
        f"{_PLANNER}/BuildScene": (Role.PLAN,),
        f"{_PLANNER}/GetScene": (Role.PLAN, Role.REVIEW),
        f"{_PLANNER}/Detect": (Role.PLAN,),
        f"{_PLANNER}/Verify": (Role.PLAN, Role.REVIEW),
        f"{_PLANNER}/ListRobots": (Role.PLAN,),
        f"{_PLANNER}/GetPlan": (Role.PLAN, Role.REVIEW),
        f"{_PLANNER}/ReviewPlan": (Role.REVIEW,),
        f"{_PLANNER}/GetStatus": (Role.ADMIN,),
        "/grpc.health.v1.Health/List": (Role.PLAN,),
        "/grpc.health.v1.Health/Watch": (Role.PLAN,),
        _REFLECTION.format(""): (Role.PLAN,),
        _REFLECTION.format("alpha"): (Role.PLAN,),
    }
)

_CALLER: ContextVar[Caller] = ContextVar("caller")


def current_caller() -> Caller:
    """Who made the call that this task answers.

    Raises:
        LookupError: the call came in without a gate.
    """
    return _CALLER.get()
