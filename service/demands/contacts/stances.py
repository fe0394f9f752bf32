"""Stances of a multi-contact task as data: surfaces of the world, and patches of the robot planted on them.

A stance is a set of contacts that carry the robot together (Hauser et al., IJRR 2008). Between two stances the robot
stands on the contacts that both have at the same place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from costs.contact import Contact
from costs.primitive import Primitive, find_round_normals
from costs.robot import RobotModel
from costs.scene import ConvexPiece
from service.verify import STANDING_DEPTH_M, TURNING_DEPTH_M, PlantedContact

LEAST_FACING = 0.5  # cosine between a surface's normal and that of the round shape behind it
INSIDE_M = 5e-4  # from the edges of a place that was brought onto a surface
SAME_PLACE_M = 1e-9  # of contact points that are kept
KEPT_TOLERANCE_M = 1e-4  # of a contact point that stays where it is
SAME_EDGE_M = 1e-6  # difference of edges of equal length


@dataclass(frozen=True)
class Surface:
    """Flat patch of the world on which the robot may stand, sit, lean or hold on.

    Attributes:
        name: as the user sees it.
        corners: (V, 3) of a convex polygon, counter-clockwise seen from outside [m].
        normal: (3,) unit, outwards: the direction in which it pushes.
        friction: coefficient.
        pieces: the scene's pieces behind it, which a link in contact may touch.
        shape: the round shape behind it; None for a flat one.
    """

    name: str
    corners: Float[np.ndarray, "V 3"]
    normal: Float[np.ndarray, "3"]
    friction: float
    pieces: tuple[str, ...] = ()
    shape: Primitive | None = None

    @staticmethod
    def on_pieces(
        name: str,
        corners: Float[np.ndarray, "V 3"],
        normal: Float[np.ndarray, "3"],
        friction: float,
        pieces: Sequence[ConvexPiece],
    ) -> Surface:
        """Return a surface in front of pieces of the scene."""
        shape = pieces[0].exact if len(pieces) == 1 else None
        return Surface(name, corners, normal, friction, tuple(piece.name for piece in pieces), shape)

    def find_normal(self, points: Float[np.ndarray, "C 3"]) -> Float[np.ndarray, "3"]:
        """Return the unit normal of what is behind it at points on it: that of a round shape, else its own."""
        if self.shape is None:
            return self.normal
        mean = find_round_normals(points, self.shape).mean(axis=0)
        return mean / np.linalg.norm(mean) if mean @ self.normal > LEAST_FACING else self.normal

    @property
    def middle(self) -> Float[np.ndarray, "3"]:
        """(3,) mean of its corners [m]."""
        return np.asarray(self.corners.mean(axis=0))

    @property
    def along(self) -> Float[np.ndarray, "3"]:
        """(3,) unit, along its longest edge, the first of equal ones."""
        edges = np.roll(self.corners, -1, axis=0) - self.corners
        lengths = np.linalg.norm(edges, axis=1)
        longest = int(np.argmax(lengths > lengths.max() - SAME_EDGE_M))
        return np.asarray(edges[longest] / lengths[longest])

    def list_edges(self) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "V"]]:
        """Return outward unit normals (V, 3) and offsets (V,) of the edges: inside is ``normal . p <= offset`` [m]."""
        along = np.roll(self.corners, -1, axis=0) - self.corners
        outwards = np.cross(along, self.normal)
        outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
        return outwards, np.einsum("vk,vk->v", outwards, self.corners)

    def measure_height(self, points: Float[np.ndarray, "C 3"]) -> Float[np.ndarray, "C"]:
        """Return how far points are in front of its plane [m]."""
        return np.asarray((points - self.corners[0]) @ self.normal)

    def measure_outside(self, points: Float[np.ndarray, "C 3"]) -> Float[np.ndarray, "C"]:
        """Return how far points, seen along the normal, are beyond its edges; negative inside [m]."""
        normals, offsets = self.list_edges()
        return np.asarray((points @ normals.T - offsets).max(axis=1))

    def bring_onto(self, place: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Return the point of the surface that is nearest to a place, seen along the normal [m]."""
        on_plane = place - self.measure_height(place[None])[0] * self.normal
        if self.measure_outside(on_plane[None])[0] <= 0.0:
            return np.asarray(on_plane)
        along = np.roll(self.corners, -1, axis=0) - self.corners
        shares = np.einsum("vk,vk->v", on_plane - self.corners, along) / np.einsum("vk,vk->v", along, along)
        nearest = self.corners + np.clip(shares, 0.0, 1.0)[:, None] * along
        best = nearest[int(np.linalg.norm(nearest - on_plane, axis=1).argmin())]
        inwards = self.middle - best
        return np.asarray(best + min(1.0, INSIDE_M / float(np.linalg.norm(inwards))) * inwards)


@dataclass(frozen=True)
class StanceContact:
    """Patch of the robot planted on a surface.

    Attributes:
        patch: name among the robot's contacts.
        surface: that carries it.
        planted: its points in the world, with friction and cap.
        slack_m: by which it may be moved along the longest edge of the surface, either way.
    """

    patch: str
    surface: Surface
    planted: PlantedContact
    slack_m: float = 0.0

    @property
    def points(self) -> Float[np.ndarray, "C 3"]:
        """(C, 3) contact points in the world [m]."""
        return self.planted.points

    def move(self, by: Float[np.ndarray, "3"]) -> StanceContact:
        """Return the contact moved by an offset in the world [m]."""
        pose = self.planted.pose_world_link.copy()
        pose[:3, 3] += by
        return replace(self, planted=replace(self.planted, pose_world_link=pose))

    def is_kept_in(self, stance: ContactStance) -> bool:
        """Return whether a stance has this patch at the same place."""
        return any(
            other.patch == self.patch
            and other.points.shape == self.points.shape
            and bool(np.abs(other.points - self.points).max() <= SAME_PLACE_M)
            for other in stance.contacts
        )


@dataclass(frozen=True)
class ContactStance:
    """Contacts that carry the robot together.

    Attributes:
        name: as the user sees it.
        contacts: at most one per link.
    """

    name: str
    contacts: tuple[StanceContact, ...]

    def keep_common(self, other: ContactStance) -> tuple[StanceContact, ...]:
        """Return the contacts that another stance has at the same place."""
        return tuple(contact for contact in self.contacts if contact.is_kept_in(other))


@dataclass(frozen=True)
class ContactChange:
    """Contacts of two stances: those that stay where they are, those that leave, and those that arrive."""

    kept: tuple[StanceContact, ...]
    leaving: tuple[StanceContact, ...]
    arriving: tuple[StanceContact, ...]

    @staticmethod
    def between(before: ContactStance, after: ContactStance) -> ContactChange:
        """Return what changes from one stance to the next."""
        kept = before.keep_common(after)
        leaving = tuple(contact for contact in before.contacts if contact not in kept)
        return ContactChange(kept, leaving, tuple(c for c in after.contacts if not c.is_kept_in(before)))


def place_patch(
    patch: Contact, name: str, surface: Surface, pose_world_link: Float[np.ndarray, "4 4"]
) -> StanceContact:
    """Return a patch planted on a surface, its link at a pose; friction is the lower of both."""
    friction = min(patch.friction, surface.friction)
    planted = PlantedContact(
        patch.link,
        pose_world_link,
        patch.points,
        friction=friction,
        force_cap_n=patch.force_cap_n,
        normal=surface.normal,
        tolerance_m=KEPT_TOLERANCE_M,
    )
    return StanceContact(name, surface, planted)


def place_patch_as_it_is(robot: RobotModel, q: Float[np.ndarray, "n"], name: str, surface: Surface) -> StanceContact:
    """Return a patch planted where a configuration has it.

    Raises:
        KeyError: the robot has no such patch.
    """
    patch = robot.contacts[name]
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return place_patch(patch, name, surface, np.array(data.oMf[robot.model.getFrameId(patch.link)].homogeneous))


def find_link_pose(
    patch: Contact, surface: Surface, place: Float[np.ndarray, "3"], yaw_rad: float
) -> Float[np.ndarray, "4 4"]:
    """Return pose_world_link of a patch that lies flat on a surface.

    Args:
        patch: of the robot.
        surface: that it lies on.
        place: (3,) of the middle of the patch's points; moved along the normal onto the surface [m].
        yaw_rad: turn about the surface's normal of the link's x axis; 0 is along the world's x axis, or along its z
            axis on a wall.
    """
    from scipy.spatial.transform import Rotation  # slow to import

    inwards = -patch.normals.mean(axis=0)
    inwards /= np.linalg.norm(inwards)
    ahead = np.array([1.0, 0.0, 0.0])
    if abs(ahead @ inwards) > 0.9:
        ahead = np.array([0.0, 0.0, 1.0])
    own = _make_frame(-inwards, ahead)
    across = np.array([1.0, 0.0, 0.0])
    if abs(across @ surface.normal) > 0.9:
        across = np.array([0.0, 0.0, 1.0])
    wanted = _make_frame(surface.normal, across) @ Rotation.from_rotvec([0.0, 0.0, yaw_rad]).as_matrix()
    pose = np.eye(4)
    pose[:3, :3] = wanted @ own.T
    on_plane = place - surface.measure_height(place[None])[0] * surface.normal
    pose[:3, 3] = on_plane - pose[:3, :3] @ patch.points.mean(axis=0)
    return pose


def find_link_yaw(patch: Contact, contact: StanceContact) -> float:
    """Return the turn about the surface's normal with which ``find_link_pose`` puts a patch's points where they are.

    Of a single point, whose turn does not matter, it is that of the link [rad].
    """
    level = find_link_pose(patch, contact.surface, contact.points.mean(axis=0), 0.0)
    spread = patch.points - patch.points.mean(axis=0)
    wide = int(np.argmax(np.linalg.norm(spread, axis=1)))
    own = spread[wide] if np.linalg.norm(spread[wide]) > 0.0 else np.array([1.0, 0.0, 0.0])
    before, after = level[:3, :3] @ own, contact.planted.pose_world_link[:3, :3] @ own
    normal = contact.surface.normal
    return float(np.arctan2(normal @ np.cross(before, after), before @ after - (before @ normal) * (after @ normal)))


def make_contact_allowances(contacts: Sequence[StanceContact]) -> tuple[Allowance, ...]:
    """Return the allowances of links in contact with the pieces behind their surfaces."""
    return tuple(
        Allowance(BodyRef.of_link(contact.planted.link), BodyRef.of_piece(piece), _find_depth(contact))
        for contact in contacts
        for piece in contact.surface.pieces
    )


def _find_depth(contact: StanceContact) -> float:
    """Return how deep a link may be in what it touches: deeper where it may turn about its points [m]."""
    return STANDING_DEPTH_M if len(contact.planted.sole) >= 3 else TURNING_DEPTH_M


def find_unjoined(stances: Sequence[ContactStance]) -> str | None:
    """Return a sentence for the first two stances that share no contact; None if all do."""
    for before, after in pairwise(stances):
        if not before.keep_common(after):
            return f"the stances '{before.name}' and '{after.name}' share no contact that stays where it is"
    return None


def _make_frame(z: Float[np.ndarray, "3"], ahead: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return axes as columns: ``z``, and x as near to ``ahead`` as it can be."""
    x = ahead - (ahead @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def ends_with_new_contacts(stances: Sequence[ContactStance]) -> bool:
    """Return whether the last stance has contacts that no stance before it has: a last phase has to stand on them."""
    return len(stances) > 1 and bool(ContactChange.between(stances[-2], stances[-1]).arriving)
