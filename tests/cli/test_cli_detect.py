"""``scopt detect all`` and its time limit."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Iterator
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from little_scan import little_scan, scopt
from rich.console import Console

import perception
from costs.stopping import Stopped, poll, stops_when
from perception import Detection, write_npz
from perception.detect import registry
from perception.detect.registry import Detector
from service.cli.report import make_hit_row
from service.cli.run import progress
from service.request.choices import KINDS
from service.scan import detect as detect_file
from service.scan.detect import TimeOver, limit_time


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scan") / "little.npz"
    write_npz(path, little_scan())
    return path


def _hit(kind: str, confidence: float) -> Detection:
    return Detection(kind, np.eye(4), {}, confidence, {}, np.zeros((0, 3)))


def _found(*kinds: str, is_late: bool = False) -> object:
    """Replace the detectors: one hit per kind with rising confidence, then optionally the end of the time."""

    def found(wanted: tuple[str, ...], *_: object, **__: object) -> Iterator[tuple[str, list[Detection]]]:
        assert wanted == KINDS
        for i, kind in enumerate(kinds):
            yield kind, [_hit(kind, 0.1 * i)]
        if is_late:
            raise TimeOver

    return found


def test_kinds_told_without_libraries_are_those_that_can_be_found() -> None:
    assert KINDS == perception.KINDS


def test_help_lists_the_kinds() -> None:
    told = " ".join(scopt("detect", "--help").stdout.split())
    assert f"What to look for: {', '.join(KINDS)}, or all." in told


def test_all_kinds_are_listed_surest_first(scan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detect_file, "detect_each", _found(*KINDS))
    result = scopt("detect", "all", scan, "--json")
    assert result.exit_code == 0
    data = json.loads(result.stdout)
    assert (data["kind"], data["searched"], data["unfinished"]) == ("all", list(KINDS), [])
    assert [hit["kind"] for hit in data["hits"]] == list(reversed(KINDS))


def test_when_the_time_is_over_what_was_found_is_given_and_the_rest_named(
    scan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(detect_file, "detect_each", _found("valve", "door", is_late=True))
    result = scopt("detect", "all", scan, "--json")
    assert result.exit_code == 5
    data = json.loads(result.stdout)
    assert data["searched"] == ["valve", "door"]
    assert data["unfinished"] == list(KINDS[2:])
    assert len(data["hits"]) == 2
    told = scopt("detect", "all", scan, "--time-limit", 60)
    assert told.exit_code == 5
    assert told.stdout.splitlines()[-1] == (
        f"TIME_LIMIT  60 s were over before these were looked for to the end: {', '.join(KINDS[2:])}"
    )


def test_a_time_that_is_over_before_the_clouds_were_read_is_one_line(
    scan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def late(*_: object) -> None:
        raise TimeOver

    monkeypatch.setattr(detect_file, "read_input", late)
    result = scopt("detect", "valve", scan, "--time-limit", 0.5, "--json")
    assert result.exit_code == 5
    line = "--time-limit: 0.5 s were over before anything could be looked for; expected more"
    assert result.stderr.splitlines()[-1] == line
    told = json.loads(result.stdout)
    assert (told["verdict"], told["explanation"]) == ("TIME_LIMIT", [line])


def test_work_ends_at_the_first_poll_after_the_time_is_over() -> None:
    def work() -> None:
        with limit_time(0.02):
            while True:
                poll()

    with pytest.raises(TimeOver):
        work()


def test_a_time_limit_sets_no_signal_and_raises_nothing_where_nobody_polls() -> None:
    earlier = signal.getsignal(signal.SIGALRM)
    with limit_time(1e-6):
        assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0
        assert signal.getsignal(signal.SIGALRM) is earlier
        time.sleep(0.001)


def test_a_stop_from_outside_is_no_time_that_is_over() -> None:
    with pytest.raises(Stopped), stops_when(lambda: True), limit_time(60.0):
        poll()


def _failing(*kinds: str) -> dict[str, Detector]:
    """Replace the detectors: the given kinds raise an error, the others return a hit."""

    def broken(*_: object) -> list[Detection]:
        np.zeros(3) + np.zeros(11)
        return []

    return {kind: Detector(broken if kind in kinds else lambda *_, kind=kind: [_hit(kind, 0.6)]) for kind in KINDS}


def test_a_detector_that_fails_leaves_the_others_and_is_noted_and_logged(
    scan: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(registry, "DETECTORS", _failing("drill", "panel"))
    result = scopt("detect", "all", scan, "--json")
    assert result.exit_code == 0
    data = json.loads(result.stdout)
    rest = [kind for kind in KINDS if kind not in ("drill", "panel")]
    assert sorted(hit["kind"] for hit in data["hits"]) == sorted(rest)
    assert (data["searched"], data["unfinished"]) == (rest, [])
    for kind in ("drill", "panel"):
        (note,) = (note for note in data["notes"] if kind in note)
        assert note.startswith(f"the detector of {kind} failed, please report it: ValueError: operands")
        assert "test_cli_detect.py:" in note
        assert any(f"the detector of {kind} failed" in line for line in caplog.messages)


def test_a_detector_that_is_stopped_has_not_failed(scan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: object) -> list[Detection]:
        raise Stopped

    monkeypatch.setattr(registry, "DETECTORS", _failing() | {"drill": Detector(stopped)})
    result = scopt("detect", "drill", scan, "--json", "--time-limit", 60)
    assert result.exit_code == 5
    assert json.loads(result.stdout)["unfinished"] == ["drill"]


def test_a_step_is_told_without_a_share_that_nobody_knows() -> None:
    for is_terminal in (False, True):
        err = Console(file=StringIO(), force_terminal=is_terminal)
        with progress(err, "begin") as report:
            report("read", None)
            report("plan", 0.25)
        assert isinstance(err.file, StringIO)
        told = err.file.getvalue()
        assert "plan" in told
        assert is_terminal or told.splitlines() == ["read", " 25 % plan"]


def test_of_residuals_a_table_shows_how_far_points_lie_off() -> None:
    hit = {
        "kind": "beam", "confidence": 0.5, "pose_world_object": np.eye(4).tolist(), "sizes": {"length": 1.5},
        "residuals": {"rms": 0.01, "air_share": 0.5},
    }  # fmt: skip
    assert make_hit_row(hit) == ("beam", "0.50", "0.000 0.000 0.000", "length 1.5", "rms 0.01", "")
