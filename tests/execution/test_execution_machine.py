"""State machine of an execution: phases in order, guards, pause, resume, abort."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.errors import ExecutionError
from service.execution.balance import PlannedBalance
from service.execution.guards import Finding, Severity
from service.execution.machine import FREE_S, ExecutionMachine, MachineSettings, MachineState, Mode, Order
from service.verify import Carrier, Phase, PlantedContact

PERIOD = 1e-2
ENDS = (1.0, 1.8, 3.0)


@dataclass(frozen=True)
class Stretch:
    name: str
    begin_s: float
    end_s: float
    rests: bool = True
    retreat_s: float | None = None


PHASES = tuple(Stretch(f"phase {k}", ([0.0, *ENDS])[k], end) for k, end in enumerate(ENDS))
WAIT = Finding(Severity.WAIT, "r_foot", 0.0, 25.0, "r_foot is in the air", True)
LOST = Finding(Severity.ABORT, "r_foot", 0.0, 50.0, "r_foot is lost", True)
FALL = Finding(Severity.STOP, "", 0.0, 0.0, "the pelvis leans")


def square(x, half=0.1):
    corners = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
    return corners + np.array([x, 0.0, 0.0])


def planted(link, x):
    pose = np.eye(4)
    return PlantedContact(link, pose, square(x))


def balance_of(margins):
    """Balance with given margins at ten times per second; both feet in phase 0 and 2, the left one alone in phase 1."""
    both, left = (planted("l_foot", 0.0), planted("r_foot", 0.5)), (planted("l_foot", 0.0),)
    phases = tuple(
        Phase(stretch.name, stretch.begin_s, stretch.end_s, contacts)
        for stretch, contacts in zip(PHASES, (both, left, both), strict=True)
    )
    times = np.arange(0.0, 3.01, 0.1)
    index = np.searchsorted(ENDS[:-1], times, side="right")
    # The centre of mass goes from between the feet over the left one and back.
    x = np.where(index == 1, 0.0, 0.25)
    com, feet = np.stack([x, 0 * x], axis=1), ("l_foot", "r_foot")
    return PlannedBalance(times, com, np.array([margins(t) for t in times]), index, phases, feet)


def run(machine, schedule=None, findings=lambda state: (), limit_s=30.0, state=None):
    """Run until the execution is over; ``schedule`` maps a time to an order.  Returns all states."""
    states, pending, time = [state or MachineState()], dict(schedule or {}), 0.0
    while not states[-1].is_over and time < limit_s:
        time += PERIOD
        order = next((pending.pop(at) for at in list(pending) if at <= time), None)
        states.append(machine.step(states[-1], findings(states[-1]), order, PERIOD))
    return states


def find_mode(states, mode):
    return [state for state in states if state.mode is mode]


def check_smooth(states, settings):
    rates = np.array([state.rate for state in states])
    jumps = np.abs(np.diff(rates))
    # The clock may stop at once at borders only, where all motion rests.
    at_border = np.isclose([state.time_s for state in states[1:]], [[end] for end in ENDS], atol=1e-9).any(axis=0)
    is_over = np.array([state.is_over for state in states[1:]])
    assert np.all(jumps[~at_border & ~is_over] <= settings.speed / settings.ramp_s * PERIOD + 1e-9)
    assert np.all(np.abs(rates) <= settings.speed + 1e-12)
    times = np.array([state.time_s for state in states])
    assert np.abs(np.diff(times)).max() <= settings.speed * PERIOD + 1e-9


def test_phases_run_in_their_order_to_the_end():
    machine = ExecutionMachine(PHASES, None)
    states = run(machine)
    assert [k for k in range(3) if any(state.phase == k for state in states)] == [0, 1, 2]
    assert np.all(np.diff([state.phase for state in states]) >= 0)
    assert (states[-1].mode, states[-1].time_s, states[-1].rate) == (Mode.DONE, 3.0, 0.0)
    assert len(states) * PERIOD == pytest.approx(3.0 + 0.15, abs=0.03)  # the ramp costs half of its time
    check_smooth(states, machine.settings)


def test_half_the_speed_takes_twice_the_time():
    states = run(ExecutionMachine(PHASES, None, MachineSettings(speed=0.5)))
    assert len(states) * PERIOD == pytest.approx(6.0 + 0.15, abs=0.05)


@pytest.mark.parametrize("at", [0.05, 0.5, 1.0, 1.4, 2.5])
def test_a_pause_in_any_phase_stops_the_clock_smoothly_and_resume_goes_on(at):
    machine = ExecutionMachine(PHASES, None)
    states = run(machine, {at: Order.PAUSE, at + 1.0: Order.RESUME})
    still = [state.time_s for state in find_mode(states, Mode.PAUSED) if state.rate == 0.0]
    assert len(still) > 0.5 / PERIOD
    assert max(still) == min(still)
    assert states[-1].mode is Mode.DONE
    check_smooth(states, machine.settings)


@pytest.mark.parametrize("order", [Order.PAUSE, Order.STOP, Order.ABORT])
def test_the_clock_does_not_stop_at_once_at_a_border_through_which_the_robot_moves(order):
    phases = (replace(PHASES[0], rests=False), *PHASES[1:])
    machine = ExecutionMachine(phases, None)
    states = run(machine, {1.05: order}, findings=lambda state: (WAIT,) if state.phase == 0 else (), limit_s=3.0)
    assert 1.0 < max(state.time_s for state in states) < 1.3
    rates = np.array([state.rate for state in states])
    assert np.abs(np.diff(rates)).max() <= machine.settings.speed / machine.settings.ramp_s * PERIOD + 1e-9
    assert {0, 1} == {state.phase for state in states}


@pytest.mark.parametrize("at", [0.5, 1.4, 2.5])
def test_an_abort_in_balance_stops_where_the_clock_can_come_to_rest(at):
    machine = ExecutionMachine(PHASES, balance_of(lambda t: 0.1))
    states = run(machine, {at: Order.ABORT})
    begun = next(state for state in states if state.mode is Mode.RETURNING)
    assert states[-1].mode is Mode.ABORTED
    assert 0.0 <= states[-1].time_s - begun.time_s <= 0.2
    assert states[-1].reason == "aborted by the operator"
    check_smooth(states, machine.settings)


@pytest.mark.parametrize("at", [0.8, 1.4, 2.5])
def test_an_abort_out_of_balance_goes_back_to_the_last_pose_in_balance(at):
    machine = ExecutionMachine(PHASES, balance_of(lambda t: 0.1 if t <= 0.5 else 0.01))
    states = run(machine, {at: Order.ABORT})
    assert states[-1].mode is Mode.ABORTED
    assert states[-1].time_s == pytest.approx(0.5, abs=2e-3)
    assert states[-1].phase == 0
    check_smooth(states, machine.settings)


@pytest.mark.parametrize("is_object", [False, True])
def test_an_abort_neither_takes_hold_again_of_what_a_hand_let_go_nor_lets_go_what_it_took(is_object):
    balance = balance_of(lambda t: 0.1 if t <= 0.5 else 0.02 - 0.01 * abs(t - 2.5))
    first, *others = balance.phases
    if is_object:
        others = [replace(phase, carriers=(Carrier("cup", "r_hand"),)) for phase in others]
    else:
        first = replace(first, contacts=(*first.contacts, planted("r_hand", 0.2)))
    balance = replace(balance, phases=(first, *others))
    states = run(ExecutionMachine(PHASES, balance), {2.8: Order.ABORT})
    assert states[-1].mode is Mode.ABORTED
    assert states[-1].time_s == pytest.approx(2.5, abs=2e-3)


def test_without_any_pose_of_the_required_margin_an_abort_takes_the_largest():
    machine = ExecutionMachine(PHASES, balance_of(lambda t: 0.02 - 0.01 * abs(t - 0.4)))
    states = run(machine, {2.0: Order.ABORT})
    assert states[-1].time_s == pytest.approx(0.4, abs=2e-3)


def test_an_abort_for_a_lost_foot_goes_back_to_where_the_others_hold_the_robot():
    machine = ExecutionMachine(PHASES, balance_of(lambda t: 0.1))
    states = run(machine, findings=lambda state: (LOST,) if state.phase == 2 else ())
    assert states[-1].mode is Mode.ABORTED
    assert states[-1].reason == "r_foot is lost"
    assert states[-1].time_s == pytest.approx(1.7, abs=0.02)  # the last sample over the left foot


def test_a_phase_waits_for_what_the_next_one_needs():
    machine, cleared = ExecutionMachine(PHASES, None), []

    def findings(state):
        if state.mode is Mode.WAITING:
            cleared.append(state)
        return (WAIT,) if state.phase == 1 and len(cleared) < 50 else ()

    states = run(machine, findings=findings)
    waiting = find_mode(states, Mode.WAITING)
    assert {state.time_s for state in waiting} == {ENDS[1]}
    assert {state.reason for state in waiting} == {"r_foot is in the air"}
    assert states[-1].mode is Mode.DONE
    check_smooth(states, machine.settings)


def test_a_wait_that_takes_too_long_is_aborted():
    machine = ExecutionMachine(PHASES, balance_of(lambda t: 0.1), MachineSettings(wait_s=0.5))
    states = run(machine, findings=lambda state: (WAIT,) if state.phase == 1 else ())
    assert states[-1].mode is Mode.ABORTED
    assert states[-1].reason == "r_foot is in the air"
    assert len(find_mode(states, Mode.WAITING)) * PERIOD == pytest.approx(0.5, abs=0.03)


def test_a_pause_at_the_end_of_a_phase_does_not_slip_into_the_next_one():
    machine = ExecutionMachine(PHASES, None)
    states = run(machine, {0.98 + 0.15: Order.PAUSE}, lambda state: (WAIT,) if state.phase == 0 else (), limit_s=5.0)
    assert max(state.time_s for state in states) == ENDS[0]
    assert states[-1].phase == 0


def test_a_fall_ends_the_execution_at_once():
    states = run(ExecutionMachine(PHASES, None), findings=lambda state: (FALL,) if state.time_s > 1.2 else ())
    assert (states[-1].mode, states[-1].reason) == (Mode.FALLEN, "the pelvis leans")
    assert states[-1].time_s == pytest.approx(1.2, abs=0.02)


@given(
    times=st.lists(st.floats(0.0, 5.0), min_size=1, max_size=6, unique=True),
    orders=st.lists(st.sampled_from([Order.PAUSE, Order.RESUME]), min_size=6, max_size=6),
    abort=st.one_of(st.none(), st.floats(0.0, 5.0)),
)
def test_whatever_the_operator_does_the_clock_stays_smooth_and_in_the_plan(times, orders, abort):
    machine = ExecutionMachine(PHASES, balance_of(lambda t: 0.1 if t < 1.5 else 0.01))
    schedule = dict(zip(times, orders, strict=False)) | ({} if abort is None else {abort: Order.ABORT})
    states = run(machine, schedule, limit_s=8.0)
    check_smooth(states, machine.settings)
    for state in states:
        phase = PHASES[state.phase]
        assert phase.begin_s - 1e-9 <= state.time_s <= phase.end_s + PERIOD


@pytest.mark.parametrize("mode", [Mode.DONE, Mode.ABORTED, Mode.FALLEN, Mode.RETURNING])
def test_orders_are_refused_once_an_execution_is_over_or_aborted(mode):
    with pytest.raises(ExecutionError, match=r"plan again|was aborted"):
        ExecutionMachine(PHASES, None).check_order(MachineState(mode=mode), Order.RESUME)


@pytest.mark.parametrize(
    "kwargs", [{"speed": 0.0}, {"speed": 1.5}, {"ramp_s": 0.0}, {"load_ramp_s": 0.0}, {"wait_s": -1.0}]
)
def test_settings_that_make_no_sense_are_refused(kwargs):
    with pytest.raises(ExecutionError, match="expected"):
        MachineSettings(**kwargs)


@pytest.mark.parametrize("before", [None, Order.PAUSE, Order.ABORT])
@pytest.mark.parametrize("at", [0.5, 1.4, 2.5])
def test_a_stop_comes_to_rest_where_the_clock_is_and_ends_the_execution_there(at, before):
    machine = ExecutionMachine(PHASES, balance_of(lambda t: 0.1 if t < 0.2 else 0.01))
    schedule = {at + 0.1: Order.STOP} | ({} if before is None else {at: before})
    states = run(machine, schedule)
    assert (states[-1].mode, states[-1].rate, states[-1].reason) == (Mode.ABORTED, 0.0, "stopped by the operator")
    assert states[-1].time_s == pytest.approx(at + 0.1, abs=0.25)
    assert len(states) * PERIOD < at + 0.6
    check_smooth(states, machine.settings)
    machine.check_order(MachineState(mode=Mode.RETURNING), Order.STOP)


@given(
    speed=st.floats(0.01, 1.0), at=st.floats(0.1, 2.5), order=st.sampled_from([Order.PAUSE, Order.ABORT, Order.STOP])
)
def test_a_clock_whose_speed_was_lowered_still_comes_to_rest_in_its_ramp(speed, at, order):
    fast = ExecutionMachine(PHASES, balance_of(lambda t: 0.1))
    state = run(fast, limit_s=at)[-1]
    slow = ExecutionMachine(PHASES, fast.balance, MachineSettings(speed=speed))
    begin, n_cycles = state.time_s, 0
    state = slow.step(state, (), order, PERIOD)
    goal = state.goal_s
    while state.rate != 0.0 and not state.is_over:
        state, n_cycles = slow.step(state, (), None, PERIOD), n_cycles + 1
    ramp_s = slow.settings.ramp_s
    if order is Order.ABORT:
        assert goal - begin <= ramp_s
    else:
        assert state.time_s - begin <= ramp_s
        assert n_cycles * PERIOD <= ramp_s * (1.0 + np.log(1.0 / speed)) + 0.1


def jam(at, free_at):
    """Findings of a hand that presses too hard from a time of the plan on, until it is back at another one."""
    words = "r_tool presses with 90 N"
    load = Finding(Severity.ABORT, "r_tool", 90.0, 30.0, words, is_load=True)
    seen = []

    def findings(state):
        seen.extend([state] if state.time_s >= at else [])
        return (load,) if seen and state.time_s > free_at else ()

    return findings


@pytest.mark.parametrize("free_at", [1.75, 1.5, 1.1])
def test_a_hand_that_presses_too_hard_goes_back_until_it_no_longer_does(free_at):
    machine = ExecutionMachine(PHASES, balance_of(lambda t: 0.1))
    states = run(machine, findings=jam(1.7, free_at))
    begun = next(state for state in states if state.mode is Mode.RETURNING)
    furthest = max(state.time_s for state in states)
    assert furthest - begun.time_s <= 0.5 * machine.settings.load_ramp_s + PERIOD
    assert states[-1].mode is Mode.ABORTED
    assert states[-1].reason == "r_tool presses with 90 N"
    assert free_at - FREE_S - 2.0 * PERIOD <= states[-1].time_s <= free_at
    check_smooth(states, replace(machine.settings, ramp_s=machine.settings.load_ramp_s))


def test_a_hand_that_presses_too_hard_all_the_way_back_stops_where_the_robot_rested_last():
    states = run(ExecutionMachine(PHASES, balance_of(lambda t: 0.1)), findings=jam(1.7, 0.0))
    assert states[-1].mode is Mode.ABORTED
    assert states[-1].time_s == pytest.approx(ENDS[0], abs=2e-3)
    assert {state.phase for state in states if state.mode is Mode.RETURNING} == {1}


def test_a_hand_that_was_freed_does_not_go_back_for_what_it_presses_then():
    findings = jam(1.7, 1.6)
    states = run(
        ExecutionMachine(PHASES, balance_of(lambda t: 0.1)),
        findings=lambda state: (
            findings(state) or (jam(0.0, 0.0)(state) if state.time_s < 1.55 and state.rate < 0 else ())
        ),
    )
    assert states[-1].mode is Mode.ABORTED
    assert states[-1].time_s > 1.45


def test_a_retreat_goes_back_to_the_rest_of_its_phase_and_is_refused_where_none_is_free():
    phases = tuple(replace(own, retreat_s=rest) for own, rest in zip(PHASES, (0.0, None, 1.8), strict=True))
    machine = ExecutionMachine(phases, balance_of(lambda t: 0.1))
    for at, goal in ((0.5, 0.0), (2.5, 1.8)):
        for before in ({}, {at - 0.2: Order.ABORT}):
            states = run(machine, {**before, at: Order.RETREAT})
            assert states[-1].mode is Mode.ABORTED
            assert states[-1].time_s == pytest.approx(goal, abs=2e-3)
            check_smooth(states, machine.settings)
    hold = Finding(Severity.HOLD, "r_arm", 0.0, 0.0, "an encoder has failed")
    states = run(machine, {0.8: Order.RETREAT}, lambda state: (hold,) if state.rate < -0.3 else ())
    assert (states[-1].mode, states[-1].reason) == (Mode.ABORTED, "an encoder has failed")
    assert states[-1].time_s > 0.2
    pressing = MachineState(time_s=1.4, phase=1, rate=1.0)
    with pytest.raises(ExecutionError, match="retreat: in 'phase 1' hands press"):
        machine.check_order(pressing, Order.RETREAT)
    assert machine.step(pressing, (), Order.RETREAT, PERIOD).mode is Mode.RUNNING
