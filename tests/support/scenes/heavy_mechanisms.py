"""Mechanisms with masses as URDF text: a hatch on a slide, a chest's lid, a slope's drawer, a flap below a slide."""

from __future__ import annotations

from typing import Any

from given_mechanisms import bar, box, request_for

from service import parse_request
from service.demands.mechanism.given import GivenMechanism, read_given_mechanism


def inertial(mass: float, at: tuple[float, float, float] = (0, 0, 0), moments: float = 0.0) -> str:
    """An <inertial> with three equal moments of inertia about its centre of mass."""
    tensor = f'<inertia ixx="{moments}" iyy="{moments}" izz="{moments}" ixy="0" ixz="0" iyz="0"/>'
    return f'<inertial><origin xyz="{at[0]} {at[1]} {at[2]}"/><mass value="{mass}"/>{tensor}</inertial>'


def joint(name: str, kind: str, parent: str, child: str, axis: str, *more: str, at: str = "0 0 0", **limit: Any) -> str:
    """A joint with limits 0 to 1, at 0.5 rad/s or m/s."""
    words = {"lower": 0, "upper": 1, "velocity": 0.5, "effort": 100} | limit
    limits = " ".join(f'{key}="{value}"' for key, value in words.items())
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><origin xyz="{at}"/>'
        f'<axis xyz="{axis}"/><limit {limits}/>{"".join(more)}</joint>'
    )


def link(name: str, *more: str) -> str:
    """A link with a small box as its shape."""
    return f'<link name="{name}">{box((0.1, 0.1, 0.1), (0, 0, 0))}{"".join(more)}</link>'


def robot(*parts: str) -> str:
    """A URDF whose root has no shape."""
    return f'<robot name="object"><link name="root"/>{"".join(parts)}</robot>'


def dynamics(friction: float = 0.0, damping: float = 0.0) -> str:
    """A joint's <dynamics>."""
    return f'<dynamics friction="{friction}" damping="{damping}"/>'


def slide_urdf(mass: float, axis: str, *more: str, **limit: Any) -> str:
    """A mass on a slide."""
    return robot(link("body", inertial(mass)), joint("slide", "prismatic", "root", "body", axis, *more, **limit))


def lid_urdf(mass: float = 10.0, *more: str, moments: float = 0.2) -> str:
    """A lid, hinged about the y axis, whose centre of mass is 0.3 m in front of the hinge while it is shut at 0."""
    body = link("body", inertial(mass, (-0.3, 0, 0), moments))
    return robot(body, joint("hinge", "revolute", "root", "body", "0 1 0", *more, upper=3.0))


def chest_request() -> dict[str, Any]:
    """Lift a lid of 2 kg by 0.4 rad with a peg below its bar, and let it down; it has 1 N m of friction."""
    lid = f'<link name="lid">{inertial(2.0, (-0.3, 0, 0), 0.03)}{box((0.6, 0.4, 0.02), (-0.3, 0, 0))}</link>'
    grip = f'<link name="handle">{bar(0.2, (0, 0, 0), "1.5707963 0 0")}</link>'
    screws = (
        '<joint name="screws" type="fixed"><parent link="lid"/><child link="handle"/><origin xyz="-0.66 0 0"/></joint>'
    )
    hinge = joint("hinge", "revolute", "root", "lid", "0 1 0", dynamics(1.0), at="0.15 0 0.95", upper=1.2)
    chest = f'<link name="root">{box((0.3, 0.5, 0.9), (0, 0, 0.45))}</link>'
    handle = {"link": "handle", "place": [0, 0, -0.018], "axis": [1, 0, 0], "tilt_deg": 35}
    steps = [{"joint": "hinge", "to": 0.4}, {"joint": "hinge", "to": 0.0}]
    urdf = f'<robot name="chest">{chest}{lid}{grip}{hinge}{screws}</robot>'
    return request_for({"urdf": urdf, "position": [1.2, -0.25, 0], "handle": handle, "moves": steps})


def make_task(urdf: str, moves: list[tuple[str, float]], **more: Any) -> dict[str, Any]:
    """A request that moves the link ``body`` by a place half a metre in front of its frame."""
    handle = {"link": "body", "place": [-0.5, 0.0, 0.0], "axis": [1.0, 0.0, 0.0]}
    steps = [{"joint": name, "to": to} for name, to in moves]
    return request_for({"urdf": urdf, "position": [1.0, 0.0, 1.0], "handle": handle, "moves": steps, **more})


def read_task(urdf: str, moves: list[tuple[str, float]], **more: Any) -> GivenMechanism:
    """Read such a request's mechanism."""
    task = parse_request(make_task(urdf, moves, **more)).task
    assert task is not None
    assert task.mechanism is not None
    return read_given_mechanism(task.mechanism)
