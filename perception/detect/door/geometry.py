"""Geometry of a door that a task opens: leaf, hinge axis, opening direction and handle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

HandleKind = Literal["lever", "pull", "push_bar", "knob"]
Opens = Literal["push", "pull"]

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class HandleGeometry:
    """Handle on the leaf's face towards the robot, with the leaf shut and the lever at rest.

    Attributes:
        kind: ``lever`` turns about a spindle, ``pull`` is a fixed bar (usually upright), ``push_bar`` is a bar across
            the leaf that is pressed towards it, ``knob`` is round.
        centre: (3,) in the world [m]: of a lever's bar at its spindle, else of the bar's or knob's middle.
        direction: (3,) unit, along the bar; of a lever from the spindle to its free end.
        length: of the bar: of a lever from the spindle to its free end [m].
        radius: half the bar's thickness [m]; of a knob half its diameter, and ``length`` is its depth.
        height: of a push bar's face, across the bar [m]; None: the bar is as high as it is thick.
    """

    kind: HandleKind
    centre: Float[np.ndarray, "3"]
    direction: Float[np.ndarray, "3"]
    length: float
    radius: float
    height: float | None = None


@dataclass(frozen=True)
class DoorGeometry:
    """A door, described with its leaf shut.

    Attributes:
        hinge: (3,) point of the hinge axis at the leaf's lower edge, in the world [m]; the axis is vertical.
        along: (3,) unit, horizontal, from the hinge to the free edge of the shut leaf.
        normal: (3,) unit, horizontal, perpendicular to ``along``, towards the robot.
        face: distance of the leaf's face towards the robot from the hinge axis, along ``normal`` [m].
        width: of the leaf, from the hinge axis to its free edge [m].
        height: of the leaf [m].
        thickness: of the leaf [m].
        opens: ``push`` if the free edge moves away from the robot, ``pull`` if towards it; None where unknown.
        ajar: opening angle of the leaf as it was seen, 0 or more [rad].
        handle: on the face towards the robot; None where none was seen.
        handle_turn: angle by which a lever was turned down from rest as it was seen [rad].
    """

    hinge: Float[np.ndarray, "3"]
    along: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    face: float
    width: float
    height: float
    thickness: float
    opens: Opens | None
    ajar: float = 0.0
    handle: HandleGeometry | None = None
    handle_turn: float = 0.0

    @property
    def hinge_axis(self) -> Float[np.ndarray, "3"]:
        """(3,) unit, vertical, about which a positive angle opens the leaf."""
        moves_along_normal = float(np.cross(UP, self.along) @ self.normal)  # of the free edge, for a turn about z
        opens_along_normal = -1.0 if self.opens == "push" else 1.0
        return np.asarray(UP * np.sign(moves_along_normal * opens_along_normal))
