"""Plan by Crocoddyl's differential dynamic programming, with small accelerations and the goals as costs.

The base floats. Joint and torque limits are quadratic barriers; clearances are ignored. Fixed goals have a
cost in the last 12 % of the time. The pose and the velocity of a client have a cost at the end only.
"""

from __future__ import annotations

from typing import Any

import crocoddyl
import numpy as np

from benchmarks.problems.judge import Problem, World, pin

STEPS, ITERATIONS = 100, 100
GOAL, BARRIER, TURN, EFFORT = 1e5, 1e4, 1e4, 1.0  # weights
INSIDE, LATE = 0.9, 0.88  # shares of the limits inside barriers, and of the time from which goals have a cost


def planned(problem: Problem, seconds: float) -> dict[str, Any]:
    """Return a motion of `STEPS` steps, integrated by the fourth-order Runge-Kutta rule."""
    world, h = World(problem), problem["duration"] / STEPS
    model, n, client = world.model, world.n, None
    state = crocoddyl.StateMultibody(model)
    motors = crocoddyl.ActuationModelFloatingBase(state)
    if world.client:
        client = world.client.states(np.linspace(0.0, problem["duration"], 5 * STEPS + 1))[-1]
    x0 = np.concatenate([world.q0, world.velocity(world.q0, np.zeros(n))])

    def within(low: Any, high: Any) -> Any:
        return crocoddyl.ActivationModelQuadraticBarrier(crocoddyl.ActivationBounds(low, high))

    def costs(last: bool, near: bool) -> Any:
        found, nu = crocoddyl.CostModelSum(state, motors.nu), motors.nu

        def add(name: str, weight: float, *parts: Any) -> None:
            found.addCost(name, crocoddyl.CostModelResidual(state, *parts), weight)

        base, most = np.full(6, np.inf), INSIDE * model.velocityLimit[6:]
        high = np.concatenate([base, model.upperPositionLimit[7:], base, most])
        low = np.concatenate([-base, model.lowerPositionLimit[7:], -base, -most])
        zero = np.concatenate([pin.neutral(model), np.zeros(n + 6)])
        add("joints", BARRIER, within(low, high), crocoddyl.ResidualModelState(state, zero, nu))
        if not last:
            harder, torque = np.append(base, INSIDE * world.acceleration), INSIDE * model.effortLimit[6:]
            speeding = crocoddyl.ResidualModelJointAcceleration(state, np.zeros(6 + n), nu)
            add("acceleration", BARRIER, within(-harder, harder), speeding)
            add("torque", BARRIER, within(-torque, torque), crocoddyl.ResidualModelControl(state, nu))
            weights = crocoddyl.ActivationModelWeightedQuad(1.0 / np.append(base, world.acceleration) ** 2)
            add("effort", EFFORT, weights, speeding)
        if problem["limits"]["base_attitude"]:
            weights = crocoddyl.ActivationModelWeightedQuad(np.repeat([0, 1.0, 0], [3, 3, 2 * n + 6]))
            add("turn", TURN, weights, crocoddyl.ResidualModelState(state, x0, nu))
        for goal, frame in zip(problem["goals"], world.frames, strict=True) if near else ():
            place, velocity = world.place(goal, client)
            if goal["quaternion"] is None:
                missed = crocoddyl.ResidualModelFrameTranslation(state, frame, place.translation, nu)
            else:
                missed = crocoddyl.ResidualModelFramePlacement(state, frame, place, nu)
            add(goal["frame"], GOAL, missed)
            if client:
                axes = pin.LOCAL_WORLD_ALIGNED
                twist = crocoddyl.ResidualModelFrameVelocity(state, frame, pin.Motion(velocity), axes, nu)
                add("velocity", GOAL, twist)
        return found

    free, rk4 = crocoddyl.DifferentialActionModelFreeFwdDynamics, crocoddyl.RKType.four
    way, hold = (
        crocoddyl.IntegratedActionModelRK(free(state, motors, costs(False, near)), rk4, h)
        for near in (False, client is None)
    )
    end = crocoddyl.IntegratedActionModelEuler(free(state, motors, costs(True, True)), 0.0)
    moving = round(LATE * STEPS)
    shooting = crocoddyl.ShootingProblem(x0, [way] * moving + [hold] * (STEPS - moving), end)
    solver = crocoddyl.SolverFDDP(shooting)
    solver.solve([x0] * (STEPS + 1), [np.zeros(n)] * STEPS, ITERATIONS, False)
    x = np.array(solver.xs)
    return {"t": h * np.arange(STEPS + 1), "joints": x[:, 7 : 7 + n], "rates": x[:, -n:]}
