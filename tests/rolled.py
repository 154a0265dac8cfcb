"""Roll out a plan by Pinocchio alone with finer steps, as an independent check of paths."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ffsms_pin import opt

FloatArray = NDArray[np.float64]


def rolled_out_by_pinocchio(sms: Any, plan: opt.Trajectory, finer: int = 10) -> tuple[FloatArray, list[Any]]:
    """Return times (K,) and end-effector poses of a joint motion with a floating base, without momentum.

    Between nodes the joint accelerations are constant. The base velocity follows from the centroidal momentum
    matrix of Pinocchio; the midpoint rule integrates it in `finer` steps for each step of the plan.
    """
    model, data = sms.model, sms.model.createData()
    h = plan.dt / finer
    q, v = plan.q[0].copy(), np.zeros(model.nv)
    times, poses = [0.0], [sms.at(q).end_effector_pose]
    for k, acceleration in enumerate(plan.joint_accelerations):
        for i in range(finer):
            rates = plan.joint_rates[k] + (i + 0.5) * h * acceleration
            middle = q
            for _ in range(2):  # the second pass uses the velocity in the middle of the step
                A = pin.computeCentroidalMap(model, data, middle)
                v[:6], v[6:] = -np.linalg.solve(A[:, :6], A[:, 6:] @ rates), rates
                middle = pin.integrate(model, q, 0.5 * h * v)
            A = pin.computeCentroidalMap(model, data, middle)
            v[:6] = -np.linalg.solve(A[:, :6], A[:, 6:] @ rates)
            q = pin.integrate(model, q, h * v)
            times.append(plan.t[k] + (i + 1) * h)
            pin.framesForwardKinematics(model, data, q)
            poses.append(data.oMf[sms.frame_id].copy())
    return np.array(times), poses
