"""Surfaces of a request: faces of the scene's pieces, or polygons given by their corners."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from costs.names import would_do
from costs.rotation import make_tangent_basis
from costs.scene import ConvexPiece, Scene
from service.demands.contacts.stances import Surface
from service.errors import RequestError
from service.request.egress import SurfaceRequest

FACE_M = 1e-3  # depth within which a piece's vertices belong to its face
FLAT_M = 1e-3  # by which a corner may be off the plane of the others


def make_surfaces(scene: Scene, requests: Mapping[str, SurfaceRequest], path: str = "surfaces") -> dict[str, Surface]:
    """Return the surfaces by name.

    Raises:
        RequestError: a piece is unknown or has no such face, or corners are not those of a flat convex polygon.
    """
    pieces = {piece.name: piece for piece in scene.pieces}
    surfaces = {}
    for name, request in requests.items():
        here = f"{path}.{name}"
        for piece in ((request.piece,) if request.piece is not None else ()) + request.pieces:
            if piece not in pieces:
                raise RequestError(f"{here}: unknown piece '{piece}'; the scene has {would_do(piece, pieces)}")
        if request.piece is not None and request.normal is not None:
            corners, normal = find_face(pieces[request.piece], np.array(request.normal), here)
            behind = [pieces[request.piece]]
        else:
            corners = np.array(request.corners)
            normal = find_normal(corners, here)
            behind = [pieces[piece] for piece in request.pieces]
        surfaces[name] = Surface.on_pieces(name, corners, normal, request.friction, behind)
    return surfaces


def find_face(
    piece: ConvexPiece, direction: Float[np.ndarray, "3"], path: str
) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "3"]]:
    """Return the corners of a piece's face, counter-clockwise seen from outside, and its unit normal.

    Raises:
        RequestError: the piece has no face with this normal.
    """
    normal = direction / np.linalg.norm(direction)
    heights = piece.vertices @ normal
    corners = piece.vertices[heights >= heights.max() - FACE_M]
    if len(corners) < 3:
        words = ", ".join(f"{value:g}" for value in direction)
        raise RequestError(f"{path}: piece '{piece.name}' has no face with the normal [{words}]")
    x, y = _split(corners, normal)
    return corners[np.argsort(np.arctan2(y, x))], normal


def _split(
    corners: Float[np.ndarray, "V 3"], normal: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "V"], Float[np.ndarray, "V"]]:
    """Return coordinates in the plane, right-handed about the normal."""
    along = make_tangent_basis(normal)[0]
    off = corners - corners.mean(axis=0)
    return off @ along, off @ np.cross(normal, along)


def find_normal(corners: Float[np.ndarray, "V 3"], path: str) -> Float[np.ndarray, "3"]:
    """Return the unit normal of a polygon whose corners are counter-clockwise seen from outside.

    Raises:
        RequestError: the corners are on a line, not flat, or not convex.
    """
    following = np.roll(corners, -1, axis=0)
    total = np.cross(corners, following).sum(axis=0)
    length = float(np.linalg.norm(total))
    if length < 1e-9:
        raise RequestError(f"{path}.corners: are on a line; expected the corners of a patch")
    normal = total / length
    off = np.abs((corners - corners.mean(axis=0)) @ normal)
    if off.max() > FLAT_M:
        raise RequestError(f"{path}.corners[{int(off.argmax())}]: is {off.max():.3g} m off the plane of the others")
    turns = np.cross(following - corners, np.roll(following, -1, axis=0) - following) @ normal
    if turns.min() < -1e-9:
        raise RequestError(f"{path}.corners: are not those of a convex polygon, in their order")
    return np.asarray(normal)
