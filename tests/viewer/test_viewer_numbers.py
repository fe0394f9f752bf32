"""Numbers on viewer pages, read in a browser and compared with the certificates."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest
from browser import Browser, open_browser
from told_results import told_results
from viewer_results import make_result

from service.result.output import write_result
from service.result.result import PlanResult, Verdict
from service.verify import Basis, Check
from service.verify.timeline import find_time
from service.viewer import write_viewer

READ = """({
  verdict: document.querySelector('.verdict').textContent,
  says: document.querySelector('.says').textContent,
  chips: Object.fromEntries([...document.querySelectorAll('.chip')].map(
    (e) => [e.querySelector('small').textContent, e.querySelector('b').textContent])),
  notes: [...document.querySelectorAll('.curve .note')].map((e) => e.textContent),
  checks: [...document.querySelectorAll('.check')].map((e) => ({
    kind: e.className.split(' ')[1], name: e.querySelector('.name').textContent,
    value: e.querySelector('.value').textContent, detail: e.querySelector('.detail').textContent })),
  sections: [...document.querySelectorAll('.panel h2')].map((e) => e.textContent),
  text: document.body.innerText,
  plots: window.__viewer.plots, gaps: window.__viewer.gaps,
})"""
SCALE = {"m": 1e3, "rad": 180.0 / math.pi, "1": 100.0}
ROUNDED = 5e-3  # three digits are printed
NEAR = 2e-6  # tolerance of a line drawn from single-precision numbers [m, s]


@dataclass(frozen=True)
class Page:
    """A result and the text of its page."""

    result: PlanResult
    read: dict

    @property
    def checks(self) -> tuple[Check, ...]:
        return () if self.result.certificate is None else self.result.certificate.checks

    def family(self, name: str) -> list[Check]:
        return [check for check in self.checks if check.name == name or check.name.startswith(f"{name}.")]

    def line(self, name: str) -> list[list[float]]:
        return [p for plot in self.read["plots"] for line in plot if line["name"] == name for p in line["points"]]

    def time(self, check: Check) -> float:
        law = self.result.motion.law
        return check.where.s if law is None else find_time(law, check.where.s)


@pytest.fixture(scope="module")
def browser(tmp_path_factory) -> Iterator[Browser]:
    with open_browser(tmp_path_factory.mktemp("profile"), (240, 160)) as browser:
        yield browser


@pytest.fixture(scope="module")
def pages(browser, tmp_path_factory) -> Mapping[str, Page]:
    """Pages of all results, which are read and not looked at."""
    folder = tmp_path_factory.mktemp("told")
    results = {name: make() for name, make in told_results(folder).items()}
    return {name: Page(result, _read(browser, result, folder / "out")) for name, result in results.items()}


def _read(browser: Browser, result: PlanResult, folder: Path) -> dict:
    browser.open(write_result(result, folder).viewer.as_uri(), is_drawn=False)
    read = browser.run(READ)
    assert browser.complaints() == []
    return read


def number(text: str) -> float:
    """Return the first number in a text with a unit of length, angle or share."""
    found = re.search(r"(−?[\d.]+(?:e[−\d.]+)?) ?(?:mm|°|%|m\b|rad)", text)
    assert found, text
    return float(found[1].replace("−", "-"))


def tightest(checks: list[Check]) -> Check:
    return min(checks, key=lambda check: check.value - check.limit)


def standing(check: Check) -> str:
    named = {Basis.PROOF: "proven", Basis.SAMPLES: "at samples", Basis.UNPROVEN: "unproven"}
    return named[check.basis] if check.ok else "refuted"


def refuted(checks: list[Check]) -> list[Check]:
    return [check for check in checks if not check.ok]


def weakest(checks: list[Check]) -> str:
    return max((standing(check) for check in checks), key=["proven", "at samples", "unproven", "refuted"].index)


def test_pages_of_every_verdict_are_read(pages):
    assert len(pages) >= 20
    verdicts = {page.result.verdict for page in pages.values()}
    assert verdicts == set(Verdict) - {Verdict.INVALID_REQUEST}
    for page in pages.values():
        assert page.read["verdict"] == page.result.verdict.value.replace("_", " ")


def test_every_check_is_printed_with_its_value_and_what_it_rests_on(pages):
    kinds = {"proven": "ok", "at samples": "ok", "unproven": "unsure", "refuted": "fail"}
    for name, page in pages.items():
        printed = sorted((row["name"], row["kind"], row["value"], row["detail"]) for row in page.read["checks"])
        expected = sorted(page.checks, key=lambda c: (c.name.replace(".", " · "), kinds[standing(c)]))
        assert len(printed) == len(expected), name
        names = [(c.name.replace(".", " · "), kinds[standing(c)]) for c in expected]
        assert [row[:2] for row in printed] == names, name
        for row in page.read["checks"]:
            alike = [c for c in page.checks if c.name.replace(".", " · ") == row["name"]]
            if "e" in row["value"] or "<" in row["value"] or alike[0].unit not in SCALE:
                continue
            shown = number(row["value"]) / (1e3 if re.search(r"[\d.] m$", row["value"]) is None else 1.0)
            scale = SCALE[alike[0].unit] / 1e3
            assert any(shown == pytest.approx(c.value * scale, rel=ROUNDED, abs=1e-9) for c in alike), (name, row)
            assert ("unproven" in row["detail"]) == (row["kind"] == "unsure"), (name, row)


def test_the_clearance_at_the_top_and_under_the_time_bar_is_the_certificates(pages):
    for name, page in pages.items():
        checks, text = page.family("clearance"), " ".join(page.read["notes"])
        shown = {key: value for key, value in page.read["chips"].items() if key.startswith("clearance")}
        if not checks:
            assert shown == {}, name
            assert "clearance" not in text, name
            continue
        how = weakest(checks)
        assert list(shown) == [f"clearance, {how}"], name
        certificate = page.result.certificate
        worst = certificate.min_clearance_m if how == "proven" else tightest(refuted(checks) or checks).value
        assert number(shown[f"clearance, {how}"]) == pytest.approx(1e3 * worst, rel=ROUNDED), name
        (note,) = (line for line in page.read["notes"] if line.startswith((how, "penetrates", "clearance")))
        assert note.startswith(f"{how}: "), name
        told = abs(number(note))
        if how == "proven":  # rounded down
            assert 1e3 * worst - 0.1001 <= told <= 1e3 * worst + 1e-9, name
        else:
            assert told == pytest.approx(1e3 * abs(worst), abs=0.1001), name


def test_nothing_is_called_proven_beside_a_refuted_or_unproven_pair(pages):
    for name, page in pages.items():
        if page.family("clearance") and weakest(page.family("clearance")) != "proven":
            head = " ".join([*page.read["notes"][:1], page.read["says"], *page.read["chips"]])
            assert "clearance, proven" not in head, name
            assert "at least, proven" not in head, name
            assert not re.search(r"\bproven: ", head), name
            assert page.read["gaps"], name
        if page.result.verdict is not Verdict.CERTIFIED:
            assert "proven on the whole curve" not in page.read["says"], name


def test_what_was_not_checked_is_said_beside_certified_and_nowhere_called_checked(browser, tmp_path):
    result, placements = make_result()
    result["coverage"] = {"not_checked": ["torques (no link names a mass)"], "left_out": []}
    write_viewer(result, placements, tmp_path / "covered.html")
    browser.open((tmp_path / "covered.html").as_uri(), is_drawn=False)
    says = browser.run("document.querySelector('.says').textContent")
    assert says.endswith("; not checked: torques (no link names a mass)")
    assert "torques checked" not in says
    assert "torques" not in says.split("; not checked")[0]


def test_a_motion_that_starts_in_collision_says_so_first(pages):
    page = pages["out of a block"]
    assert page.result.verdict is Verdict.CERTIFIED
    assert page.read["says"].startswith("starts in collision")
    assert "clearance of pairs that may not touch" in page.read["says"]
    assert "starts in collision" not in pages["past a post"].read["says"]


def test_the_drawn_clearance_is_never_better_than_the_certificates(pages):
    for name, page in pages.items():
        checks = page.family("clearance")
        if not checks:
            continue
        proven = [value for _, value in page.line("clearance") if value is not None and math.isfinite(value)]
        certificate = page.result.certificate
        if weakest(checks) == "proven":
            assert min(proven) == pytest.approx(certificate.min_clearance_m, abs=NEAR), name
            continue
        marked = {how: page.line(how) for how in ("refuted", "unproven")}
        for check in checks:
            spot = (pytest.approx(page.time(check), abs=NEAR), pytest.approx(check.value, abs=NEAR))
            assert any(tuple(point) == spot for point in marked[standing(check)]), (name, check.text)
            spans = [gap for gap in page.read["gaps"] if set(gap["names"]) == set(check.where.names)]
            assert any(gap["start"] - NEAR <= page.time(check) <= gap["end"] + NEAR for gap in spans), (
                name,
                check.text,
            )
        drawn = [*proven, *(value for line in marked.values() for _, value in line)]
        assert min(drawn) <= certificate.min_clearance_m + NEAR, name


def test_no_bound_is_drawn_where_a_pair_is_open(pages):
    seen = 0
    for name, page in pages.items():
        for gap in page.read["gaps"]:
            for time, value in page.line("clearance"):
                if gap["start"] <= time <= gap["end"]:
                    seen += 1
                    assert value is None or not math.isfinite(value), name
    assert seen > 100


@pytest.mark.parametrize(("family", "line"), [("balance", "COM"), ("zmp", "ZMP")])
def test_balance_and_zmp_are_printed_and_drawn_as_the_certificate_has_them(pages, family, line):
    n_seen = 0
    for name, page in pages.items():
        checks = page.family(family)
        notes = [note for note in page.read["notes"] if f"{line} " in note]
        if not checks:
            assert notes == [], name
            continue
        n_seen += 1
        worst, how = (
            tightest(refuted(checks)) if refuted(checks) else min(checks, key=lambda c: c.value),
            weakest(checks),
        )
        (note,) = notes
        part = note[note.index(f"{line} ") :].split(";")[0]
        assert number(part) == pytest.approx(1e3 * worst.value, rel=ROUNDED), name
        assert {"proven": "at least, proven", "at samples": "at samples", "unproven": "unproven"}.get(how, "") in part
        assert ("proven" in part.split()) == (how == "proven"), name
        title = {"balance": "balance", "zmp": "ZMP"}[family]
        assert number(page.read["chips"][f"{title}, {how}"]) == pytest.approx(1e3 * worst.value, rel=ROUNDED), name
        points = page.line(line)
        assert min(value for _, value in points) == pytest.approx(min(c.value for c in checks), abs=NEAR), name
        if family == "balance" and not refuted(checks):
            assert worst.value == page.result.certificate.min_balance_margin_m, name
        for check in checks:
            spot = (pytest.approx(page.time(check), abs=NEAR), pytest.approx(check.value, abs=NEAR))
            assert any(tuple(point) == spot for point in points), (name, check.name)
    assert n_seen >= 5


def test_unproven_checks_are_counted_as_such(pages):
    for name, page in pages.items():
        open_ones = [check for check in page.checks if check.ok and check.basis is Basis.UNPROVEN]
        (title,) = [line for line in page.read["sections"] if line.startswith("Checks")] or [""]
        assert (f"{len(open_ones)} unproven" in title) == bool(open_ones), name
        assert "all" not in title or not open_ones, name
