"""Parts that other packages add: loaded by name, or refused in a sentence."""

from __future__ import annotations

from importlib.metadata import EntryPoint

import pytest

from costs import entry_points
from costs.entry_points import load_entry_points

GROUP = "scopt_numbers"


@pytest.fixture
def offer(monkeypatch: pytest.MonkeyPatch):
    def offer(*offers: tuple[str, str]) -> None:
        entries = [EntryPoint(name, value, GROUP) for name, value in offers]
        monkeypatch.setattr(entry_points, "entry_points", lambda group: entries if group == GROUP else [])

    return offer


def test_parts_come_by_name(offer) -> None:
    offer(("tau", "math:tau"), ("e", "math:e"))
    assert [name for name, _ in load_entry_points(GROUP, float, (), ValueError)] == ["e", "tau"]


@pytest.mark.parametrize(
    ("offers", "words"),
    [
        ([("pi", "math:no_such_number")], r"'pi' of scopt_numbers \(math:no_such_number\): AttributeError: .*, line "),
        ([("pi", "math:sqrt")], "expected a float named 'pi'"),
        ([("e", "math:e")], "'e' exists already; expected another name"),
        ([("pi", "math:pi"), ("pi", "math:tau")], "'pi' exists already"),
    ],
)
def test_what_cannot_be_used_is_named_by_group_and_entry(offer, offers, words) -> None:
    offer(*offers)
    with pytest.raises(ValueError, match=words):
        list(load_entry_points(GROUP, float, {"e"}, ValueError))
