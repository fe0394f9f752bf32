"""Which links are joint neighbours: those that a joint connects, with the bodies fixed to them that are near it."""

from __future__ import annotations

from pathlib import Path

import pytest
from robot_files import joint, link, robot, write_urdf

from costs.robot import load_robot
from service.verify.coverage.link_tree import LinkTree

CUBE = '<box size="0.1 0.1 0.1"/>'


def tree_with(folder: Path, carrier: str, height_m: float) -> LinkTree:
    """Two links joined at the origin of the lower one, and a 10 cm cube fixed this far above the joint.

    ``upper`` turns on the base; its joint with ``lower`` is 0.3 m above its own origin.
    """
    above_carrier = height_m if carrier == "lower" else 0.3 + height_m
    parts = [
        link("base"),
        link("upper", CUBE),
        link("lower", CUBE),
        link("cube", CUBE),
        joint("turn", "base", "upper", xyz="0 0 1"),
        joint("hinge", "upper", "lower", xyz="0 0 0.3"),
        joint("bolt", carrier, "cube", "fixed", "", xyz=f"0 0 {above_carrier}"),
    ]
    return LinkTree(load_robot(urdf=write_urdf(folder, robot(*parts))))


# The cube's corners are sqrt((h + 0.05)^2 + 2 * 0.05^2) from the joint: 0.2432 m for h = 0.183, 0.2529 m for 0.193.
@pytest.mark.parametrize(("height_m", "is_near"), [(0.0, True), (0.183, True), (0.193, False), (1.0, False)])
@pytest.mark.parametrize(("carrier", "across"), [("lower", "upper"), ("upper", "lower")])
def test_a_body_fixed_to_a_link_is_a_neighbour_across_its_joint_when_all_of_it_is_within_a_quarter_of_a_metre(
    tmp_path: Path, carrier: str, across: str, height_m: float, is_near: bool
) -> None:
    tree = tree_with(tmp_path, carrier, height_m)
    assert tree.are_neighbours("cube", across) is is_near
    assert tree.are_neighbours(across, "cube") is is_near
    assert tree.are_neighbours("cube", carrier)
    assert tree.are_neighbours("upper", "lower")
