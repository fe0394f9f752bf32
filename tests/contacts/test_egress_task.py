"""The task of getting out: its first step planned, certified and replayed, and requests that cannot be planned."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from shared_plans import write_undrawn

from service.demands.egress.demand import SHIPPED_PHASES, EgressDemand
from service.errors import RequestError, ResultError
from service.planner import plan
from service.replay.replay import verify_result
from service.request.file import parse_request
from service.result.result import Verdict

REQUEST = Path(__file__).resolve().parents[2] / "examples" / "requests" / "egress_model.yaml"


def first_step():
    """The shipped request with its first two phases."""
    data = yaml.safe_load(REQUEST.read_text())
    phases = yaml.safe_load(SHIPPED_PHASES.read_text())["phases"][:2]
    data["task"]["egress"] |= {"phases": phases, "samples": 3}
    return data


@pytest.fixture(scope="module")
def stepped(tmp_path_factory):
    """The plan of the first step, and its folder."""
    result = plan(parse_request(first_step()))
    folder = tmp_path_factory.mktemp("egress") / "out"
    write_undrawn(result, folder)
    return result, folder


def test_the_right_foot_leaves_the_car_with_a_certificate(stepped):
    result, folder = stepped
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    names = [phase.name for phase in result.motion.phases]
    assert names == [f"right foot out: {part}" for part in ("shift", "lift", "swing", "land")] + ["finish"]
    assert [contact.link for contact in result.motion.phases[2].contacts] == ["pelvis", "l_foot"]
    assert all(contact.tolerance_m <= 1e-4 for phase in result.motion.phases for contact in phase.contacts)
    assert verify_result(folder)["verdict"] == "CERTIFIED"


def test_a_foot_that_the_phases_put_elsewhere_is_refused(stepped, tmp_path):
    _, folder = stepped
    data = json.loads((folder / "result.json").read_text())
    for phase in data["request"]["task"]["egress"]["phases"][1:]:
        phase["contacts"]["right_foot"]["toe"][1] -= 0.3
    other = tmp_path / "out"
    other.mkdir()
    for path in folder.rglob("*"):
        if path.is_file() and path.name != "result.json":
            (other / path.relative_to(folder)).parent.mkdir(parents=True, exist_ok=True)
            (other / path.relative_to(folder)).write_bytes(path.read_bytes())
    (other / "result.json").write_text(json.dumps(data))
    with pytest.raises(ResultError, match=r"right_foot in 'right foot out' is .* m from the place that the phases"):
        verify_result(other)


def test_the_left_foot_leaves_the_mirrored_car_on_its_left_side(stepped):
    given = mirror(yaml.safe_load(REQUEST.read_text()))
    given["task"]["egress"] |= {"side": "left", "until": "left foot out", "samples": 3}
    result = plan(parse_request(given))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    there, here = result.motion.phases, stepped[0].motion.phases
    assert there[2].name == "left foot out: swing"
    assert [contact.link for contact in there[2].contacts] == ["pelvis", "r_foot"]
    for mine, other in zip(there[3].contacts, here[3].contacts, strict=True):
        np.testing.assert_allclose(mine.points.mean(axis=0), other.points.mean(axis=0) * [1, -1, 1], atol=1e-3)


def mirror(data):
    """A request mirrored by hand in the plane y = 0."""
    turned_back = ("hpy", "kny", "aky", "ely", "bky", "wry", "wry2", "ry")
    start = data["start"]["joints"]
    data["start"]["joints"] = {
        {"l": "r", "r": "l"}.get(name[0], name[0]) + name[1:]: value * (1 if name.endswith(turned_back) else -1)
        for name, value in start.items()
    }
    for obstacle in data["scene"]["obstacles"]:
        obstacle["position"][1] *= -1
        w, x, y, z = obstacle.get("quaternion_wxyz", (1, 0, 0, 0))
        obstacle["quaternion_wxyz"] = [w, -x, y, -z]
    chest = data["robot"]["contacts"]["chest"]
    for points in (chest["points"], *(s.get("corners", []) for s in data["task"]["egress"]["surfaces"].values())):
        for point in points:
            point[1] *= -1
        points.reverse()
    return data


def test_a_foot_at_the_edge_is_turned_onto_the_platform_and_replayed_so(tmp_path):
    data = first_step()
    foot = data["task"]["egress"]["phases"][1]["contacts"]["right_foot"]
    foot |= {"toe": [0.34, -0.66, 0.35], "region": [0.004, 0.004]}
    result = plan(parse_request(data))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    (planted,) = (contact for contact in result.motion.phases[-1].contacts if contact.link == "r_foot")
    assert np.rad2deg(np.arctan2(*planted.pose_world_link[[1, 0], 0])) > foot["yaw_deg"] + 1.0
    assert planted.points[:, 1].max() <= -0.46 + 1e-6
    write_undrawn(result, tmp_path / "out")
    assert verify_result(tmp_path / "out")["verdict"] == "CERTIFIED"


def test_a_robot_that_does_not_sit_on_the_seat_is_refused_in_metres():
    data = yaml.safe_load(REQUEST.read_text())
    data["start"]["base"]["position"][2] += 0.05
    with pytest.raises(RequestError, match=r"hip is 0\.05\d m above seat"):
        plan(parse_request(data))


def test_unknown_patches_and_surfaces_of_phases_are_refused(stepped):
    result, _ = stepped
    data = first_step()
    contacts = data["task"]["egress"]["phases"][0]["contacts"]
    contacts["knee"] = {"surface": "seat"}
    contacts["hip"]["surface"] = "sofa"
    request = parse_request(data).task.egress
    with pytest.raises(RequestError) as refused:
        EgressDemand.of(request, result.robot, result.scene, np.array(result.start))
    assert any("contacts: unknown contact patch 'knee'" in line for line in refused.value.problems)
    assert any("unknown surface 'sofa'" in line for line in refused.value.problems)
