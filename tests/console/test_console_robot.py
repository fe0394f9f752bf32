"""The robot at the operator's page, in a browser against a real server with a simulated robot."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import Browser, open_browser
from console_page import click, console_of, wait
from planner_server import planner_server

from service.cli.console.bridge import send_events
from service.cli.console.robot import describe_measured, describe_state, find_surprises
from service.client import PlannerClient
from service.client.answers import FinishedPlan
from service.proto.planner.v1 import execution_pb2 as wire
from service.request.file import parse_request

ALERT = "document.querySelector('.robot-strip .alert')"
SAID = "document.querySelector('.robot-strip .said').textContent"


def make_state(
    last_order: str = "", speed: float = 1.0, plan: str = "a", station: str = "console 12"
) -> wire.WatchResponse:
    return wire.WatchResponse(
        status=wire.ExecutionStatus(mode=wire.EXECUTION_MODE_RUNNING, last_order=last_order, speed=speed),
        plan=wire.LoadedPlan(plan_id=plan, trajectory_sha256=plan, joint_names=["one", "two"]),
        control=wire.ControlHolder(name="ann", station=station),
        pose=wire.RobotPose(measured=[0.0, 1.0], planned=[0.1, 1.3]),
    )


@pytest.mark.parametrize(
    ("after", "told"),
    [
        (make_state(), []),
        (make_state("speed by ann (console 12)", 0.2), []),
        (make_state("speed by ann (console 13)", 0.2), ["speed by ann (console 13): the speed is now 0.2"]),
        (make_state("execute by bob", plan="b"), ["execute by bob: plan b has replaced the one that was loaded"]),
        (make_state("stop by bob"), ["stop by bob"]),
        (make_state("pause: ann (console 12) has gone (--when-alone hold)"),
         ["pause: ann (console 12) has gone (--when-alone hold)"]),
    ],
)  # fmt: skip
def test_what_others_ordered_is_a_surprise_and_own_orders_are_not(after: wire.WatchResponse, told: list[str]) -> None:
    assert find_surprises(make_state(), after) == told
    assert find_surprises(after, after) == []


def test_the_joint_that_is_farthest_from_the_plan_is_named() -> None:
    shown = describe_state(make_state())
    assert (shown["mode"], shown["control"]) == ("running", "ann (console 12)")
    farthest = describe_measured(make_state())["farthest"]
    assert (farthest["joint"], farthest["off"]) == ("two", pytest.approx(0.3))
    idle = wire.ExecutionStatus(mode=wire.EXECUTION_MODE_IDLE)
    assert describe_measured(wire.WatchResponse(status=idle))["farthest"] is None


class Line:
    """A line to a page, as its bridge sees it."""

    def __init__(self) -> None:
        self.sent: list[dict[str, Any]] = []

    async def send_json(self, message: dict[str, Any]) -> None:
        self.sent.append(message)


def test_a_slow_line_gets_answers_at_once_and_of_poses_the_newest() -> None:
    line = Line()

    async def run() -> None:
        queue: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        sender = asyncio.create_task(send_events(line, queue, 3600.0))  # type: ignore[arg-type]
        for number in range(100):
            queue.put_nowait({"event": "measured", "clock_s": number})
        queue.put_nowait({"id": 1, "result": {}})
        while len(line.sent) < 2:
            await asyncio.sleep(0.001)
        queue.put_nowait({"event": "measured", "clock_s": 100})
        queue.put_nowait({"id": 2, "result": {}})
        while len(line.sent) < 3:
            await asyncio.sleep(0.001)
        sender.cancel()

    asyncio.run(run())
    assert [message.get("id", message.get("clock_s")) for message in line.sent] == [1, 99, 2]


def test_a_measured_pose_of_a_humanoid_is_half_of_what_a_slow_line_carries_in_a_second() -> None:
    state = wire.WatchResponse(
        plan=wire.LoadedPlan(joint_names=[f"l_arm_joint_{k}" for k in range(36)]),
        pose=wire.RobotPose(
            clock_s=123.456789, measured=[-1.23456789] * 36, planned=[-1.2] * 36, measured_base=[-1.23456789] * 7
        ),
    )
    sent = json.dumps({"event": "measured", **describe_measured(state)}, separators=(",", ":"))
    assert 8 * len(sent) < 0.5 * 9600


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    pytest.importorskip("mujoco")
    folder = tmp_path_factory.mktemp("robot")
    with planner_server(folder / "data", "--robot", "sim,period_ms=10,pace=0.7") as server:
        yield server.address


@pytest.fixture(scope="module")
def made(target: str, tmp_path_factory: pytest.TempPathFactory) -> FinishedPlan:
    request = {"robot": {"name": "atlas", "root": "fixed"}, "goal": {"joints": {"l_arm_elx": 1.2}}}
    with PlannerClient(target) as client:
        return client.plan(parse_request(request), out=tmp_path_factory.mktemp("plan") / "out")


def test_an_accepted_plan_is_carried_out_and_what_others_change_is_shown_until_it_is_acknowledged(
    target: str, made: FinishedPlan, tmp_path: Path
) -> None:
    with console_of(target, tmp_path) as url, open_browser(tmp_path / "p", (1280, 800)) as browser:
        browser.open(url, is_drawn=False)
        wait(browser, "window.__viewer.robot?.mode === 'idle'")
        browser.run(f"window.__viewer.open('{made.plan_id}')")
        click(browser, ".judge .yes", "Accept")
        click(browser, ".robot-strip button", "Take control", until="window.__viewer.robot.has_control")
        browser.run("document.querySelector('.placed input').checked = true")
        click(browser, ".buttons .yes", "Execute", until="['running', 'done'].includes(window.__viewer.robot.mode)")
        assert browser.run("window.__viewer.robot.trajectory_sha256") == made.result.trajectory.sha256
        wait(browser, f"{SAID}.startsWith('answered: state ')")
        wait(browser, "window.__viewer.robot.mode === 'done'")
        assert browser.run(f"{ALERT}.hidden")
        with PlannerClient(target) as other:
            _take_over_behind(browser, other)
            # The acceptance that the page relies on is void once another reviewer rejects the plan.
            other.review(other.get_plan(made.plan_id).record, accept=False, comment="old scan")
        refused = f"{SAID}.includes('was rejected by local since; open it again')"
        click(browser, ".buttons .yes", "Execute", until=refused)
        assert browser.complaints() == []


def _take_over_behind(browser: Browser, other: PlannerClient) -> None:
    """Another client takes control: shown in red, and orders are refused until the operator has seen it."""
    other.take_control("bob", takes_over=True)
    wait(browser, f"!{ALERT}.hidden && {ALERT}.textContent.includes('local (bob) took control')")
    assert browser.run("[...document.querySelectorAll('.buttons .yes')].at(-1).disabled")
    click(browser, ".robot-strip .alert button", "Seen", until=f"{ALERT}.hidden")
    click(browser, ".robot-strip button", "Take over", until="window.__viewer.robot.has_control")
