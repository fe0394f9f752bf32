"""Objects that belong to no kind, or to another one, are not reported with a confidence to act on."""

from __future__ import annotations

import pytest

from benchmarks.clouds.others import make_other
from perception import CONFIDENT, detect, make_view
from perception.simulate.scenes import make_scene


@pytest.mark.parametrize(
    ("scene", "seed", "sensor", "kind"),
    [
        pytest.param("knife_switch_long", 0, "dense", "valve", id="a handle on a switch box is no lever valve"),
        pytest.param("none_fans", 1, "sparse", "valve", id="a fan seen with few rays is no wheel"),
        pytest.param("none_carts", 40, "camera", "valve", id="a rung before a rail of a hand truck is no lever valve"),
        pytest.param("knife_switch_short", 2, "solid_sparse", "panel", id="a bar before a box is no pair of buttons"),
        pytest.param("none_reels", 0, "dense", "panel", id="a disc with a hub is no panel"),
        pytest.param("none_switches", 0, "dense", "door", id="a cabinet apart from its handle is no door"),
        pytest.param("drill_short", 0, "dense", "beam", id="a table's leg is no loose beam"),
    ],
)
def test_another_object_is_not_reported_as_one_to_act_on(scene: str, seed: int, sensor: str, kind: str) -> None:
    hits = detect(kind, make_view(make_other(scene, seed).scan(sensor)))
    assert [hit.confidence for hit in hits if hit.confidence >= CONFIDENT] == []


def test_a_pull_handle_is_no_lever_where_nothing_shows_what_holds_it() -> None:
    hits = detect("lever", make_view(make_scene("door_left_pull", 0).scan("solid")))
    assert [hit.confidence for hit in hits if hit.confidence >= CONFIDENT] == []


def test_a_carton_near_the_floor_is_no_handle_of_a_door_beside_the_true_one() -> None:
    scene = make_other("door_narrow", 1)
    door = next(truth for truth in scene.truth if truth.kind == "door")
    sure = [hit for hit in detect("door", make_view(scene.scan("camera"))) if hit.confidence >= CONFIDENT]
    assert len(sure) == 1
    assert sure[0].sizes["handle_z"] == pytest.approx(door.sizes["handle_z"], abs=0.02)


def test_noise_above_the_end_of_a_lever_is_no_grip() -> None:
    scene = make_scene("valve_lever", 2)
    hit = detect("valve", make_view(scene.scan("sparse")))[0]
    assert hit.confidence >= CONFIDENT
    assert "grip_length" not in hit.sizes
    assert hit.sizes["lever_length"] == pytest.approx(scene.truth[0].sizes["lever_length"], abs=0.02)
