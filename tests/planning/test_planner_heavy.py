"""Objects with masses: certified with their weight, carried out in physics with the same masses, and replayed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from given_mechanisms import drawer_request, drawer_urdf
from heavy_mechanisms import chest_request, inertial
from shared_plans import write_undrawn

from costs.curve import TimeLaw
from service import RequestError, parse_request, plan
from service.demands.mechanism.demand import GivenMechanismDemand
from service.demands.mechanism.given import read_given_mechanism
from service.demands.recorded_task import RecordedTask
from service.replay.replay import verify_result
from service.result.result import PlanResult, Verdict
from service.setup.prepare import prepare
from service.simulation.options import SimulationOptions
from service.simulation.simulate import simulate
from service.verify import verify

LINK = '<link name="drawer">'
MASS = 5.0


def heavy_urdf(mass: float = MASS) -> str:
    """The cupboard's drawer with a mass, 0.2 m behind its front."""
    return drawer_urdf().replace(LINK, LINK + inertial(mass, (0.2, 0.0, 0.0), 0.1))


def hatch_request(**more: Any) -> dict[str, Any]:
    """The same front as a hatch of 3 kg that slides upwards by 0.05 m on a peg below its bar; the hand stays."""
    urdf = drawer_urdf().replace(LINK, LINK + inertial(3.0, (0.0, 0.0, 0.0), 0.05))
    urdf = urdf.replace('xyz="-1 0 0"', 'xyz="0 0 1"').replace("0.27 0 1.1", "0.37 0 1.6")
    handle = {"link": "handle", "place": [0, 0, -0.018], "axis": [1, 0, 0], "tilt_deg": 30}
    return drawer_request(to=0.05, **({"urdf": urdf, "handle": handle, "joints": {}, "stays": True} | more))


def plan_certified(request: dict[str, Any]) -> PlanResult:
    result = plan(parse_request(request))
    assert result.verdict is Verdict.CERTIFIED, result.explanation
    return result


@pytest.fixture(name="drawer", scope="module")
def _drawer(tmp_path_factory: pytest.TempPathFactory) -> tuple[PlanResult, Path]:
    """A drawer of 5 kg pulled out against 30 N of friction."""
    result = plan_certified(drawer_request(urdf=heavy_urdf()))
    return result, write_undrawn(result, tmp_path_factory.mktemp("drawer") / "out")


@pytest.fixture(name="hatch", scope="module")
def _hatch(tmp_path_factory: pytest.TempPathFactory) -> tuple[PlanResult, Path]:
    result = plan_certified(hatch_request())
    return result, write_undrawn(result, tmp_path_factory.mktemp("hatch") / "out")


@pytest.fixture(name="lid", scope="module")
def _lid(tmp_path_factory: pytest.TempPathFactory) -> tuple[PlanResult, Path]:
    result = plan_certified(chest_request())
    return result, write_undrawn(result, tmp_path_factory.mktemp("lid") / "out")


def test_the_masses_of_a_mechanism_are_loads_and_no_weight_of_the_robot(drawer: tuple[PlanResult, Path]) -> None:
    motion = drawer[0].motion
    assert motion is not None
    model = motion.robot.model
    index = model.getJointId("slide")
    assert model.inertias[index].mass == 0.0
    phase = next(phase for phase in motion.phases if phase.name == "move slide")
    (load,) = phase.loads
    # 30 N of friction, and 5 kg sped up by the default limit of 1 m/s^2.
    np.testing.assert_allclose(load.force, [-35.0, 0.0, 0.0], atol=1e-9)


def test_a_hatch_is_lifted_with_its_weight(hatch: tuple[PlanResult, Path]) -> None:
    motion = hatch[0].motion
    assert motion is not None
    (load,) = next(phase for phase in motion.phases if phase.name == "move slide").loads
    gain = 0.01 * 0.05 / 0.03**2  # at which servos lag behind by a hundredth of the 5 cm as the motion ends
    np.testing.assert_allclose(load.force, [0.0, 0.0, 3.0 * (9.81 + gain)], atol=1e-9)
    assert verify_result(hatch[1])["verdict"] == "CERTIFIED"


def test_a_lid_is_pushed_upwards_on_both_ways(lid: tuple[PlanResult, Path]) -> None:
    """2 kg at 0.3 m: 5.89 N m shut; the bar is 0.66 m from the hinge, and the peg 18 mm below it."""
    motion = lid[0].motion
    assert motion is not None
    phases = {phase.name: phase.loads for phase in motion.phases if phase.loads}
    (up,), (down,) = phases["move hinge"], phases["move hinge 2"]
    # 0.21 kg m^2 at the default limit of 2 rad/s^2 come on top of weight and friction.
    weight, arm = 2.0 * 9.81 * 0.3, float(np.hypot(0.66, 0.018))
    # The rod's place is moved by some tenths of a millimetre until it touches.
    assert np.linalg.norm(up.force) == pytest.approx((weight + 1.0 + 0.42) / arm, rel=1e-3)
    assert np.linalg.norm(down.force) == pytest.approx((weight - 1.0 + 0.42) / arm, rel=1e-3)
    assert up.force[2] > 0.0
    assert down.force[2] > 0.0


def test_physics_has_the_same_masses(
    drawer: tuple[PlanResult, Path], hatch: tuple[PlanResult, Path], lid: tuple[PlanResult, Path], tmp_path: Path
) -> None:
    """The hand's largest force is that of the plan, though the physics engine knows nothing of the plan's loads.

    Friction along the face, which the loads leave out, is left out of physics as well.
    """
    for name, (_, folder) in (("drawer", drawer), ("hatch", hatch), ("lid", lid)):
        options = SimulationOptions(hand_friction=0.0, settle_s=0.3, after_s=0.5)
        made = simulate(folder, options, output=tmp_path / f"{name}.json")
        assert all(moved["share"] >= 0.95 for moved in made["mechanism"]), name
        for load in (load for phase in made["phases"] for load in phase["loads"]):
            assert 0.9 * load["expected_n"] < load["peak_n"] < 1.45 * load["expected_n"], name


def test_a_plan_for_a_lighter_object_is_refused(drawer: tuple[PlanResult, Path], tmp_path: Path) -> None:
    assert verify_result(drawer[1])["verdict"] == "CERTIFIED"
    for name, changed in (("heavier", heavy_urdf(8.0)), ("massless", drawer_urdf())):
        path = tmp_path / f"{name}.yaml"
        path.write_text(json.dumps(drawer_request(urdf=changed)))
        again = verify_result(drawer[1], path)
        assert again["verdict"] != "CERTIFIED", name
        assert any("loads of phase 'move slide'" in line for line in again["explanation"]), again["explanation"]


def test_a_law_that_moves_the_object_faster_than_its_loads_assume_is_refuted(drawer: tuple[PlanResult, Path]) -> None:
    motion = drawer[0].motion
    assert motion is not None
    assert motion.law is not None
    hasty = TimeLaw(0.1 * motion.law.times, motion.law.path, 10.0 * motion.law.speed)
    strong = motion.robot.acceleration.copy()
    strong[:-1] *= 100.0  # of the robot itself
    certificate = verify(replace(motion, law=hasty, robot=replace(motion.robot, acceleration=strong)))
    failed = {check.name: check for check in certificate.checks if not check.ok}
    assert "slide" in failed["limits.acceleration"].text


def test_a_mechanism_that_leaves_its_way_is_refused(drawer: tuple[PlanResult, Path]) -> None:
    """Its loads are those between the two values of the move: further out they are not known."""
    result = drawer[0]
    motion = result.motion
    assert motion is not None
    assert result.request.task is not None
    assert result.request.task.mechanism is not None
    demand = GivenMechanismDemand(read_given_mechanism(result.request.task.mechanism), result.robot)
    assert RecordedTask.of(demand, motion).problems == ()
    phase = next(phase for phase in motion.phases if phase.name == "move slide")
    inside = np.flatnonzero((motion.curve.knots > phase.first) & (motion.curve.knots < phase.last))
    positions = motion.curve.positions.copy()
    positions[inside[-1], -1] = 0.3  # and back to 0.25
    strayed = replace(motion, curve=replace(motion.curve, positions=positions))
    assert any("slide leaves its way from 0 to 0.25" in line for line in RecordedTask.of(demand, strayed).problems)


def test_the_shipped_lies_about_weights_and_shapes_are_refused_or_named(shared_data: Path) -> None:
    lies = shared_data.parent / "cases" / "lies"
    if not lies.is_dir():
        pytest.skip(f"no cases at {lies}")

    def read(name: str) -> dict[str, Any]:
        return dict(yaml.safe_load((lies / name / "request.yaml").read_text()))

    with pytest.raises(
        RequestError, match=r"slide does not rest where the hand lets go .* gravity moves it with 294 N"
    ):
        plan(parse_request(read("hatch")))
    held = read("hatch")
    held["task"]["mechanism"]["stays"] = True
    heavy = plan(parse_request(held))
    assert heavy.verdict is not Verdict.CERTIFIED
    assert any("of its torque during move slide" in line for line in heavy.explanation)
    assert any("velocity limits are 0 (slide)" in note for note in prepare(parse_request(read("vel0"))).notes)
    with pytest.raises(RequestError, match=r"mechanism/drawer/drawer\.1 is 0\.10 m inside fixture/cupboard\.1"):
        prepare(parse_request(read("solid")))
