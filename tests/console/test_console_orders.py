"""Orders over the bridge, from log-in to a review, against a stand-in of the planning server."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import grpc
import pytest
from planner_stand_in import PLAN_ID, PlannerStandIn, make_result, refuse, serving, slow_plan
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from service.cli.console.app import make_app
from service.cli.console.sessions import COOKIE
from service.cli.console.settings import ConsoleSettings, page_version

BASE = "http://127.0.0.1:8080"
ORDERS = "ws://127.0.0.1:8080/orders"
ORIGIN = {"origin": BASE}
KNOWN = "scopt_known"


class GuardedStandIn(PlannerStandIn):
    """Knows one token, and one that may only plan."""

    def _record(self, message: Any, context: grpc.ServicerContext) -> None:
        super()._record(message, context)
        said = self.metadata[-1].get("authorization", "")
        if said not in (f"Bearer {KNOWN}", "Bearer scopt_plans"):
            refuse(context, grpc.StatusCode.UNAUTHENTICATED, "authorization: the token is unknown to this server")
        if said == "Bearer scopt_plans" and type(message).__name__ == "ReviewPlanRequest":
            refuse(context, grpc.StatusCode.PERMISSION_DENIED, "ReviewPlan needs the role review; bob has plan")


@pytest.fixture
def stand_in() -> GuardedStandIn:
    return GuardedStandIn()


@pytest.fixture
def browser(stand_in: GuardedStandIn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[TestClient]:
    monkeypatch.setenv("SCOPT_TASKS", str(tmp_path))
    task = "{steps: [{move: {hand: right, by: {translation: [0, 0, 0.1]}, along: line}}]}"
    (tmp_path / "up.yaml").write_text(f"help: Up.\ntask: {task}\n")
    with serving(stand_in) as target, TestClient(make_app(ConsoleSettings(target, scans=(tmp_path,))), BASE) as client:
        yield client


class Page:
    """A page of the console: orders, and the events that came between."""

    def __init__(self, socket: Any) -> None:
        self._socket = socket
        self._number = 0
        self.events: list[dict[str, Any]] = []

    def order(self, name: Any, **values: Any) -> dict[str, Any]:
        self._number += 1
        self._socket.send_json({"id": self._number, "order": name, **values})
        while (answer := self._socket.receive_json()).get("id") != self._number:
            self.events.append(answer)
        return dict(answer)

    def wait(self, is_it: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        while not any(map(is_it, self.events)):
            self.events.append(self._socket.receive_json())
        return next(event for event in self.events if is_it(event))


@contextmanager
def page_of(browser: TestClient, token: str = KNOWN) -> Iterator[Page]:
    said = browser.post("/login", json={"token": token}, headers=ORIGIN).json()
    with browser.websocket_connect(ORDERS, headers=ORIGIN) as socket:
        socket.send_json({"hello": {"version": said["version"], "forgery": said["forgery"]}})
        assert socket.receive_json()["event"] == "hello"
        yield Page(socket)


def test_a_wrong_token_is_refused_in_the_words_of_the_server(browser: TestClient) -> None:
    assert browser.post("/session", headers=ORIGIN).json()["code"] == "UNAUTHENTICATED"
    reply = browser.post("/login", json={"token": "scopt_wrong"}, headers=ORIGIN)
    assert (reply.status_code, reply.json()["error"]) == (403, "authorization: the token is unknown to this server")
    assert COOKIE not in reply.cookies
    for body in ("{", "[]", '{"token": 3}', "{}", '{"token": "a b"}'):
        reply = browser.post("/login", content=body, headers=ORIGIN)
        assert (reply.status_code, "token: expected" in reply.json()["error"]) == (400, True)


def test_the_cookie_is_the_pages_own_and_the_token_is_not_in_it(browser: TestClient) -> None:
    reply = browser.post("/login", json={"token": KNOWN}, headers=ORIGIN)
    cookie = reply.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert KNOWN not in cookie
    assert browser.post("/session", headers=ORIGIN).json()["forgery"] == reply.json()["forgery"]


def test_a_server_that_does_not_answer_is_named(tmp_path: Path) -> None:
    with TestClient(make_app(ConsoleSettings("localhost:1", scans=(tmp_path,))), BASE) as browser:
        reply = browser.post("/session", headers=ORIGIN)
    assert reply.status_code == 503
    assert "no server answers at localhost:1" in reply.json()["error"]


def test_forged_orders_are_refused(browser: TestClient, stand_in: GuardedStandIn) -> None:
    said = browser.post("/login", json={"token": KNOWN}, headers=ORIGIN).json()
    for headers in ({}, {"origin": "http://evil.example"}, {"origin": "http://127.0.0.1:9999"}, {"origin": "null"}):
        assert browser.post("/login", json={"token": KNOWN}, headers=headers).status_code == 403
        assert browser.post("/logout", headers=headers).status_code == 403
        assert browser.post("/session", headers=headers).status_code == 403
        with pytest.raises(WebSocketDisconnect), browser.websocket_connect(ORDERS, headers=headers):
            pass
    assert browser.get("/session").status_code == 405
    n_calls = len(stand_in.requests)
    hellos = [
        ({"version": said["version"], "forgery": "guessed"}, "forgery: is not that of this session"),
        ({"version": said["version"]}, "forgery: is not that of this session"),
        ({"version": "old", "forgery": said["forgery"]}, "of another version"),
        (None, "expected hello"),
    ]
    for hello, words in hellos:
        with browser.websocket_connect(ORDERS, headers=ORIGIN) as socket:
            socket.send_json({"hello": hello})
            assert words in socket.receive_json()["refused"]
    browser.cookies.clear()
    with browser.websocket_connect(ORDERS, headers=ORIGIN) as socket:
        socket.send_json({"hello": {"version": said["version"], "forgery": said["forgery"]}})
        assert "the session has ended" in socket.receive_json()["refused"]
    assert len(stand_in.requests) == n_calls


def test_a_wrong_order_is_answered_by_a_sentence_and_the_page_lives_on(browser: TestClient) -> None:
    with page_of(browser) as page:
        assert "unknown order 'opn'; expected open" in page.order("opn", plan_id=PLAN_ID)["error"]
        assert "unknown order" in page.order(7)["error"]
        assert "plan_id" in page.order("open")["error"]
        assert "plan_idd" in page.order("open", plan_id=PLAN_ID, plan_idd=1)["error"]
        assert page.order("open", plan_id="other")["code"] == "NOT_FOUND"
        assert "is not open" in page.order("review", **decision(make_result()), plan_id="other")["error"]
        assert page.order("inbox", plan_id=PLAN_ID)["code"] == "INVALID_ARGUMENT"


def decision(result: Any, **more: Any) -> dict[str, Any]:
    hashes = {"trajectory_sha256": result.trajectory.sha256, "certificate_sha256": result.certificate.sha256}
    return {"accept": True, **hashes, "page_sha256": "", **more}


def test_a_review_is_of_exactly_what_the_page_showed(browser: TestClient, stand_in: GuardedStandIn) -> None:
    with page_of(browser) as page:
        shown = page.order("open", plan_id=PLAN_ID)["result"]
        assert (shown["verdict"], shown["needs_decision"], shown["has_page"]) == ("CERTIFIED", True, True)
        assert browser.get(f"/plans/{PLAN_ID}/viewer.html").headers["content-security-policy"].startswith("sandbox ")
        # Another client plans again, and this operator opens that in a second page.
        first, stand_in.result = stand_in.result, make_result("FEASIBLE_AT_SAMPLES")
        stand_in.result.certificate.json += b" "
        from service.wire.hashes import hash_certificate

        stand_in.result.certificate.sha256 = hash_certificate(stand_in.result.certificate.json)
        page.order("open", plan_id=PLAN_ID)
        refused = page.order("review", plan_id=PLAN_ID, **decision(first))
        assert "is not what this page shows" in refused["error"]
        assert stand_in.reviews == []
        stand_in.result = first
        page.order("open", plan_id=PLAN_ID)
        row = page.order("review", plan_id=PLAN_ID, **decision(first, comment="fine"))["result"]
        assert [(one["is_accepted"], one["comment"]) for one in row["reviews"]] == [(True, "fine")]
        # The plan changed at the server since it was opened: the server refuses.
        stand_in.result = make_result("NOT_FOUND")
        stand_in.result.certificate.sha256 = "sha256:other"
        assert "another plan was seen" in page.order("review", plan_id=PLAN_ID, **decision(first))["error"]


def test_a_role_that_may_not_review_is_told_so(browser: TestClient, stand_in: GuardedStandIn) -> None:
    with page_of(browser, "scopt_plans") as page:
        page.order("open", plan_id=PLAN_ID)
        refused = page.order("review", plan_id=PLAN_ID, **decision(stand_in.result))
    assert refused["code"] == "PERMISSION_DENIED"
    assert refused["error"] == "ReviewPlan needs the role review; bob has plan"


def test_a_plan_goes_on_while_its_page_is_gone_and_a_new_page_sees_it(
    browser: TestClient, stand_in: GuardedStandIn
) -> None:
    stand_in.plans.append(slow_plan(stand_in))
    with page_of(browser) as page:
        job = page.order("plan", task="up", values={}, robot="atlas")["result"]
        page.wait(lambda event: event.get("plan_id") == PLAN_ID)
    said = browser.post("/session", headers=ORIGIN).json()
    with browser.websocket_connect(ORDERS, headers=ORIGIN) as socket:
        socket.send_json({"hello": {"version": page_version(), "forgery": said["forgery"]}})
        (again,) = socket.receive_json()["jobs"]
        assert (again["job"], again["state"], again["plan_id"]) == (job["job"], "planning", PLAN_ID)
        other = Page(socket)
        assert "result" in other.order("cancel", job=job["job"])
        assert other.wait(lambda event: event.get("state") == "stopped")["job"] == job["job"]
        assert stand_in.stopped.wait(60.0)
        assert "there is no plan 99" in other.order("cancel", job=99)["error"]


def test_a_plan_is_finished_once_it_can_be_opened(browser: TestClient, stand_in: GuardedStandIn) -> None:
    with page_of(browser) as page:
        page.order("plan", task="up", values={}, robot="atlas")
        done = page.wait(lambda event: event.get("state") == "finished")
        assert (done["verdict"], done["plan_id"]) == ("CERTIFIED", PLAN_ID)
    (sent,) = (one for one in stand_in.requests if type(one).__name__ == "PlanRequest")
    assert sent.with_files
    assert sent.request.robot.name == "atlas"


def test_the_inbox_has_what_the_server_lists_and_what_waits_for_a_decision_is_not_lost_among_newer_ones(
    browser: TestClient, stand_in: GuardedStandIn
) -> None:
    with page_of(browser) as page:
        rows = page.order("inbox")["result"]
    assert [row["plan_id"] for row in rows] == [f"plan{number}" for number in range(5)]
    assert all(row["needs_decision"] and not row["is_rejected"] for row in rows)
    asked = [one.needs_review for one in stand_in.requests if type(one).__name__ == "ListPlansRequest"]
    assert set(asked) == {True, False}
