"""Edits of scene and robot: pieces, movables, URDF, SRDF and meshes."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from xml.etree import ElementTree as ET

from benchmarks.attack.arm_files import box_obj
from benchmarks.attack.forgery import Folder, Level, Registry

WORLD = Registry()


@WORLD.lie("arm", "reach", "carry", "valve", "program", "scan")
def an_obstacle_deleted(folder: Folder) -> None:
    folder.data["pieces"].pop(0)


@WORLD.lie("arm", "reach", level=Level.RAW, stranger=True)
def an_obstacle_deleted_without_its_hash(folder: Folder) -> None:
    folder.data["pieces"].pop(0)


@WORLD.lie("arm", "reach", "valve")
def all_pieces_but_the_floor_deleted(folder: Folder) -> None:
    folder.data["pieces"] = [piece for piece in folder.data["pieces"] if piece["name"] == "floor"]


@WORLD.lie("arm", "reach", "valve")
def an_obstacle_moved_by_5_cm(folder: Folder) -> None:
    piece = folder.data["pieces"][0]
    piece["vertices"] = [[x, y, z - 0.05] for x, y, z in piece["vertices"]]


@WORLD.lie("arm", "reach")
def an_obstacle_moved_by_4_mm(folder: Folder) -> None:
    piece = folder.data["pieces"][0]
    piece["vertices"] = [[x, y + 0.004, z] for x, y, z in piece["vertices"]]


@WORLD.lie("arm", "reach")
def an_obstacle_cut_in_half(folder: Folder) -> None:
    piece = folder.data["pieces"][0]
    piece["vertices"] = piece["vertices"][: len(piece["vertices"]) // 2]


@WORLD.lie("reach")
def an_obstacle_called_floor(folder: Folder) -> None:
    folder.piece("table").update(name="floor")


@WORLD.lie("valve")
def an_obstacle_called_like_the_rim(folder: Folder) -> None:
    folder.data["pieces"][0]["name"] = "valve/rim/99"


@WORLD.lie("reach")
def floor_lowered_by_12_mm(folder: Folder) -> None:
    floor = folder.piece("floor")
    floor["vertices"] = [[x, y, z - 0.012] for x, y, z in floor["vertices"]]


@WORLD.lie("reach", "carry")
def floor_deleted(folder: Folder) -> None:
    folder.data["pieces"] = [piece for piece in folder.data["pieces"] if piece["name"] != "floor"]


@WORLD.lie("reach")
def floor_shrunk_to_the_size_of_a_coin(folder: Folder) -> None:
    floor = folder.piece("floor")
    floor["vertices"] = [[0.002 * x, 0.002 * y, z] for x, y, z in floor["vertices"]]


@WORLD.lie("arm", level=Level.RAW)
def piece_with_a_vertex_that_is_null(folder: Folder) -> None:
    folder.data["pieces"][0]["vertices"][0][0] = None


@WORLD.lie("valve")
def origin_of_the_wheel_moved_by_4_mm(folder: Folder) -> None:
    folder.data["movables"][0]["origin"][2] += 0.004


@WORLD.lie("valve")
def axis_of_the_wheel_turned_round(folder: Folder) -> None:
    folder.data["movables"][0]["axis"] = [1.0, 0.0, 0.0]


@WORLD.lie("valve")
def wheel_may_turn_ten_times_as_fast(folder: Folder) -> None:
    folder.data["movables"][0].update(velocity=10.0, acceleration=20.0)


@WORLD.lie("valve")
def wheel_without_hub(folder: Folder) -> None:
    movable = folder.data["movables"][0]
    movable["bodies"] = [body for body in movable["bodies"] if body["name"] != "valve/hub"]


@WORLD.lie("valve")
def wheel_with_half_a_rim(folder: Folder) -> None:
    folder.data["movables"][0]["bodies"] = folder.data["movables"][0]["bodies"][10:]


@WORLD.lie("valve")
def wheel_shrunk_by_a_tenth(folder: Folder) -> None:
    movable = folder.data["movables"][0]
    for body in movable["bodies"]:
        body["vertices"] = [
            [o + 0.9 * (v - o) for v, o in zip(row, movable["origin"], strict=True)] for row in body["vertices"]
        ]


@WORLD.lie("valve", level=Level.RAW)
def angles_of_the_wheel_drawn_six_times_as_far(folder: Folder) -> None:
    folder.data["movables"][0]["angles"] = [6.0 * angle for angle in folder.data["movables"][0]["angles"]]


@WORLD.lie("valve", level=Level.RAW)
def wheel_said_to_start_elsewhere(folder: Folder) -> None:
    folder.data["movables"][0]["start"] += 0.5


@WORLD.lie("valve")
def wheel_that_slides(folder: Folder) -> None:
    folder.data["movables"][0]["type"] = "prismatic"


@WORLD.lie("valve")
def wheel_with_a_latch(folder: Folder) -> None:
    folder.data["releases"] = [{"joint": "valve_turn", "latch": "neck_ry", "latch_at": 0.1, "free_beyond": 0.0}]


def _each(path: str, change: Callable[[ET.Element], object]) -> Callable[[ET.Element], None]:
    def run(root: ET.Element) -> None:
        for element in root.findall(path):
            change(element)

    return run


def _scale(attribute: str, factor: float) -> Callable[[ET.Element], None]:
    def run(element: ET.Element) -> None:
        element.set(attribute, " ".join(str(factor * float(value)) for value in element.get(attribute, "").split()))

    return run


@WORLD.lie("arm", "reach", robot=True)
def joint_limits_widened(folder: Folder) -> None:
    folder.edit_urdf(_each("joint/limit[@lower]", _scale("lower", 3.0)))
    folder.edit_urdf(_each("joint/limit[@upper]", _scale("upper", 3.0)))


@WORLD.lie("arm", "reach", robot=True)
def speed_limits_raised_and_law_sped_up(folder: Folder) -> None:
    folder.edit_urdf(_each("joint/limit[@velocity]", _scale("velocity", 10.0)))
    law = folder.curve["law"]
    law.update(times=[0.6 * t for t in law["times"]], speed=[v / 0.6 for v in law["speed"]])


@WORLD.lie("arm", "reach", robot=True)
def effort_limits_raised(folder: Folder) -> None:
    folder.edit_urdf(_each("joint/limit[@effort]", _scale("effort", 100.0)))


@WORLD.lie("arm", "reach", robot=True)
def masses_halved(folder: Folder) -> None:
    folder.edit_urdf(_each("link/inertial/mass", _scale("value", 0.5)))


@WORLD.lie("arm", robot=True)
def boxes_of_the_robot_halved(folder: Folder) -> None:
    folder.edit_urdf(_each("link/collision/geometry/box", _scale("size", 0.5)))
    folder.edit_urdf(_each("link/collision/geometry/capsule", _scale("radius", 0.5)))


@WORLD.lie("arm", "reach", robot=True)
def collision_shapes_of_the_forearm_removed(folder: Folder) -> None:
    def remove(root: ET.Element) -> None:
        for link in root.findall("link"):
            if link.get("name") in ("forearm", "l_larm", "l_farm", "l_hand"):
                for shape in link.findall("collision"):
                    link.remove(shape)

    folder.edit_urdf(remove)


@WORLD.lie("arm", robot=True)
def mesh_swapped_for_a_smaller_one(folder: Folder) -> None:
    (folder.path / "robot" / "hand.obj").write_text(box_obj((0.02, 0.02, 0.02)), encoding="utf-8")


@WORLD.lie("arm", level=Level.RAW)
def mesh_swapped_without_a_word(folder: Folder) -> None:
    (folder.path / "robot" / "hand.obj").write_text(box_obj((0.02, 0.02, 0.02)), encoding="utf-8")


@WORLD.lie("arm", robot=True)
def mesh_scaled_down(folder: Folder) -> None:
    folder.edit_urdf(_each("link/collision/geometry/mesh", lambda mesh: mesh.set("scale", "0.2 0.2 0.2")))


@WORLD.lie("arm", robot=True)
def base_of_the_arm_20_cm_higher(folder: Folder) -> None:
    folder.edit_urdf(_each("joint[@name='yaw']/origin", lambda origin: origin.set("xyz", "0 0 0.56")))


@WORLD.lie("arm", "reach", robot=True)
def srdf_with_more_disabled_pairs(folder: Folder) -> None:
    links = [link["link"] for link in folder.data["bodies"]]
    rows = "".join(f'<disable_collisions link1="{a}" link2="{b}"/>' for a in links for b in links if a < b)
    folder.edit_text("robot/robot.srdf", lambda text: text.replace("</robot>", rows + "</robot>"))


@WORLD.lie("arm", "reach", level=Level.RAW, stranger=True)
def pairs_ignored_that_a_stranger_reads(folder: Folder) -> None:
    links = sorted({body["link"] for body in folder.data["bodies"]})
    folder.data["ignored_pairs"] = [[a, b] for a in links for b in links if a < b]


@WORLD.lie("arm", "reach", level=Level.RAW, stranger=True)
def bodies_shrunk_that_a_stranger_reads(folder: Folder) -> None:
    for body in folder.data["bodies"]:
        body["vertices"] = [[0.5 * x, 0.5 * y, 0.5 * z] for x, y, z in body["vertices"]]


@WORLD.lie("reach", level=Level.HASHED)
def a_robot_fixed_to_the_world(folder: Folder) -> None:
    folder.data["robot"]["root"] = "fixed"


@WORLD.lie("arm", level=Level.HASHED)
def urdf_outside_the_folder(folder: Folder) -> None:
    outside = folder.path.parent / "elsewhere.urdf"
    shutil.copyfile(folder.path / "robot" / "robot.urdf", outside)
    shutil.copyfile(folder.path / "robot" / "hand.obj", folder.path.parent / "hand.obj")
    folder.data["robot"]["urdf"] = "../elsewhere.urdf"


@WORLD.lie("arm", level=Level.HASHED)
def urdf_behind_a_link_out_of_the_folder(folder: Folder) -> None:
    outside = folder.path.parent / "elsewhere.urdf"
    shutil.move(folder.path / "robot" / "robot.urdf", outside)
    os.symlink(outside, folder.path / "robot" / "robot.urdf")


@WORLD.lie("arm", robot=True)
def urdf_text_changed_and_its_hash_too(folder: Folder) -> None:
    folder.edit_urdf(lambda root: root.append(ET.Comment("checked by nobody")))
    folder.edit_urdf(_each("link[@name='hand']/collision/geometry/mesh", lambda mesh: mesh.set("scale", "0.9 0.9 0.9")))


@WORLD.lie("arm", "reach", level=Level.RAW, stranger=True)
def urdf_changed_without_its_hash(folder: Folder) -> None:
    folder.edit_urdf(_each("link/inertial/mass", _scale("value", 0.9)))
