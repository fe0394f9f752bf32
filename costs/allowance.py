"""Pairs of bodies or pieces that may touch, and the largest penetration allowed; names are exact, not patterns."""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Shaped

from costs.robot.model import LinkBody
from costs.scene import ConvexPiece

Owner = Literal["robot", "scene", "mechanism"]
OWNERS: tuple[Owner, ...] = get_args(Owner)


@dataclass(frozen=True)
class BodyRef:
    """A body of a link, all bodies of a link, or a piece of the scene.

    Attributes:
        owner: the robot, the scene, or the mechanism that a task moves.
        link: the robot's or the mechanism's link; None for a piece.
        body: name of the body or piece; None for every body of the link.

    Raises:
        ValueError: an unknown owner, a piece with a link or without a name, a body without a link.
    """

    owner: Owner
    link: str | None
    body: str | None = None

    def __post_init__(self) -> None:
        if self.owner not in OWNERS:
            raise ValueError(f"owner is {self.owner!r}; expected one of {', '.join(OWNERS)}")
        if self.owner == "scene":
            is_complete = self.link is None and isinstance(self.body, str)
        else:
            is_complete = isinstance(self.link, str) and isinstance(self.body, str | None)
        if not is_complete:
            kind = "a piece's name and no link" if self.owner == "scene" else "a link's name, and a body's or null"
            raise ValueError(
                f"a reference to the {self.owner} needs {kind}, got link {self.link!r} and body {self.body!r}"
            )

    @staticmethod
    def of_link(link: str) -> BodyRef:
        """Return a reference to every body of one of the robot's links."""
        return BodyRef("robot", link)

    @staticmethod
    def of_piece(name: str) -> BodyRef:
        """Return a reference to a piece of the scene."""
        return BodyRef("scene", None, name)

    @staticmethod
    def of_body(body: LinkBody, mechanism_links: AbstractSet[str] = frozenset()) -> BodyRef:
        """Return a reference to one body of the robot or of one of the mechanism's links."""
        return BodyRef("mechanism" if body.link in mechanism_links else "robot", body.link, body.name)

    def names(self, other: BodyRef) -> bool:
        """Return whether it names this body or piece."""
        is_whole_link = self.body is None and (self.owner, self.link) == (other.owner, other.link)
        return is_whole_link or self == other

    def __str__(self) -> str:
        return str(self.link if self.body is None else self.body)


@dataclass(frozen=True)
class Allowance:
    """A pair that may touch, down to a stated depth; without one a pair must keep clear.

    Attributes:
        first, second: the two that may touch; their order does not matter.
        depth: greatest penetration [m], >= 0.

    Raises:
        ValueError: the depth is negative or not finite.
    """

    first: BodyRef
    second: BodyRef
    depth: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.depth < float("inf"):
            raise ValueError(
                f"depth must be finite and not negative, got {self.depth} for {self.first} and {self.second}"
            )

    def covers(self, body: BodyRef, other: BodyRef) -> bool:
        """Return whether it covers these two, in either order."""
        return (self.first.names(body) and self.second.names(other)) or (
            self.first.names(other) and self.second.names(body)
        )


class BodyIndex:
    """Indices of referenced bodies and pieces in a table of bodies against bodies and pieces.

    Bodies come first, in their order, then pieces.
    """

    def __init__(
        self,
        bodies: Sequence[LinkBody],
        mechanism_links: AbstractSet[str] = frozenset(),
        pieces: Sequence[ConvexPiece] = (),
    ) -> None:
        self.n_bodies = len(bodies)
        self.shape = (len(bodies), len(bodies) + len(pieces))
        # Plain tuples: a scene has up to 20,000 pieces, and an index is made for every problem.
        self._rows: dict[tuple[str, str | None, str | None], list[int]] = {}
        for row, body in enumerate(bodies):
            owner = "mechanism" if body.link in mechanism_links else "robot"
            for name in (body.name, None):
                self._rows.setdefault((owner, body.link, name), []).append(row)
        for row, piece in enumerate(pieces, start=self.n_bodies):
            self._rows.setdefault(("scene", None, piece.name), []).append(row)

    def rows(self, ref: BodyRef) -> list[int]:
        """Return the indices of the bodies or the piece that a reference names; empty if there are none."""
        return self._rows.get((ref.owner, ref.link, ref.body), [])

    def fill(self, table: Shaped[np.ndarray, "B B+P"], first: BodyRef, second: BodyRef, value: float) -> None:
        """Set ``table`` where its row is a body of one reference and its column a body or piece of the other."""
        for ref, other in ((first, second), (second, first)):
            bodies = [row for row in self.rows(ref) if row < self.n_bodies]
            table[np.ix_(bodies, self.rows(other))] = value
