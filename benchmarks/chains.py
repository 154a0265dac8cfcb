"""Generate chains of any number of joints as URDF, to measure times over the number of joints."""

from __future__ import annotations

import tempfile
from pathlib import Path

import ffsms_pin as ffsms

LENGTH, MASS, BASE_MASS = 2.4, 24.0, 400.0  # [m, kg] length and mass of the arm, mass of the satellite
PACKAGED = {3: "planar_3r", 7: "space_arm_7", 14: "two_arms"}


def chain_urdf(n: int) -> str:
    """Return an arm of `n` equal links on a satellite; the joint axes alternate between z and y."""
    link, mass = LENGTH / n, MASS / n
    bend = mass * link**2 / 12.0
    lines = [
        f'<robot name="chain_{n}">',
        _body("base", BASE_MASS, 0.0, (60.0, 60.0, 60.0), "<box size='1 1 1'/>"),
    ]
    for i in range(1, n + 1):
        lines.append(_body(f"link_{i}", mass, link / 2.0, (0.1 * bend + 1e-4, bend, bend)))
        parent, place = ("base", 0.5) if i == 1 else (f"link_{i - 1}", link)
        axis = "0 0 1" if i % 2 else "0 1 0"
        lines.append(
            f'<joint name="joint_{i}" type="revolute"><parent link="{parent}"/><child link="link_{i}"/>'
            f'<origin xyz="{place!r} 0 0"/><axis xyz="{axis}"/>'
            '<limit lower="-2" upper="2" velocity="0.4" effort="20"/></joint>'
        )
    lines.append(
        f'<link name="tip"/><joint name="tip" type="fixed"><parent link="link_{n}"/><child link="tip"/>'
        f'<origin xyz="{link!r} 0 0"/></joint></robot>'
    )
    return "\n".join(lines)


def _body(name: str, mass: float, com: float, inertia: tuple[float, float, float], shape: str = "") -> str:
    xx, yy, zz = inertia
    collision = f"<collision><geometry>{shape}</geometry></collision>" if shape else ""
    return (
        f'<link name="{name}"><inertial><origin xyz="{com!r} 0 0"/><mass value="{mass!r}"/>'
        f'<inertia ixx="{xx!r}" iyy="{yy!r}" izz="{zz!r}" ixy="0" ixz="0" iyz="0"/></inertial>'
        f"{collision}</link>"
    )


def chain(n: int) -> ffsms.SpaceManipulator:
    """Return the generated chain of `n` joints."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "chain.urdf"
        path.write_text(chain_urdf(n))
        return ffsms.load(path)


def robot(n: int) -> ffsms.SpaceManipulator:
    """Return a robot of `n` joints, a packaged one if there is one, otherwise the chain."""
    if n not in PACKAGED:
        return chain(n)
    return ffsms.load(PACKAGED[n], end_effector="left_tool" if n == 14 else None)
