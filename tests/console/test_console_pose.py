"""Poses and nudges at the operator's page: by hand in a browser against a real server, and what is sent of them."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from browser import Browser, open_browser
from console_page import click, console_of, wait
from planner_server import planner_server

from service.cli.console.moves import find_neck, read_last_pose
from service.cli.console.posing import PoseSeat, describe_pose
from service.errors import RequestError
from service.proto.planner.v1 import pose_pb2 as wire
from service.proto.planner.v1.result_pb2 import Trajectory

POSE = "window.__viewer.pose"
HAND = f"{POSE}.view.placeOf('r_hand')"
SAID = "document.querySelector('.nudges .said').textContent"
BYTES = 1000  # of a pose that is sent to a page


def test_a_pose_that_is_sent_to_a_page_has_less_than_a_kilobyte() -> None:
    stop = wire.PoseStop(kind=wire.POSE_STOP_KIND_PAIR, names=["r_hand", "wall"], value=0.02, text="x" * 120)
    pose = wire.SessionPose(
        number=123456, revision=123456, is_checked=True, base=[-1.23456789] * 7, positions=[-1.23456789] * 30,
        stops=[stop] * 3, clearance_m=0.0212345, balance_margin_m=0.1234567, torque_share=0.7654321,
    )  # fmt: skip
    assert len(json.dumps({"event": "pose", **describe_pose(pose)}, separators=(",", ":"))) < BYTES


@pytest.mark.parametrize(
    ("names", "neck"),
    [
        (["l_knee", "head_yaw", "head_pitch"], ("head_pitch", 2.0)),
        (["neck_rz", "neck_ry"], ("neck_ry", 1.0)),
        (["l_knee"], None),
    ],
)
def test_the_joint_that_nods_is_found_by_its_name(names: list[str], neck: tuple[str, float] | None) -> None:
    assert find_neck(names, [0.0, 1.0, 2.0][: len(names)]) == neck


@pytest.mark.parametrize("has_base", [True, False])
def test_the_last_pose_of_a_trajectory_is_a_start(has_base: bool) -> None:
    base = ["base_x", "base_y", "base_z", "base_qw", "base_qx", "base_qy", "base_qz"] if has_base else []
    row = [*([1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0] if has_base else []), 0.1, 0.2]
    trajectory = Trajectory(joint_names=[*base, "one", "two"], positions=[0.0] * len(row) + row)
    start = read_last_pose(trajectory)
    assert (start["joint_names"], start["positions"]) == (["one", "two"], [0.1, 0.2])
    assert ("base" in start) == has_base
    assert not has_base or start["base"]["position"] == [1.0, 2.0, 3.0]


class PoseServer:
    """A server whose pose sessions only open."""

    async def pose_session(self, request: Any, events: AsyncIterator[Any], *, with_drawing: bool) -> AsyncIterator[Any]:
        yield wire.PoseSessionResponse(opened=wire.PoseSessionOpened(joint_names=["one"], pose=wire.SessionPose()))
        async for _ in events:
            pass


def test_a_page_whose_pose_another_page_ended_is_told_so_and_its_orders_are_refused() -> None:
    told: list[Mapping[str, Any]] = []

    async def run() -> None:
        seat = PoseSeat(PoseServer(), told.append)  # type: ignore[arg-type]
        first, second = [(await seat.open({"robot": {"name": "atlas"}}))["session"] for _ in range(2)]
        seat.require(second)
        with pytest.raises(RequestError, match="another page of this session has opened a pose"):
            seat.require(first)
        await seat.close()
        assert [(event["session"], "another page" in event["problem"]) for event in told] == [(first, True)]

    asyncio.run(run())


@pytest.fixture(scope="module")
def tasks(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("tasks")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SCOPT_TASKS", str(folder))
        yield folder


def drag(browser: Browser, link: str, dx: float, dy: float) -> None:
    """Drag the gizmo of a link by some pixels with the pointer, and wait until the ghost rests."""
    browser.run(f"{POSE}.view.choose(['{link}'])")
    x, y = browser.run(f"{POSE}.view.pixelOf('{link}')")
    browser.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    browser.settle()
    for kind, share in [("mousePressed", 0.0), *(("mouseMoved", k / 8) for k in range(1, 9)), ("mouseReleased", 1.0)]:
        at = {"x": x + share * dx, "y": y + share * dy}
        browser.call("Input.dispatchMouseEvent", type=kind, **at, button="left", buttons=1, clickCount=1)
    wait(browser, f"{POSE}.isAtRest && {POSE}.pose.undo === 1")


def read_pose(browser: Browser) -> Any:
    return json.loads(browser.run(f"{POSE}.ordered('pose_read').then((state) => JSON.stringify(state))"))


def test_a_ghost_is_dragged_undone_nudged_and_kept(
    tmp_path_factory: pytest.TempPathFactory, tasks: Path, tmp_path: Path
) -> None:
    folder = tmp_path_factory.mktemp("server")
    with (
        planner_server(folder / "kept", workers=1) as server,
        console_of(server.address, tmp_path) as url,
        open_browser(tmp_path / "p", (1280, 800)) as browser,
    ):
        browser.open(url, is_drawn=False)
        click(browser, ".tabs button", "Pose", until=f"{POSE} !== null")
        wait(browser, f"{POSE}.opened !== null && !window.__viewer.busy")
        first, began = read_pose(browser), browser.run(HAND)
        drag(browser, "r_hand", 60, -60)
        led, there = read_pose(browser), browser.run(HAND)
        assert browser.run(f"{POSE}.pose.is_checked")
        assert there[2] > began[2] + 0.05
        click(browser, ".tab button", "Undo", until=f"{POSE}.pose.redo === 1")
        assert read_pose(browser) == first
        click(browser, ".tab button", "Redo", until=f"{POSE}.pose.redo === 0 && {POSE}.pose.undo === 1")
        assert read_pose(browser) == led

        browser.run("document.querySelectorAll('.placed input')[1].click()")
        browser.key("ArrowUp")
        wait(browser, f"{SAID}.startsWith('the ghost has motion')")
        wait(browser, f"{HAND}[2] > {there[2]} + 0.008")
        assert browser.run(f"{HAND}[2]") < there[2] + 0.012

        browser.run(f"{POSE}.name.value = 'reach_out'")
        click(
            browser,
            ".tab button",
            "Keep as task",
            until="document.querySelector('.tab .said').textContent.startsWith('kept in')",
        )
        assert (tasks / "reach_out.yaml").is_file()
        wait(browser, "[...document.querySelectorAll('.tabs button')].some((e) => e.textContent === 'reach out')")
        assert browser.complaints() == []
