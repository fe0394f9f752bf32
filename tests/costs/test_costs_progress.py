"""Progress of long work."""

from __future__ import annotations

from costs.progress import tell, tells_progress


def test_a_long_step_tells_its_share_and_the_time_left() -> None:
    now, said = [0.0], list[str]()
    with tells_progress(said.append, lambda: now[0]):
        tell("read")
        for done in range(1, 21):
            now[0] += 1.0
            tell("fit", done / 20)
    assert said[:2] == ["read", "fit"]
    assert said[2] == "fit 10 %, about 9 s left"
    assert 8 <= len(said) - 2 <= 11


def test_a_short_step_tells_its_name_only() -> None:
    said = list[str]()
    with tells_progress(said.append, lambda: 0.0):
        for done in range(100):
            tell("fit", done / 100)
    assert said == ["fit"]
    tell("nobody listens", 0.5)
    assert said == ["fit"]
