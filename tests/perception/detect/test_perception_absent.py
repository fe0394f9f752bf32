"""Objects that belong to no kind, or to another one, are not reported with a confidence to act on."""

from __future__ import annotations

import pytest

from benchmarks.cloud_others import make_other
from perception import CONFIDENT, detect, make_view


@pytest.mark.parametrize(
    ("scene", "seed", "sensor", "kind"),
    [
        pytest.param("knife_switch_long", 0, "dense", "valve", id="a handle on a switch box is no lever valve"),
        pytest.param("none_fans", 1, "dense", "valve", id="the drum of a fan is no wheel"),
        pytest.param("none_reels", 0, "dense", "panel", id="a disc with a hub is no panel"),
        pytest.param("none_switches", 0, "dense", "door", id="a cabinet apart from its handle is no door"),
        pytest.param("drill_short", 0, "dense", "beam", id="a table's leg is no loose beam"),
    ],
)
def test_another_object_is_not_reported_as_one_to_act_on(scene: str, seed: int, sensor: str, kind: str) -> None:
    hits = detect(kind, make_view(make_other(scene, seed).scan(sensor)))
    assert [hit.confidence for hit in hits if hit.confidence >= CONFIDENT] == []
