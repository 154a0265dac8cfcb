"""The model in which wheels are joints: what a simulation integrates.

A wheel that is balanced and symmetric acts on its satellite by its spin alone. With the wheels' masses and
the rest of their inertias counted for the base, a wheel is a body without mass whose only inertia is I about
its axis. The base then has to be without it: its inertia is that with standing wheels less the sum of
I a a^T. In this model the articulated-body algorithm is exact: with h = I (W + a . w), W the wheel's speed
against the base and w the base's angular velocity,

    h' = tau,   and the base feels   -a tau - w x (a h)

(gyrostat: P. C. Hughes, "Spacecraft Attitude Dynamics", Wiley 1986, chapter 3).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation.wheels import ReactionWheels
from ffsms_pin.checks import FloatArray, instance
from ffsms_pin.errors import InvalidValue

__all__ = ["check_inertia", "gyrostat"]


def gyrostat(model: Any, wheels: ReactionWheels) -> Any:
    """A copy of the model with the wheels as its last joints.

    Parameters
    ----------
    model : pinocchio.Model
        With a free-flyer as its first joint; its base's inertia counts the wheels as standing still.
    wheels : ReactionWheels

    Returns
    -------
    pinocchio.Model
        q = [q of `model`; wheel angles (w,)], v = [v of `model`; wheel speeds (w,) against the base].
    """
    instance("model", model, pin.Model)
    instance("wheels", wheels, ReactionWheels)
    model = model.copy()
    base = model.inertias[1]
    model.inertias[1] = pin.Inertia(base.mass, base.lever, base.inertia - wheels.spin_inertia)
    origin = np.zeros(3)
    for i, (axis, inertia) in enumerate(zip(wheels.axes, wheels.inertia, strict=True)):
        place = pin.SE3(_turn_z_to(axis), origin)
        joint = model.addJoint(1, pin.JointModelRZ(), place, f"{wheels.names[i]} of the base")
        model.inertias[joint] = pin.Inertia(0.0, origin, np.diag([0.0, 0.0, float(inertia)]))
    return model


def check_inertia(model: Any, wheels: ReactionWheels) -> None:
    """Raise `InvalidValue` where the wheels' spin inertias exceed what the base has."""
    rest = model.inertias[1].inertia - wheels.spin_inertia
    if np.linalg.eigvalsh(rest)[0] <= 0.0:
        raise InvalidValue(
            "wheels.inertia",
            wheels.inertia,
            "must leave the base an inertia: the base's counts the wheels, and is smaller than theirs",
        )


def _turn_z_to(axis: FloatArray) -> FloatArray:
    """A rotation matrix (3, 3) whose third column is the unit vector `axis`."""
    start = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(start, axis)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])
