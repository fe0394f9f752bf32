"""Proof that objects at rest stay where they are, also on each other: each holds what lies on it, too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Float

from costs.robot import LinkBody
from costs.scene import ConvexPiece
from service.verify.carrying.resting import find_rest_contact, measure_margin_on, measure_rest_margin

LEVEL = float(np.cos(np.deg2rad(1.0)))  # least upward part of the normal of a top that carries an object
MOST_LOADS = 200  # ways in which the weights on an object may lie

Loads = tuple[tuple[float, tuple[float, float, float]], ...]
"""Masses and where they act in the world [kg, m]: the vertices of what may weigh on something."""


@dataclass(frozen=True, eq=False)
class RestingObject:
    """An object that the world carries.

    Attributes:
        body: in the world [m].
        mass: [kg].
        centre: (3,) of mass, in the world [m].
    """

    body: LinkBody
    mass: float
    centre: Float[np.ndarray, "3"]

    @cached_property
    def piece(self) -> ConvexPiece:
        """Its shape as others see it."""
        return ConvexPiece(self.body.name, self.body.vertices)


@dataclass(frozen=True)
class Rest:
    """How an object rests.

    Attributes:
        margin: by which its centre of mass, with what lies on it, may be off to any side; negative infinity where
            nothing holds it [m].
        names: of the pieces and objects that it touches, those that lie on it left out.
    """

    margin: float
    names: tuple[str, ...]


def measure_rests(objects: Sequence[RestingObject], pieces: Sequence[ConvexPiece]) -> Mapping[str, Rest]:
    """Return by name how objects rest on pieces and on each other.

    An object carries others by a level top.  What stands on objects is held by level tops alone, without friction, so
    that its weight on each of them is a vertical force inside the places where they touch; every distribution lies
    between those in which one place bears all of it and those in which it bears nothing.
    """
    return _Heap(tuple(objects), tuple(pieces)).measure()


@dataclass(frozen=True)
class _Heap:
    objects: tuple[RestingObject, ...]
    pieces: tuple[ConvexPiece, ...]

    @cached_property
    def contacts(self) -> Mapping[tuple[str, str], tuple[Float[np.ndarray, "P 3"], Float[np.ndarray, "3"]]]:
        """Where an object touches another, and the normal into the first, by both names."""
        found = {}
        for own in self.objects:
            for other in self.objects:
                if other is not own:
                    points, normal = find_rest_contact(own.body, other.piece)
                    if len(points):
                        found[own.body.name, other.body.name] = points, normal
        return found

    @cached_property
    def below(self) -> Mapping[str, tuple[str, ...]]:
        """Objects with whose level tops each object is carried."""
        placed = {own.body.name: own for own in self.objects}
        return {
            name: tuple(
                other
                for (mover, other), (_, normal) in self.contacts.items()
                if mover == name and normal[2] >= LEVEL and _has_level_top(placed[other].body)
            )
            for name in placed
        }

    def measure(self) -> Mapping[str, Rest]:
        """Return how each object rests."""
        rests = {}
        for own in self.objects:
            name = own.body.name
            beside = tuple(other for mover, other in self.contacts if mover == name and name not in self.below[other])
            if self.below[name]:
                margins = [self._measure_on_tops(own, centre) for _, centre in self._list_loads(name)]
                names = tuple(piece.name for piece in self.pieces if len(find_rest_contact(own.body, piece)[0]))
            else:
                found = [measure_rest_margin(own.body, np.array(at), self.pieces) for _, at in self._list_loads(name)]
                margins, names = [margin for margin, _ in found], (found[0][1] if found else ())
            rests[name] = Rest(min(margins, default=-np.inf), (*names, *beside))
        return rests

    def _measure_on_tops(self, own: RestingObject, centre: Sequence[float]) -> float:
        """Return the margin of an object on level tops alone [m]."""
        points = [self.contacts[own.body.name, other][0] for other in self.below[own.body.name]]
        for piece in self.pieces:
            spots, normal = find_rest_contact(own.body, piece)
            if len(spots) and normal[2] >= LEVEL:
                points.append(spots)
        every = np.concatenate(points)
        upwards = np.tile([0.0, 0.0, 1.0], (len(every), 1))
        return measure_margin_on(every, upwards, np.array(centre), np.zeros(len(every)))

    def _list_loads(self, name: str) -> Loads:
        """Return what an object and all that lies on it weigh together, and where; empty where these are too many."""
        own = next(each for each in self.objects if each.body.name == name)
        x, y, z = own.centre.tolist()
        sums: list[Loads] = [((own.mass, (x, y, z)),)]
        for other, carriers in self.below.items():
            if name not in carriers:
                continue
            loads = self._list_loads(other)
            is_alone = carriers == (name,) and not self._touches_level_piece(other)
            if not is_alone:  # its weight is shared in an unknown way
                spots = self.contacts[other, name][0]
                most = max((mass for mass, _ in loads), default=np.inf)
                loads = ((0.0, (x, y, z)), *((most, tuple(spot)) for spot in spots.tolist()))
            sums.append(loads)
        if np.prod([len(each) for each in sums]) > MOST_LOADS:
            return ()
        return tuple(_add(each) for each in product(*sums))

    def _touches_level_piece(self, name: str) -> bool:
        own = next(each for each in self.objects if each.body.name == name)
        contacts = (find_rest_contact(own.body, piece) for piece in self.pieces)
        return any(len(spots) and normal[2] >= LEVEL for spots, normal in contacts)


def _add(loads: Sequence[tuple[float, tuple[float, float, float]]]) -> tuple[float, tuple[float, float, float]]:
    """Return the sum of masses and where it acts."""
    mass = sum(own for own, _ in loads)
    x, y, z = (np.sum([own * np.array(at) for own, at in loads], axis=0) / mass).tolist()
    return mass, (x, y, z)


def _has_level_top(body: LinkBody) -> bool:
    """Return whether the top of a body is where its hull has it: a round body's is, where it stands on its end."""
    if body.exact is None:
        return True
    return body.exact.kind == "cylinder" and abs(float(body.exact.pose[2, 2])) >= LEVEL
