"""Content of a TrajOpt problem file as frozen data; link names and list lengths are not yet checked against a robot.

Lengths in metres, angles in radians, quaternions as w x y z; steps count waypoints from 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float

from costs.rotation import quaternion_matrix

Vector = tuple[float, ...]
ZEROS, ONES, UPRIGHT = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class BasicInfo:
    """``basic_info``.

    Attributes:
        n_steps: number of waypoints.
        manip: groups, joints, ``base`` or ``active``, joined by ``+``.
        is_start_fixed: whether the first waypoint stays at the robot's start.
        robot: name of the robot, or "".
        fixed_dofs: degrees of freedom (indices into ``manip``'s) that keep their start value.
        fixed_steps: waypoints that keep their value of ``init_info``.
        fixed_dofs_key: key of ``fixed_dofs`` in the file.
        is_step_fixed: whether the file lists the first waypoint among the fixed ones.
    """

    n_steps: int
    manip: str
    is_start_fixed: bool
    robot: str = ""
    fixed_dofs: tuple[int, ...] = ()
    fixed_steps: tuple[int, ...] = ()
    fixed_dofs_key: str = "dofs_fixed"
    is_step_fixed: bool = False


@dataclass(frozen=True)
class InitInfo:
    """``init_info``: the initial trajectory.

    Attributes:
        kind: all waypoints at the start, a straight line to ``endpoint``, or ``data``.
        endpoint: one number per degree of freedom.
        data: one row per waypoint.
        rate: steps per second, for terms with ``use_time``.
    """

    kind: Literal["stationary", "straight_line", "given_traj"]
    endpoint: Vector = ()
    data: tuple[Vector, ...] = ()
    rate: float = 1.0


@dataclass(frozen=True)
class Term:
    """One cost or constraint.

    Attributes:
        path: JSON path, such as ``costs[2]``.
        name: value of ``name`` in the file, by default the type.
        is_cost: false for a constraint.
    """

    path: str
    name: str
    is_cost: bool

    @property
    def title(self) -> str:
        """Name for messages, unique among the terms."""
        return f"{self.path} {self.name}"


@dataclass(frozen=True)
class PoseTerm(Term):
    """``pose``, ``cart_pose``, ``dynamic_cart_pose``: target pose of a frame, or of a pose fixed in that frame.

    Attributes:
        frame: link or frame.
        step: waypoint.
        xyz, wxyz: target pose in ``reference``, in the world if None.
        offset_xyz, offset_wxyz: pose in ``frame`` that has to reach the target.
        pos_coeffs, rot_coeffs: weights along and about the axes of the target pose; 0 leaves an axis free.
        turn_gain: weight of a small rotation's angle in the original: 1, or 0.5 where it measures by quaternion.
        frame_key, reference_key: keys of ``frame`` and ``reference`` in the file.
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

    @property
    def target(self) -> Float[np.ndarray, "4 4"]:
        """Target pose as a matrix."""
        return _make_matrix(self.xyz, self.wxyz)

    @property
    def offset(self) -> Float[np.ndarray, "4 4"]:
        """Offset as a matrix."""
        return _make_matrix(self.offset_xyz, self.offset_wxyz)

    @property
    def position_axes(self) -> tuple[bool, bool, bool]:
        """Constrained directions of the target's axes."""
        x, y, z = (c > 0.0 for c in self.pos_coeffs)
        return x, y, z

    @property
    def rotation_axes(self) -> tuple[bool, bool, bool]:
        """Constrained rotations about the target's axes."""
        x, y, z = (c > 0.0 for c in self.rot_coeffs)
        return x, y, z


@dataclass(frozen=True)
class JointTerm(Term):
    """``joint``, ``joint_pos``, ``joint_vel``, ``joint_acc``, ``joint_jerk``: joint values or their differences.

    Attributes:
        order: 0 for joint values; 1, 2, 3 for their first to third differences between waypoints.
        targets, coeffs: one number, or one per degree of freedom.
        lower_tols, upper_tols: likewise; allowed deviation below (<= 0) and above (>= 0) the target.
        first, last: waypoints, inclusive.
        rate: ``1 / dt`` of the differences.
        targets_key: key of ``targets`` in the file.
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
        """Whether values may deviate from their targets."""
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
    """Exception of a collision term for the pairs of ``link`` with each of ``others``."""

    path: str
    link: str
    others: tuple[str, ...]
    coeffs: Vector
    dist_pen: Vector


@dataclass(frozen=True)
class CollisionTerm(Term):
    """``collision``: a cost or constraint on pairs nearer than ``dist_pen``.

    Attributes:
        is_swept: whether the motion between the waypoints counts, too.
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
    """``opt_info``: settings by the field names of ``scopt.Settings``, and the tolerance of constraints."""

    settings: Mapping[str, float] = field(default_factory=dict)
    tolerance: float = 1e-4


@dataclass(frozen=True)
class ProblemFile:
    """A whole file.

    Attributes:
        basic, init, opt: the sections.
        terms: costs first.
        notes: one line per setting of the file that has no effect.
    """

    basic: BasicInfo
    init: InitInfo
    opt: OptInfo
    terms: tuple[Term, ...]
    notes: tuple[str, ...] = ()


def _make_matrix(xyz: Vector, wxyz: Vector) -> Float[np.ndarray, "4 4"]:
    """Return a pose as a matrix; the quaternion is normalised."""
    matrix = np.eye(4)
    matrix[:3, :3] = quaternion_matrix(wxyz)
    matrix[:3, 3] = xyz
    return matrix
