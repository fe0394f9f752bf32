"""What an operator may do at the page: the buttons that it shows, the next step to a motion, and forged orders."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from benchmarks.console.seat import Message, Seat

UNDER_WAY = ("ready", "running", "paused", "waiting", "returning", "holding")  # as in console-data.ts
KEYS = ("Up", "Down", "Left", "Right", "i", "o", "e", "d", "s", "f", "w", "r", "E", "S", "W", "q", "a")
SPEEDS = (0.1, 0.25, 0.5, 1.0)
LED = ("l_hand", "r_hand", "pelvis", "utorso")
PLACED = "placed"


@dataclass(frozen=True)
class Act:
    """One click or key.

    Attributes:
        name: of the order or of the box.
        give: does it, and returns the answer.
        values: that it sends, as far as they explain what follows.
        may_open: whether it confirms that hands may let go what they hold.
        is_placed: whether it puts the simulated robot elsewhere, so that its hands hold nothing.
    """

    name: str
    give: Callable[[], Message]
    values: str = ""
    may_open: bool = False
    is_placed: bool = False

    @property
    def begins(self) -> bool:
        """Whether it may begin a motion of the robot."""
        return self.name in ("execute", "forged execute", "forged plan", "forged move", "nudge robot")


def list_boxes(seat: Seat) -> list[str]:
    """Return the boxes of the open plan that allow hands to open."""
    placed = PLACED in seat.ticked
    held = [] if placed else [name for name in seat.robot.get("held", ()) if name not in seat.plan["holds"]]
    return [*seat.plan["releases"], *held]


def list_clicks(seat: Seat, rng: random.Random) -> Iterator[Act]:
    """Yield a click on each button, box and key that the page offers now."""
    yield from list_robot_clicks(seat, rng)
    yield Act("inbox", lambda: show_inbox(seat))
    if seat.rows:
        yield Act("open", lambda: show_plan(seat, rng.choice(seat.rows)["plan_id"]))
    if seat.plan:
        yield from list_plan_clicks(seat, rng)
    yield Act("pose_open", lambda: lead(seat))
    if seat.pose:
        yield from list_pose_clicks(seat, rng)


def list_robot_clicks(seat: Seat, rng: random.Random) -> Iterator[Act]:
    """Yield a click on each button of the strip on top."""
    robot = seat.robot
    if not robot.get("is_there"):
        return
    if robot["surprises"]:
        yield Act("acknowledge", lambda: seat.order("acknowledge", seen=len(robot["surprises"])))
    if not robot["has_control"]:
        yield Act("take", lambda: seat.order("take", takes_over=bool(robot["control"])))
    is_under_way = robot["mode"] in UNDER_WAY
    if is_under_way:
        yield command(seat, "stop")
    if not seat.may_order:
        return
    yield command(seat, "release_control")
    if is_under_way:
        yield command(seat, "speed", speed=rng.choice(SPEEDS))
        yield command(seat, "resume" if robot["mode"] == "paused" else "pause")
        yield command(seat, "abort")
        yield command(seat, "retreat")
        if robot["shiftable"]:
            offset = [round(rng.uniform(-0.3, 0.3), 3) for _ in range(3)]
            yield command(seat, "shift", link=rng.choice(robot["shiftable"]), offset_m=offset)


def list_plan_clicks(seat: Seat, rng: random.Random) -> Iterator[Act]:
    """Yield a click on each button and box of the open plan."""
    yield Act("review", lambda: review(seat, rng.random() < 0.7))
    for box in (*list_boxes(seat), PLACED):
        yield Act("tick", lambda box=box: tick(seat, box))  # type: ignore[misc]
    if seat.plan["is_approved"] and seat.may_order and seat.ticked.issuperset(list_boxes(seat)):
        yield execute(seat)


def list_pose_clicks(seat: Seat, rng: random.Random) -> Iterator[Act]:
    """Yield a drag, a step back, and keys for ghost and robot."""
    number = seat.pose["session"]
    targets = [{"link": rng.choice(LED), "position": [round(rng.uniform(-0.2, 0.7), 2) for _ in range(3)]}]
    yield Act("pose_drag", lambda: seat.order("pose_drag", session=number, targets=targets, is_last=rng.random() < 0.5))
    yield Act("pose_go", lambda: seat.order("pose_go", session=number, way=rng.choice(("undo", "redo"))))
    yield nudge(seat, rng, "ghost")
    yield nudge(seat, rng, "robot")


def next_click(seat: Seat, rng: random.Random) -> Iterator[Act]:
    """Yield what leads on to a motion, or interrupts the one that is under way."""
    robot = seat.robot
    if robot.get("surprises") or not robot.get("has_control"):
        yield from (act for act in list_robot_clicks(seat, rng) if act.name in ("acknowledge", "take"))
    elif robot["mode"] in UNDER_WAY:
        yield from (act for act in list_robot_clicks(seat, rng) if act.name not in ("release_control", "take"))
    elif not seat.rows:
        yield Act("inbox", lambda: show_inbox(seat))
    elif not seat.plan or rng.random() < 0.4:
        yield Act("open", lambda: show_plan(seat, rng.choice(seat.rows)["plan_id"]))
    elif not seat.plan["is_approved"]:
        yield Act("review", lambda: review(seat, True))
    elif boxes := [box for box in list_boxes(seat) if box not in seat.ticked]:
        yield Act("tick", lambda: tick(seat, boxes[0]))
    elif PLACED not in seat.ticked and rng.random() < 0.6:
        yield Act("tick", lambda: tick(seat, PLACED))
    elif seat.pose and rng.random() < 0.2:
        yield nudge(seat, rng, "robot")
    else:
        yield execute(seat)


def list_forgeries(seat: Seat, rng: random.Random) -> Iterator[Act]:
    """Yield orders that no button of the page gives in this state."""
    stale = max(0, seat.revision - rng.randrange(4))
    yield command(seat, rng.choice(("resume", "abort", "retreat", "pause")), revision=stale)
    yield Act("forged plan", lambda: seat.order("execute", plan_id="none", trajectory_sha256="0" * 64, revision=stale))
    if seat.plan:
        plan, confirms = seat.plan, rng.random() < 0.1
        yield Act("forged review", lambda: seat.order(
            "review", plan_id=plan["plan_id"], accept=True, trajectory_sha256="1" * 64,
            certificate_sha256=plan["certificate_sha256"], page_sha256=plan["page_sha256"],
        ))  # fmt: skip
        sha256 = rng.choice([plan["trajectory_sha256"], "2" * 64])
        names = list_boxes(seat) if confirms else []
        yield Act("forged execute", lambda: seat.order(
            "execute", plan_id=plan["plan_id"], trajectory_sha256=sha256, revision=seat.revision, lets_go=names,
        ), may_open=bool(names))  # fmt: skip
    if seat.pose:
        yield nudge(seat, rng, "robot")
        joints = {"l_arm_elx": round(rng.uniform(-3.0, 3.0), 2)}
        yield Act("forged move", lambda: keep_shown(seat, seat.order(
            "move", session=seat.pose["session"], step={"move": {"joints": joints}}, to="robot", revision=seat.revision
        )))  # fmt: skip


def command(seat: Seat, name: str, **values: Any) -> Act:
    """Return an order to the robot."""
    say = " ".join(str(value) for value in values.values())
    return Act(name, lambda: seat.order("command", **{"command": name, "revision": seat.revision, **values}), say)


def execute(seat: Seat) -> Act:
    """Return the click on *Execute*, with the boxes as they are."""
    plan, ticked = seat.plan, seat.ticked
    names = [name for name in list_boxes(seat) if name in ticked]
    return Act("execute", lambda: seat.order(
        "execute", plan_id=plan["plan_id"], trajectory_sha256=plan["trajectory_sha256"], revision=seat.revision,
        is_placed=PLACED in ticked, lets_go=names,
    ), f"{plan['plan_id'][:6]} {sorted(ticked)}", may_open=bool(names), is_placed=PLACED in ticked)  # fmt: skip


def nudge(seat: Seat, rng: random.Random, to: str) -> Act:
    """Return a key, whose motion ghost and robot get alike."""
    session, key, hand = seat.pose["session"], rng.choice(KEYS), rng.choice(("left", "right"))
    return Act(f"nudge {to}", lambda: keep_shown(
        seat, seat.order("nudge", session=session, key=key, hand=hand, to=to, revision=seat.revision)
    ))  # fmt: skip


def keep_shown(seat: Seat, answer: Message) -> Message:
    """Note the motion that the ghost got, and return the answer."""
    result = answer.get("result")
    if isinstance(result, dict) and "trajectory_sha256" in result:
        seat.shown.add(result["trajectory_sha256"])
    return answer


def show_inbox(seat: Seat) -> Message:
    """Read the list of plans."""
    answer = seat.order("inbox")
    seat.rows = [row for row in answer.get("result", ()) if row["state"] == "finished"]
    return answer


def show_plan(seat: Seat, plan_id: str) -> Message:
    """Open a plan; its boxes are not ticked."""
    answer = seat.order("open", plan_id=plan_id)
    if "result" in answer:
        seat.plan, seat.ticked = answer["result"], set()
        seat.shown.add(seat.plan["trajectory_sha256"])
    return answer


def review(seat: Seat, is_accepted: bool) -> Message:
    """Accept or reject the open plan."""
    plan = seat.plan
    answer = seat.order(
        "review", plan_id=plan["plan_id"], accept=is_accepted, trajectory_sha256=plan["trajectory_sha256"],
        certificate_sha256=plan["certificate_sha256"], page_sha256=plan["page_sha256"], comment="at random",
        despite="" if plan["verdict"] == "CERTIFIED" else plan["verdict"],
    )  # fmt: skip
    if "result" in answer:
        plan["is_approved"] = answer["result"]["is_approved"]
    return answer


def tick(seat: Seat, box: str) -> Message:
    """Tick a box of the open plan, or untick it."""
    seat.ticked ^= {box}
    return {"result": {}}


def lead(seat: Seat) -> Message:
    """Open the tab in which a pose is led."""
    answer = seat.order("pose_open", robot="atlas", posture="stand")
    if "result" in answer:
        seat.pose = {"session": answer["result"]["session"]}
    return answer
