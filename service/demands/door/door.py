"""The door of a task as a mechanism: leaf and handle, their joints, and the pace at which a leaf stays at the hand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from costs.robot import Mechanism, MechanismJoint, Release
from perception.detect.door.bodies import HANDLE_LINK, LEAF_LINK, door_bodies
from perception.detect.door.geometry import UP, DoorGeometry, HandleGeometry
from perception.detect.door.seen_parts import HANDLE_NAMES
from service.demands.resistance import ASSUMED_DENSITY
from service.request.tasks.door import DOOR, HANDLE_JOINT, LEAF_JOINT

if TYPE_CHECKING:
    from perception import SeenPart

LARGEST_OPENING = np.deg2rad(170.0)
LEAF_ACCELERATION, LEAST_ACCELERATION = 1.0, 5e-3  # of a leaf [rad/s^2]
SPRING_BACK = 0.015  # by which a hand that presses a bar follows once the latch is free: its servos had given way [m]
INERTIA_SHARE = 0.7  # of the torque at the hinge, that the inertia of a leaf may come to: it never runs ahead
SAME_ANGLE = 1e-6  # [rad]
STOP_ROUNDING = 1e-3  # by which a joint may pass its stop at 0 [rad, m]
LEVER_STOP = np.deg2rad(60.0)
BEYOND_RELEASE = np.deg2rad(5.0)  # by which the lever is turned further than it needs
PRESS_BEYOND = 3e-3  # the same of a push bar [m]
FREE_BEYOND = np.deg2rad(5.0)  # opening from which on the latch no longer holds the leaf


@dataclass(frozen=True)
class Door:
    """A door to open.

    Attributes:
        geometry: leaf and handle; ``opens`` is known.
        release: angle of the lever, or travel of the push bar, from which on the leaf is free [rad, m].
        lever_nm, hinge_nm, push_bar_n: what turns the lever, opens the leaf, and presses the bar.
        seen: parts of it that the scan shows, with their counts; None where the request gives the door.
    """

    geometry: DoorGeometry
    release: float
    lever_nm: float
    hinge_nm: float
    push_bar_n: float
    seen: tuple[SeenPart, ...] | None = None

    @property
    def handle(self) -> HandleGeometry | None:
        """The handle."""
        return self.geometry.handle

    @property
    def handle_name(self) -> str:
        """What a hand holds: ``lever``, ``pull handle``, ``push bar``."""
        return "handle" if self.handle is None else HANDLE_NAMES.get(self.handle.kind, self.handle.kind)

    @property
    def has_push_bar(self) -> bool:
        """Whether the handle is a push bar."""
        return self.handle is not None and self.handle.kind == "push_bar"

    @property
    def is_push(self) -> bool:
        """Whether the leaf moves away from the robot."""
        return self.geometry.opens == "push"

    @property
    def is_latched(self) -> bool:
        """Whether the leaf has to be released before it opens."""
        has_latch = self.handle is not None and self.handle.kind in ("lever", "push_bar")
        return bool(has_latch and self.geometry.ajar < FREE_BEYOND)

    @property
    def pressed(self) -> float:
        """Value of the handle's joint at which the leaf is opened [rad, m]."""
        is_bar = self.has_push_bar
        return self.release + (PRESS_BEYOND if is_bar else float(BEYOND_RELEASE))

    @cached_property
    def mechanism(self) -> Mechanism:
        """Leaf and handle as a tree of joints, described with the leaf shut and the lever at rest."""
        geometry, handle = self.geometry, self.handle
        bodies = {
            link: {f"{link}/{name}": vertices for name, vertices in parts.items()}
            for link, parts in door_bodies(geometry).items()
        }
        joints = [
            MechanismJoint(
                LEAF_JOINT,
                LEAF_LINK,
                geometry.hinge,
                geometry.hinge_axis,
                bodies[LEAF_LINK],
                lower=-STOP_ROUNDING,
                upper=LARGEST_OPENING,
                start=max(geometry.ajar, 0.0),  # seen with noise
                acceleration=self.leaf_acceleration,
            )
        ]
        if handle is None or HANDLE_LINK not in bodies:
            return Mechanism(DOOR, tuple(joints))
        is_bar = self.has_push_bar
        joints.append(
            MechanismJoint(
                HANDLE_JOINT,
                HANDLE_LINK,
                handle.centre,
                -geometry.normal if is_bar else self.spindle_axis,
                bodies[HANDLE_LINK],
                kind="prismatic" if is_bar else "revolute",
                parent=LEAF_LINK,
                lower=-STOP_ROUNDING,
                upper=self.pressed + 0.01 if is_bar else LEVER_STOP,
                start=0.0 if is_bar else max(geometry.handle_turn, 0.0),  # seen with noise
                velocity=0.2 if is_bar else 1.0,
                acceleration=1.0 if is_bar else 2.0,
            )
        )
        return Mechanism(DOOR, tuple(joints), (Release(LEAF_JOINT, HANDLE_JOINT, self.release, float(FREE_BEYOND)),))

    @property
    def leaf_inertia(self) -> float:
        """About the hinge, of a leaf of assumed density [kg m^2]."""
        return self._leaf_mass * self.geometry.width**2 / 3.0

    @property
    def _leaf_mass(self) -> float:
        geometry = self.geometry
        return ASSUMED_DENSITY * geometry.width * geometry.height * geometry.thickness

    @property
    def leaf_acceleration(self) -> float:
        """At which a leaf stays at the hand that pushes it: its hinge brings it to rest as fast [rad/s^2]."""
        gentle = INERTIA_SHARE * self.hinge_nm / self.leaf_inertia
        return min(LEAF_ACCELERATION, max(gentle, LEAST_ACCELERATION))

    def explain_loose(self, last: float) -> str | None:
        """Return a sentence where nothing brings a pushed leaf to rest; None where its hinge does.

        A leaf that the bar's latch sets free is thrown by what the hand's servos had given way: half the bar's force
        along it has to be spent at the hinge before the hand has opened the leaf.

        Args:
            last: angle to which the hand opens it [rad].
        """
        slowed, thrown = self.leaf_inertia * self.leaf_acceleration, 0.0
        if self.has_push_bar and self.is_latched:
            thrown = 0.5 * self.push_bar_n * SPRING_BACK / max(last - self.geometry.ajar, SAME_ANGLE)
        needed = max(slowed, thrown)
        if self.hinge_nm >= needed:
            return None
        return (
            f"task.door.hinge_nm: {self.hinge_nm:g} N m; a leaf of about {self._leaf_mass:.0f} kg would run ahead of "
            f"the hand, and nothing would bring it to rest; expected at least {np.ceil(1e3 * needed) / 1e3:g}"
        )

    @property
    def spindle_axis(self) -> Float[np.ndarray, "3"]:
        """(3,) unit: about which a positive angle turns the lever down."""
        if self.handle is None:
            raise ValueError("a door without a handle has no spindle")
        normal = self.geometry.normal
        return np.asarray(normal * (-1.0 if np.cross(normal, self.handle.direction) @ UP > 0.0 else 1.0))
