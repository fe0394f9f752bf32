"""A real server with a simulated robot: plans carried out, orders, two operators, and clients that are killed."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import grpc
import pytest
from executor_waiting import until
from planner_server import ServerProcess, planner_server

from service.client import PlannerClient, PlannerError
from service.client.answers import FinishedPlan
from service.execution.machine import Order
from service.proto.planner.v1 import execution_pb2 as wire
from service.request.file import parse_request
from service.server.operation.executions import ORDERS, PROVEN_S, ExecutionHandlers, RobotSettings
from service.store import DIRECT

pytest.importorskip("mujoco")
pytestmark = pytest.mark.filterwarnings("error")

FIXED = {"name": "atlas", "root": "fixed"}
WAIT_S = 120.0
OVER = (wire.EXECUTION_MODE_DONE, wire.EXECUTION_MODE_ABORTED, wire.EXECUTION_MODE_FALLEN, wire.EXECUTION_MODE_LOST)


def plan(client: PlannerClient, folder: Path, angle: float, **start: float) -> FinishedPlan:
    """A short reach of an arm on a fixed pelvis."""
    request = {"robot": FIXED, "goal": {"joints": {"l_arm_elx": angle}}}
    return client.plan(parse_request({**request, "start": {"joints": start}} if start else request), out=folder)


class Operator:
    """A client with the lease, whose presence a Watch call shows.

    Attributes:
        state: the newest state that was looked at.
    """

    def __init__(self, client: PlannerClient, station: str = "", *, takes_over: bool = False) -> None:
        self.client = client
        self.lease = client.take_control(station, takes_over=takes_over).lease
        self._states = client.watch(lease=self.lease, rate_hz=50.0)
        self.state = next(self._states)

    def look(self, is_wanted: Callable[[wire.WatchResponse], bool]) -> wire.WatchResponse:
        """Look until a state comes."""
        while not is_wanted(self.state):
            self.state = next(self._states)
        return self.state

    def look_for(self, *modes: int) -> wire.WatchResponse:
        return self.look(lambda state: state.status.mode in modes)

    def execute(self, made: FinishedPlan, **more: object) -> wire.ExecuteResponse:
        """Carry out a plan from the state that is there now."""
        revision = self.now().revision
        values = {"lease": self.lease, "revision": revision, "is_placed": True, **more}
        answer = self.client.execute(made.plan_id, made.result.trajectory.sha256, **values)  # type: ignore[arg-type]
        self.look(lambda state: state.revision >= answer.revision)
        return answer

    def order(self, order: str, **more: float) -> int:
        return self.client.command(order, lease=self.lease, revision=self.now().revision, **more).revision

    def now(self) -> wire.WatchResponse:
        """The state as another Watch call shows it at once."""
        return look_once(self.client)

    def leave(self) -> None:
        self._states.close()


def look_once(client: PlannerClient) -> wire.WatchResponse:
    states = client.watch()
    try:
        return next(states)
    finally:
        states.close()


@contextmanager
def refused(words: str, code: grpc.StatusCode = grpc.StatusCode.FAILED_PRECONDITION) -> Iterator[None]:
    with pytest.raises(PlannerError, match=words) as caught:
        yield
    assert caught.value.code is code


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    folder = tmp_path_factory.mktemp("robot")
    with planner_server(folder / "data", "--robot", "sim,period_ms=10,pace=0.7") as started:
        yield started


@pytest.fixture(scope="module")
def client(server: ServerProcess) -> Iterator[PlannerClient]:
    with PlannerClient(server.address) as opened:
        yield opened


@pytest.fixture(scope="module")
def made(client: PlannerClient, tmp_path_factory: pytest.TempPathFactory) -> FinishedPlan:
    finished = plan(client, tmp_path_factory.mktemp("plan") / "out", 1.2)
    assert finished.verdict == "CERTIFIED"
    return finished


@pytest.fixture
def operator(client: PlannerClient) -> Iterator[Operator]:
    """An operator of a robot at rest, who leaves it at rest."""
    operator = Operator(client, "test", takes_over=True)
    yield operator
    if look_once(client).status.mode not in (*OVER, wire.EXECUTION_MODE_IDLE):
        client.command("stop")
        assert until(lambda: look_once(client).status.mode in OVER, WAIT_S)
    operator.leave()


@pytest.mark.parametrize(
    ("kind", "age_s", "is_proven"), [(DIRECT, 1.0, True), (DIRECT, PROVEN_S + 1.0, False), ("steps", 1.0, False)]
)
def test_only_a_direct_move_that_the_server_has_just_certified_is_not_verified_again(
    kind: str, age_s: float, is_proven: bool
) -> None:
    handlers = ExecutionHandlers(RobotSettings(), None)  # type: ignore[arg-type]
    now = time.time() + 1000.0
    record = SimpleNamespace(kind=kind, created=now - age_s)
    assert handlers._is_just_proven(record, now) is is_proven  # type: ignore[arg-type]
    earlier = SimpleNamespace(kind=kind, created=handlers._begun - 1.0)  # by the server that ran before
    assert not handlers._is_just_proven(earlier, handlers._begun)  # type: ignore[arg-type]


def test_the_curve_that_is_carried_out_is_the_one_that_was_previewed(operator: Operator, made: FinishedPlan) -> None:
    answer = operator.execute(made)
    assert answer.trajectory_sha256 == made.result.trajectory.sha256
    done = operator.look_for(*OVER)
    assert done.status.mode == wire.EXECUTION_MODE_DONE
    assert done.plan.trajectory_sha256 == made.result.trajectory.sha256
    assert done.plan.certificate_sha256 == made.result.certificate.sha256
    elbow = list(done.plan.joint_names).index("l_arm_elx")
    assert done.pose.planned[elbow] == pytest.approx(1.2, abs=1e-3)
    assert done.pose.measured[elbow] == pytest.approx(1.2, abs=0.02)
    assert done.pose.ByteSize() < 1000


def test_orders_are_obeyed_and_answered_by_the_revision_of_the_state_after_them(
    operator: Operator, made: FinishedPlan
) -> None:
    operator.execute(made, waits_for_start=True)
    assert operator.now().status.mode == wire.EXECUTION_MODE_READY
    with refused("resume: the plan has not started; give the order start"):
        operator.order("resume")
    slow = operator.order("speed", speed=0.2)
    assert operator.look(lambda state: state.revision >= slow).status.speed == pytest.approx(0.2)
    for order, mode in (
        ("start", wire.EXECUTION_MODE_RUNNING),
        ("pause", wire.EXECUTION_MODE_PAUSED),
        ("resume", wire.EXECUTION_MODE_RUNNING),
    ):
        revision = operator.order(order)
        state = operator.now()
        assert (state.revision, state.status.mode) == (revision, mode)
        assert state.status.last_order == f"{order} by local (test)"
    operator.client.command(
        "shift", lease=operator.lease, revision=operator.now().revision, link="l_hand", offset_m=(0.02, 0.0, 0.0)
    )
    assert [(shift.link, list(shift.offset_m)) for shift in operator.now().status.shifts] == [("l_hand", [0.02, 0, 0])]
    with refused("offset_m: expected three finite numbers", grpc.StatusCode.INVALID_ARGUMENT):
        operator.order("shift")
    with refused("start: the plan is running; it waits for no start"):
        operator.order("start")
    with refused("another plan is running"):
        operator.execute(made)
    operator.order("abort")
    state = operator.look_for(*OVER)
    assert (state.status.mode, state.status.reason) == (wire.EXECUTION_MODE_ABORTED, "aborted by the operator")
    with refused("abort: the execution is aborted; plan again to go on"):
        operator.order("abort")


def test_every_order_of_an_execution_has_a_message() -> None:
    assert {order.value for order in Order} < set(ORDERS.values())


def test_anybody_stops_the_robot_without_lease_and_revision(
    operator: Operator, made: FinishedPlan, client: PlannerClient
) -> None:
    operator.execute(made, waits_for_start=True)
    operator.order("speed", speed=0.2)
    operator.order("start")
    client.command("stop")
    state = operator.look_for(*OVER)
    assert (state.status.mode, state.status.reason) == (wire.EXECUTION_MODE_ABORTED, "stopped by the operator")
    assert state.pose.clock_s < made.result.trajectory.times[-1]


def test_of_two_operators_one_has_control_and_stale_orders_are_refused(
    operator: Operator, made: FinishedPlan, client: PlannerClient
) -> None:
    seen = operator.now().revision
    with refused(r"local \(test\) has control since .* take it over explicitly"):
        client.take_control("other")
    other = Operator(client, "other", takes_over=True)
    with refused(r"local \(other\) has control; the one you name has ended"):
        client.execute(made.plan_id, made.result.trajectory.sha256, lease=operator.lease, revision=seen)
    with refused(r"expected_revision: the state is \d+, the order is about \d+; now local \(other\) took control over"):
        client.command("pause", lease=other.lease, revision=seen)
    with refused("pause: the robot carries out no plan|pause: the execution is"):
        other.order("pause")
    assert operator.look(lambda state: state.control.station == "other").control.name == "local"
    other.leave()


def test_a_plan_that_another_client_made_in_its_place_is_refused(
    operator: Operator, made: FinishedPlan, client: PlannerClient, tmp_path: Path
) -> None:
    again = plan(client, tmp_path / "again", 1.0)
    with refused("trajectory_sha256: plan .* it is not the plan that was looked at"):
        client.execute(
            again.plan_id, made.result.trajectory.sha256, lease=operator.lease, revision=operator.now().revision
        )
    with refused("approval: plan .* has no review"):
        operator.execute(again, approval=b"of the earlier plan")


def test_a_forgotten_start_is_refused_with_the_joint_that_is_off(
    operator: Operator, made: FinishedPlan, client: PlannerClient, tmp_path: Path
) -> None:
    operator.execute(made)
    operator.look_for(wire.EXECUTION_MODE_DONE)
    with refused("not at the plan's start: l_arm_elx is 1.2.*expected at most 0.05"):
        operator.execute(made, is_placed=False)
    assert operator.now().status.mode == wire.EXECUTION_MODE_DONE
    onward = plan(client, tmp_path / "on", 1.0, l_arm_elx=1.2)
    operator.execute(onward, is_placed=False)
    assert operator.look_for(*OVER).plan.plan_id == onward.plan_id


def test_the_robot_holds_when_its_client_is_killed_and_a_new_watch_shows_so_at_once(
    server: ServerProcess, client: PlannerClient, made: FinishedPlan
) -> None:
    client.command("release_control", lease=client.take_control("none", takes_over=True).lease)
    program = f"""
import time
from service.client import PlannerClient
client = PlannerClient({server.address!r})
lease = client.take_control("killed").lease
states = client.watch(lease=lease)
revision = next(states).revision
sha256 = {made.result.trajectory.sha256!r}
client.execute({made.plan_id!r}, sha256, lease=lease, revision=revision, is_placed=True, waits_for_start=True)
ready = next(state for state in states if state.status.mode == 3)
slow = client.command("speed", lease=lease, revision=ready.revision, speed=0.05).revision
client.command("start", lease=lease, revision=slow)
print("started", flush=True)
time.sleep(600)
"""
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as killed:
        assert killed.stdout is not None
        assert killed.stdout.readline() == "started\n"
        assert look_once(client).status.mode == wire.EXECUTION_MODE_RUNNING
        killed.send_signal(signal.SIGKILL)
    assert until(lambda: look_once(client).status.mode == wire.EXECUTION_MODE_PAUSED, WAIT_S)
    state = look_once(client)
    assert state.plan.trajectory_sha256 == made.result.trajectory.sha256
    assert state.status.last_order == "pause: local (killed) has gone (--when-alone hold)"
    assert (state.control.station, state.control.is_present) == ("killed", False)
    other = Operator(client, "rescue", takes_over=True)
    other.order("speed", speed=1.0)
    other.order("resume")
    assert other.look_for(*OVER).status.mode == wire.EXECUTION_MODE_DONE
    other.leave()


def test_orders_without_presence_or_with_wrong_values_are_refused(client: PlannerClient, made: FinishedPlan) -> None:
    taken = client.take_control("absent", takes_over=True)
    sha256 = made.result.trajectory.sha256
    with refused(r"local \(absent\) does not watch; open Watch with the lease first"):
        client.execute(made.plan_id, sha256, lease=taken.lease, revision=taken.revision)
    invalid = grpc.StatusCode.INVALID_ARGUMENT
    with refused("start_tolerance: expected above 0 and at most 0.1, got 0.5", invalid):
        client.execute(made.plan_id, sha256, lease=taken.lease, revision=taken.revision, start_tolerance=0.5)
    with refused("speed: expected 0.01 to 1, got 3", invalid):
        client.command("speed", lease=taken.lease, revision=taken.revision, speed=3.0)
    with refused("rate_hz: expected above 0", invalid):
        list(client.watch(rate_hz=0.0))
    with refused("station: expected at most 60 characters, got 61", invalid):
        client.take_control("x" * 61)


def test_the_commands_carry_out_watch_and_order(server: ServerProcess, made: FinishedPlan) -> None:
    def scopt(*arguments: str) -> subprocess.CompletedProcess[str]:
        program = "from service.cli.app import main; main()"
        command = [sys.executable, "-c", program, *arguments, "--target", server.address]
        return subprocess.run(command, capture_output=True, text=True, timeout=WAIT_S)

    executed = scopt("execute", made.plan_id, "--take-over", "--place", "--json")
    assert executed.returncode == 0, executed.stderr
    assert json.loads(executed.stdout)["verdict"] == "DONE"
    state = json.loads(scopt("watch", "--once", "--json").stdout)
    assert (state["status"]["mode"], state["plan"]["plan_id"]) == ("done", made.plan_id)
    ordered = scopt("command", "pause")
    assert ordered.returncode == 3
    assert "nobody has control of the robot; take it first" in ordered.stderr
