"""Coupling used against coupling fought: the base held, floating, or turned back, and what each takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.actuation.thrusters import ThrusterAllocation
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import BaseLimits, Problem, SearchOptions, Trajectory
from ffsms_pin.opt.plans import lacking, plan_problem
from ffsms_pin.studies.numbers import why_not_reached
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.base_reaction import whole_body
from ffsms_pin.system.dynamics import inertia_matrix

STRATEGIES = ("held", "held-longer", "used", "restored", "straight")
"""held: attitude held by wheels all the time. held-longer: the same in the whole time that "used" takes.
used: coupling-informed, floating, then the wheels turn the base back. restored: floating, the attitude
restored by the arm alone. straight: resolved rates, floating, then turned back."""

RESTORED_WITHIN = np.radians(0.1)  # [rad] what "restored" leaves of the base's turn

_SAMPLES = 401
_IN_HAND = 0.08  # share of the wheels' limits that turning back leaves for the feedback
_LONGER = 1.05


class Spent(NamedTuple):
    """What wheels and thrusters do along a motion.

    Attributes
    ----------
    t : ndarray, shape (K,)
        [s]
    momentum, torque : ndarray, shape (K, w)
        Of the wheels [N m s], and of their motors [N m].
    energy : float
        Integral of the sum of |motor torque x wheel speed| [J]: nothing is won back in braking.
    propellant : float
        [kg]
    """

    t: FloatArray
    momentum: FloatArray
    torque: FloatArray
    energy: float
    propellant: float


def held_torque(sms: SpaceManipulator, plan: Trajectory) -> FloatArray:
    """Rate (N + 1, 3) of the angular momentum of arm and base on a plan [N m], axes of the root.

    Along a plan that holds the attitude this is what wheels or thrusters have to give.
    """
    model, data = sms.model, sms.model.createData()
    torque = np.empty((len(plan.t), 3))
    a = np.zeros(model.nv)
    for k in range(len(plan.t)):
        a[6:] = plan.joint_accelerations[min(k, len(plan.t) - 2)]
        # About the centre of mass the base's own linear acceleration does not matter.
        rate = pin.computeCentroidalMomentumTimeVariation(model, data, plan.q[k], plan.v[k], a)
        torque[k] = pin.Quaternion(plan.q[k, 3:7]).toRotationMatrix().T @ rate.angular
    return torque


def turn_back(
    sms: SpaceManipulator, q: FloatArray, attitude: FloatArray, duration: float
) -> tuple[Spent, float]:
    """Turn the base back to an attitude with the arm locked, from rest to rest about one axis.

    The angle follows the cubic of least squared torque. Where the wheels cannot do it in the duration, it
    takes as much longer as they need.

    Parameters
    ----------
    sms : SpaceManipulator
        With wheels or thrusters.
    q : ndarray, shape (nq,)
        Configuration at the start.
    attitude : ndarray, shape (4,)
        Quaternion (x, y, z, w) to turn to.
    duration : float
        [s]

    Returns
    -------
    spent : Spent
    moved : float
        How far the end effector is carried along [m].
    """
    here, there = (pin.Quaternion(one).toRotationMatrix() for one in (q[3:7], attitude))
    body, wheels = whole_body(inertia_matrix(sms, q)), sms.wheels
    wanted = body.inertia @ pin.log3(here.T @ there)  # angular momentum a unit of the angle's share a second
    if wheels is not None:
        duration = max(duration, _shortest(wheels, wanted))
        while not _possible(_by_wheels(wheels, wanted, duration), wheels):
            duration *= _LONGER
        found = _by_wheels(wheels, wanted, duration)
    else:
        t, _, rise = _cubic(duration)
        found = _by_thrusters(sms, t, rise[:, None] * wanted, body.lever)
    arm = sms.at(q).end_effector_pose.translation - (q[:3] + here @ body.lever)
    return found, float(np.linalg.norm(there @ here.T @ arm - arm))


def spent(sms: SpaceManipulator, plan: Trajectory) -> Spent:
    """What a plan asks of wheels or thrusters: nothing while the base floats."""
    w = plan.wheel_momentum.shape[1]
    still = Spent(plan.t, np.zeros((len(plan.t), w)), np.zeros((len(plan.t), w)), 0.0, 0.0)
    if not ((plan.base_rotation < 1e-9).all() and (np.abs(plan.v[:, 3:6]) < 1e-12).all()):  # it is not held
        return still
    torque = held_torque(sms, plan)
    if sms.wheels is not None:
        rise = -torque @ np.linalg.pinv(sms.wheels.axes.T).T
        return _of_wheels(sms.wheels, plan.t, plan.wheel_momentum, rise)
    return _by_thrusters(sms, plan.t, torque, None)


def _cubic(duration: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Instants, rate and acceleration of 3 s^2 - 2 s^3."""
    s = np.linspace(0.0, 1.0, _SAMPLES)
    return duration * s, 6.0 * (s - s**2) / duration, 6.0 * (1.0 - 2.0 * s) / duration**2


def _by_wheels(wheels: ReactionWheels, wanted: FloatArray, duration: float) -> Spent:
    """The total momentum stays zero: what the base gets, the wheels lose."""
    t, rate, rise = _cubic(duration)
    shares = np.linalg.pinv(wheels.axes.T) @ wanted
    return _of_wheels(wheels, t, -rate[:, None] * shares, -rise[:, None] * shares)


def _shortest(wheels: ReactionWheels, wanted: FloatArray) -> float:
    """The least duration without friction [s]: peaks are 1.5 / T of the rate and 6 / T^2 of its rise."""
    shares = np.abs(np.linalg.pinv(wheels.axes.T) @ wanted) / (1.0 - _IN_HAND)
    by_momentum = 1.5 * float((shares / wheels.momentum).max())
    return max(by_momentum, float(np.sqrt(6.0 * (shares / wheels.torque).max())))


def _possible(found: Spent, wheels: ReactionWheels) -> bool:
    """Whether wheels have the torque, friction included."""
    fastest = np.where(np.isfinite(wheels.momentum), wheels.momentum, 0.0) / wheels.inertia
    rubbing = wheels.friction * fastest + wheels.coulomb  # where it leaves no torque, no duration would do
    return bool((np.abs(found.torque) <= wheels.torque).all() or (wheels.torque <= rubbing).any())


def _of_wheels(wheels: ReactionWheels, t: FloatArray, momentum: FloatArray, rise: FloatArray) -> Spent:
    speed = momentum / wheels.inertia
    torque = rise - wheels.friction_torque(speed)
    return Spent(t, momentum, torque, float(np.trapezoid(np.abs(torque * speed).sum(axis=1), t)), 0.0)


def _by_thrusters(
    sms: SpaceManipulator, t: FloatArray, torque: FloatArray, centre: FloatArray | None
) -> Spent:
    """By pure moments (K, 3) on the base; proportional forces, whatever the thrusters are."""
    none = np.zeros((len(t), 0))
    if sms.thrusters is None:
        return Spent(t, none, none, 0.0, 0.0)
    allocation = ThrusterAllocation(sms.thrusters, sms.base_com if centre is None else centre)
    zero = np.zeros(3)
    flow = np.array([sms.thrusters.flow(allocation.forces(zero, row)) for row in torque])
    return Spent(t, none, none, 0.0, float(np.trapezoid(flow, t)))


class Strategy(NamedTuple):
    """One way to do the task: what wheels or thrusters do along the plan, and after it.

    `after` is None where the base is not turned back; `carried` is how far that carries the end effector [m].
    """

    plan: Trajectory
    during: Spent
    after: Spent | None = None
    carried: float = 0.0


def strategies(
    problem: Problem,
    options: SearchOptions | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> dict[str, Strategy]:
    """Plans for a problem of a robot with wheels or thrusters, whatever its mode, by `STRATEGIES`.

    "straight" is left out where resolved rates do not know what the problem asks for.
    `progress` is called with a strategy's name and the share of its plan that is done, 0 to 1.
    """
    sms = problem.sms
    held = replace(problem, mode="rotation-flying" if sms.wheels is None else "rotation-floating")
    floating = replace(problem, mode="floating", wheel_momentum=None)
    kept = [limit for limit in floating.limits if not isinstance(limit, BaseLimits)]
    restoring = replace(floating, limits=(*kept, BaseLimits(final_attitude=RESTORED_WITHIN)))

    def made(name: str, problem: Problem, method: str = "horizon") -> Trajectory:
        if progress is not None:
            progress(name, 0.0)
        return plan_problem(problem, method, options, progress and partial(progress, name))

    found = {"held": _kept(sms, made("held", held)), "used": _turned_back(sms, made("used", floating))}
    after = found["used"].after
    longer = held.lasting(held.duration + (0.0 if after is None else float(after.t[-1])))
    found["held-longer"] = _kept(sms, made("held-longer", longer))
    found["restored"] = _kept(sms, made("restored", restoring))
    if not lacking(floating, "resolved-rate"):
        found["straight"] = _turned_back(sms, made("straight", floating, "resolved-rate"))
    return {name: found[name] for name in STRATEGIES if name in found}


def _kept(sms: SpaceManipulator, plan: Trajectory) -> Strategy:
    """A motion after which the base stays as it is."""
    return Strategy(plan, spent(sms, plan))


def _turned_back(sms: SpaceManipulator, plan: Trajectory) -> Strategy:
    """A floating motion, and the base turned back within as much time again."""
    after, carried = turn_back(sms, plan.q[-1], plan.q[0, 3:7], plan.duration)
    return Strategy(plan, spent(sms, plan), after, carried)


def mode_numbers(found: dict[str, Strategy]) -> dict[str, dict[str, Any]]:
    """One row a strategy, every key of a quantity ending in its unit.

    `wheel_energy_J` is the integral of the sum of |motor torque x wheel speed|. `carried_m` is how far the
    end effector is carried off its target while the base is turned back with the arm locked.
    """
    numbers = {}
    for name, one in found.items():
        parts = [part for part in (one.during, one.after) if part is not None]
        numbers[name] = {
            "reached": one.plan.reached,
            "wheel_momentum_max_Nms": max(float(np.abs(x.momentum).max(initial=0.0)) for x in parts),
            "wheel_momentum_final_Nms": float(np.abs(parts[-1].momentum[-1]).max(initial=0.0)),
            "wheel_torque_max_Nm": max(float(np.abs(x.torque).max(initial=0.0)) for x in parts),
            "wheel_energy_J": sum(x.energy for x in parts),
            "propellant_kg": sum(x.propellant for x in parts),
            "time_s": one.plan.duration + (0.0 if one.after is None else float(one.after.t[-1])),
            "rotation_max_deg": float(np.degrees(one.plan.base_rotation.max())),
            "rotation_at_arrival_deg": float(np.degrees(one.plan.base_rotation[-1])),
            "carried_m": one.carried,
            "cost_integral_s": one.plan.cost_integral,
            "joint_travel_rad": one.plan.joint_travel,
            "note": why_not_reached(one.plan) or one.plan.note,
        }
    return numbers
