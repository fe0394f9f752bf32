"""A small arm as other people would bring it: a URDF file of links that turn in a horizontal plane."""

from pathlib import Path


def write_planar_arm(folder: Path, n_links: int, length: float, thickness: float, limit: float) -> Path:
    """Path of the URDF of an arm whose joints j0, j1, ... turn links l0, l1, ... by up to ``limit`` either way."""
    links = "".join(
        f'<link name="l{k}"><collision><origin xyz="{length / 2} 0 0"/>'
        f'<geometry><box size="{length} {thickness} {thickness}"/></geometry></collision></link>'
        for k in range(n_links)
    )
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="{"base" if k == 0 else f"l{k - 1}"}"/><child link="l{k}"/>'
        f'<origin xyz="{0.0 if k == 0 else length} 0 0"/><axis xyz="0 0 1"/>'
        f'<limit lower="{-limit}" upper="{limit}" velocity="2" effort="20"/></joint>'
        for k in range(n_links)
    )
    urdf = folder / "arm.urdf"
    urdf.write_text(f'<robot name="arm"><link name="base"/>{links}{joints}</robot>')
    return urdf
