"""Work that is asked to stop at any of its polls ends there, and leaves nothing behind that changes later results."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from little_scan import little_scan
from planar_arm import write_planar_arm

from costs.stopping import Stopped, stops_when
from perception import KINDS, Cloud, detect_kinds, make_view, perceive, update, write_npz
from service.executor import JobCancelled
from service.planner import plan
from service.request.file import parse_request
from service.result.result import Verdict
from service.scan.cloud import CloudInput
from service.verify import Motion, verify
from service.work.look import DetectTask, SceneTask, build_scene, detect
from service.work.plan import PlanAnswer, PlanTask, run_plan

N_STOPS = 2
LEAST_POLLS = 20


class Asked:
    """Says stop from its ``at``-th question on."""

    def __init__(self, at: float = np.inf) -> None:
        self.at, self.n = at, 0

    def __call__(self) -> bool:
        self.n += 1
        return self.n > self.at


class StandIn:
    """A job's control."""

    def __init__(self, should_stop: Callable[[], bool]) -> None:
        self.should_stop = should_stop
        self.events: list[Any] = []

    def report(self, event: Any) -> None:
        self.events.append(event)

    def now(self) -> float:
        return 0.0


@pytest.fixture(scope="module")
def cloud() -> Cloud:
    return little_scan()


@pytest.fixture(scope="module")
def request_of_arm(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A planar arm goes around a post."""
    urdf = write_planar_arm(tmp_path_factory.mktemp("arm"), 3, 0.3, 0.04, limit=3.0)
    post = {"type": "box", "name": "post", "size": [0.05, 0.05, 1.0], "position": [0.5, 0.3, 0.0]}
    return {"robot": {"urdf": str(urdf)}, "goal": {"joints": {"j0": 1.2}}, "scene": {"obstacles": [post]}}


@pytest.fixture(scope="module")
def motion(request_of_arm: dict[str, Any]) -> Motion:
    made = plan(parse_request(request_of_arm)).motion
    assert made is not None
    return made


def _check_stops(work: Callable[[], Any], least: int = LEAST_POLLS) -> None:
    """The work ends wherever it is asked to stop, and does what it did when it is not."""
    counted = Asked()
    with stops_when(counted):
        before = work()
    assert counted.n >= least
    for at in np.random.default_rng(0).integers(counted.n, size=N_STOPS).tolist():
        with pytest.raises(Stopped), stops_when(Asked(at)):
            work()
    assert repr(work()) == repr(before)


def test_perception_stops_at_any_poll(cloud: Cloud) -> None:
    def see() -> object:
        seen = perceive(cloud, kinds=("wheel",), unknown="occupied")
        return [piece.shape for piece in seen.pieces], [one.confidence for one in seen.detections]

    _check_stops(see)


def test_an_update_stops_at_any_poll(cloud: Cloud) -> None:
    before = perceive(cloud)
    _check_stops(lambda: [piece.shape for piece in update(before, cloud).pieces])


@pytest.mark.parametrize("kind", KINDS)
def test_a_detection_stops_at_any_poll(cloud: Cloud, kind: str) -> None:
    view = make_view(cloud)
    _check_stops(lambda: [one.confidence for one in detect_kinds((kind,), view)], least=1)


def test_a_verification_stops_at_any_poll_and_gives_no_certificate(motion: Motion) -> None:
    _check_stops(lambda: verify(motion).to_json())
    with pytest.raises(Stopped):
        verify(motion, should_stop=Asked(5))


def test_a_plan_that_is_cancelled_at_any_poll_ends_as_cancelled(request_of_arm: dict[str, Any]) -> None:
    counted = Asked()
    whole = plan(parse_request(request_of_arm), should_stop=counted)
    assert whole.verdict is Verdict.CERTIFIED, whole.explanation
    for at in np.random.default_rng(1).integers(counted.n, size=N_STOPS).tolist():
        stopped = plan(parse_request(request_of_arm), should_stop=Asked(at))
        assert stopped.verdict is Verdict.CANCELLED
    again = plan(parse_request(request_of_arm))
    np.testing.assert_array_equal(again.motion.curve.positions, whole.motion.curve.positions)


def test_jobs_about_clouds_that_are_stopped_were_cancelled(cloud: Cloud, tmp_path: Path) -> None:
    write_npz(tmp_path / "scan.npz", cloud)
    clouds = CloudInput((tmp_path / "scan.npz",))
    counted = Asked()
    scene = build_scene(SceneTask(clouds, ("valve",)), StandIn(counted))
    assert isinstance(scene, bytes)
    assert json.loads(scene)["pieces"]
    for at in (0, counted.n // 3, counted.n // 2):  # reading the file takes more polls or fewer
        with pytest.raises(JobCancelled):
            build_scene(SceneTask(clouds, ("valve",)), StandIn(Asked(at)))
    with pytest.raises(JobCancelled):
        detect(DetectTask(clouds, "valve"), StandIn(Asked(3)))


def test_a_job_that_plans_and_is_stopped_answers_that_it_was_cancelled(request_of_arm: dict[str, Any]) -> None:
    answer = run_plan(PlanTask(parse_request(request_of_arm)), StandIn(Asked(40)))
    assert isinstance(answer, PlanAnswer)
    assert answer.verdict == "CANCELLED"
