"""`plan`: from a start and a target to a trajectory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, positive, vector
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.clearances import CollisionMode
from ffsms_pin.opt.step_kinetics import step_kinetics
from ffsms_pin.opt.step_planner import Step, StepPlanner, StepWeights
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.base_motion import advance

__all__ = ["METHODS", "march", "plan"]

METHODS = ("step", "paper", "resolved-rate", "least-disturbance", "minimum-effort")

# The references are about what they spare: ten times the step's own price of redundant motion, and still too
# little to keep an arm from leaving a singular start.
REFERENCE_WEIGHTS = StepWeights(effort=1e-5)

Progress = Callable[[float], None]


def plan(
    sms: SpaceManipulator,
    q0: ArrayLike,
    target: ArrayLike,
    duration: float = 12.0,
    dt: float = 0.01,
    kappa: float = 10.0,
    *,
    clearance: float = 0.01,
    collision: CollisionMode = "points",
    method: str = "step",
    progress: Progress | None = None,
) -> Trajectory:
    """Plan a coupling-informed motion from rest at `q0` to `target`.

    Parameters
    ----------
    sms : SpaceManipulator
    q0 : array_like, shape (nq,)
        Start, within the joint limits; the system is at rest.
    target : array_like, shape (3,)
        Wanted end-effector position, inertial axes [m].
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
        "step": the per-step programme, marched from the start once for each side of the cost's cone that the
        end effector can take; of the plans that arrive, the one with the lowest cost.
        "paper": the paper's cost minimised step by step as it stands, with a schedule for const8.
        "resolved-rate", "least-disturbance", "minimum-effort": classical references that go straight to the
        target (see `AIMS`), under the same limits.
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
    goal = _position(target)
    duration, dt = positive("duration", duration, "s"), positive("dt", dt, "s")
    if duration < dt:
        raise InvalidValue("duration", duration, f"must be at least one step of {dt:g} s")
    check_start(sms, q0)
    if method not in METHODS:
        raise InvalidValue("method", method, f"must be one of {', '.join(METHODS)}")
    dt = duration / round(duration / dt)
    if method == "paper":
        from ffsms_pin.opt.paper_step import PaperStepPlanner

        paper = PaperStepPlanner(sms, dt, kappa, clearance, collision)
        return march(paper, q0, goal, duration, progress)
    weights = StepWeights() if method == "step" else REFERENCE_WEIGHTS
    planner = StepPlanner(sms, dt, kappa, clearance, collision, weights, method)
    if method != "step":
        return march(planner, q0, goal, duration, progress)

    sides = start_sides(sms, q0, goal)
    plans: list[Trajectory] = []
    for i, side in enumerate(sides):
        planner.reset(side)
        report = None if progress is None else _part(progress, i, len(sides))
        plans.append(march(planner, q0, goal, duration, report))
    return min(plans, key=_rank)


class Stepper(Protocol):
    """What `march` needs: one step after the other."""

    sms: SpaceManipulator
    dt: float
    kappa: float

    def advance(self, q: FloatArray, rates: FloatArray, target: FloatArray, time_left: float) -> Step:
        """Joint rates for the next step."""


def march(
    planner: Stepper,
    q0: FloatArray,
    target: FloatArray,
    duration: float,
    progress: Progress | None = None,
) -> Trajectory:
    """Plan step by step from rest at q0, each step a single quadratic programme."""
    sms, dt = planner.sms, planner.dt
    steps = max(1, round(duration / dt))
    t = np.linspace(0.0, duration, steps + 1)
    q, rates = np.empty((steps + 1, sms.nq)), np.zeros((steps + 1, sms.n))
    q[0] = q0
    braked = 0
    for k in range(steps):
        step = planner.advance(q[k], rates[k], target, duration - t[k])
        braked += not step.solved
        rates[k + 1] = step.joint_rates
        q[k + 1], _ = advance(sms, q[k], rates[k], (rates[k + 1] - rates[k]) / dt, dt)
        if progress is not None:
            progress((k + 1) / steps)
    note = f"the arm braked in {braked} of {steps} steps whose programme was not solved" if braked else ""
    return measure(sms, t, q, rates, target, planner.kappa, note)


def start_sides(sms: SpaceManipulator, q0: FloatArray, target: FloatArray) -> list[FloatArray]:
    """Directions across the way to the target in which the end effector can move at the start.

    For a planar arm the two sides of the way; in space both senses of the two principal directions.
    """
    kinetics = step_kinetics(sms, q0)
    way = target - kinetics.position
    distance = float(np.linalg.norm(way))
    across = np.eye(3) if distance < 1e-12 else np.eye(3) - np.outer(way, way) / distance**2
    directions, strengths, _ = np.linalg.svd(across @ kinetics.J_v)
    usable = [directions[:, i] for i in range(2) if i < len(strengths) and strengths[i] > 1e-6]
    return [sign * direction for direction in usable for sign in (1.0, -1.0)] or [np.zeros(3)]


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


def _position(target: ArrayLike) -> FloatArray:
    if hasattr(target, "translation"):
        raise InvalidValue("target", target, "must be a position (3,): orientations cannot be planned yet")
    return vector("target", target, 3, "m")


def _rank(plan: Trajectory) -> tuple[bool, float]:
    """Plans that arrive by cost, before the others by how near they come."""
    return not plan.reached, plan.cost_integral if plan.reached else float(plan.position_error[-1])


def _part(progress: Progress, index: int, count: int) -> Progress:
    return lambda share: progress((index + share) / count)
