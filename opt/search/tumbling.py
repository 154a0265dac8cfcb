"""The final poses of a tumbling robot after joint motions, and their slopes by changes of the whole motion.

The base's attitude R satisfies R' = R [omega]x. The angular velocity omega has a contribution of the joint
rates, and a contribution of the total angular momentum L. A change of the joint motion rotates the
whole robot by an additional rotation vector theta, which satisfies theta' = c + A theta. The vector c is the
change of omega by the joints. The term A theta = R J R^T (L x theta), with the inverse inertia J, arises
because L in base axes depends on the base's attitude. Both equations are integrated by collocation at the
Gauss points of a spline.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.rollouts import apply_rates, velocity_slopes
from ffsms_pin.opt.search.spline import RateSpline
from ffsms_pin.system.batch.arm import ArmValues
from ffsms_pin.system.batch.stacks import apply


def tumbling_ends(
    problem: Problem,
    spline: RateSpline,
    joints: FloatArray,
    rates: FloatArray,
    share: FloatArray,
    speed: FloatArray,
) -> tuple[ArmValues, FloatArray, FloatArray]:
    """Return the final states of K motions of a tumbling robot.

    The results are the arm in base axes, and, in the base's axes at the start, the base's rotation (3, 3, K)
    and the slopes (3, n, K) of the robot's final rotation vector by the joint goals.

    Parameters
    ----------
    joints, rates : ndarray, shape (n, K, Q)
        Joint positions and rates of the motions at the instants of the spline.
    share, speed : ndarray, shape (Q,)
        Derivatives of joint positions and rates at these instants with respect to the joint goal.
    """
    stack = problem.stack
    assert problem.momentum is not None
    momentum = problem.rotation0.T @ problem.momentum[3:]
    arm = stack.evaluate(joints)
    turned = kernel.spline_attitudes(
        spline.quadrature, apply_rates(arm.spin, rates), arm.inverse, np.eye(3), momentum
    )
    R, drift = turned[:9].reshape(3, 3, *rates.shape[1:]), turned[9:].reshape(3, *rates.shape[1:])
    slopes, _ = velocity_slopes(stack, arm, rates, drift)
    by_joints = apply(R, share * slopes + speed * arm.spin)
    # Columns of A: R J R^T (L x e).
    by_turn = apply(R, apply(arm.inverse, np.einsum("yxkq,yz->xzkq", R, pin.skew(momentum))))
    end = ArmValues(*(value[..., -1] for value in arm.arrays()))
    return end, R[..., -1], _linear_end(spline, by_joints, by_turn)


def _linear_end(spline: RateSpline, forcing: FloatArray, matrix: FloatArray) -> FloatArray:
    """Integrate theta' = forcing + matrix theta from zero; return the final theta (3, n, K).

    `forcing` is (3, n, K, Q), and `matrix` (3, 3, K, Q).
    """
    to_points, over, _ = spline.quadrature
    intervals, gauss = over.shape
    n, count = forcing.shape[1:3]

    def by_interval(values: FloatArray) -> FloatArray:
        """Return values (3, ., K, Q) at the Gauss points as (intervals, K, gauss, 3, .)."""
        points = values[..., : intervals * gauss].reshape(3, -1, count, intervals, gauss)
        return np.asarray(points.transpose(3, 2, 4, 0, 1))

    c, A = by_interval(forcing), by_interval(matrix)
    # The system is solved for theta at the Gauss points of each interval. The right-hand sides are theta at
    # the interval's start and the integral of the forcing.
    system = np.eye(3 * gauss) - np.einsum("ibe,ikexy->ikbxey", to_points, A).reshape(
        intervals, count, 3 * gauss, 3 * gauss
    )
    start = np.broadcast_to(np.tile(np.eye(3), (gauss, 1)), (intervals, count, 3 * gauss, 3))
    forced = np.einsum("ibe,ikexj->ikbxj", to_points, c).reshape(intervals, count, 3 * gauss, n)
    at_points = np.linalg.solve(system, np.concatenate([start, forced], axis=-1))
    at_points = at_points.reshape(intervals, count, gauss, 3, 3 + n)
    moved = np.einsum("ie,ikexy,ikeyj->ikxj", over, A, at_points)
    moved[..., 3:] += np.einsum("ie,ikexj->ikxj", over, c)
    theta = np.zeros((count, 3, n))
    for step in moved:
        theta = theta + step[..., :3] @ theta + step[..., 3:]
    return np.asarray(theta.transpose(1, 2, 0))
