"""`plan`: from a start and a target to a trajectory."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, number, positive, vector
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.base_limits import BaseLimits, judged
from ffsms_pin.opt.clearances import CollisionMode
from ffsms_pin.opt.horizon import keeps_clear, plan_horizon
from ffsms_pin.opt.marching import Progress, march, rank, start_sides
from ffsms_pin.opt.step_planner import StepPlanner, StepWeights
from ffsms_pin.opt.targets import goal
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.system import SpaceManipulator

__all__ = ["METHODS", "plan"]


METHODS = ("horizon", "step", "paper", "resolved-rate", "least-disturbance", "minimum-effort")

# [m, rad] Nearer than this to its target, an arm is there. Within the paper's r_th the whole-horizon planner
# takes no way round for the cost's sake (see its `is_near`).
ALREADY_THERE = 1e-6

# The references are about what they spare: ten times the step's own price of redundant motion, and still too
# little to keep an arm from leaving a singular start.
REFERENCE_WEIGHTS = StepWeights(effort=1e-5)


def plan(
    sms: SpaceManipulator,
    q0: ArrayLike,
    target: Any,
    duration: float = 12.0,
    dt: float = 0.01,
    kappa: float = 10.0,
    *,
    clearance: float = 0.01,
    collision: CollisionMode = "points",
    method: str = "horizon",
    base_limits: BaseLimits | None = None,
    momentum: ArrayLike | None = None,
    progress: Progress | None = None,
) -> Trajectory:
    """Plan a coupling-informed motion from rest at `q0` to `target`.

    Parameters
    ----------
    sms : SpaceManipulator
    q0 : array_like, shape (nq,)
        Start, within the joint limits; the system is at rest.
    target : array_like, shape (3,), or pinocchio.SE3
        Wanted end-effector position [m], or pose, in inertial axes.
    duration : float
        Time to arrive [s]. The paper does not state its own; 12 s is ours for its cases: 1.5 to 3 times
        what the joint limits need there.
    dt : float
        Step [s]; the paper states none. A whole number of steps makes up the duration, so the step used is
        the nearest that does.
    kappa : float
        Sharpness of C~. Not stated in the paper; 10 makes C~ nearly max(0, cos(theta_a)).
    clearance : float
        The paper's d_safe [m], between points of the arm and from them to the base box.
    collision : {"points", "shapes", "off"}
        What is kept clear: the paper's points (const4 to const7), the collision shapes, or nothing.
    method : str
        "horizon": the whole motion at once, from several starts (see docs/horizon.md). The default: it
        reaches what the step marches past, and its cost is that of a full nonlinear programme.
        "step": the per-step programme, marched from the start once for each side of the cost's cone that the
        end effector can take; of the plans that arrive, the one with the lowest cost.
        "paper": the paper's cost minimised step by step as it stands, with a schedule for const8.
        "resolved-rate", "least-disturbance", "minimum-effort": classical references that go straight to the
        target (see `AIMS`), under the same limits.
    base_limits : BaseLimits, optional
        How far and how fast the base may move. A plan that breaks them has not `reached`. Not for "paper".
    momentum : array_like, shape (6,), optional
        Total momentum [linear; angular] of the system about its centre of mass, inertial axes
        [kg m/s; kg m^2/s], as in `sms.velocity`: the joints start at rest on a base that drifts and turns.
        Default zero. Not for "paper".
    progress : callable, optional
        Called with the share of the work done, 0 to 1.

    Returns
    -------
    Trajectory
        `reached` says whether the target was reached; `note` what stood in the way.

    Raises
    ------
    InvalidValue
        A wrong shape, a number out of range, or a start outside the joint limits.
    """
    q0 = sms.checked_configuration("q0", q0)
    position, rotation = goal(target)
    duration, dt = positive("duration", duration, "s"), positive("dt", dt, "s")
    kappa, clearance = positive("kappa", kappa), number("clearance", clearance)
    if duration < dt:
        raise InvalidValue("duration", duration, f"must be at least one step of {dt:g} s")
    check_start(sms, q0)
    if method not in METHODS:
        raise InvalidValue("method", method, f"must be one of {', '.join(METHODS)}")
    drifting = None if momentum is None else vector("momentum", momentum, 6)
    if drifting is not None and not drifting.any():
        drifting = None
    if base_limits is not None and not isinstance(base_limits, BaseLimits):
        raise InvalidValue("base_limits", base_limits, "must be an opt.BaseLimits")
    if method == "paper" and (base_limits is not None or drifting is not None):
        raise InvalidValue("method", method, "knows no base limits and no momentum; take another one")
    dt = duration / round(duration / dt)
    start = sms.at(q0).end_effector_pose
    turned = 0.0 if rotation is None else float(np.linalg.norm(pin.log3(rotation @ start.rotation.T)))
    there = max(float(np.linalg.norm(position - start.translation)), turned) < ALREADY_THERE
    if there and drifting is None:
        plan = _stand_still(sms, q0, position, duration, dt, kappa, rotation)
        if keeps_clear(sms, plan, clearance, collision):
            return plan
    if method == "horizon":
        return plan_horizon(
            sms,
            q0,
            position,
            duration,
            dt,
            kappa,
            clearance,
            collision,
            progress,
            rotation,
            base_limits,
            drifting,
        )
    if method == "step":
        plan = _both_sides(
            StepPlanner(sms, dt, kappa, clearance, collision, base_limits=base_limits, momentum=drifting),
            q0,
            position,
            duration,
            progress,
            rotation,
        )
    elif method == "paper":
        from ffsms_pin.opt.paper_step import PaperStepPlanner

        paper = PaperStepPlanner(sms, dt, kappa, clearance, collision)
        plan = march(paper, q0, position, duration, progress, rotation)
    else:
        planner = StepPlanner(
            sms,
            dt,
            kappa,
            clearance,
            collision,
            REFERENCE_WEIGHTS,
            method,
            base_limits=base_limits,
            momentum=drifting,
        )
        plan = march(planner, q0, position, duration, progress, rotation)
    kept = replace(plan, clear=keeps_clear(sms, plan, clearance, collision))
    return judged(sms, kept, base_limits)


def _stand_still(
    sms: SpaceManipulator,
    q0: FloatArray,
    target: FloatArray,
    duration: float,
    dt: float,
    kappa: float,
    rotation: FloatArray | None,
) -> Trajectory:
    """The motion of an arm that is already there: none, whatever the paper's cost charges for it."""
    steps = round(duration / dt)
    t, q = np.linspace(0.0, duration, steps + 1), np.tile(q0, (steps + 1, 1))
    note = "the end effector is at its target from the start"
    return measure(sms, t, q, np.zeros((steps + 1, sms.n)), target, kappa, note, rotation)


def _both_sides(
    planner: StepPlanner,
    q0: FloatArray,
    target: FloatArray,
    duration: float,
    progress: Progress | None,
    rotation: FloatArray | None,
) -> Trajectory:
    """The best of the marches that start on the different sides of the cone."""
    sides = start_sides(planner.sms, q0, target)
    plans: list[Trajectory] = []
    for i, side in enumerate(sides):
        planner.reset(side)
        report = None if progress is None else _part(progress, i, len(sides))
        plans.append(march(planner, q0, target, duration, report, rotation))
    return min(plans, key=rank)


def check_start(sms: SpaceManipulator, q0: FloatArray) -> None:
    """Raise `InvalidValue` where a joint starts outside its limits."""
    positions = sms.layout.positions(q0)
    outside = sms.limits.violation(positions)
    if outside.any():
        i = int(np.argmax(outside))
        raise InvalidValue(
            f"q0: joint '{sms.joint_names[i]}'",
            round(float(positions[i]), 6),
            f"must start within [{sms.limits.lower[i]:.6g}, {sms.limits.upper[i]:.6g}] rad",
        )


def _part(progress: Progress, index: int, count: int) -> Progress:
    return lambda share: progress((index + share) / count)
