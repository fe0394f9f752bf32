"""Objects of known shape: placed where they are said to be, or looked for in a scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from perception.solids.closed import Solid
from perception.solids.match import MeshMatch, judged, match_mesh
from perception.view import View


@dataclass(frozen=True)
class KnownMesh:
    """An object of known shape, and what is known of where it stands.

    Attributes:
        name: what to call it.
        solid: its shape in its own frame [m].
        pose_world_mesh: (4, 4), right within 20 degrees and 15 cm unless it ``is_placed``; None: to be found.
        hint: (3,) a point on or near it, where there is no pose; None: it is looked for everywhere [m].
        is_placed: whether it stands exactly at its pose, whatever the scan shows.
    """

    name: str
    solid: Solid
    pose_world_mesh: Float[np.ndarray, "4 4"] | None = None
    hint: Float[np.ndarray, "3"] | None = None
    is_placed: bool = False


def located(known: KnownMesh, view: View) -> MeshMatch:
    """Where it stands in the scan and how surely; one that is placed stays, and the scan only says how well it agrees.

    Args:
        known: the object.
        view: the scan, made ready.
    """
    if known.is_placed and known.pose_world_mesh is not None:
        return judged(known.solid, view, known.pose_world_mesh)
    return match_mesh(known.solid, view, hint=known.hint, initial=known.pose_world_mesh)
