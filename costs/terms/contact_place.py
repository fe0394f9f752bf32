"""Places of contact points: planted, on a plane, inside the edges of a patch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from costs.contact_points import MovedPoints
from costs.kinematics import Kinematics, locate_frame
from costs.robot.model import RobotModel
from costs.state import MotionState
from costs.terms.pose import make_waypoint_rows
from scopt import AffineRows, Residual


class ContactPlace(Residual[MotionState]):
    """Points of a link along directions of the world or of a mechanism's link, one row per point and direction [m].

    Row ``(i, r)`` is ``direction_r . p_i - offset_ir``.  As an equality ``at`` plants the points and ``on_plane`` keeps
    them on a plane; as an inequality ``inside`` keeps them within a patch.
    """

    is_smooth = True

    def __init__(
        self,
        robot: RobotModel,
        link: str,
        points: Float[np.ndarray, "C 3"],
        waypoints: Int[np.ndarray, "S"] | Sequence[int],
        directions: Float[np.ndarray, "R 3"],
        offsets: Float[np.ndarray, "#C R"],
        reference: str | None = None,
    ) -> None:
        """
        Args:
            link: that touches.
            points: (C, 3) in the link's frame [m].
            waypoints: (S,) where the rows are measured.
            directions: (R, 3) in the reference.
            offsets: (C, R) or (R,) [m].
            reference: link that the places are given in; the world if None.

        Raises:
            KeyError: the robot has no such link.
        """
        points = np.asarray(points, dtype=float)
        self._points = MovedPoints.on_links(robot, [link] * len(points), points)
        self._waypoints = np.asarray(waypoints)
        self._directions = np.asarray(directions, dtype=float)
        self._offsets = np.broadcast_to(offsets, (len(points), len(self._directions)))
        self._reference: int = 0
        self._pose: Float[np.ndarray, "4 4"] = np.eye(4)
        if reference is not None:
            self._reference, self._pose = locate_frame(robot, reference)

    @staticmethod
    def at(
        robot: RobotModel,
        link: str,
        points: Float[np.ndarray, "C 3"],
        waypoints: Int[np.ndarray, "S"] | Sequence[int],
        places: Float[np.ndarray, "C 3"],
        reference: str | None = None,
    ) -> ContactPlace:
        """Return the offsets of points from their places, three rows per point; an equality plants them."""
        return ContactPlace(robot, link, points, waypoints, np.eye(3), places, reference)

    @staticmethod
    def on_plane(
        robot: RobotModel,
        link: str,
        points: Float[np.ndarray, "C 3"],
        waypoints: Int[np.ndarray, "S"] | Sequence[int],
        normal: Float[np.ndarray, "3"],
        offset: float,
        reference: str | None = None,
    ) -> ContactPlace:
        """Return the heights of points above the plane ``normal . p = offset``, ``normal`` of unit length."""
        return ContactPlace(robot, link, points, waypoints, np.asarray(normal)[None], np.array([offset]), reference)

    @staticmethod
    def inside(
        robot: RobotModel,
        link: str,
        points: Float[np.ndarray, "C 3"],
        waypoints: Int[np.ndarray, "S"] | Sequence[int],
        normals: Float[np.ndarray, "E 3"],
        offsets: Float[np.ndarray, "E"],
        reference: str | None = None,
    ) -> ContactPlace:
        """Return how far points are beyond the edges ``normal . p <= offset`` of a patch, for an inequality."""
        return ContactPlace(robot, link, points, waypoints, normals, offsets, reference)

    def value(self, state: MotionState) -> Float[np.ndarray, "m"]:
        kinematics = state.kinematics
        directions, origin = self._place_directions(kinematics)
        places = self._points.locate(kinematics, self._waypoints)
        along = np.einsum("srk,sck->scr", directions, places - origin[:, None])
        return np.asarray((along - self._offsets).ravel())

    def linearize(self, state: MotionState) -> AffineRows:
        kinematics, here = state.kinematics, self._waypoints
        directions, _ = self._place_directions(kinematics)
        moves = self._points.differentiate(kinematics, here)
        if self._reference:
            places = self._points.locate(kinematics, here)
            count = places.shape[1]
            carried = kinematics.point_jacobian(
                np.repeat(here, count), np.full(len(here) * count, self._reference), places.reshape(-1, 3)
            )
            moves = moves - carried.reshape(moves.shape)
        rows = np.einsum("srk,sckn->scrn", directions, moves)
        return make_waypoint_rows(self.value(state), rows.reshape(len(here), -1, moves.shape[3]), here, kinematics)

    def _place_directions(self, kinematics: Kinematics) -> tuple[Float[np.ndarray, "S R 3"], Float[np.ndarray, "S 3"]]:
        """Return the directions in the world and the origin of the reference."""
        rotation = kinematics.rotation[self._waypoints, self._reference]
        origin = rotation @ self._pose[:3, 3] + kinematics.position[self._waypoints, self._reference]
        return np.einsum("skl,rl->srk", rotation @ self._pose[:3, :3], self._directions), origin
