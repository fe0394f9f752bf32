"""Mechanisms in front of Atlas, as URDF text with the request that moves them: a drawer, a cabinet, a box's lid."""

from __future__ import annotations

from typing import Any

BAR, PEG = 0.008, 0.009  # radii of the handles' bars, and of Atlas's rod [m]


def box(size: tuple[float, float, float], at: tuple[float, float, float]) -> str:
    """A box's <collision>."""
    x, y, z = size
    return (
        f'<collision><origin xyz="{at[0]} {at[1]} {at[2]}"/><geometry><box size="{x} {y} {z}"/></geometry></collision>'
    )


def bar(length: float, at: tuple[float, float, float], rpy: str = "0 0 0") -> str:
    """A bar's <collision>, along z before it is turned."""
    return (
        f'<collision><origin xyz="{at[0]} {at[1]} {at[2]}" rpy="{rpy}"/>'
        f'<geometry><cylinder radius="{BAR}" length="{length}"/></geometry></collision>'
    )


def drawer_urdf() -> str:
    """A cupboard whose front is at x = 0 of its root, with a drawer that comes out by 0.4 m along -x."""
    return f"""<robot name="cupboard">
  <link name="cupboard">{box((0.5, 0.5, 0.85), (0.27, 0, 0.425))}{box((0.5, 0.5, 0.1), (0.27, 0, 1.1))}</link>
  <link name="drawer">{box((0.02, 0.46, 0.16), (0, 0, 0))}{box((0.4, 0.4, 0.02), (0.21, 0, -0.06))}</link>
  <link name="handle">{bar(0.2, (0, 0, 0), "1.5707963 0 0")}</link>
  <joint name="slide" type="prismatic"><parent link="cupboard"/><child link="drawer"/>
    <origin xyz="0 0 0.95"/><axis xyz="-1 0 0"/><limit lower="0" upper="0.4" velocity="0.5" effort="100"/></joint>
  <joint name="screws" type="fixed"><parent link="drawer"/><child link="handle"/><origin xyz="-0.06 0 0"/></joint>
</robot>"""


def cabinet_urdf() -> str:
    """A cabinet with a door 0.4 m wide, hinged at y = 0.2 of its root, that opens towards -x; a vertical bar."""
    return f"""<robot name="cabinet">
  <link name="cabinet">{box((0.3, 0.42, 0.5), (0.18, 0, 0.25))}</link>
  <link name="door">{box((0.02, 0.4, 0.5), (0, -0.2, 0))}</link>
  <link name="handle">{bar(0.16, (0, 0, 0))}</link>
  <joint name="hinge" type="revolute"><parent link="cabinet"/><child link="door"/>
    <origin xyz="0 0.2 0.25"/><axis xyz="0 0 -1"/><limit lower="0" upper="2" velocity="1" effort="50"/></joint>
  <joint name="screws" type="fixed"><parent link="door"/><child link="handle"/><origin xyz="-0.06 -0.35 0"/></joint>
</robot>"""


def request_for(urdf: str, position: tuple[float, float, float], handle: dict[str, Any], **more: Any) -> dict[str, Any]:
    """A request for Atlas at the origin."""
    task = {"urdf": urdf, "position": list(position), "handle": handle, **more}
    return {
        "robot": {"name": "atlas"},
        "start": {"posture": "reach_ready"},
        "task": {"mechanism": task},
        "options": {"time_limit_s": 60},
    }


def drawer_request(to: float = 0.25, x: float = 0.75, y: float = -0.25, **more: Any) -> dict[str, Any]:
    """Pull the drawer by a peg that points down behind its bar."""
    place = [BAR + PEG + 0.001, 0.0, 0.01]
    handle = {"link": "handle", "place": place, "axis": [0, 0, -1]}
    more = {"moves": [{"joint": "slide", "to": to}], "joints": {"slide": {"friction": 30.0}}, **more}
    return request_for(drawer_urdf(), (x, y, 0.0), handle, **more)


def cabinet_request(to: float = 0.8, x: float = 0.75, y: float = -0.1, **more: Any) -> dict[str, Any]:
    """Pull the cabinet's door by a peg behind its vertical bar."""
    behind = BAR + PEG + 0.001
    place = [0.866 * behind, -0.5 * behind, 0.0]
    handle = {"link": "handle", "place": place, "axis": [0.5, 0.866, 0.0], "tilt_deg": 25}
    more = {"moves": [{"joint": "hinge", "to": to}], "joints": {"hinge": {"friction": 3.0}}, **more}
    return request_for(cabinet_urdf(), (x, y, 0.8), handle, **more)
