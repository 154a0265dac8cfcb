"""What thrusters that hold the base have to give, along whole motions.

In base axes, with L u the linear momentum of the arm on a base at rest, r from the base's centre of mass to
the system's, m the system's mass, and w = spin u the angular velocity of a base whose place is held:

    attitude held               no force,                     moment (D u)'
    both held                   force (L u)',                 moment about the base's centre of mass
    place held                  force p' + w x p,             no moment,   p = L u + m w x r

A prime is the rate of change seen from the base. All of it follows from the slopes in `opt.motion.slopes`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.actuation.allocation import ThrusterAllocation
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion.motions import Motions, apply_rates
from ffsms_pin.opt.motion.slopes import fixed_base_slopes, momentum_slopes, velocity_slopes
from ffsms_pin.opt.motion.wheels import held_momentum
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.stacks import cross

__all__ = ["WrenchSlopes", "held_wrench", "propellant", "thruster_shares", "wrench_slopes"]

_STEP = 1e-6  # [rad] of the differences by the joint positions


class WrenchSlopes(NamedTuple):
    """Slopes of `held_wrench` by joint positions, rates and accelerations, each (6, n, V)."""

    by_joints: FloatArray
    by_rates: FloatArray
    by_accelerations: FloatArray


def held_wrench(stack: ArmStack, arm: ArmValues, rates: FloatArray, accelerations: FloatArray) -> FloatArray:
    """Force [N] and moment [N m] about the base's centre of mass (6, ...) that hold the base, base axes.

    Parameters
    ----------
    stack : ArmStack
        Of a mode that holds something.
    arm : ArmValues
    rates, accelerations : ndarray, shape (n, ...)
    """
    if stack.moves:  # the attitude is held, the place is free
        moment = apply_rates(held_momentum(arm), accelerations)
        moment = moment + apply_rates(momentum_slopes(stack, arm, rates), rates)
        return np.concatenate([np.zeros_like(moment), moment])
    linear, angular = (apply_rates(slope, rates) for slope in fixed_base_slopes(stack, arm, rates))
    force = apply_rates(arm.linear, accelerations) + linear
    base = stack.base_com.reshape(3, *(1,) * (force.ndim - 1)) + np.zeros_like(force)
    if not stack.turns_freely:
        about_root = apply_rates(arm.angular, accelerations) + angular
        return np.concatenate([force, about_root - cross(base, force)])
    spin = apply_rates(arm.spin, rates)
    turning = apply_rates(arm.spin, accelerations)
    turning = turning + apply_rates(velocity_slopes(stack, arm, rates)[0], rates)
    from_base = stack.first_moment(arm) - stack.total_mass * base  # m r
    moved = apply_rates(arm.linear, rates)  # m r'
    p = moved + cross(spin, from_base)
    force = force + cross(turning, from_base) + cross(spin, moved) + cross(spin, p)
    return np.concatenate([force, np.zeros_like(force)])


def wrench_slopes(
    stack: ArmStack, joints: FloatArray, rates: FloatArray, accelerations: FloatArray
) -> WrenchSlopes:
    """Slopes at single configurations, columns (n, V) each.

    The wrench is quadratic in the rates and linear in the accelerations, so differences by these are exact;
    by the joint positions they are central.
    """
    n = stack.n
    u, a = rates[:, None], accelerations[:, None]
    # Columns of the identity, one a joint, as a stack of n; then the same backwards.
    ahead = np.eye(n)[..., None]
    both = np.concatenate([ahead, -ahead], axis=1)
    moved = held_wrench(stack, stack.evaluate(joints[:, None] + _STEP * both), u + 0.0 * both, a + 0.0 * both)
    arm = ArmValues(*(x[..., None, :] for x in stack.evaluate(joints).arrays()))
    faster = held_wrench(stack, arm, u + both, np.zeros_like(u + both))
    pushed = held_wrench(stack, arm, np.zeros_like(u + ahead), ahead + np.zeros_like(u))
    return WrenchSlopes(
        (moved[:, :n] - moved[:, n:]) / (2.0 * _STEP), 0.5 * (faster[:, :n] - faster[:, n:]), pushed
    )


def thruster_shares(motions: Motions) -> FloatArray:
    """Rows (r, 6): forces of the thrusters for a unit of each force and moment; parallel ones as one.

    What two thrusters give alike, or one gives and the other takes, is one row with the sum of both.
    """
    assert motions.thrusters is not None
    rows = ThrusterAllocation(motions.thrusters, motions.stack.base_com).shares
    kept: list[FloatArray] = []
    for row in rows:
        size = float(np.linalg.norm(row))
        if size == 0.0:
            continue
        for i, other in enumerate(kept):
            if abs(row @ other) > (1.0 - 1e-9) * size * float(np.linalg.norm(other)):
                kept[i] = other * (1.0 + size / float(np.linalg.norm(other)))
                break
        else:
            kept.append(row)
    return np.array(kept)


def propellant(motion: Motions) -> float:
    """What thrusters that hold the base use over one motion [kg], by the law's own sharing of forces.

    As proportional thrusters would give them; pulses of the same mean use the same.
    """
    thrusters = motion.thrusters
    if thrusters is None:
        return 0.0
    middles = slice(1, None, 2)
    arm = ArmValues(*(x[..., 0, middles] for x in motion.arm.arrays()))
    columns: Any = (motion.rates[:, 0, middles], motion.accelerations[:, 0, middles])
    wrench = held_wrench(motion.stack, arm, *columns)
    allocation = ThrusterAllocation(thrusters, motion.stack.base_com)
    flow = [thrusters.flow(allocation.forces(row[:3], row[3:])) for row in wrench.T]
    return float(np.sum(flow)) * float(motion.times[2] - motion.times[0])
