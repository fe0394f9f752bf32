"""Robots: pinocchio model, limits, convex bodies, groups and postures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin
from jaxtyping import Float

from costs.contact import Contact
from costs.primitive import Primitive

LEAST_MASS_KG = 1e-3  # of all links together; less counts as no mass
PLANAR_NAMES = ("base_x", "base_y", "base_yaw")
BASE_NAMES = ("base_x", "base_y", "base_z", "base_yaw", "base_pitch", "base_roll")


@dataclass(frozen=True, eq=False)
class LinkBody:
    """A convex body of a link; equal to itself only, so that results can be cached per body.

    Attributes:
        name: the link's name, with ``/1``, ``/2`` ... for its further bodies.
        link: the link it belongs to.
        joint: index of the pinocchio joint that carries it (0: fixed to the world).
        vertices: (V, 3) hull in the frame of that joint [m].
        outer: (W, 3) vertices whose hull contains ``vertices``, for the optimiser's sweeps [m]: at most 48, or 240 of a
            round shape (the same array when the hull has no more than 32, or no more than 240 of a round shape).
        exact: the round shape in the frame of that joint that ``vertices`` contain; None for any other shape.
    """

    name: str
    link: str
    joint: int
    vertices: Float[np.ndarray, "V 3"]
    outer: Float[np.ndarray, "W 3"]
    exact: Primitive | None = None


@dataclass(frozen=True)
class RobotSource:
    """The files a robot was made from, which results include.

    Attributes:
        urdf: text of the URDF.
        srdf: text of the SRDF ("" if none).
        files: mesh files by their path relative to the written ``package_dirs`` entry.
        roots: folders that its meshes are looked for in.
    """

    urdf: str
    srdf: str
    files: Mapping[str, Path]
    roots: tuple[Path, ...] = ()


@dataclass(frozen=True)
class RobotHand:
    """Frames of a hand with a rod on its axis, which serves as a hook and as a peg, or with two fingers.

    Attributes:
        link: the hand itself, whose front ends at ``stub``.
        hook: link of the rod, which may touch what is held.
        tool: frame at the rod's end, z along the hand's axis outwards.
        peg, stub: frames in the middle of the free rod and where it leaves the hand, parallel to ``tool``; empty where
            the robot has none.
        peg_radius: half the rod's thickness [m].
        fingers: links of two fingers that close along a straight line; empty where the robot has none.
    """

    link: str
    hook: str
    tool: str
    peg: str = ""
    stub: str = ""
    peg_radius: float = 9e-3
    fingers: tuple[str, ...] = ()


@dataclass(frozen=True)
class RobotModel:
    """A robot with ``n`` degrees of freedom whose configuration is a plain vector.

    Attributes:
        model: pinocchio model with nq == nv == n.
        joint_names: n coordinate names; with a floating base the first six are ``BASE_NAMES``.
        lower, upper: (n,) position limits [rad, m]; base unbounded (+-inf).
        velocity, acceleration, effort: (n,) symmetric limits [rad/s, rad/s^2, Nm]; base +inf.
        bodies: convex bodies of all links.
        is_floating: whether the base is free.
        groups: joint names by group name (SRDF), as ordered in ``joint_names``.
        link_groups: link names by group name; ``feet`` and ``hands`` are used by the tasks.
        postures: (n,) configurations by name.
        ignored_pairs: link pairs (sorted names) not checked against each other.
        fixed_links: links that no joint moves; not checked against the scene.
        mechanism_links: links of a task's mechanism (``with_mechanism``), not part of the robot's mass. Their motion is
            prescribed, so that the optimiser leaves out their clearance from the scene and each other; the verifier
            checks it.
        source: the files it came from.
        ignored_reasons: reason for each of ``ignored_pairs``: ``srdf (its reason)``, ``adjacent``, ``derived`` (they
            overlap in nearly all poses), ``same joint``; for users only, no check relies on it.
        contacts: patches by name that may carry force, on the surfaces of the bodies (``costs.robot.contact_patches``).
        hands: by side (``left``, ``right``); empty where nothing names them.
        notes: what the files leave open or state in an unusual way, and how it was read.
        rolls: whether the planar base stands on two wheels: it turns and drives ahead or back, but never sideways.
    """

    name: str
    model: pin.Model
    joint_names: tuple[str, ...]
    lower: Float[np.ndarray, "n"]
    upper: Float[np.ndarray, "n"]
    velocity: Float[np.ndarray, "n"]
    acceleration: Float[np.ndarray, "n"]
    effort: Float[np.ndarray, "n"]
    bodies: tuple[LinkBody, ...]
    is_floating: bool
    groups: Mapping[str, tuple[str, ...]]
    link_groups: Mapping[str, tuple[str, ...]]
    postures: Mapping[str, Float[np.ndarray, "n"]]
    ignored_pairs: frozenset[tuple[str, str]]
    fixed_links: frozenset[str]
    mechanism_links: frozenset[str]
    source: RobotSource
    ignored_reasons: Mapping[tuple[str, str], str] = field(default_factory=dict)
    contacts: Mapping[str, Contact] = field(default_factory=dict)
    hands: Mapping[str, RobotHand] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    rolls: bool = False

    @property
    def is_planar(self) -> bool:
        """Whether the base slides and turns on a plane: the first coordinates are ``PLANAR_NAMES``."""
        return not self.is_floating and self.joint_names[: len(PLANAR_NAMES)] == PLANAR_NAMES

    @property
    def can_balance(self) -> bool:
        """Whether the links have masses, without which there is no centre of mass."""
        return float(pin.computeTotalMass(self.model)) >= LEAST_MASS_KG

    @property
    def n(self) -> int:
        """Degrees of freedom, the base's included."""
        return len(self.joint_names)
