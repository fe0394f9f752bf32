"""Contact forces that balance the robot and what it moves, inside their friction pyramids."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int

from costs.contact_points import DOWN, ContactPoints, Load, Loads, measure_weight
from costs.kinematics import Topology
from costs.robot.model import RobotModel
from costs.rotation import skew
from costs.state import LoadedState
from costs.terms.pose import make_waypoint_rows
from scopt import AffineRows, Residual


class Equilibrium(Residual[LoadedState]):
    """Force and moment that are missing for static equilibrium, six rows per waypoint [weight, weight times m].

    ``sum f_i + w`` and ``sum p_i x f_i + c x w`` with the weight ``w = (0, 0, -1)`` at the centre of mass ``c`` and the
    given loads added: the six rows of the base in eq. 1 of Liu et al., Humanoids 2015, as forces and moments in the
    world.  Contacts with links of a mechanism count like all others; see ``MechanismBalance``.
    """

    is_smooth = True

    def __init__(
        self,
        robot: RobotModel,
        points: ContactPoints,
        waypoints: Int[np.ndarray, "S"] | Sequence[int],
        loads: Sequence[Load] = (),
        about: Float[np.ndarray, "3"] | None = None,
    ) -> None:
        """
        Args:
            points: of the contacts, in the order of the state's forces.
            waypoints: (S,) where the rows are measured.
            loads: that act at all these waypoints.
            about: (3,) point in the world about which moments are taken, best near the robot; the origin if None.
        """
        self._points = points
        self._waypoints = np.asarray(waypoints)
        self._loads = Loads.of(robot, loads)
        self._about = np.zeros(3) if about is None else np.asarray(about, dtype=float)

    def value(self, state: LoadedState) -> Float[np.ndarray, "m"]:
        kinematics, here = state.kinematics, self._waypoints
        places, forces = self._gather(state)
        force = forces.sum(axis=1) + DOWN
        moment = np.cross(places - self._about, forces).sum(axis=1) + self._loads.moment.sum(axis=0)
        moment = moment + np.cross(kinematics.com[here] - self._about, DOWN)
        return np.concatenate([force, moment], axis=1).ravel()

    def linearize(self, state: LoadedState) -> AffineRows:
        kinematics, here, n_points = state.kinematics, self._waypoints, len(self._points)
        places, forces = self._gather(state)
        moves = np.concatenate(
            [
                self._points.places.differentiate(kinematics, here),
                self._loads.points.differentiate(kinematics, here),
            ],
            axis=1,
        )
        n = moves.shape[3]
        rows = np.zeros((len(here), 6, n + 3 * n_points))
        rows[:, 3:, :n] = -np.einsum("sckl,scln->skn", _skew(forces), moves)
        rows[:, 3:, :n] -= skew(DOWN[None]) @ kinematics.com_jacobian[here]
        rows[:, :3, n:] = np.tile(np.eye(3), n_points)
        levers = _skew(places[:, :n_points] - self._about)
        rows[:, 3:, n:] = levers.transpose(0, 2, 1, 3).reshape(len(here), 3, -1)
        return make_waypoint_rows(self.value(state), rows, here, kinematics)

    def _gather(self, state: LoadedState) -> tuple[Float[np.ndarray, "S A 3"], Float[np.ndarray, "S A 3"]]:
        """Return points and forces of the contacts, then of the loads."""
        kinematics, here = state.kinematics, self._waypoints
        places = [self._points.places.locate(kinematics, here), self._loads.points.locate(kinematics, here)]
        given = np.broadcast_to(self._loads.force, (len(here), *self._loads.force.shape))
        return np.concatenate(places, axis=1), np.concatenate([state.forces[here], given], axis=1)


class FrictionPyramid(Residual[LoadedState]):
    """Distance of contact forces outside their friction pyramids and caps, five rows per point [robot's weight].

    The pyramid has four edges on the cone and four sides inside it: ``t . f - mu / sqrt 2  n . f`` for the directions
    ``t`` halfway between the edges.  The fifth row is ``n . f - cap``; a point without friction has a sixth,
    ``-n . f``.  A force may err by ``margin`` in any direction without leaving pyramid and cap, along its normal if it
    has no friction.  Normals that turn with their links enter the derivative.
    """

    is_smooth = True

    def __init__(
        self, points: ContactPoints, waypoints: Int[np.ndarray, "S"] | Sequence[int], margin: float = 0.0
    ) -> None:
        """
        Args:
            points: of the contacts, in the order of the state's forces.
            waypoints: (S,) where the rows are measured.
            margin: distance inside [robot's weight].
        """
        self._points = points
        self._waypoints = np.asarray(waypoints)
        self.point, self._face, offset, self.length = list_faces(points)
        self._offset = offset + margin * self.length

    def value(self, state: LoadedState) -> Float[np.ndarray, "m"]:
        faces = self._points.turn(state.kinematics, self._waypoints, self.point, self._face)
        forces = state.forces[self._waypoints][:, self.point]
        return np.asarray((np.einsum("srk,srk->sr", faces, forces) + self._offset).ravel())

    def linearize(self, state: LoadedState) -> AffineRows:
        kinematics, here = state.kinematics, self._waypoints
        faces = self._points.turn(kinematics, here, self.point, self._face)
        forces = state.forces[here][:, self.point]
        n, n_rows = kinematics.q.shape[1], len(self.point)
        rows = np.zeros((len(here), n_rows, n + 3 * len(self._points)))
        # A face a that turns with w dq: (w x a) . f = w . (a x f).
        axes = kinematics.jacobian[here, 3:]
        carried = kinematics.topology.moves[self._points.normal_joint[self.point]]
        turned = np.einsum("srk,skn->srn", np.cross(faces, forces), axes) * carried
        rows[:, :, :n] = kinematics.topology.add_followers(turned)
        columns = n + 3 * self.point[:, None] + np.arange(3)
        rows[:, np.arange(n_rows)[:, None], columns] = faces
        return make_waypoint_rows(self.value(state), rows, here, kinematics)


def list_faces(
    points: ContactPoints,
) -> tuple[Int[np.ndarray, "R"], Float[np.ndarray, "R 3"], Float[np.ndarray, "R"], Float[np.ndarray, "R"]]:
    """List the faces of pyramids and caps: a force is inside where ``face . f + offset <= 0``.

    Returns:
        point: (R,) whose force is meant.
        face: (R, 3) where the point's normal is given.
        offset: (R,) [robot's weight].
        length: (R,) of the faces; 0 where they leave no force any room: sides without friction, points without a cap.
    """
    point, face, offset, has_room = [], [], [], []
    across = np.cross(points.normal, points.tangent)
    for i, (normal, friction, cap) in enumerate(zip(points.normal, points.friction, points.cap, strict=True)):
        # Sides halfway between the edges, which lean to the tangent and across it.
        sides = [
            (along * points.tangent[i] + aside * across[i] - friction * normal) / np.sqrt(2.0)
            for along in (1.0, -1.0)
            for aside in (1.0, -1.0)
        ]
        bottom = [] if friction > 0.0 else [-normal]
        own = [*sides, *bottom, normal]
        face += own
        has_room += [min(friction, cap) > 0.0] * 4 + [cap > 0.0] * (len(own) - 4)
        offset += [0.0] * (len(own) - 1) + [-cap]
        point += [i] * len(own)
    faces = np.array(face).reshape(-1, 3)
    return np.array(point, dtype=int), faces, np.array(offset), np.linalg.norm(faces, axis=1) * has_room


class ContactForce(Residual[LoadedState]):
    """``gain (f - target)``, three rows (world axes) per contact point and waypoint [gain times robot's weight]."""

    is_smooth = True

    def __init__(
        self,
        points: ContactPoints,
        waypoints: Int[np.ndarray, "S"] | Sequence[int],
        target: Float[np.ndarray, "#C 3"] | None = None,
        gain: Float[np.ndarray, "C"] | float = 1.0,
    ) -> None:
        """
        Args:
            points: of the contacts, in the order of the state's forces.
            waypoints: (S,) where the rows are measured.
            target: (C, 3) [robot's weight]; no force if None.
            gain: per point.
        """
        self._waypoints = np.asarray(waypoints)
        self._target = np.zeros((len(points), 3)) if target is None else np.asarray(target, dtype=float)
        self._gain = np.broadcast_to(gain, (len(points),))[:, None]

    def value(self, state: LoadedState) -> Float[np.ndarray, "m"]:
        return np.asarray((self._gain * (state.forces[self._waypoints] - self._target)).ravel())

    def linearize(self, state: LoadedState) -> AffineRows:
        n, n_rows = state.motion.x.shape[1], 3 * len(self._gain)
        rows = np.zeros((len(self._waypoints), n_rows, n + n_rows))
        rows[:, np.arange(n_rows), n + np.arange(n_rows)] = np.repeat(self._gain[:, 0], 3)
        return make_waypoint_rows(self.value(state), rows, self._waypoints, state.kinematics)


class MechanismBalance(Residual[LoadedState]):
    """Load on a mechanism's coordinates that contacts leave unbalanced, one row per coordinate and waypoint [weight m].

    ``-sum S_k . (f_i, p_i x f_i) - load_k`` over the contacts with links of the mechanism: what the robot pushes along
    coordinate ``k`` is the load, so that a free leaf or wheel supports nobody.  Mechanisms have no mass.
    """

    is_smooth = False  # measured on columns of the Jacobian

    def __init__(
        self,
        robot: RobotModel,
        points: ContactPoints,
        waypoints: Int[np.ndarray, "S"] | Sequence[int],
        loads: Mapping[str, float] | None = None,
    ) -> None:
        """
        Args:
            points: of the contacts, in the order of the state's forces.
            waypoints: (S,) where the rows are measured.
            loads: by joint name: what the robot has to exert along it [N m, N]; 0 if not given.

        Raises:
            KeyError: a load of a joint that no contact moves.
        """
        self._points = points
        self._waypoints = np.asarray(waypoints)
        self._touching = np.flatnonzero(points.reference_joint)
        topology = Topology.of(robot.model)
        moves = topology.moves[points.reference_joint[self._touching]]
        self._axes = np.flatnonzero(moves.any(axis=0))  # of a mechanism, where no joint follows another
        self._coordinates = topology.coordinate[self._axes]
        self._moves = moves[:, self._axes].astype(float)
        names = [robot.joint_names[k] for k in self._coordinates]
        given = {} if loads is None else loads
        unknown = sorted(set(given) - set(names))
        if unknown:
            raise KeyError(f"no contact moves '{unknown[0]}'; joints that contacts move: {', '.join(names) or 'none'}")
        self._load = np.array([given.get(name, 0.0) for name in names]) / measure_weight(robot)

    def value(self, state: LoadedState) -> Float[np.ndarray, "m"]:
        wrench = self._wrench(state)[0]
        columns = state.kinematics.jacobian[self._waypoints][:, :, self._axes]
        pushed = -np.einsum("sck,skm,cm->sm", wrench, columns, self._moves)
        return np.asarray((pushed - self._load).ravel())

    def linearize(self, state: LoadedState) -> AffineRows:
        kinematics, here = state.kinematics, self._waypoints
        n, n_points, n_rows = kinematics.q.shape[1], len(self._points), len(self._coordinates)
        rows = np.zeros((len(here), n_rows, n + 3 * n_points))
        if not n_rows:
            return make_waypoint_rows(self.value(state), rows, here, kinematics)
        wrench, places, forces = self._wrench(state)
        columns = kinematics.jacobian[here][:, :, self._axes]
        linear, angular = columns[:, :3], columns[:, 3:]
        moves = self._points.places.differentiate(kinematics, here)[:, self._touching]
        # The point moves: -w_k . (dp x f) = -(f x w_k) . dp.
        turned = np.cross(forces[:, :, None], angular.transpose(0, 2, 1)[:, None]) * self._moves[:, :, None]
        rows[:, :, :n] = -np.einsum("scmk,sckn->smn", turned, moves)
        # Column k moves with a coordinate j before it: dS_k = S_j x S_k.
        total = np.einsum("sck,cm->smk", wrench, self._moves)
        v, w = linear.transpose(0, 2, 1), angular.transpose(0, 2, 1)
        d_linear = np.cross(w[:, None], v[:, :, None]) + np.cross(v[:, None], w[:, :, None])
        change = np.concatenate([d_linear, np.cross(w[:, None], w[:, :, None])], axis=3)  # (S, row k, column j, 6)
        carried = kinematics.topology.precedes[np.ix_(self._axes, self._axes)].T
        rows[:, :, self._coordinates] -= np.einsum("skjm,skm->skj", change, total) * carried
        at_points = linear[:, None] + np.cross(angular[:, None], places[..., None], axis=2)  # (S, c, 3, rows)
        for c, point in enumerate(self._touching):
            force_columns = slice(n + 3 * point, n + 3 * point + 3)
            rows[:, :, force_columns] = -(at_points[:, c] * self._moves[c]).transpose(0, 2, 1)
        return make_waypoint_rows(self.value(state), rows, here, kinematics)

    def _wrench(
        self, state: LoadedState
    ) -> tuple[Float[np.ndarray, "S c 6"], Float[np.ndarray, "S c 3"], Float[np.ndarray, "S c 3"]]:
        """Return the wrenches about the origin, points and forces of the contacts with the mechanism."""
        places = self._points.places.locate(state.kinematics, self._waypoints)[:, self._touching]
        forces = state.forces[self._waypoints][:, self._touching]
        return np.concatenate([forces, np.cross(places, forces)], axis=2), places, forces


def _skew(v: Float[np.ndarray, "S C 3"]) -> Float[np.ndarray, "S C 3 3"]:
    """Return the cross-product matrix of every vector."""
    return skew(v.reshape(-1, 3)).reshape(*v.shape, 3)
