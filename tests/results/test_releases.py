"""What a plan lets go, from its recorded phases."""

from __future__ import annotations

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from service.result.releases import describe_releases, list_releases


def phase(name: str, **held: str | None) -> dict[str, Any]:
    return {"name": name, "carriers": [{"object": item, "link": link} for item, link in held.items()]}


def test_an_object_is_let_go_where_no_hand_holds_it_any_more() -> None:
    phases = [
        phase("grasp", drill=None), phase("lift", drill="r_hand"), phase("hand over", drill="l_hand"),
        phase("put down", drill=None), phase("leave"),
    ]  # fmt: skip
    released = list_releases({"phases": phases})
    assert released == {"drill": "put down"}
    assert describe_releases(released) == "'drill' in phase 'put down'"
    assert list_releases({"phases": phases[:3]}) == {}
    assert list_releases({}) == {}


HANDS = st.sampled_from([None, "l_hand", "r_hand"])


@given(st.lists(st.dictionaries(st.sampled_from("ab"), HANDS), max_size=6))
def test_what_is_let_go_was_held_before_and_is_not_in_that_phase(held: list[dict[str, str | None]]) -> None:
    released = list_releases({"phases": [phase(str(k), **own) for k, own in enumerate(held)]})
    for name, first in released.items():
        assert held[int(first)].get(name) is None
        assert any(own.get(name) is not None for own in held[: int(first)])
    kept = set("ab") - set(released)
    for name in kept:
        holds = [own.get(name) is not None for own in held]
        assert holds == sorted(holds)
