"""Small robots as URDF text, for tests of the loader."""

from __future__ import annotations

from pathlib import Path

LIMIT = '<limit lower="-1" upper="1" velocity="2" effort="3"/>'
CUBE_OBJ = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1))


def link(name: str, *collisions: str) -> str:
    """A link with one <collision> per geometry text."""
    body = "".join(f"<collision><geometry>{geometry}</geometry></collision>" for geometry in collisions)
    return f'<link name="{name}">{body}</link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = LIMIT, xyz: str = "0 0 1") -> str:
    """A joint about z."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="0 0 0"/><axis xyz="0 0 1"/>{inside}</joint>'
    )


def robot(*elements: str) -> str:
    """A URDF of these elements."""
    return f'<robot name="sample">{"".join(elements)}</robot>'


def two_links(inside: str = LIMIT, kind: str = "revolute", geometry: str = '<box size="1 1 1"/>') -> str:
    """A base and one link that carries ``geometry``."""
    return robot(link("base"), link("arm", geometry), joint("turn", "base", "arm", kind, inside))


def write_urdf(folder: Path, text: str) -> Path:
    """The text as ``robot.urdf`` in a folder."""
    path = folder / "robot.urdf"
    path.write_text(text, encoding="utf-8")
    return path
