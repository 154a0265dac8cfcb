"""The way back from a client: straight, as a probe comes out of a nozzle, whatever it is near to in there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Meet, Problem, Trajectory
from ffsms_pin.opt.plans import plan_problem
from ffsms_pin.opt.trajectory import measure

# A plan, or None and why there is none.
Planned = tuple[Trajectory | None, str]

_RETURN = 1.0  # [1/s] how fast what a step leaves of the way is made good, and self-motions die out
_DAMPING = 0.05  # [1] of changes of the rates, where the arm is near a singularity (Wampler 1986)


def moved_away(problem: Problem, way: FloatArray) -> Planned:
    """From the start of a problem to meet a client by `way` (3,) [m], grasp axes: straight, or as can be."""
    goal = problem.goal
    assert isinstance(goal, Meet)
    away = replace(goal, grasp=goal.grasp * pin.SE3(np.eye(3), way), standoff=0.0)
    problem = replace(problem, goal=away)
    straight, worse = _straight(problem, away, goal.grasp.rotation @ way)
    plan = plan_problem(problem) if worse else straight
    if worse and not plan.reached:
        return None, f"straight it breaks limits ({', '.join(worse)}), otherwise: {plan.note}"
    return plan, ""


def _straight(problem: Problem, goal: Meet, way: FloatArray) -> tuple[Trajectory, list[str]]:
    """The end effector moves by `way` (3,) [m], client axes, as the client sees it, and turns with it.

    By resolved rates (Umetani and Yoshida 1989), from the joint rates at the start. And which limits it
    breaks by more than they are at the start: one that is broken there must only not get worse.
    """
    sms, client, dt, free = problem.sms, goal.client, problem.dt, problem.free
    q, rates = problem.q0.copy(), problem.joint_rates.copy()
    held, found = client.pose(0.0).actInv(sms.at(q).end_effector_pose), [rates]

    def wanted(t: float) -> pin.SE3:
        s = min(t / problem.duration, 1.0)
        return client.pose(t) * pin.SE3(held.rotation, held.translation + (3.0 - 2.0 * s) * s * s * way)

    def apart(there: pin.SE3, here: pin.SE3) -> FloatArray:
        return np.append(there.translation - here.translation, pin.log3(there.rotation @ here.rotation.T))

    for k in range(1, problem.steps + 1):
        q = pin.integrate(sms.model, q, dt * sms.velocity(q, rates, problem.momentum))
        state = sms.at(q, sms.velocity(q, np.zeros(sms.n), problem.momentum))
        before, here, after = (wanted((k + i) * dt) for i in (-0.5, 0.0, 0.5))
        twist = apart(after, before) / dt + _RETURN * apart(here, state.end_effector_pose)
        J, rates = state.J_star[:, free], rates * free * np.exp(-_RETURN * dt)
        lack = twist - state.end_effector_twist - J @ rates[free]
        rates[free] += J.T @ np.linalg.solve(J @ J.T + _DAMPING**2 * np.eye(6), lack)
        found.append(rates)
    plan = measure(problem, np.array(found))
    # At the start is broken what a motion breaks that goes on as it is.
    start = measure(replace(problem, duration=2.0 * dt), np.tile(found[0], (3, 1))).broken
    return plan, [name for name, amount in plan.broken.items() if amount > 1.001 * start.get(name, 0.0)]
