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


def request_for(task: dict[str, Any]) -> dict[str, Any]:
    """A request for Atlas at the origin."""
    return {
        "robot": {"name": "atlas"},
        "start": {"posture": "reach_ready"},
        "task": {"mechanism": task},
        "options": {},
    }


def drawer_request(to: float = 0.25, x: float = 0.75, y: float = -0.25, **more: Any) -> dict[str, Any]:
    """Pull the drawer by a peg that points down behind its bar."""
    place = [BAR + PEG + 0.001, 0.0, 0.01]
    handle = {"link": "handle", "place": place, "axis": [0, 0, -1]}
    task = {"urdf": drawer_urdf(), "position": [x, y, 0.0], "handle": handle}
    task |= {"moves": [{"joint": "slide", "to": to}], "joints": {"slide": {"friction": 30.0}}}
    return request_for({**task, **more})


def cabinet_request(to: float = 0.8, x: float = 0.75, y: float = -0.1, **more: Any) -> dict[str, Any]:
    """Pull the cabinet's door by a peg behind its vertical bar."""
    behind = BAR + PEG + 0.001
    place = [0.866 * behind, -0.5 * behind, 0.0]
    handle = {"link": "handle", "place": place, "axis": [0.5, 0.866, 0.0], "tilt_deg": 25}
    task = {"urdf": cabinet_urdf(), "position": [x, y, 0.8], "handle": handle}
    task |= {"moves": [{"joint": "hinge", "to": to}], "joints": {"hinge": {"friction": 3.0}}}
    return request_for({**task, **more})


def latched_urdf() -> str:
    """The cupboard with a paddle instead of the bar: pulled by 0.2 rad, it releases the drawer."""
    paddle = f"""<link name="pivot">{box((0.02, 0.02, 0.02), (0, 0.13, 0))}</link>
  <link name="handle">{bar(0.2, (0, 0, 0), "1.5707963 0 0")}</link>
  <joint name="paddle" type="revolute"><parent link="drawer"/><child link="pivot"/>
    <origin xyz="-0.09 0 0.06"/><axis xyz="0 1 0"/><limit lower="0" upper="0.6" velocity="1" effort="5"/></joint>
  <joint name="arm" type="fixed"><parent link="pivot"/><child link="handle"/><origin xyz="0 0 -0.06"/></joint>"""
    before, _, after = drawer_urdf().partition('<link name="handle">')
    _, _, after = after.partition("</link>")
    joints, _, _ = after.partition('<joint name="screws"')
    return f"{before}{joints}{paddle}</robot>"


def latched_request(**more: Any) -> dict[str, Any]:
    """Pull the paddle, then the drawer, then let the paddle go."""
    place = [BAR + PEG + 0.001, 0.0, 0.01]
    handle = {"link": "handle", "place": place, "axis": [0, 0, -1]}
    moves = [{"joint": "paddle", "to": 0.3}, {"joint": "slide", "to": 0.2}, {"joint": "paddle", "to": 0.0}]
    task = {
        "urdf": latched_urdf(),
        "position": [0.75, -0.25, 0.0],
        "handle": handle,
        "moves": moves,
        "joints": {"slide": {"friction": 30.0}, "paddle": {"preload": 0.5, "stiffness": 1.0}},
        "releases": [{"joint": "slide", "latch": "paddle", "at": 0.2, "free_beyond": 0.03}],
    }
    return request_for({**task, **more})
