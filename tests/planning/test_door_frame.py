"""The way in which a shut door opens, as far as its frame tells."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from costs.scene import ConvexPiece
from perception.detect.door.geometry import DoorGeometry
from service.demands.door.demand import SeenDoor, choose_door
from service.demands.door.frame import list_free_openings
from service.request.tasks.door import DoorRequest

WIDTH, THICK, HEIGHT = 0.9, 0.04, 2.0


def _frame(stop: str | None, side: float, turn: Rotation) -> tuple[DoorGeometry, list[ConvexPiece]]:
    """A shut leaf between two walls, with a strip over its free edge on one side of the leaf."""

    def piece(name: str, x: tuple[float, float], out: tuple[float, float]) -> ConvexPiece:
        corners = np.array([[side * a, b, c] for a in x for b in out for c in (0.0, 2.2)])
        return ConvexPiece(name, turn.apply(corners))

    walls = [piece("wall", (-1.0, -0.02), (-0.1, 0.02)), piece("far wall", (WIDTH + 0.02, 2.0), (-0.1, 0.02))]
    if stop is not None:
        out = (0.001, 0.03) if stop == "pull" else (-THICK - 0.03, -THICK - 0.001)
        walls.append(piece("stop", (WIDTH - 0.02, WIDTH + 0.02), out))
    along, normal = turn.apply([[side, 0.0, 0.0], [0.0, 1.0, 0.0]])
    return DoorGeometry(np.zeros(3), along, normal, 0.0, WIDTH, HEIGHT, THICK, None), walls


@settings(max_examples=25)
@given(st.sampled_from(["push", "pull"]), st.sampled_from([-1.0, 1.0]), st.floats(-180.0, 180.0))
def test_a_leaf_does_not_open_through_its_stop(stop: str, side: float, yaw: float) -> None:
    door, pieces = _frame(stop, side, Rotation.from_euler("z", yaw, degrees=True))
    assert list_free_openings(door, pieces) == (("pull",) if stop == "push" else ("push",))


@pytest.mark.parametrize(("stop", "chosen"), [("pull", "push"), ("push", "pull"), (None, None)])
def test_a_door_that_can_open_one_way_alone_is_opened_that_way(stop: str | None, chosen: str | None) -> None:
    door, pieces = _frame(stop, 1.0, Rotation.identity())
    found = choose_door(DoorRequest(), [SeenDoor(door, 0.9)], np.array([0.5, 1.0, 0.0]), pieces)
    if chosen is None:
        assert "whether the door opens by a push or a pull; say it" in str(found)
    else:
        assert isinstance(found, DoorGeometry)
        assert found.opens == chosen
