"""What wheels have of the momentum of a base that they hold.

Wheels that hold the attitude share by the pseudo-inverse, as `ffsms_pin.control.WheelAllocation` does. No
moment acts on the system from outside then, so its angular momentum about its centre of mass is constant:
what the arm and the moving base have of it, the wheels lose. With D the angular momentum a joint rate
(`held_momentum`), A the axes (3, w) and h_0 the wheels' momenta with the joints at rest,

    h = h_0 - A^+ D u,    h' = -A^+ (D u)';

a motor also has to overcome its bearing's friction (`Features.wheels`, `Features.wheel_torques`).
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.checks import FloatArray
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmValues
from ffsms_pin.system.batch.stacks import cross

__all__ = ["held_momentum", "wheel_shares", "wheel_total"]


def wheel_shares(wheels: ReactionWheels | None) -> FloatArray:
    """A^+ (w, 3): the wheels' shares of a momentum or a torque in root axes; no rows without wheels."""
    return np.zeros((0, 3)) if wheels is None else np.linalg.pinv(wheels.axes.T)


def held_momentum(arm: ArmValues) -> FloatArray:
    """D (3, n, ...): angular momentum a joint rate about the system's centre of mass, base axes.

    The base's attitude held, its place free or held: moving on evenly, a system has none about its own centre
    of mass.
    """
    return arm.angular - cross(arm.com[:, None], arm.linear)


def wheel_total(
    sms: SpaceManipulator, wheels: ReactionWheels, q: FloatArray, v: FloatArray, momentum: FloatArray
) -> FloatArray:
    """Momenta h_0 (w,) that wheels would have with all else at rest, from those of now (w,) [N m s].

    At a measured state, Pinocchio's q (nq,) and v (6 + n,): what arm and base have of angular momentum, their
    turning as well, is the wheels' in the end.
    """
    angular = pin.computeCentroidalMomentum(sms.model, sms.model.createData(), q, v).angular
    in_root_axes = pin.Quaternion(q[3:7]).toRotationMatrix().T @ angular
    return np.asarray(momentum + wheel_shares(wheels) @ in_root_axes)
