"""What a TrajOpt problem file says, as frozen data: no robot is known here, so names and lengths are unchecked.

Lengths in metres, angles in radians, quaternions as w x y z; steps count waypoints from 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Vector = tuple[float, ...]
ZEROS, ONES, UPRIGHT = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class BasicInfo:
    """``basic_info``.

    Attributes:
        n_steps: waypoints.
        manip: groups, joints, ``base`` or ``active``, joined by ``+``.
        is_start_fixed: whether the first waypoint stays where the robot starts.
        robot: name of the robot, "" if none.
        fixed_dofs: degrees of freedom (as counted in ``manip``) that stay at their start.
        fixed_steps: waypoints that stay where ``init_info`` puts them.
        fixed_dofs_key: what the file calls them.
    """

    n_steps: int
    manip: str
    is_start_fixed: bool
    robot: str = ""
    fixed_dofs: tuple[int, ...] = ()
    fixed_steps: tuple[int, ...] = ()
    fixed_dofs_key: str = "dofs_fixed"


@dataclass(frozen=True)
class InitInfo:
    """``init_info``: the trajectory to start from.

    Attributes:
        kind: all waypoints at the start, a straight line to ``endpoint``, or ``data``.
        endpoint: one number per degree of freedom.
        data: one row per waypoint.
        rate: steps per second that terms with ``use_time`` reckon with.
    """

    kind: Literal["stationary", "straight_line", "given_traj"]
    endpoint: Vector = ()
    data: tuple[Vector, ...] = ()
    rate: float = 1.0


@dataclass(frozen=True)
class Term:
    """One cost or constraint.

    Attributes:
        path: in the file, such as ``costs[2]``.
        name: its ``name``, else its type.
        is_cost: or else a constraint.
    """

    path: str
    name: str
    is_cost: bool

    @property
    def title(self) -> str:
        """Unique among the terms, for messages."""
        return f"{self.path} {self.name}"


@dataclass(frozen=True)
class PoseTerm(Term):
    """``pose``, ``cart_pose``, ``dynamic_cart_pose``: a frame (moved by an offset) at a pose in a reference.

    Attributes:
        frame: link or frame; ``frame_key`` is what the file calls it.
        step: waypoint.
        xyz, wxyz: the pose; in ``reference``, in the world if None.
        offset_xyz, offset_wxyz: of what is posed, in the frame.
        pos_coeffs, rot_coeffs: weights along and about the axes of the wanted pose; 0 leaves an axis free.
        turn_gain: how the original measures a small turn: by its angle (1), or by half of it (quaternion).
    """

    frame: str
    step: int
    xyz: Vector
    wxyz: Vector
    reference: str | None = None
    offset_xyz: Vector = ZEROS
    offset_wxyz: Vector = UPRIGHT
    pos_coeffs: Vector = ONES
    rot_coeffs: Vector = ONES
    turn_gain: float = 1.0
    frame_key: str = "link"
    reference_key: str = "target_frame"


@dataclass(frozen=True)
class JointTerm(Term):
    """``joint``, ``joint_pos``, ``joint_vel``, ``joint_acc``, ``joint_jerk``: joint values or their differences.

    Attributes:
        order: 0 for positions, 1, 2, 3 for differences from waypoint to waypoint.
        targets, coeffs: one number, or one per degree of freedom.
        lower_tols, upper_tols: likewise; how far below (<= 0) and above (>= 0) its target a value may lie.
        first, last: waypoints, inclusive.
        rate: factor of the differences' ``1 / dt``.
        targets_key: what the file calls them.
    """

    order: int
    targets: Vector
    coeffs: Vector
    lower_tols: Vector
    upper_tols: Vector
    first: int
    last: int
    rate: float = 1.0
    targets_key: str = "targets"

    @property
    def has_tolerance(self) -> bool:
        """Whether values may lie off their targets."""
        return any(self.lower_tols) or any(self.upper_tols)


@dataclass(frozen=True)
class JointStepTerm(Term):
    """``joint_vel_limits``: no joint moves by more than ``vals`` from waypoint to waypoint."""

    vals: Vector
    first: int
    last: int


@dataclass(frozen=True)
class CartVelTerm(Term):
    """``cart_vel``: a link's origin moves by at most ``limit`` along each axis from waypoint to waypoint [m]."""

    link: str
    first: int
    last: int
    limit: float


@dataclass(frozen=True)
class CollisionPair:
    """What is asked of single pairs of a collision term; ``coeffs`` and ``dist_pen`` as there."""

    path: str
    link: str
    others: tuple[str, ...]
    coeffs: Vector
    dist_pen: Vector


@dataclass(frozen=True)
class CollisionTerm(Term):
    """``collision``: pairs nearer than ``dist_pen`` are charged, or forbidden.

    Attributes:
        is_swept: between the waypoints, or only at them.
        first, last: waypoints, inclusive.
        coeffs, dist_pen: one number, or one per waypoint from first to last [1/m, m].
        pairs: exceptions.
    """

    is_swept: bool
    first: int
    last: int
    coeffs: Vector
    dist_pen: Vector
    pairs: tuple[CollisionPair, ...] = ()


@dataclass(frozen=True)
class ZmpTerm(Term):
    """``zmp``: the centre of mass is above the hull of the planted links' soles at a waypoint."""

    step: int
    links: tuple[str, ...]


@dataclass(frozen=True)
class FootHeightTerm(Term):
    """``foot_height``: a link's sole is at least ``height`` above the world's origin at a waypoint [m]."""

    step: int
    link: str
    height: float


@dataclass(frozen=True)
class OptInfo:
    """``opt_info``: settings of the optimiser by the names they have here, and the tolerance of constraints."""

    settings: Mapping[str, float] = field(default_factory=dict)
    tolerance: float = 1e-4


@dataclass(frozen=True)
class Problem:
    """A whole file.

    Attributes:
        basic, init, opt: its sections.
        terms: costs first.
        notes: what was read and has no bearing here.
    """

    basic: BasicInfo
    init: InitInfo
    opt: OptInfo
    terms: tuple[Term, ...]
    notes: tuple[str, ...] = ()
