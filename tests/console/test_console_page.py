"""The console in a real browser, against a real server with tokens: log-in, a user's task, judging and deciding."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from browser import Browser, open_browser
from console_page import WAIT_S, click, console_of, wait
from planner_server import planner_server

from service.trust import Role, make_token

RAISE = """
help: Raise the right hand.
parameters:
  far: {type: number, unit: m, default: 0.05, range: [0.01, 0.2], help: way of the hand}
task:
  steps:
    - move: {hand: right, by: {translation: "${[0, 0, far]}"}, along: line, speed_m_s: 0.1}
"""


@dataclass(frozen=True)
class Desk:
    """A console in front of a server, and the tokens of its operators."""

    url: str
    tokens: dict[str, str]
    tasks: Path


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Desk]:
    folder = tmp_path_factory.mktemp("desk")
    (folder / "tasks").mkdir()
    made = {"ada": make_token("ada", [Role.PLAN, Role.REVIEW]), "bob": make_token("bob", [Role.PLAN])}
    tokens = folder / "tokens.yaml"
    tokens.touch(mode=0o600)
    tokens.write_text("".join(f"{line}\n" for _, line in made.values()))
    with pytest.MonkeyPatch.context() as patch, planner_server(folder / "kept", "--tokens", str(tokens)) as server:
        patch.setenv("SCOPT_TASKS", str(folder / "tasks"))
        with console_of(server.address, folder) as url:
            yield Desk(url, {name: token for name, (token, _) in made.items()}, folder / "tasks")


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with open_browser(tmp_path_factory.mktemp("profile"), (1280, 800)) as browser:
        yield browser


def log_in(browser: Browser, token: str) -> None:
    wait(browser, "document.querySelector('.login')?.hidden === false")
    browser.run(f"document.querySelector('.login input').value = {json.dumps(token)}")
    click(browser, ".login button", "Log in")


def said(browser: Browser) -> str:
    return str(browser.run("document.querySelector('.panel .said').textContent"))


def wait_for_motion(browser: Browser) -> None:
    """Wait until something of many colours is drawn in the middle, where the frame of the plan's page is."""
    end = time.monotonic() + WAIT_S
    while len(np.unique(browser.picture()[200:700, 300:850].reshape(-1, 3) // 16, axis=0)) < 30:
        assert time.monotonic() < end, "the motion is not drawn"
        time.sleep(0.2)


def test_an_operator_logs_in_plans_a_task_of_their_own_and_decides_about_it(browser: Browser, desk: Desk) -> None:
    browser.open(desk.url)
    log_in(browser, "scopt_wrong")
    wait(browser, "document.querySelector('.login .said').textContent.includes('the token is unknown to this server')")
    log_in(browser, desk.tokens["ada"])
    wait(browser, "document.querySelector('.login').hidden && window.__viewer.state === 'open'")

    (desk.tasks / "raise.yaml").write_text(RAISE)
    (desk.tasks / "torn.yaml").write_text("help: [")
    click(browser, ".tabs button", "torn")
    wait(browser, "document.querySelector('.panel .why')?.textContent.includes('torn.yaml')")
    click(browser, ".tabs button", "raise")
    browser.run("document.querySelector('.field input').value = '3'")
    click(browser, ".panel .yes", "Plan")
    wait(browser, "document.querySelector('.panel .said').textContent.includes('far: expected 0.01 to 0.2 m, got 3')")
    browser.run("document.querySelector('.field input').value = '0.03'")
    click(browser, ".panel .yes", "Plan")

    wait(browser, "document.querySelectorAll('.judge .risk').length > 1")
    assert browser.run("document.querySelector('.judge .verdict').textContent") == "CERTIFIED"
    assert said(browser) == "needs a decision"
    titles = browser.run("[...document.querySelectorAll('.risk .name')].map((e) => e.textContent)")
    assert titles[:2] == ["Closest pair", "Largest torque"]
    wait(browser, "document.querySelector('.tabs button').textContent === 'Inbox 1'")
    assert browser.run("[...document.querySelectorAll('.group')].every((e) => !e.open)")
    wait_for_motion(browser)
    browser.run("document.querySelector('.comment').value = 'seen'")
    click(browser, ".judge .yes", "Accept")
    wait(browser, "document.querySelector('.panel .said').textContent === 'accepted by ada: seen'")
    wait(browser, "document.querySelector('.tabs button').textContent === 'Inbox'")
    click(browser, ".judge .no", "Reject")
    wait(browser, "document.querySelector('.panel .said').textContent.startsWith('rejected by ada')")
    # The browser itself notes that a session was asked for and a token refused.
    assert [line for line in browser.complaints() if "status of 403" not in line] == []


def test_a_page_of_another_origin_reaches_nothing(browser: Browser, desk: Desk) -> None:
    # The same server under its other name, in the same browser: another origin.
    browser.open(desk.url.replace("127.0.0.1", "localhost"), is_drawn=False)
    orders = desk.url.replace("http", "ws") + "orders"
    opened = f"new Promise((done) => {{ const s = new WebSocket({json.dumps(orders)}); "
    opened += "s.onopen = () => done('open'); s.onerror = () => done('refused'); })"
    assert browser.run(f"{opened}.catch(() => 'refused')") == "refused"
    session = json.dumps(desk.url + "session")
    assert browser.run(f"fetch({session}).then(() => 'read', () => 'refused')") == "refused"


def test_who_may_not_review_is_told_so(browser: Browser, desk: Desk) -> None:
    browser.open(desk.url, is_drawn=False)
    wait(browser, "document.querySelectorAll('.row').length > 0")
    plan_id = browser.run("document.querySelector('.row .id').textContent")
    click(browser, ".tools button", "Log out")
    log_in(browser, desk.tokens["bob"])
    wait(browser, "window.__viewer.state === 'open'")
    browser.run(f"window.__viewer.open({json.dumps(plan_id)})")
    wait(browser, "document.querySelector('.bar-top').textContent.includes('needs the role review')")
