"""Simulate the published run of the paper's author, a planar robot under PD control, here and in MuJoCo."""

from __future__ import annotations

from pathlib import Path

import mujoco as mj
import numpy as np
from engines import Array, Mujoco

import ffsms_pin as ffsms
from ffsms_pin.control import PD
from ffsms_pin.simulation import Conditions

__all__ = ["PUBLISHED", "ROBOT", "mujoco_end", "our_end", "planar_robot"]

# Base position [m] and attitude [rad] about the system's centre of mass at the end, read from the plots.
PUBLISHED = np.array([-0.055, 0.009, 0.22])
_DURATION, _STEP = 20.0, 2e-3
_DESIRED = np.radians([-30.0, 0.0, 0.0])


def _link(name: str, mass: float, com: float, moments: tuple[float, float, float]) -> str:
    inertia = " ".join(f'i{a}{a}="{value}"' for a, value in zip("xyz", moments, strict=True))
    body = f'<origin xyz="{com} 0 0"/><mass value="{mass}"/><inertia {inertia} ixy="0" ixz="0" iyz="0"/>'
    return f'<link name="{name}"><inertial>{body}</inertial></link>'


def _joint(name: str, parent: str, child: str, x: float, kind: str = "revolute") -> str:
    moves = '<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="5" velocity="1"/>'
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{x} 0 0"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{moves if kind == "revolute" else ""}</joint>'


# A box of 33.015 kg, 0.464 m wide, and square bars of 1.2, 1.2 and 0.5 kg, each 0.38 m long.
_HEAVY, _LIGHT = (0.0002888, 0.0145844, 0.0145844), (0.00012033, 0.00607683, 0.00607683)
ROBOT = "".join(
    [
        '<robot name="published_planar">',
        _link("base", 33.015, 0.0, (1.2342, 1.2342, 1.184666)),
        _link("l1", 1.2, 0.19, _HEAVY),
        _link("l2", 1.2, 0.19, _HEAVY),
        _link("l3", 0.5, 0.19, _LIGHT),
        '<link name="ee"/>',
        _joint("j1", "base", "l1", 0.232),
        _joint("j2", "l1", "l2", 0.38),
        _joint("j3", "l2", "l3", 0.38),
        _joint("je", "l3", "ee", 0.38, "fixed"),
        "</robot>",
    ]
)


def planar_robot(folder: Path) -> ffsms.SpaceManipulator:
    """Write the robot's file into a folder and load it."""
    path = folder / "published_planar.urdf"
    path.write_text(ROBOT)
    return ffsms.load(path)


class _Step:
    """A reference with constant joint positions."""

    duration, target = _DURATION, np.zeros(3)

    def sample(self, t: float) -> tuple[Array, Array, Array]:
        """Return the desired joint motion."""
        return _DESIRED, np.zeros(3), np.zeros(3)


def _base(q: Array) -> Array:
    """Return the position of the base in the plane [m] and its angle [rad]."""
    return np.array([q[0], q[1], 2.0 * np.arctan2(q[5], q[6])])


def our_end(sms: ffsms.SpaceManipulator) -> Array:
    """Return x, y [m] and angle [rad] of the base at the end of the run, by `simulate`."""
    conditions, start = Conditions(guards=None), sms.configuration(np.zeros(3))
    law = PD(sms, 1.0, 1.0)
    return _base(ffsms.simulate(sms, _Step(), law, _STEP, start, conditions=conditions).q[-1])


def mujoco_end(sms: ffsms.SpaceManipulator) -> Array:
    """Return x, y [m] and angle [rad] of the base at the end, by MuJoCo with the same control law."""
    peer, law, start = Mujoco(sms, _STEP), PD(sms, 1.0, 1.0), sms.configuration(np.zeros(3))
    peer.set(start, np.zeros(sms.nv))
    for _ in range(round(_DURATION / _STEP)):
        q, v = peer.state()
        peer.data.ctrl[:] = law.torque(q, v, _DESIRED, np.zeros(3), np.zeros(3))
        mj.mj_step(peer.model, peer.data)
    return _base(peer.state()[0])
