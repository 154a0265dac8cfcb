"""The free-floating system as a MuJoCo model, number by number from Pinocchio's; its joints' axes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, instance, positive
from ffsms_pin.system import SpaceManipulator


def to_mjcf(sms: SpaceManipulator, timestep: float = 1e-3, actuators: bool = True) -> str:
    """MJCF text: a free base, the arm's joints with their limits, no gravity, no contact, Runge-Kutta.

    The end effector is the site `end_effector`. Shapes are left out: this is for dynamics.

    Parameters
    ----------
    sms : SpaceManipulator
    timestep : float
        [s]
    actuators : bool
        Whether each joint gets a motor, whose control is its torque [N m].

    Notes
    -----
    MuJoCo's `qpos` begins with the base's position and its quaternion (w, x, y, z); the linear part of its
    `qvel` has inertial axes, the angular part the base's own.
    """
    instance("sms", sms, SpaceManipulator)
    positive("timestep", timestep, "s")
    instance("actuators", actuators, bool)
    model, axes = sms.model, joint_axes(sms)

    def body(j: int) -> str:
        if j == 1:
            text = '<body name="base"><freejoint name="base"/>'
        else:
            text = f'<body name="{model.names[j]}_link" {_place(model.jointPlacements[j])}>{joint(j)}'
        text += _inertial(model.inertias[j])
        frame = model.frames[sms.frame_id]
        if frame.parentJoint == j:
            text += f'<site name="end_effector" {_place(frame.placement)}/>'
        return text + "".join(body(k) for k in model.children[j]) + "</body>"

    def joint(j: int) -> str:
        i = j - 2
        slides, axis = axes[i]
        lower, upper = sms.limits.lower[i], sms.limits.upper[i]
        limited = np.isfinite([lower, upper]).all()
        bounds = f' limited="true" range="{_numbers([lower, upper])}"' if limited else ' limited="false"'
        return (
            f'<joint name="{model.names[j]}" type="{"slide" if slides else "hinge"}" axis="{_numbers(axis)}"'
            f'{bounds} damping="0" armature="0"/>'
        )

    motors = "".join(f'<motor joint="{name}"/>' for name in sms.joint_names) if actuators else ""
    return (
        f'<mujoco model="{model.name}"><compiler angle="radian" autolimits="false"/>'
        f'<option gravity="0 0 0" timestep="{timestep!r}" integrator="RK4">'
        '<flag contact="disable" constraint="disable"/></option>'
        f"<worldbody>{body(1)}</worldbody><actuator>{motors}</actuator></mujoco>\n"
    )


def _inertial(inertia: Any) -> str:
    entries = [inertia.inertia[a, b] for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    pos, full = _numbers(inertia.lever), _numbers(entries)
    return f'<inertial pos="{pos}" mass="{inertia.mass!r}" fullinertia="{full}"/>'


def _place(pose: Any) -> str:
    x, y, z, w = pin.SE3ToXYZQUAT(pose)[3:]
    return f'pos="{_numbers(pose.translation)}" quat="{_numbers([w, x, y, z])}"'


def _numbers(values: Any) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(values))


class JointAxis(NamedTuple):
    """Whether a joint slides, and its axis (3,) in the joint's frame; otherwise it turns about the axis."""

    slides: bool
    axis: FloatArray


def joint_axes(sms: SpaceManipulator) -> list[JointAxis]:
    """The axes of the n actuated joints, in order."""
    model = sms.model
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    found = []
    for j in range(2, model.njoints):
        column = pin.getJointJacobian(model, data, j, pin.LOCAL)[:, model.joints[j].idx_v]
        slides = not column[3:].any()
        found.append(JointAxis(slides, np.array(column[:3] if slides else column[3:])))
    return found
