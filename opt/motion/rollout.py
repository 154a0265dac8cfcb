"""Rolling out joint rates: joints, base and end effector at the nodes and in the middles between."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.motion.motions import ARRIVAL_SHARE, Motions, apply_rates
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.batch.stacks import apply, cross, quaternions


def rolled_out(
    sms: SpaceManipulator,
    stack: ArmStack,
    q0: FloatArray,
    rates: FloatArray,
    dt: float,
    momentum: FloatArray | None = None,
) -> Motions:
    """One motion at its N + 1 nodes, even instants, and in the N middles between them, odd instants.

    From `q0` (nq,), with joint rates (N + 1, n) at nodes `dt` [s] apart, linear between them [rad/s], and the
    total momentum (6,) [linear; angular], inertial axes, about the system's centre of mass. It has no target
    (NaN); see `dataclasses.replace`.
    """
    steps, n = len(rates) - 1, sms.n
    count = 2 * steps + 1
    times = np.linspace(0.0, steps * dt, count)
    u = np.empty((n, count))
    u[:, ::2], u[:, 1::2] = rates.T, 0.5 * (rates[:-1] + rates[1:]).T
    joints = np.empty((n, count))
    travel = np.cumsum(0.5 * dt * (rates[1:] + rates[:-1]), axis=0)
    start = sms.layout.positions(q0)
    joints[:, ::2] = (start + np.vstack([np.zeros(n), travel])).T
    joints[:, 1::2] = joints[:, :-1:2] + 0.125 * dt * (3.0 * rates[:-1] + rates[1:]).T
    slopes = np.diff(rates, axis=0).T / dt
    accelerations = np.hstack([np.repeat(slopes, 2, axis=1), slopes[:, -1:]])

    arm = stack.evaluate(joints)
    rotation0 = pin.Quaternion(q0[3:7]).toRotationMatrix()
    com0 = q0[:3] + rotation0 @ arm.com[:, 0]
    total = np.zeros(6) if momentum is None else momentum
    drift = total[:3] / stack.mass
    if total[3:].any():
        state = np.concatenate([rotation0.ravel(), q0[:3], start, rates[0]])
        turned = kernel.roll_out(stack.tree, state, accelerations[:, :-1], total, 0.5 * dt)[:9]
    else:  # the angular velocity is known
        turned = kernel.attitudes(rotation0, apply_rates(arm.spin, u), dt)
    R = turned.reshape(3, 3, -1)
    own = apply(arm.inverse, np.einsum("yxk,y->xk", R, total[3:]))
    simpson = np.full(count, dt / 3.0)
    simpson[1::2] *= 2.0
    simpson[[0, -1]] *= 0.5
    return Motions(
        stack=stack,
        times=times,
        weights=simpson,
        limit_weights=simpson,
        last_tenth=np.flatnonzero(times >= ARRIVAL_SHARE * times[-1] - 1e-9),
        joints=joints[:, None],
        rates=u[:, None],
        accelerations=accelerations[:, None],
        evaluated=arm.stacked(),
        base_attitude=R[:, :, None],
        com=com0[:, None] + drift[:, None] * times,
        drift=drift,
        own_spin=own[:, None],
        base_start=com0 + rotation0 @ (stack.base_com - arm.com[:, 0]),
        rotation_start=rotation0,
        target=np.full((3, count), np.nan),
        mean_speed=1.0,
    )


def configurations(sms: SpaceManipulator, q0: FloatArray, motion: Motions) -> FloatArray:
    """Pinocchio's q (N + 1, nq) at the nodes of a motion that was rolled out from q0."""
    R, arm = motion.base_attitude[:, :, 0, ::2], motion.arm
    q = np.empty((R.shape[-1], sms.nq))
    q[:, :3] = (motion.com[:, ::2] - apply(R, arm.com[:, 0, ::2])).T
    q[:, 3:7] = quaternions(R).T
    sms.layout.set_positions(q, motion.joints[:, 0, ::2].T)
    q[0] = q0
    return q


def velocities(motion: Motions) -> FloatArray:
    """Pinocchio's v (N + 1, 6 + n) at the nodes: root velocity in root axes, then joint rates."""
    R, arm, u = motion.base_attitude[:, :, 0, ::2], motion.arm, motion.rates[:, 0, ::2]
    own = motion.own_spin[:, 0, ::2]
    linear = apply_rates(arm.root[..., 0, ::2], u) + np.einsum("yxk,y->xk", R, motion.drift)
    angular = apply_rates(arm.spin[..., 0, ::2], u) + own
    return np.concatenate([linear + cross(arm.com[:, 0, ::2], own), angular, u]).T


def angles_from_start(quaternions: FloatArray) -> FloatArray:
    """Angle of each attitude from the first one (N + 1,) [rad], of unit quaternions (N + 1, 4)."""
    apart = np.abs(quaternions @ quaternions[0])
    return np.asarray(2.0 * np.arccos(np.minimum(apart, 1.0)))
