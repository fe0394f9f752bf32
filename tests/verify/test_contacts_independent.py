"""Motions that change contacts, checked with other code: slip, touch and forces of the example requests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from contact_replay import ContactReplay
from shared_plans import write_example
from viewer_results import unpack

from service.viewer.payload import make_payload
from service.viewer.placements import LinkPlacements

MOST_SLIP_M, MOST_GAP_M = 1.1e-3, 3e-3
MOST_MISSING = 1e-4  # share of the weight
EXAMPLES = ("steps", "chair", "stair")


@pytest.fixture(params=EXAMPLES)
def replay(request: pytest.FixtureRequest) -> ContactReplay:
    return ContactReplay.of(write_example(request.param))


@pytest.fixture
def steps() -> ContactReplay:
    return ContactReplay.of(write_example("steps"))


def _measure_slip(replay: ContactReplay) -> float:
    return max(replay.measure_slip(phase, c) for phase in replay.data["phases"] for c in phase["contacts"])


def _measure_gap(replay: ContactReplay) -> float:
    return max(replay.measure_gap(contact) for phase in replay.data["phases"] for contact in phase["contacts"])


def _find_missing(replay: ContactReplay, seed: int = 0, count: int = 4) -> float:
    rng = np.random.default_rng(seed)
    phases = replay.data["phases"]
    return max(
        replay.find_missing_force(phase, time) for phase in phases for time in replay.pick_times(phase, rng, count)
    )


def test_kept_contacts_stay_touch_and_carry_the_motion(replay: ContactReplay) -> None:
    assert _measure_slip(replay) <= MOST_SLIP_M
    assert _measure_gap(replay) <= MOST_GAP_M
    assert _find_missing(replay) <= MOST_MISSING


def test_every_phase_of_the_request_is_there(replay: ContactReplay) -> None:
    planted = [len(phase["contacts"]) for phase in replay.data["phases"]]
    assert all(planted)
    assert len(set(planted)) > 1  # contacts come and go


def test_the_page_draws_forces_and_regions_of_every_phase(replay: ContactReplay) -> None:
    data, rows = replay.data, np.array(replay.data["com"])
    weight = 9.81 * sum(inertia.mass for inertia in replay.model.inertias[1:])
    frames = LinkPlacements((), np.zeros((len(rows), 0, 7)))
    payload = make_payload({**data, "bodies": []}, frames)
    for phase, drawn in zip(data["phases"], payload["phases"], strict=True):
        (region,) = drawn["regions"]
        assert region["margin_m"] == phase["region_margin_m"] == pytest.approx(0.02)
        points = [point for contact in phase["contacts"] for point in contact["sole"]]
        assert np.allclose(region["places"], points)
        forces = unpack(region["forces"])
        assert np.isfinite(forces).all()
        assert np.allclose(forces.sum(axis=1), [0.0, 0.0, weight], atol=0.1)


def _hardly_any_friction(replay: ContactReplay) -> None:
    for phase in replay.data["phases"]:
        for contact in phase["contacts"]:
            contact["friction"] = 2e-3


def _weak_contacts(replay: ContactReplay) -> None:
    for phase in replay.data["phases"]:
        for contact in phase["contacts"]:
            contact["force_cap_n"] = 100.0


def _one_foot_from_the_start(replay: ContactReplay) -> None:
    replay.data["phases"][0]["contacts"].pop()


def _leaning_surfaces(replay: ContactReplay) -> None:
    for phase in replay.data["phases"]:
        for contact in phase["contacts"]:
            contact["normal"] = [np.sin(0.7), 0.0, np.cos(0.7)]


def _ten_times_as_fast(replay: ContactReplay) -> None:
    law = replay.data["curve"]["law"]
    law["times"] = [0.1 * time for time in law["times"]]
    law["speed"] = [10.0 * speed for speed in law["speed"]]
    replay.table[:, 0] *= 0.1


@pytest.mark.parametrize(
    "lie", [_hardly_any_friction, _weak_contacts, _one_foot_from_the_start, _leaning_surfaces, _ten_times_as_fast]
)
def test_forces_are_missing_where_contacts_cannot_make_them(
    steps: ContactReplay, lie: Callable[[ContactReplay], None]
) -> None:
    lie(steps)
    assert _find_missing(steps) > 10.0 * MOST_MISSING


def test_a_foot_that_is_moved_slips(steps: ContactReplay) -> None:
    table = steps.table.copy()
    table[len(table) // 2, 1] += 0.004
    assert _measure_slip(replace(steps, table=table)) > MOST_SLIP_M


def test_a_foot_in_the_air_slips(steps: ContactReplay) -> None:
    shift, lift = steps.data["phases"][:2]
    lift["contacts"] = shift["contacts"]
    assert _measure_slip(steps) > 10.0 * MOST_SLIP_M


@pytest.mark.parametrize("offset", [[0.0, 0.0, 0.01], [0.25, 0.0, 0.0]])
def test_contact_points_off_their_stone_leave_a_gap(steps: ContactReplay, offset: list[float]) -> None:
    contact = steps.data["phases"][-1]["contacts"][0]
    contact["sole"] = (np.array(contact["sole"]) + offset).tolist()
    assert _measure_gap(steps) > MOST_GAP_M
