"""What a certificate covers, as data: links with and without shapes, pairs checked, pairs left out and why."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

# A link without a shape may reach this far out of the shapes next to it: a camera, a coupling [m].
SMALL_M = 0.05


@dataclass(frozen=True)
class LeftOut:
    """A pair of links with shapes that is not checked.

    Attributes:
        pair: their names, sorted.
        reason: ``same joint``, ``adjacent`` (joint neighbours), ``srdf (what it says)``, ``derived``, ``kept`` (their
            relative pose is held all along), ``around a joint`` (one link apart, and overlapping in nearly all poses of
            the joints between), or ``given``.
        is_neighbour: whether its links are joint neighbours, or around a joint, so that an overlap tells nothing.
        deepest_m: how deep one was seen to be in the other; 0 where they were proven to keep apart on the whole curve
            (``s`` is None), or not proven and seen apart; NaN for joint neighbours and links of one joint.
        s, time_s: where it is deepest, or not proven; None elsewhere.
    """

    pair: tuple[str, str]
    reason: str
    is_neighbour: bool
    deepest_m: float
    s: float | None = None
    time_s: float | None = None

    @property
    def is_told_as_neighbour(self) -> bool:
        """Whether nobody expects such a pair to be checked."""
        return self.is_neighbour or self.reason == "same joint"


@dataclass(frozen=True)
class Shapeless:
    """A link without a collision shape, or with one far smaller than the link.

    Attributes:
        link: its name.
        place: ``between`` links with shapes, at an ``end``, or at the ``root``.
        reach_m: the longest side of what is known of it (the line to its joints, its drawn shapes, its mass as an even
            box), or how far that reaches out of the shapes of the links next to it at the motion's first pose if that
            is less; 0 for a mere frame, NaN where its size is unknown.
    """

    link: str
    place: str
    reach_m: float

    @property
    def is_small(self) -> bool:
        """Whether what no shape covers is no larger than a camera or a coupling."""
        return self.reach_m <= SMALL_M


@dataclass(frozen=True)
class Coverage:
    """What was checked, and what was not.

    Attributes:
        links_with_shape, links_without_shape: names of the robot's links.
        shapeless: where each link without a shape sits, and how far it reaches out of the shapes next to it.
        n_link_pairs: pairs of links checked against each other.
        n_piece_pairs: pairs of a link and a piece of the scene that were checked.
        left_out: pairs of links with shapes that were not checked.
        joints_without_torque_limit: joints whose torque is held against nothing.
        not_checked: what was not checked because the request does not ask for it or the robot's file does not allow it.
    """

    links_with_shape: tuple[str, ...] = ()
    links_without_shape: tuple[str, ...] = ()
    shapeless: tuple[Shapeless, ...] = ()
    n_link_pairs: int = 0
    n_piece_pairs: int = 0
    left_out: tuple[LeftOut, ...] = ()
    joints_without_torque_limit: tuple[str, ...] = ()
    not_checked: tuple[str, ...] = ()

    def sentences(self) -> Iterator[str]:
        """What was not checked, for people."""
        if self.not_checked:
            yield f"not checked: {', '.join(self.not_checked)}"
        if self.left_out:
            kinds = Counter("neighbours" if one.is_told_as_neighbour else one.reason for one in self.left_out)
            told = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
            yield f"{len(self.left_out)} pairs of links are not checked against each other: {told}"
        if self.links_without_shape:
            yield f"{len(self.links_without_shape)} links have no shape: {', '.join(self.links_without_shape)}"

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Coverage:
        """Read what the certificate's JSON holds."""
        return Coverage(
            tuple(data["links_with_shape"]),
            tuple(data["links_without_shape"]),
            tuple(Shapeless(one["link"], one["place"], _number(one["reach_m"])) for one in data["shapeless"]),
            data["n_link_pairs"],
            data["n_piece_pairs"],
            tuple(
                LeftOut(
                    (one["pair"][0], one["pair"][1]),
                    one["reason"],
                    one["is_neighbour"],
                    _number(one["deepest_m"]),
                    one["s"],
                    one["time_s"],
                )
                for one in data["left_out"]
            ),
            tuple(data["joints_without_torque_limit"]),
            tuple(data["not_checked"]),
        )


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)
