"""Coarse marches of the kernel against the same rule on Pinocchio's state, one after the other."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.marches import cone_marches
from ffsms_pin.opt.horizon.shooting import joint_range
from ffsms_pin.opt.step.state import sides_across

STEPS = 12
POWER, LEAST, DAMPING, SHARE = 2.5, 0.2, 0.003, 0.8


def plain_march(problem: opt.Problem, side: FloatArray | None) -> FloatArray:
    """Joint rates (STEPS, n) to one side of the target's direction; None: straight."""
    sms, T, dt = problem.sms, problem.duration, problem.duration / STEPS
    place, n, (low, high) = problem.goal.place(T), sms.n, joint_range(problem)
    q, speed, rates = problem.q0.copy(), 0.0, []
    for k in range(STEPS):
        state = sms.at(q)
        tip = state.end_effector_pose
        way = place.position - tip.translation
        distance = float(np.linalg.norm(way))
        d, cosine, e = way / distance, 1.0, way / distance
        if side is not None:
            margin = problem.kappa * (1.0 - state.coupling.entropy)
            cosine = float(np.clip(np.log(np.expm1(margin)) / problem.kappa, -1.0, 1.0))
            side = side - (side @ d) * d
            side = side / np.linalg.norm(side)
            e = cosine * d + np.sqrt(1.0 - cosine**2) * side
        share = POWER / (T - k * dt + 0.5 * POWER * dt)
        rise = 10.0 / STEPS * max(problem.mean_speed, distance / T) * POWER
        speed = min(share * distance / max(cosine, LEAST), speed + rise)
        J, wanted = state.J_star[:3], speed * e
        if place.rotation is not None:
            J = state.J_star
            wanted = np.append(wanted, share * pin.log3(place.rotation @ tip.rotation.T))
        square = J @ J.T + (DAMPING * problem.stack.length) ** 2 * np.eye(len(J))
        u = J.T @ np.linalg.solve(square, wanted)
        u = u + J.T @ np.linalg.solve(square, wanted - J @ u)
        most = SHARE * sms.limits.velocity
        u = u / max(1.0, float(np.abs(u / most).max()))
        joints = sms.layout.positions(q)
        u = np.clip(u, (low - joints) / dt, (high - joints) / dt)
        rates.append(u)
        # The base turns as it began to; its place follows from the centre of mass, which does not move.
        com = state.com
        R = pin.Quaternion(q[3:7]).toRotationMatrix()
        R = R @ pin.exp3(dt * (R.T @ (state.C_bm[3:] @ u)))
        q = sms.configuration(joints + dt * u)
        q[3:7] = pin.Quaternion(R).coeffs()
        q[:3] += com - sms.at(q).com
        assert len(u) == n
    return np.array(rates)


@pytest.mark.parametrize("posed", [False, True])
@pytest.mark.parametrize("robot", ["planar_3r", "satellite_panda"])
def test_marches_against_the_plain_rule(robot: str, posed: bool, rng: np.random.Generator) -> None:
    sms = ffsms.load(robot)
    start = np.clip(np.full(sms.n, 0.5), sms.limits.lower + 0.2, sms.limits.upper - 0.2)
    q0 = sms.configuration(start)
    goal = sms.at(sms.configuration(start + 0.3 * rng.uniform(-1.0, 1.0, sms.n))).end_effector_pose
    problem = opt.Problem(sms, q0, goal=goal if posed else goal.translation, duration=8.0)
    state = sms.at(q0)
    sides = sides_across(goal.translation - state.end_effector_pose.translation, state.J_star[:3])
    wanted = [plain_march(problem, side) for side in [*sides, None]]
    found = cone_marches(problem, STEPS)
    # Near a singular posture the damped solution multiplies rounding by up to 1 / (damping of 3 mm)^2.
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=1e-6)
    assert np.abs(found).max() > 1e-2
