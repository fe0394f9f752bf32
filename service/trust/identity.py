"""Identities of callers, and the roles that RPCs need."""

from __future__ import annotations

from collections.abc import Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType


class Role(StrEnum):
    """Permission of an identity; no role includes another."""

    PLAN = "plan"
    REVIEW = "review"
    EXECUTE = "execute"  # have the robot carry out a plan
    COMMAND = "command"  # control of the robot, and orders to it
    ADMIN = "admin"


@dataclass(frozen=True)
class Identity:
    """A client known by its token or certificate."""

    name: str
    roles: frozenset[Role]


@dataclass(frozen=True)
class Caller:
    """The caller of an RPC.

    Attributes:
        identity: None for calls that need none.
        key: key of its limits: the identity's name, or the peer's address.
        connection: address and port of the peer.
    """

    identity: Identity | None
    key: str
    connection: str = ""

    @property
    def name(self) -> str:
        """Name of the identity; the key without one."""
        return self.key if self.identity is None else self.identity.name

    @property
    def owner(self) -> str:
        """Whose work it is, among which workers are shared: the identity's, or without tokens the connection's."""
        return (self.connection or self.key) if self.identity in (None, LOCAL) else self.name


# Identity of every caller of a server without tokens.
LOCAL = Identity("local", frozenset(Role))

_PLANNER = "/planner.v1.PlannerService"
_REFLECTION = "/grpc.reflection.v1{}.ServerReflection/ServerReflectionInfo"

# A probe has no token, and learns only whether the server is serving.
OPEN_TO_ALL = frozenset({"/grpc.health.v1.Health/Check"})

# Any of a method's roles is sufficient. A watch occupies a call and reflection lists the methods, so both need a role.
# Nobody may call a method that is not listed.
ROLE_NEEDED: Mapping[str, tuple[Role, ...]] = MappingProxyType(
    {
        f"{_PLANNER}/Plan": (Role.PLAN,),
        f"{_PLANNER}/UploadCloud": (Role.PLAN,),
        f"{_PLANNER}/BuildScene": (Role.PLAN,),
        f"{_PLANNER}/GetScene": (Role.PLAN, Role.REVIEW),
        f"{_PLANNER}/Detect": (Role.PLAN,),
        f"{_PLANNER}/Verify": (Role.PLAN, Role.REVIEW),
        f"{_PLANNER}/SimulatePlan": (Role.PLAN, Role.REVIEW),
        f"{_PLANNER}/ListRobots": (Role.PLAN,),
        f"{_PLANNER}/GetPlan": (Role.PLAN, Role.REVIEW),
        f"{_PLANNER}/ListPlans": (Role.PLAN, Role.REVIEW, Role.EXECUTE),
        f"{_PLANNER}/ListScenes": (Role.PLAN, Role.REVIEW),
        f"{_PLANNER}/ReviewPlan": (Role.REVIEW,),
        f"{_PLANNER}/PoseSession": (Role.PLAN,),
        f"{_PLANNER}/Execute": (Role.EXECUTE,),
        f"{_PLANNER}/Command": (Role.COMMAND,),
        f"{_PLANNER}/Watch": (Role.EXECUTE, Role.COMMAND, Role.REVIEW),
        f"{_PLANNER}/GetStatus": (Role.ADMIN,),
        "/grpc.health.v1.Health/List": (Role.PLAN,),
        "/grpc.health.v1.Health/Watch": (Role.PLAN,),
        _REFLECTION.format(""): (Role.PLAN,),
        _REFLECTION.format("alpha"): (Role.PLAN,),
    }
)

_CALLER: ContextVar[Caller] = ContextVar("caller")


def set_caller(caller: Caller) -> None:
    """Set the caller of the RPC that this task answers."""
    _CALLER.set(caller)


def current_caller() -> Caller:
    """Return the caller of the RPC that this task answers.

    Raises:
        LookupError: the call did not pass access control.
    """
    return _CALLER.get()
