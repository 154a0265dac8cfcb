"""The retreat from a grasp by straight or planned motions, and the reasons why plans failed."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from operator import itemgetter

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import FreeBody
from ffsms_pin.client.client import carried
from ffsms_pin.errors import FfsmsError, InvalidValue, length_text
from ffsms_pin.opt import Clearance, Meet, Problem, Trajectory
from ffsms_pin.opt.evaluation import violation_of
from ffsms_pin.opt.flown import least_clearance
from ffsms_pin.opt.plans import plan_problem
from ffsms_pin.opt.search.inverse_kinematics import within_workspace
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.robot import SpaceManipulator

_RETURN = 1.0  # [1/s] rate at which pose errors are corrected and self-motions decay
_DAMPING = 0.05  # [m] damping of changes of the joint rates near a singularity (Wampler 1986)
_RUBS = 0.05  # [m] tolerated violation of the clearance from a guide if no other retreat is possible
_OVERLAP = 1e-3  # [m] overlap of bodies above which a plan is not flown
_SHORT = 0.01  # [m] tolerated shortfall of a retreat, in addition to a tenth of its length
_STOP = 2.0  # [s] time in which the initial velocity relative to the client decays to zero
_TURNING = (1.0, 0), (1.0, 2), (0.03, 0)  # alternatives for the rotation, see `_straight`

# A plan, or None and the reason for the failure.
Planned = tuple[Trajectory | None, str]


def in_collision(plan: Trajectory, sms: SpaceManipulator) -> str:
    """Return a text of two bodies that overlap in a plan; empty if there are none.

    Overlaps count if they exceed the overlap permitted at the grasp, if any, by at least 1 mm.
    """
    if "clearance" not in plan.broken or plan.problem is None:
        return ""
    least = least_clearance(plan.problem, sms, plan.problem.motion(plan.joint_rates, plan.dt))
    if least is None or least.distance > min(0.0, least.required) - _OVERLAP:
        return ""
    return f"in the plan {least.pair} overlap by {length_text(-least.distance)} at {least.time:.3g} s"


def why_no_plan(plan: Trajectory) -> str:
    """Return the reason why a plan to a grasp does not arrive, in one sentence."""
    problem, off = plan.problem, float(plan.position_error[-1])
    assert problem is not None
    if not within_workspace(problem):
        return f"the grasp is out of the workspace at the deadline, {length_text(off)} away at best"
    motion = problem.motion(plan.joint_rates)
    for limit in problem.limits:
        if limit.name in {*plan.broken, *plan.binding} and (nearest := violation_of(limit, motion).nearest):
            return f"no motion to the grasp keeps clear of obstacles (blocked by {nearest})"
    linear, angular = np.linalg.norm(plan.contact_velocity.reshape(2, 3), axis=1)
    return (
        f"the plan ends {length_text(off)} and {np.degrees(plan.orientation_error[-1]):.3g} deg from the "
        f"grasp and moves with {1e3 * linear:.3g} mm/s and {np.degrees(angular):.3g} deg/s relative to it"
    )


def refusal(error: FfsmsError) -> str:
    """Return the reason why planning raised an error, in one sentence without the arguments' values."""
    return error.reason if isinstance(error, InvalidValue) else str(error)


def moved_away(problem: Problem, *displacements: FloatArray) -> Planned:
    """Plan a retreat by the first feasible of `displacements` (3,) [m], grasp axes.

    Straight motions are tried first, because a probe must leave a nozzle straight. Three rotations of the end
    effector are tried: it turns with the client, its rotation is ramped down, or it hardly turns. Each motion
    is tried in the full time of the problem and in shorter times. If no straight motion keeps the limits and
    lets all joints brake before their position limits, a motion by the first displacement is planned. The
    next choice is a straight motion that keeps the limits but does not let all joints brake. The last choice
    is a straight motion that only violates the clearance from the guide, by less than 50 mm.
    """
    goal, trouble = problem.goal, ""
    assert isinstance(goal, Meet)
    held = (goal.client.pose(0.0) * goal.grasp).actInv(problem.sms.at(problem.q0).end_effector_pose)
    goals = [
        replace(
            goal,
            grasp=goal.grasp * pin.SE3(np.eye(3), held.translation + displacement),
            standoff=0.0,
            misalignment=None,
            coast=None,
        )
        for displacement in displacements
    ]
    beside: list[tuple[float, Trajectory]] = []
    hasty: list[Trajectory] = []  # feasible, but a joint cannot brake before its position limit afterwards
    for cut, (displacement, to), turning, share in product(
        (False, True), zip(displacements, goals, strict=True), _TURNING, (1.0, 0.6, 0.4)
    ):
        duration = max(2, round(share * problem.steps)) * problem.dt
        quick = replace(problem, goal=to, duration=duration)
        plan, worse = _straight(quick, goal.client, goal.grasp.rotation @ displacement, turning, cut)
        if not worse and _can_stop(plan):
            return plan, ""
        if not worse:
            hasty.append(plan)
            continue
        if worse == ["clearance"] and _only_rubs(quick, plan):
            beside.append((plan.broken["clearance"], plan))
        trouble = trouble or f"a straight motion violates limits ({', '.join(worse)})"
    plan = plan_problem(replace(problem, goal=goals[0]))
    if plan.reached and (_can_stop(plan) or not hasty):
        return plan, ""
    if hasty:
        return hasty[0], ""
    if beside and min(beside, key=itemgetter(0))[0] < _RUBS:
        return min(beside, key=itemgetter(0))[1], ""
    return None, f"{trouble}, and in a planned motion {why_no_plan(plan)}"


def _can_stop(plan: Trajectory) -> bool:
    """Return whether `brake` can stop all joints before their position limits after a motion."""
    assert plan.problem is not None
    limits, joints, rates = plan.problem.sms.limits, plan.joint_positions[-1], plan.joint_rates[-1]
    slack = np.where(rates > 0.0, limits.upper - joints, joints - limits.lower)
    return bool((0.75 * rates**2 / limits.acceleration <= slack).all())


def _only_rubs(problem: Problem, plan: Trajectory) -> bool:
    """Return whether a motion keeps clear of all bodies except the pieces of a guide at the grasp."""
    others = [
        replace(
            limit,
            obstacles=[obstacle for obstacle in limit.obstacles if obstacle.piece_of is None],
            _stacks=(),
        )
        if isinstance(limit, Clearance)
        else limit
        for limit in problem.limits
    ]
    if sum(len(limit.obstacles) for limit in others) == sum(len(limit.obstacles) for limit in problem.limits):
        return False
    return "clearance" not in measure(replace(problem, limits=others), plan.joint_rates).broken


def _straight(
    problem: Problem,
    client: FreeBody,
    displacement: FloatArray,
    turning: tuple[float, int],
    cut: bool = False,
) -> tuple[Trajectory, list[str]]:
    """Move the end effector straight by `displacement` (3,) [m], client axes, and turn it with the client.

    The motion is resolved-rate control (Umetani and Yoshida 1989) from the initial joint rates. The initial
    velocity relative to the client decays.

    Parameters
    ----------
    turning : tuple
        The weight of the rotation relative to the displacement [m/rad], and an exponent: the weight decreases
        as this power of the remaining share of the displacement.
    cut : bool
        True if rates and accelerations are clipped at the joint limits. Later steps compensate the clipping.
        A motion that then ends too far short of the displacement counts as a violation of "joints".

    Returns
    -------
    Trajectory
    list of str
        The names of the limits that the motion violates by more than at its start.
    """
    sms, dt, free, limits = problem.sms, problem.dt, problem.free, problem.sms.limits
    q, rates = problem.q0.copy(), problem.joint_rates.copy()
    start, rows = sms.at(q, sms.velocity(q, rates, problem.momentum)), [rates]
    held = client.pose(0.0).actInv(start.end_effector_pose)
    past = start.end_effector_twist - carried(client.pose(0.0), client.twist(0.0), held)[1]
    drift, angular = past.reshape(2, 3) @ client.pose(0.0).rotation

    def share(t: float) -> float:
        s = min(t / problem.duration, 1.0)
        return (3.0 - 2.0 * s) * s * s

    def desired(t: float) -> pin.SE3:
        on = t * max(0.0, 1.0 - t / _STOP) ** 2
        place = held.translation + share(t) * displacement + on * drift
        return client.pose(t) * pin.SE3(pin.exp3(on * angular) @ held.rotation, place)

    def between(there: pin.SE3, here: pin.SE3) -> FloatArray:
        return np.append(there.translation - here.translation, pin.log3(there.rotation @ here.rotation.T))

    for k in range(1, problem.steps + 1):
        q = pin.integrate(sms.model, q, dt * sms.velocity(q, rates, problem.momentum))
        state = sms.at(q, sms.velocity(q, np.zeros(sms.n), problem.momentum))
        before, here, after = (desired((k + i) * dt) for i in (-0.5, 0.0, 0.5))
        twist = between(after, before) / dt + _RETURN * between(here, state.end_effector_pose)
        weights = np.repeat([1.0, turning[0] * (1.0 - share(k * dt)) ** turning[1]], 3)
        J, rates = weights[:, None] * state.J_star[:, free], rates * free * np.exp(-_RETURN * dt)
        lack = weights * (twist - state.end_effector_twist) - J @ rates[free]
        rates[free] += J.T @ np.linalg.solve(J @ J.T + _DAMPING**2 * np.eye(6), lack)
        if cut:
            change = np.clip(rates - rows[-1], -dt * limits.acceleration, dt * limits.acceleration)
            rates = np.clip(rows[-1] + change, -limits.velocity, limits.velocity)
        rows.append(rates)
    plan = measure(problem, np.array(rows))
    # The violation at the start is that of a motion with constant rates.
    first = measure(replace(problem, duration=2.0 * dt), np.tile(rows[0], (3, 1))).broken
    worse = [name for name, amount in plan.broken.items() if amount > 1.001 * first.get(name, 0.0)]
    end = sms.at(plan.q[-1]).end_effector_pose.translation
    short = float(np.linalg.norm(end - desired(problem.duration).translation))
    if cut and "joints" not in worse and short > _SHORT + 0.1 * float(np.linalg.norm(displacement)):
        worse.append("joints")
    return plan, worse
