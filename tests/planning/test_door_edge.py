"""Pulling an ajar leaf by its free edge: where the rod is, which gap it needs, and whether physics opens the leaf."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from given_doors import door_request
from hypothesis import given
from hypothesis import strategies as st
from shared_plans import write_undrawn

from perception.detect.door.geometry import UP, DoorGeometry
from service.demands.door.phases import Push
from service.demands.hands import HANDS, PEG_FROM_END
from service.demands.holds.door_edge import (
    EDGE_LEAN,
    EDGE_TILT,
    MOST_SLANT,
    hold_edge,
    make_edge_load,
    measure_edge_gap,
)
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.result.result import PlanResult, Verdict
from service.simulation.options import SimulationOptions
from service.simulation.simulate import simulate

FREE_ROD = 0.065  # of Atlas's hook [m]


def ajar_request(ajar: float, kind: str | None = "knob", **more: Any) -> dict[str, Any]:
    request = door_request(opens="pull", x=0.9, **more)
    door = request["task"]["door"]
    request["start"] = {"posture": "stand"}
    door["leaf"]["ajar_deg"] = ajar
    if kind is None:
        del door["handle"]
    else:
        door["handle"]["kind"] = kind
    return request


def make_geometry(angle: float, width: float, thickness: float, is_left: bool) -> DoorGeometry:
    normal = np.array([-np.cos(angle), -np.sin(angle), 0.0])
    along = np.cross(UP, normal) * (1.0 if is_left else -1.0)
    return DoorGeometry(np.array([0.9, 0.4, 0.01]), along, normal, 0.0, width, 2.0, thickness, "pull", 0.3)


@given(
    angle=st.floats(-1.0, 1.0),
    width=st.floats(0.6, 1.1),
    thickness=st.floats(0.02, 0.06),
    is_left=st.booleans(),
    slant=st.floats(-MOST_SLANT, MOST_SLANT),
    lean=st.floats(-EDGE_TILT, EDGE_TILT),
)
def test_the_rod_touches_nothing_of_the_leaf_but_its_back_corner(
    angle: float, width: float, thickness: float, is_left: bool, slant: float, lean: float
) -> None:
    """Whatever its lean; and what it presses with is within atan(0.3) of the way on which the corner moves."""
    geometry = make_geometry(angle, width, thickness, is_left)
    push = Push(HANDS["left"], width, 1.0, 0.6, slant)
    motion, _, normal = hold_edge(geometry, push)
    aside = np.cross(UP, motion.axis)
    axis = motion.axis * np.cos(lean) + aside / np.linalg.norm(aside) * np.sin(lean)
    rod = motion.place + np.linspace(PEG_FROM_END - FREE_ROD, PEG_FROM_END, 60)[:, None] * axis
    off = np.column_stack([rod @ geometry.along - width, -thickness - rod @ geometry.normal])
    inside = np.maximum(off, 0.0)
    distance = np.where((off > 0.0).any(axis=1), np.hypot(*inside.T), off.max(axis=1))
    nearest = int(np.argmin(distance))
    assert -2e-3 < distance[nearest] - HANDS["left"].peg_radius < 3e-3
    assert abs(rod[nearest] @ geometry.along - width) < 0.012
    way = np.cross(geometry.hinge_axis, motion.place)
    pressed = np.cross(axis, UP) * np.sign(np.cross(axis, UP) @ normal)
    assert pressed @ way / (np.linalg.norm(way) * np.linalg.norm(pressed)) > np.cos(np.arctan(0.3))


def test_the_force_at_the_edge_has_the_moment_of_the_hinge() -> None:
    geometry = make_geometry(0.0, 0.9, 0.04, is_left=True)
    motion, _, normal = hold_edge(geometry, Push(HANDS["right"], 0.9, 1.0, 0.6, 0.0))
    load = make_edge_load(geometry, motion, normal, 30.0)
    assert np.cross(load.place, load.force) @ geometry.hinge_axis == pytest.approx(30.0)


def test_the_gap_is_how_far_the_back_corner_has_moved_out() -> None:
    """The corner of a leaf 0.9 m wide and 4 cm thick: 0.9 sin(30 deg) + 0.04 (1 - cos(30 deg))."""
    geometry = make_geometry(0.0, 0.9, 0.04, is_left=True)
    assert measure_edge_gap(geometry, 0.0) == 0.0
    assert measure_edge_gap(geometry, np.pi / 6.0) == pytest.approx(0.45 + 0.04 * (1.0 - np.sqrt(0.75)))
    assert EDGE_TILT < EDGE_LEAN  # the rod's end stays off the leaf


@pytest.mark.parametrize(("kind", "words"), [("knob", "the door has a knob"), (None, "no handle to pull it by")])
def test_a_gap_too_narrow_for_the_hand_is_named_with_its_width(kind: str | None, words: str) -> None:
    result = plan(parse_request(ajar_request(5.5, kind)))
    assert result.verdict is Verdict.NOT_FOUND
    assert any(words in line for line in result.explanation)
    assert any("the free edge and the frame is 86 mm" in line for line in result.explanation)


@pytest.fixture(scope="module")
def pulled() -> PlanResult:
    """A leaf with a knob, 14 deg ajar, pulled open to 35."""
    return plan(parse_request(ajar_request(14.0, open_deg=35.0)))


def test_an_ajar_leaf_with_a_knob_is_pulled_by_its_edge(pulled: PlanResult, tmp_path: Path) -> None:
    assert pulled.verdict is Verdict.CERTIFIED, pulled.explanation
    assert [phase.name for phase in pulled.motion.phases] == ["reach", "touch", "push", "retract"]
    folder = write_undrawn(pulled, tmp_path / "out")
    again = verify_result(folder)
    assert again["verdict"] == "CERTIFIED", again["explanation"]
    (leaf,) = simulate(folder, SimulationOptions(settle_s=0.3, after_s=0.5), output=tmp_path / "there.json")[
        "mechanism"
    ]
    assert leaf["share"] == pytest.approx(1.0, abs=0.05)
