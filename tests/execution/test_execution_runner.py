"""The control loop of a robot: orders between cycles, answers after them, and its end when the service has gone."""

from __future__ import annotations

import json
import socket
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from executor_waiting import until
from small_plan import small_plan

from service.errors import ExecutionError, RequestError
from service.execution.driver import JointCommand
from service.execution.reference import PlannedReference
from service.execution.settings import ExecutionSettings
from service.execution.tracking import KinematicRobot
from service.work.robot import runner as runner_module
from service.work.robot.load import LoadedPlan, hash_motion
from service.work.robot.robot import open_robot
from service.work.robot.runner import Runner
from service.work.robot.simulated import open_simulated
from service.work.robot.udp import UdpDriver, open_udp

PERIOD = 1e-2


class StillRobot:
    """A robot without dynamics that waits for no clock; implements ``Robot``."""

    is_simulated = True

    def __init__(self) -> None:
        self.is_closed = False

    def drive(self, reference, folder, is_placed, tolerance):
        return KinematicRobot(reference.joint_names, reference.at(0.0).q, PERIOD)

    def follow(self, phase):
        pass

    def pose_world_base(self):
        return None

    def close(self):
        self.is_closed = True


class Service:
    """The other end of a runner: what it was told.

    Attributes:
        told: all messages, in their order.
    """

    def __init__(self, *, holds_alone: bool) -> None:
        self.told: list[dict] = []
        self.robot = StillRobot()
        self.runner = Runner(self.robot, self.told.append, holds_alone=holds_alone)
        self._thread = Thread(target=self.runner.run, daemon=True)
        self._thread.start()
        self._n = 0

    def order(self, order: str, **values: object) -> dict:
        """Give an order; the answer."""
        self._n += 1
        number = self._n
        self.runner.give({"id": number, "order": order, "by": f"{order} by ann", **values})
        assert until(lambda: any(message.get("id") == number for message in list(self.told)))
        return next(message for message in self.told if message.get("id") == number)

    def execute(self, **more: object) -> dict:
        values = {"folder": "/", "plan_id": "p", "trajectory_sha256": "t", "certificate_sha256": "c"}
        return self.order(
            "execute", **values, start_tolerance=0.05, **{"waits_for_start": False, "is_placed": False, **more}
        )

    @property
    def status(self) -> dict:
        return next(message["status"] for message in reversed(list(self.told)) if "status" in message)

    def leave(self) -> None:
        """Go away, and wait until the robot has ended."""
        self.runner.leave_alone()
        self._thread.join(60.0)
        assert not self._thread.is_alive()


@pytest.fixture(scope="module")
def reference():
    return PlannedReference(small_plan().motion)


@pytest.fixture
def loaded(reference, monkeypatch):
    """Loading a plan gives the small one."""
    plan = LoadedPlan(reference, ExecutionSettings(), Path("/"), hash_motion(reference.motion), "s")
    monkeypatch.setattr(runner_module, "load_plan", lambda folder, sha256, **more: plan)
    return plan


@pytest.mark.parametrize(
    ("last", "mode_then", "reason"),
    [("stop", "holding", "stopped by the operator"), ("retreat", "returning", "retreats by the operator's order")],
)
def test_an_order_is_answered_after_the_state_that_it_led_to(loaded, last, mode_then, reason):
    service = Service(holds_alone=True)
    assert (service.status["mode"], service.status["held"]) == ("idle", [])
    answer = service.execute(waits_for_start=True)
    assert (answer["error"], answer["trajectory_sha256"]) == ("", loaded.trajectory_sha256)
    assert (service.status["mode"], service.status["last_order"]) == ("ready", "execute by ann")
    service.order("speed", speed=0.01)
    for order, mode in (("start", "running"), ("pause", "paused"), ("resume", "running"), (last, mode_then)):
        assert service.order(order)["error"] == ""
        before = service.told[: next(k for k, m in enumerate(service.told) if m.get("id") == service._n)]
        assert [m["status"]["mode"] for m in before if "status" in m][-1] == mode
    assert until(lambda: service.status["mode"] == "aborted")
    assert service.status["reason"] == reason
    service.leave()


def test_a_shifted_target_is_told_until_it_is_taken_back(loaded):
    service = Service(holds_alone=True)
    hand = "l_hand"
    service.execute(waits_for_start=True)
    early = service.order("shift", link=hand, offset_m=[0.1, 0.0, 0.0])["error"]
    assert early == "shift: the execution is ready; expected one that runs or is paused"
    service.order("speed", speed=0.01)
    service.order("start")
    assert service.order("shift", link=hand, offset_m=[0.1, 0.0, 0.0])["error"] == ""
    assert (service.status["shifts"], service.status["last_order"]) == ({hand: [0.1, 0.0, 0.0]}, "shift by ann")
    assert "expected at most 0.3 m" in service.order("shift", link=hand, offset_m=[0.4, 0.0, 0.0])["error"]
    assert "unknown link 'nose'" in service.order("shift", link="nose", offset_m=[0.1, 0.0, 0.0])["error"]
    assert service.order("shift", link=hand, offset_m=[0.0, 0.0, 0.0])["error"] == ""
    assert service.status["shifts"] == {}
    service.order("stop")
    service.leave()


def test_orders_that_make_no_sense_are_refused_in_a_sentence(loaded, monkeypatch):
    service = Service(holds_alone=True)
    assert service.order("pause")["error"] == "pause: the robot carries out no plan"
    service.execute(waits_for_start=True)
    assert service.order("resume")["error"] == "resume: the plan has not started; give the order start"
    assert service.order("speed", speed=0.0)["error"].startswith("speed 0, return_speed")
    service.order("start")
    assert service.order("start")["error"] == "start: the plan is running; it waits for no start"
    assert service.execute()["error"] == "another plan is running; stop it, or wait until it is done"
    service.order("stop")
    assert until(lambda: service.status["mode"] == "aborted")

    def fail(folder, sha256, **more):
        raise ValueError("a file that nobody thought of")

    monkeypatch.setattr(runner_module, "load_plan", fail)
    assert service.execute()["error"] == "the plan cannot be read: ValueError"
    assert service.status["mode"] == "aborted"
    service.leave()


@pytest.mark.parametrize(("holds_alone", "mode"), [(True, "paused"), (False, "done")])
def test_a_robot_whose_service_has_gone_holds_or_finishes(loaded, holds_alone, mode):
    service = Service(holds_alone=holds_alone)
    service.execute()
    service.leave()
    assert service.status["mode"] == mode
    assert service.robot.is_closed


def test_a_pose_has_measured_and_planned_joints_in_one_order(loaded, reference):
    service = Service(holds_alone=True)
    service.execute(waits_for_start=True)
    plan = next(message["plan"] for message in service.told if "plan" in message)
    assert plan["joint_names"] == list(reference.joint_names)
    pose = next(message["pose"] for message in service.told if "pose" in message)
    np.testing.assert_allclose(pose["planned"], reference.at(0.0).q, atol=1e-5)
    np.testing.assert_allclose(pose["measured"], pose["planned"], atol=1e-5)
    assert len(pose["planned_base"]) == 7
    json.dumps(service.told)
    service.leave()


def test_a_robot_that_does_not_exist_or_an_option_that_is_wrong_is_refused():
    with pytest.raises(RequestError, match="unknown robot 'simm'; expected sim"):
        open_robot("simm")
    with pytest.raises(RequestError, match="expected NAME,key=value"):
        open_robot("sim,fast")
    with pytest.raises(RequestError, match="udp: port: expected 1 to 65535, got ''"):
        open_udp({})
    pytest.importorskip("mujoco")
    wrong = [
        ({"pase": "1"}, "unknown option 'pase'; expected pace"),
        ({"pace": "x"}, "expected a number"),
        ({"pace": "nan"}, "expected a finite"),
        ({"period_ms": "50"}, "expected 1 to 20"),
    ]
    for options, words in wrong:
        with pytest.raises(RequestError, match=words):
            open_simulated(options)


class Peer:
    """A robot at the other end of a socket, which answers as a test wants."""

    def __init__(self, answer) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        self.heard: list[dict] = []
        self.socket.settimeout(0.05)
        self._answer, self._is_over = answer, False
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over = True
        self._thread.join(60.0)
        self.socket.close()

    def _run(self) -> None:
        while not self._is_over:
            with suppress(TimeoutError):
                data, sender = self.socket.recvfrom(65507)
                self.heard.append(json.loads(data))
                reply = self._answer(self.heard[-1])
                if reply is not None:
                    self.socket.sendto(reply, sender)


def reading(q: float = 0.0, **more: object) -> dict:
    return {"time_s": 0.0, "q": [q, 0.0], "qd": [0.0, 0.0], "torque": [0.0, 0.0], **more}


HELLO = {"joint_names": ["a", "b"], "period_s": 0.01, **reading()}


def test_a_robot_over_udp_is_read_and_commanded_and_what_is_unreadable_is_left_out():
    answers = [b"no json", json.dumps(reading(q=9.0, qd=[1.0])).encode(), json.dumps(reading(q=0.5)).encode()]

    def answer(message):
        return json.dumps(HELLO).encode() if "hello" in message else answers.pop(0) if answers else None

    with Peer(answer) as peer:
        driver = UdpDriver("127.0.0.1", peer.port)
        assert (driver.joint_names, driver.period_s) == (("a", "b"), 0.01)
        for _ in range(3):
            driver.command(JointCommand(np.array([0.1, 0.2]), np.zeros(2), np.zeros(2)))
        assert until(lambda: driver.read().q[0] == 0.5)
        assert peer.heard[-1] == {"n": 3, "q": [0.1, 0.2], "qd": [0.0, 0.0], "tau": [0.0, 0.0]}

        def is_silent() -> bool:
            try:
                driver.read()
            except ConnectionError as error:
                return f"no reading from 127.0.0.1:{peer.port}" in str(error)
            return False

        assert until(is_silent)
        driver.close()


@pytest.mark.parametrize(
    ("hello", "words"),
    [
        ({**HELLO, "period_s": 3.0}, "period_s 3; expected 0.0005 to 0.1"),
        ({**HELLO, "q": [0.0]}, "expected 2 numbers, got 1"),
        ({"joint_names": ["a"], "period_s": 0.01}, "does not answer as it should: 'time_s'"),
    ],
)
def test_a_robot_that_answers_otherwise_is_refused(hello, words):
    with Peer(lambda message: json.dumps(hello).encode()) as peer, pytest.raises(ExecutionError, match=words):
        UdpDriver("127.0.0.1", peer.port)


def test_another_curve_has_another_hash(reference):
    motion = reference.motion
    curve = replace(motion.curve, positions=motion.curve.positions + 1e-6)
    assert hash_motion(replace(motion, curve=curve)) != hash_motion(motion)
