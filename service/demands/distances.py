"""Distances from the world that a request demands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product

from costs.robot import RobotModel
from costs.scene import Scene
from service.demands.scene import is_part
from service.errors import RequestError, shown, would_do
from service.request.schema import Options
from service.verify import NO_SWAY, Sway, bound_largest_sway


@dataclass(frozen=True)
class Distances:
    """Demanded distances of the robot's links from pieces that they may not touch.

    Attributes:
        clearance_m: of every pair [m].
        sway: of a base that something else balances; the distances hold however it sways.
        padding: what links and pieces add to that of their pairs, by name; a pair demands the sum, at least
            ``clearance_m`` [m].
    """

    clearance_m: float = 0.0
    sway: Sway = NO_SWAY
    padding: Mapping[str, float] = field(default_factory=dict)

    @staticmethod
    def of(options: Options, scene: Scene) -> Distances:
        """Return the distances of a request; the padding of a mesh is that of all its pieces."""
        padding = dict(options.padding)
        for piece in scene.pieces:
            owners = [name for name in options.padding if is_part(piece.name, name)]
            padding.update((piece.name, options.padding[name]) for name in owners if piece.name not in options.padding)
        return Distances(options.clearance_m, Sway(options.sway_m, options.sway_deg), padding)

    def bound_least(self, robot: RobotModel) -> float:
        """Return a distance that is enough for all pairs without padding [m]."""
        return self.clearance_m + bound_largest_sway(robot, self.sway)

    def list_padded(self, robot: RobotModel, scene: Scene) -> list[tuple[str, str, float]]:
        """Return the pairs of a link and a piece whose padding demands more, with a distance that is enough [m]."""
        if not self.padding:
            return []
        sway = bound_largest_sway(robot, self.sway)
        links = dict.fromkeys(body.link for body in robot.bodies if body.link not in robot.mechanism_links)
        sums = (
            (link, piece.name, self.padding.get(link, 0.0) + self.padding.get(piece.name, 0.0))
            for link, piece in product(links, scene.pieces)
        )
        return [(link, piece, least + sway) for link, piece, least in sums if least > self.clearance_m]


def check_padding(given: Mapping[str, float], robot: RobotModel, scene: Scene) -> None:
    """Refuse padding of names that are neither a link with a shape, a carried body nor an obstacle or piece.

    Raises:
        RequestError: one line per unknown name.
    """
    links = dict.fromkeys(body.link for body in robot.bodies)
    pieces = dict.fromkeys(piece.name for piece in scene.pieces)
    names = [*links, *pieces, *(name.rpartition("/")[0] for name in pieces if "/" in name)]
    unknown = [name for name in given if name not in names]
    if unknown:
        raise RequestError(
            [
                f"options.padding: {shown(name)} is no link with a shape, carried body or obstacle; "
                f"{would_do(name, names)}"
                for name in unknown
            ]
        )
