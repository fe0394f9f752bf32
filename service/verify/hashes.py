"""Hashes of what a certificate is about: scene, bodies, robot and the promises of the phases."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import fields

import numpy as np
from jaxtyping import Float

from costs.allowance import Allowance, BodyRef
from costs.robot.carried import MovableObject
from costs.robot.mechanism import Release
from costs.robot.model import RobotModel
from costs.scene import Scene
from service.request.formats import FORMAT
from service.verify.motion import (
    HandContact,
    HandLoad,
    HandPush,
    HeldJoint,
    Phase,
    PlantedContact,
    SupportPolygon,
    Target,
)

HASH_OFFSET = 0.381966  # of a micrometre
ADDED = {
    2: (
        "PlantedContact.friction",
        "PlantedContact.force_cap_n",
        "PlantedContact.normal",
        "PlantedContact.tilt_rad",
        "RelativePoseTarget.slide",
    ),
    3: ("HandLoad.across_n", "HandLoad.twist_nm"),
}
"""Fields of promises by the format that brought them, ``CLASS.FIELD``; hashes of earlier formats are without them."""


def scene_hash(scene: Scene) -> str:
    """``sha256:`` of the pieces in order of name: name, then the vertices in whole micrometres."""
    return _hash((piece.name, piece.vertices) for piece in sorted(scene.pieces, key=lambda piece: piece.name))


def bodies_hash(robot: RobotModel) -> str:
    """``sha256:`` of the bodies (vertices in the link frame, in whole micrometres) and of the ignored link pairs."""
    bodies = [(body.name, link_vertices(robot, body.link, body.vertices)) for body in robot.bodies]
    pairs = [(f"{a}|{b}", np.empty((0, 3))) for a, b in sorted(robot.ignored_pairs)]
    return _hash(sorted(bodies, key=lambda body: body[0]) + pairs)


def robot_hash(robot: RobotModel) -> str:
    """``sha256:`` of the URDF text."""
    return "sha256:" + hashlib.sha256(robot.source.urdf.encode()).hexdigest()


def promises_hash(
    phases: Iterable[Phase],
    releases: Iterable[Release] = (),
    version: int = FORMAT,
    objects: Iterable[MovableObject] = (),
) -> str:
    """``sha256:`` of what the phases promise, of the releases, and of place and mass of what hands carry.

    As a format hashed it (docs/result-format.md).
    """
    digest = hashlib.sha256()
    later = frozenset(key for brought, keys in ADDED.items() if brought > version for key in keys)
    for phase in phases:
        _add(digest, "phase", phase.name, np.array([phase.first, phase.last]))
        for allowance in phase.allowances:
            _add(digest, "allowance", *_parts(allowance, later))
        for contact in phase.contacts:
            _add(digest, "contact", *_parts(contact, later))
        if phase.support is not None:
            _add(digest, "support", *_parts(phase.support, later))
        if phase.region_margin_m is not None:
            _add(digest, "region margin", np.array([phase.region_margin_m]))
        for target in phase.targets:
            _add(digest, type(target).__name__, *_parts(target, later))
        for load in phase.loads:
            _add(digest, "load", *_parts(load, later))
        for push in phase.pushes:
            _add(digest, "push", *_parts(push, later))
        for carrier in phase.carriers:
            _add(digest, "carrier", carrier.item, carrier.link or "")
            for grip in carrier.grips:
                _add(digest, "grip", *grip.fingers, np.array([grip.force_n, grip.friction]))
    for release in releases:
        _add(digest, "release", *_parts(release, later))
    for item in objects:
        own = item.inertia
        _add(digest, "object", item.name, item.start, np.array([own.mass]), own.centre, own.moments)
    return "sha256:" + digest.hexdigest()


def link_vertices(robot: RobotModel, link: str, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
    """Return a body's vertices in the frame of its link, given in the frame of its joint [m]."""
    if not robot.model.existFrame(link):
        return vertices
    placement = robot.model.frames[robot.model.getFrameId(link)].placement
    return np.asarray((vertices - placement.translation) @ placement.rotation)


def _hash(named: Iterable[tuple[str, np.ndarray]]) -> str:
    digest = hashlib.sha256()
    for name, vertices in named:
        digest.update(name.encode() + b"\0" + len(vertices).to_bytes(8, "little"))
        digest.update(np.rint(vertices * 1e6).astype("<i8").tobytes())
    return "sha256:" + digest.hexdigest()


def _parts(
    promise: Allowance
    | BodyRef
    | HandContact
    | HandLoad
    | HandPush
    | HeldJoint
    | PlantedContact
    | Release
    | SupportPolygon
    | Target,
    later: frozenset[str],
) -> Iterator[str | np.ndarray]:
    """Yield the fields of a promise in their order: texts, references to bodies, numbers; no numbers for None."""
    for item in fields(promise):
        if later and f"{type(promise).__name__}.{item.name}" in later:
            continue
        value = getattr(promise, item.name)
        if isinstance(value, BodyRef):
            yield from _parts(value, later)
        elif isinstance(promise, HandPush) and item.name in ("contacts", "held"):
            for part in value:
                yield from _parts(part, later)
        elif isinstance(value, tuple) and value and isinstance(value[0], str):
            yield from value
        else:
            yield value if isinstance(value, str) else np.empty(0) if value is None else np.asarray(value, dtype=float)


def _add(digest: hashlib._Hash, *parts: str | np.ndarray) -> None:
    for part in parts:
        if isinstance(part, str):
            digest.update(b"t" + part.encode() + b"\0")
            continue
        # Steps of a micrometre whose borders lie where written decimals do not; what is not finite counts as -1.
        steps = np.floor(np.where(np.isfinite(part), part, -1.0).ravel() * 1e6 + HASH_OFFSET)
        digest.update(b"n" + steps.size.to_bytes(8, "little") + steps.astype("<i8").tobytes())
