"""Reaction wheels that stand in a URDF: continuous joints on the base that are no joints of the arm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidUrdf, InvalidValue, UnsupportedJoint
from ffsms_pin.system.urdf_edit import fix_joint
from ffsms_pin.system.urdf_file import UrdfFile

__all__ = ["taken_out", "wheel_names"]

_ROUNDING = 1e-4  # of a wheel's inertia: the digits of a file


def wheel_names(value: object) -> tuple[str, ...]:
    """Names of joints that are wheels, checked to be texts; there may be none."""
    if isinstance(value, Sequence) and not isinstance(value, (str, bytes)):
        names = tuple(value)
        if all(isinstance(name, str) for name in names):
            return names
    raise InvalidValue("wheels", value, "must be a list of names of joints")


def taken_out(urdf: UrdfFile, names: Sequence[str]) -> tuple[UrdfFile, ReactionWheels]:
    """The same robot with these joints fixed, so that the base has the wheels' masses, and the wheels.

    Spin inertia, axis, largest torque (the effort limit) and friction are those of the file; the largest
    momentum is that at the velocity limit. `InvalidValue` for what is no joint of the file,
    `UnsupportedJoint` for one that is not continuous, is not on the base, carries another joint, or whose
    link is not balanced and symmetric about its axis.
    """
    types = {joint.name: joint.type for joint in urdf.joints}
    for name in names:
        if name not in types:
            raise InvalidValue("wheels", name, f"names no joint of the file ({', '.join(types)})")
        if types[name] != "continuous":
            raise UnsupportedJoint(
                urdf.path, f"wheel '{name}' is {types[name]}; a wheel's joint is continuous"
            )
    try:
        model = pin.buildModelFromXML(urdf.kinematics(), pin.JointModelFreeFlyer())
    except Exception as error:  # whatever the parser objects to that the checks before it did not
        raise InvalidUrdf(urdf.path, f"Pinocchio cannot build a model from it ({error})") from None
    wheels = _wheels(urdf, model, names)
    robot = ElementTree.fromstring(urdf.full_text())
    for joint in robot.findall("joint"):
        if joint.get("name") in names:
            fix_joint(joint, 0.0)
    return UrdfFile(urdf.path, robot, any_tensor=True), wheels  # its tensors were judged before


def _wheels(urdf: UrdfFile, model: Any, names: Sequence[str]) -> ReactionWheels:
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    axes, inertias = [], []
    indices = [model.getJointId(name) for name in names]
    for name, j in zip(names, indices, strict=True):
        if model.parents[j] != 1:
            raise UnsupportedJoint(urdf.path, f"wheel '{name}' is not on the base")
        if j in list(model.parents):
            raise UnsupportedJoint(urdf.path, f"wheel '{name}' carries another joint")
        local = pin.getJointJacobian(model, data, j, pin.ReferenceFrame.LOCAL)[3:, model.joints[j].idx_v]
        inertias.append(_spin_inertia(urdf, name, model.inertias[j], local))
        axes.append(data.oMi[j].rotation @ local)
    rows = [model.joints[j].idx_v for j in indices]
    largest = np.finfo(np.float64).max
    torque, speed = (
        np.where(limit[rows] < largest, limit[rows], np.inf)
        for limit in (np.array(model.upperEffortLimit), np.array(model.upperVelocityLimit))
    )
    friction, coulomb = np.array(model.damping)[rows], np.array(model.upperDryFrictionLimit)[rows]
    spin = np.array(inertias)
    return ReactionWheels(axes, spin, torque, spin * speed, friction, coulomb, names=tuple(names))


def _spin_inertia(urdf: UrdfFile, name: str, body: Any, axis: FloatArray) -> float:
    """Inertia about the axis [kg m^2] of a body that is balanced and symmetric about it."""
    tensor = np.array(body.inertia)
    spin = float(axis @ tensor @ axis)
    cross = (np.trace(tensor) - spin) / 2.0
    symmetric = cross * np.eye(3) + (spin - cross) * np.outer(axis, axis)
    if np.abs(tensor - symmetric).max() > _ROUNDING * np.abs(tensor).max():
        raise UnsupportedJoint(urdf.path, f"wheel '{name}' is not symmetric about its axis")
    off = float(np.linalg.norm(np.cross(axis, body.lever)))
    if body.mass * off**2 > _ROUNDING * spin:
        words = f"wheel '{name}' is not balanced: its centre is {off:.3g} m off its axis"
        raise UnsupportedJoint(urdf.path, words)
    return spin
