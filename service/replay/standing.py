"""What a recorded certificate is worth today: it holds, or it held under an earlier version and lacks checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

from service.request.formats import RELEASES
from service.verify import Basis, Certificate

HELD_BEFORE = "HELD_BEFORE"
MOST_NAMED = 3  # checks in a sentence

CHANGED_CHECKS: dict[int, tuple[str, ...]] = {3: ("target.", "axis.", "circle.", "keep.", "planted.")}
"""First words of the names of checks whose meaning a format changed; values of earlier formats are not compared."""


class State(StrEnum):
    """A certificate's state; what is neither of these is damaged, which is an error (``DamagedResultError``)."""

    HOLDS = "HOLDS"
    HELD_BEFORE = HELD_BEFORE


@dataclass(frozen=True)
class Standing:
    """State of a recorded certificate.

    Attributes:
        state: whether it holds today.
        release: first release that wrote its format.
        format: number of the format.
        lacks: names of checks that today's certificate of the same motion has and the recorded one has not; where only
            promises differ, sentences on them.
        fails: names of recorded checks that do not hold any more, by today's demands.
    """

    state: State
    release: str
    format: int
    lacks: tuple[str, ...] = ()
    fails: tuple[str, ...] = ()

    @staticmethod
    def of(version: int, lacks: Sequence[str] = (), fails: Sequence[str] = ()) -> Standing:
        """Return the standing of a certificate of a format: it holds if it lacks nothing and nothing fails."""
        state = State.HELD_BEFORE if lacks or fails else State.HOLDS
        return Standing(state, RELEASES[version], version, tuple(lacks), tuple(fails))

    @staticmethod
    def compare(
        version: int, recorded: Mapping[str, Any], certificate: Certificate, differences: Sequence[str]
    ) -> Standing:
        """Return the standing of a recorded certificate beside one that answers today's demands.

        Args:
            version: number of the recorded one's format.
            recorded: the recorded certificate.
            certificate: of the same motion, held to what its request demands today.
            differences: sentences on promises of the record that are not today's.
        """
        names = {check["name"] for check in recorded["checks"]}
        open_checks = [check.name for check in certificate.checks if not check.ok or check.basis is Basis.UNPROVEN]
        missing = [check.name for check in certificate.checks if check.name not in names]
        lacks = missing if differences else [name for name in missing if name in open_checks]
        fails = [name for name in open_checks if name in names]
        lacks, fails = list(dict.fromkeys(lacks)), list(dict.fromkeys(fails))
        return Standing.of(version, lacks or ([] if fails else differences), fails)

    def to_json(self) -> dict[str, Any]:
        """Return plain data, with the sentence."""
        return {**asdict(self), "sentence": self.sentence()}

    def sentence(self) -> str:
        """Return the state in one line."""
        if self.state is State.HOLDS:
            return f"holds today; format {self.format} (version {self.release})"
        reasons = [
            f"{verb} {_join_names(names)}" for verb, names in (("lacks", self.lacks), ("fails", self.fails)) if names
        ]
        return (
            f"held under version {self.release} (format {self.format}), {' and '.join(reasons)} today; "
            "not accepted anew"
        )


def _join_names(names: Sequence[str]) -> str:
    rest = len(names) - MOST_NAMED
    return ", ".join(names[:MOST_NAMED]) + (f" and {rest} more" if rest > 0 else "")


def is_comparable(name: str, version: int) -> bool:
    """Return whether a check of a format still means the same."""
    changed = [word for later, words in CHANGED_CHECKS.items() if later > version for word in words]
    return not name.startswith(tuple(changed))
