"""Allowances to touch: which link may touch what, and how deep."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Allowance:
    """A pair that may touch, down to a stated depth; without one a pair must keep clear.

    Attributes:
        link: a link's or a body's name, or a prefix that ends with ``*``.
        other: a piece's, link's or body's name, or a prefix that ends with ``*`` (``valve/rim/*``).
        depth: greatest penetration [m], >= 0.
    """

    link: str
    other: str
    depth: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.depth < float("inf"):
            raise ValueError(
                f"depth must be finite and not negative, got {self.depth} for {self.link} and {self.other}"
            )

    def covers(self, body_name: str, body_link: str, other_name: str, other_link: str = "") -> bool:
        """Whether it covers this pair, in either order; ``other_link`` is empty for a piece of the scene."""
        return (self.names_link(body_name, body_link) and self.names_other(other_name, other_link)) or (
            self.names_link(other_name, other_link) and self.names_other(body_name, body_link)
        )

    def names_link(self, name: str, link: str) -> bool:
        """Whether ``link`` names this body (or piece, with an empty ``link``)."""
        return _matches(self.link, (name, link))

    def names_other(self, name: str, link: str) -> bool:
        """Whether ``other`` names this body (or piece, with an empty ``link``)."""
        return _matches(self.other, (name, link))


def _matches(pattern: str, names: tuple[str, ...]) -> bool:
    if pattern.endswith("*"):
        return any(name and name.startswith(pattern[:-1]) for name in names)
    return any(name == pattern for name in names)
