"""The Atlas v5 that ships with the package: public figures, shapes and hooks of our own."""

from __future__ import annotations

from collections.abc import Mapping

from costs.robot.atlas.description import DEFAULT_TOOL_DISTANCE, FOLDER, urdf_text
from costs.robot.load import Root, build_robot
from costs.robot.model import RobotModel
from costs.robot.xmlfile import read_xml_text


def load_atlas(root: Root, tool_distance_m: float | None, locked_joints: Mapping[str, float]) -> RobotModel:
    """The bundled Atlas; see ``costs.robot.load_robot``."""
    urdf, srdf = FOLDER / "atlas.urdf", FOLDER / "atlas.srdf"
    if tool_distance_m is None or tool_distance_m == DEFAULT_TOOL_DISTANCE:
        text = read_xml_text(urdf)
    else:
        text = urdf_text(tool_distance_m)
    roots = (FOLDER.parent,)
    return build_robot(text, read_xml_text(srdf), roots, root, locked_joints, str(urdf), str(srdf))
