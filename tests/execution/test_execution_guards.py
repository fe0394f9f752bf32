"""Guards of an execution: expected forces, caps and thresholds at which it is aborted."""

from dataclasses import replace

import numpy as np
import pytest

from service.errors import ExecutionError
from service.execution.guards import Guards, GuardSettings, Severity
from service.execution.reference import ReferencePhase
from service.verify import LoadLimits, PlantedContact

PERIOD = 1e-2
SOLE = np.array([[-0.1, -0.05, 0.0], [0.1, -0.05, 0.0], [0.1, 0.05, 0.0], [-0.1, 0.05, 0.0]])
FOOT = {link: PlantedContact(link, np.eye(4), SOLE, force_cap_n=500.0) for link in ("l_foot", "r_foot")}
LOAD = LoadLimits("l_tool", ("wheel",), 40.0, 200.0)
SWING = ReferencePhase("swing", 0.0, 1.0, (FOOT["l_foot"],), ())
STAND = ReferencePhase("stand", 1.0, 2.0, (FOOT["l_foot"], FOOT["r_foot"]), ())
TURN = replace(STAND, name="turn", loads=(LOAD,))


def raise_all(forces, width):
    return {link: np.array([0.0, 0.0, force, 0.0, 0.0, 0.0])[:width] for link, force in forces.items()}


def check_for(seconds, phase, following=None, upright=None, hands=None, expected=None):
    guards, findings = Guards(), ()
    upright, expected = raise_all(upright or {}, 3), raise_all(expected or {}, 6)
    for _ in range(max(round(seconds / PERIOD), 1)):
        findings, guards = guards.check(phase, following, upright, hands or {}, expected, PERIOD)
    return findings


def test_a_foot_that_the_next_phase_plants_must_carry_force_first():
    (finding,) = check_for(0.0, SWING, STAND, {"l_foot": 1500.0, "r_foot": 3.0})
    assert (finding.severity, finding.link, finding.is_lost) == (Severity.WAIT, "r_foot", True)
    assert "'stand' needs it in contact" in finding.sentence
    assert check_for(0.0, SWING, STAND, {"l_foot": 1500.0, "r_foot": 30.0}) == ()


def test_a_foot_without_sensor_is_not_waited_for():
    assert check_for(0.0, SWING, STAND, {"l_foot": 1500.0}) == ()


def test_a_foot_that_lost_the_ground_aborts_after_the_hold_time():
    forces = {"l_foot": 1500.0, "r_foot": 0.0}
    expected = {"l_foot": 800.0, "r_foot": 750.0}
    assert check_for(0.2, STAND, None, forces, expected=expected) == ()
    (finding,) = check_for(0.4, STAND, None, forces, expected=expected)
    assert (finding.severity, finding.is_lost) == (Severity.ABORT, True)
    assert "the plan expects 750 N" in finding.sentence


def test_a_foot_that_lost_the_ground_is_waited_for_while_others_than_feet_hold_the_robot():
    seat = PlantedContact("pelvis", np.eye(4), SOLE, force_cap_n=500.0, normal=np.array([0.0, 0.0, 1.0]))
    rise = replace(STAND, contacts=(*STAND.contacts, seat))
    forces, expected = {"l_foot": 800.0, "r_foot": 0.0, "pelvis": 900.0}, {"r_foot": 750.0}
    (finding,) = check_for(0.4, rise, None, forces, expected=expected)
    assert (finding.severity, finding.link, finding.is_lost) == (Severity.WAIT, "r_foot", True)


def test_a_foot_that_the_plan_hardly_loads_may_carry_nothing():
    assert check_for(1.0, STAND, None, {"l_foot": 1500.0, "r_foot": 0.0}, expected={"r_foot": 60.0}) == ()


def test_the_cap_of_a_foot_is_that_of_all_its_corners():
    assert check_for(1.0, STAND, None, {"l_foot": 2900.0}) == ()
    (finding,) = check_for(1.0, STAND, None, {"l_foot": 3100.0})
    assert (finding.severity, finding.limit, finding.is_lost) == (Severity.ABORT, 3000.0, False)
    assert "its cap is 2000 N, abort at 3000 N" in finding.sentence


def test_a_hand_aborts_half_way_between_the_expected_force_and_the_cap():
    assert LOAD.abort_n == 120.0
    assert check_for(1.0, TURN, hands={"l_tool": 110.0}) == ()
    (finding,) = check_for(1.0, TURN, hands={"l_tool": 130.0})
    assert finding.severity is Severity.ABORT
    assert "expected 40 N, abort at 120 N, cap 200 N" in finding.sentence


def test_a_short_peak_does_not_abort():
    guards = Guards()
    for step in range(100):
        force = 300.0 if step % 20 == 0 else 50.0
        findings, guards = guards.check(TURN, None, {}, {"l_tool": force}, {}, PERIOD)
        assert findings == ()


def test_a_hand_on_a_wall_is_measured_along_its_normal():
    normal = np.array([-1.0, 0.0, 0.0])
    wall = replace(FOOT["r_foot"], link="r_hook", normal=normal)
    lean = ReferencePhase("lean", 1.0, 2.0, (FOOT["l_foot"], wall), ())
    for force, count in ((np.array([-20.0, 0.0, 0.0]), 0), (np.array([0.0, 0.0, 40.0]), 1)):
        findings, _ = Guards().check(SWING, lean, {"r_hook": force}, {}, {}, PERIOD)
        assert len(findings) == count


def test_the_share_moves_the_threshold_of_a_load_up_to_its_cap():
    guards = Guards(GuardSettings(load_share=1.0, hold_s=0.0))
    assert guards.check(TURN, None, {}, {"l_tool": 190.0}, {}, PERIOD)[0] == ()
    assert len(guards.check(TURN, None, {}, {"l_tool": 210.0}, {}, PERIOD)[0]) == 1


@pytest.mark.parametrize("kwargs", [{"touch_n": 0.0}, {"lost_share": 1.0}, {"hold_s": -0.1}])
def test_limits_that_make_no_sense_are_refused(kwargs):
    with pytest.raises(ExecutionError, match="expected positive forces"):
        GuardSettings(**kwargs)


def test_a_force_that_grew_to_its_cap_counts_until_it_is_below_its_threshold():
    guards, kinds = Guards(), []
    for force in [50.0, *np.linspace(60.0, 260.0, 10), *np.linspace(260.0, 100.0, 10)]:
        findings, guards = guards.check(TURN, None, {}, {"l_tool": force}, {}, PERIOD)
        kinds.append(bool(findings))
    first = kinds.index(True)
    assert kinds[first:-2] == [True] * len(kinds[first:-2])
    assert kinds[-1] is False
