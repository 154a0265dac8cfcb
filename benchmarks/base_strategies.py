"""Five strategies for one task of a robot with reaction wheels, and their use of the wheels.

- held: the wheels hold the attitude during the motion.
- held-longer: as "held", but in the total time of "used".
- used: a floating motion planned by `opt.plan`, after which the wheels turn the base back.
- restored: a floating motion at whose end the base has its initial attitude.
- straight: a floating motion by resolved rates, after which the wheels turn the base back.

The wheels are frictionless.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin import opt

FloatArray = NDArray[np.float64]

STRATEGIES = ("held", "held-longer", "used", "restored", "straight")
RESTORED_WITHIN = np.radians(0.1)  # [rad] the final base rotation of "restored"
MARGIN = 0.08  # share of the wheels' limits that the return motion leaves to feedback control
SAMPLES = 401  # number of instants while the base is turned back


class WheelUse(NamedTuple):
    """The momentum (K, w) [N m s] and motor torque (K, w) [N m] of the wheels at times t (K,) [s]."""

    t: FloatArray
    momentum: FloatArray
    torque: FloatArray
    wheels: ffsms.ReactionWheels

    @property
    def energy(self) -> float:
        """The integral of the sum of |motor torque x wheel speed| [J]; braking recovers no energy."""
        power = np.abs(self.torque * self.momentum / self.wheels.inertia).sum(axis=1)
        return float(np.trapezoid(power, self.t))


class Strategy(NamedTuple):
    """A plan, the use of the wheels during the plan, and their use while they turn the base back.

    `after` is None if the base is not turned back. `carried` is the displacement of the end effector by
    the return motion [m].
    """

    plan: opt.Trajectory
    during: WheelUse
    after: WheelUse | None = None
    carried: float = 0.0


def held_torque(sms: ffsms.SpaceManipulator, plan: opt.Trajectory) -> FloatArray:
    """Compute the rate of change (N + 1, 3) of the angular momentum of arm and base [N m], root axes.

    The wheels provide the opposite torque while they hold the attitude.
    """
    model, data = sms.model, sms.model.createData()
    torque, a = np.empty((len(plan.t), 3)), np.zeros(model.nv)
    for k in range(len(plan.t)):
        a[6:] = plan.joint_accelerations[min(k, len(plan.t) - 2)]
        # The rate about the centre of mass does not depend on the base's own linear acceleration.
        rate = pin.computeCentroidalMomentumTimeVariation(model, data, plan.q[k], plan.v[k], a)
        torque[k] = pin.Quaternion(plan.q[k, 3:7]).toRotationMatrix().T @ rate.angular
    return torque


def use_along(sms: ffsms.SpaceManipulator, plan: opt.Trajectory) -> WheelUse:
    """Compute the use of the wheels along a plan, which is zero if the base floats."""
    held = (plan.base_rotation < 1e-9).all() and (np.abs(plan.v[:, 3:6]) < 1e-12).all()
    wheels = sms.wheels
    assert wheels is not None
    if not held:
        zero = np.zeros((len(plan.t), len(wheels.axes)))
        return WheelUse(plan.t, zero, zero, wheels)
    rise = -held_torque(sms, plan) @ np.linalg.pinv(wheels.axes)
    return WheelUse(plan.t, plan.wheel_momentum, rise, wheels)


def turn_back(
    sms: ffsms.SpaceManipulator, q: FloatArray, attitude: FloatArray, duration: float
) -> tuple[WheelUse, float]:
    """Turn the base back to an attitude (quaternion) about one axis, from rest to rest, with the arm locked.

    The angle follows the cubic that minimises the squared torque. The motion takes longer than `duration` if
    the wheels' limits require it. Return the use of the wheels and the displacement of the end effector [m].
    """
    wheels, data = sms.wheels, sms.model.createData()
    assert wheels is not None
    pin.ccrba(sms.model, data, q, np.zeros(sms.nv))  # data.Ig: the locked robot about its centre of mass
    now, goal = (pin.Quaternion(one).toRotationMatrix() for one in (q[3:7], attitude))
    # Angular momentum of the robot per unit of the normalized rate, root axes, and the share of each wheel.
    momentum = now.T @ data.Ig.inertia @ now @ pin.log3(now.T @ goal)
    shares = np.linalg.pinv(wheels.axes.T) @ momentum
    # The cubic 3 s^2 - 2 s^3 has a peak rate of 1.5 / T and a peak acceleration of 6 / T^2.
    by_momentum = 1.5 * (np.abs(shares) / wheels.momentum).max() / (1.0 - MARGIN)
    by_torque = np.sqrt(6.0 * (np.abs(shares) / wheels.torque).max() / (1.0 - MARGIN))
    duration = max(duration, by_momentum, by_torque)
    s = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    rate, acceleration = 6.0 * (s - s**2) / duration, 6.0 * (1.0 - 2.0 * s) / duration**2
    use = WheelUse(duration * s[:, 0], -rate * shares, -acceleration * shares, wheels)
    state = sms.at(q)
    arm = state.end_effector_pose.translation - state.com
    return use, float(np.linalg.norm(goal @ now.T @ arm - arm))


def strategies(problem: opt.Problem, options: opt.SearchOptions | None = None) -> dict[str, Strategy]:
    """Plan a problem by each of `STRATEGIES`, regardless of the problem's own mode."""
    sms = problem.sms
    held = replace(problem, mode="rotation-floating")
    floating = replace(problem, mode="floating", wheel_momentum=None)
    restoring = replace(floating, limits=(*floating.limits, opt.BaseLimits(final_attitude=RESTORED_WITHIN)))

    def kept(problem: opt.Problem) -> Strategy:
        plan = opt.solve(problem, options)
        return Strategy(plan, use_along(sms, plan))

    def turned_back(plan: opt.Trajectory) -> Strategy:
        after, carried = turn_back(sms, plan.q[-1], plan.q[0, 3:7], plan.duration)
        return Strategy(plan, use_along(sms, plan), after, carried)

    used = turned_back(opt.solve(floating, options))
    assert used.after is not None
    straight = opt.plan(sms, problem.q0, problem.goal, problem.duration, problem.dt, method="resolved-rate")
    return {
        "held": kept(held),
        "held-longer": kept(held.lasting(used.plan.duration + used.after.t[-1])),
        "used": used,
        "restored": kept(restoring),
        "straight": turned_back(straight),
    }


def mode_numbers(found: dict[str, Strategy]) -> dict[str, dict[str, Any]]:
    """Return one row for each strategy; the key of a quantity ends in its unit."""
    numbers = {}
    for name, strategy in found.items():
        uses = [use for use in (strategy.during, strategy.after) if use is not None]
        plan = strategy.plan
        numbers[name] = {
            "reached": plan.reached,
            "wheel_momentum_max_Nms": max(float(np.abs(use.momentum).max()) for use in uses),
            "wheel_torque_max_Nm": max(float(np.abs(use.torque).max()) for use in uses),
            "wheel_energy_J": sum(use.energy for use in uses),
            "time_s": sum(float(use.t[-1]) for use in uses),
            "rotation_max_deg": float(np.degrees(plan.base_rotation.max())),
            "carried_m": strategy.carried,
            "cost_integral_s": plan.cost_integral,
            "joint_travel_rad": plan.joint_travel,
            "note": plan.note,
        }
    return numbers
