"""The first-order covariance of the end effector's final position under uncertain inertial parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, frozen, matrix
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.rollouts import rolled_out
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.regressors import PER_BODY

if TYPE_CHECKING:
    from ffsms_pin.opt.trajectory import Trajectory

_SMALL = 1e-5  # step of finite differences, as a share of the parameter scales of `_sizes`
_NONE = 1e-14  # a scaled variance of at most this share of the largest one is taken as zero


def end_spread(plan: Trajectory, covariance: FloatArray, sms: SpaceManipulator | None) -> FloatArray:
    """Return the covariance (3, 3) [m^2] of the end effector's final position, see `Trajectory.spread`."""
    if sms is None:
        if plan.problem is None:
            raise InvalidValue(
                "sms", sms, "must be given, because a plan that was loaded from a file has no problem"
            )
        sms = plan.problem.sms
    if sms.nq != plan.q.shape[1]:
        raise InvalidValue("sms", sms, "must be the robot of the plan, with the same joints")
    size = PER_BODY * (1 + sms.n)
    covariance = matrix("covariance", covariance, size, size, largest=np.inf)
    if not np.allclose(covariance, covariance.T, rtol=1e-6, atol=1e-9 * float(np.abs(covariance).max())):
        raise InvalidValue("covariance", covariance, "must be symmetric")
    sizes = _sizes(sms.inertial_parameters.reshape(-1, PER_BODY)).ravel()
    scaled = 0.5 * (covariance + covariance.T) / np.outer(sizes, sizes)
    variances, directions = np.linalg.eigh(scaled)
    if variances[0] < -1e-6 * max(float(variances[-1]), 1e-300):
        raise InvalidValue("covariance", float(variances[0]), "must have no eigenvalue below zero")
    kept = variances > _NONE * max(float(variances[-1]), 0.0)
    slopes = np.zeros((3, int(kept.sum())))
    for i, direction in enumerate(directions[:, kept].T):
        step = _SMALL * sizes * direction
        ends = [_end(plan, sms, sign * step) for sign in (1.0, -1.0)]
        slopes[:, i] = (ends[0] - ends[1]) / (2.0 * _SMALL)
    slopes *= np.sqrt(variances[kept])
    return frozen(slopes @ slopes.T)


def _sizes(parameters: FloatArray) -> FloatArray:
    """Return scales (b, 10) of inertial parameters: m, m l and m l^2 for mass m and radius of gyration l."""
    masses = parameters[:, 0]
    inertias = parameters[:, [4, 6, 9]].sum(axis=1) / 2.0
    lengths = np.sqrt(np.divide(inertias, masses, out=np.ones_like(masses), where=masses > 0.0))
    columns = [masses, *[masses * lengths] * 3, *[inertias] * 6]
    return np.asarray(np.maximum(np.array(columns).T, 1e-300))


def _end(plan: Trajectory, sms: SpaceManipulator, change: FloatArray) -> FloatArray:
    """Return the end effector's final position (3,) [m] for changed parameters and the same joint motion."""
    numbers = (sms.inertial_parameters + change).reshape(-1, PER_BODY)
    bodies = [
        pin.Inertia.FromDynamicParameters(row) if row[0] > 0.0 else body
        for row, body in zip(numbers, list(sms.model.inertias)[1:], strict=True)
    ]
    changed = sms.with_inertias(bodies)
    momentum = plan.momentum if plan.momentum.any() else None
    motion = rolled_out(changed, changed.arm_stack(plan.mode), plan.q[0], plan.joint_rates, plan.dt, momentum)
    return np.asarray(motion.end_effector[:, 0, -1])
