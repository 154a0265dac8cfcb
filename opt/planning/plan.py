"""`plan`: from a start and a target to a trajectory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import one_of
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.given import default_limits, default_terms
from ffsms_pin.opt.goals import Also, Via, as_goal
from ffsms_pin.opt.horizon import SearchOptions, solve
from ffsms_pin.opt.horizon.diagnosis import with_limits_said
from ffsms_pin.opt.horizon.solve import refused
from ffsms_pin.opt.horizon.starts import marched, reference_stepper
from ffsms_pin.opt.limits import BaseLimits, Clearance, Limit, Obstacle
from ffsms_pin.opt.paper.nonlinear_step import NonlinearStepper
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.step.march import Progress, start_sides
from ffsms_pin.opt.step.stepper import Stepper
from ffsms_pin.opt.terms import Coupling
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.threads import one_blas_thread

__all__ = ["KAPPA", "METHODS", "plan", "plan_problem"]

METHODS = ("horizon", "step", "paper", "resolved-rate", "least-disturbance", "minimum-effort")

KAPPA = Coupling.kappa  # of the paper's cost, where none is given

ALREADY_THERE = 1e-6  # [m, rad] nearer than this to its target, an arm is there and stays


def plan(
    sms: SpaceManipulator,
    q0: ArrayLike,
    target: Any,
    duration: float = Problem.duration,
    dt: float = Problem.dt,
    kappa: float = KAPPA,
    *,
    clearance: float = Clearance.clearance,
    collision: str = Clearance.collision,
    obstacles: Sequence[Obstacle] = (),
    method: str = "horizon",
    base_limits: BaseLimits | None = None,
    momentum: ArrayLike | None = None,
    joint_rates: ArrayLike | None = None,
    locked: Sequence[str] = (),
    effort: float | None = None,
    base: float = 0.0,
    time_limit: float | None = None,
    also: Mapping[str, Any] | None = None,
    via: Sequence[Any] = (),
    progress: Progress | None = None,
    mode: str = Problem.mode,
    wheel_momentum: ArrayLike | None = None,
) -> Trajectory:
    """Plan a coupling-informed motion from `q0` to `target`: build an `opt.Problem`, and solve it.

    See `opt.Problem` for what is not listed here; its `goal` is the target. For other terms and limits build
    one yourself and call `opt.solve`.

    Parameters
    ----------
    kappa : float
        Sharpness of C~. Not stated in the paper; 10 makes C~ nearly max(0, cos(theta_a)).
    clearance, collision, obstacles
        As for `Clearance`.
    method : str
        "horizon": the whole motion at once, from several starts (docs/horizon.md). It reaches what a step
        marches past, and its cost is that of a full nonlinear programme.
        "step": the per-step programme, marched once for each side of the cost's cone; the best of these.
        "paper": the paper's cost minimised step by step as it stands, with a schedule for const8. It knows no
        base limits, momentum, `also` or `via`.
        "resolved-rate", "least-disturbance", "minimum-effort": classical references that go straight to the
        target (see `REFERENCES`), under the same limits.
    base_limits : BaseLimits, optional
        How far and how fast the base may move.
    effort, base : float
        Weights on joint travel (`opt.Effort`) and on turning of the base (`opt.BaseTurn`); for "horizon", as
        `locked` and `time_limit` (see `SearchOptions`) are.
    also : mapping, optional
        Goals of other frames at the deadline, by the frames' names (see `opt.Also`).
    via : sequence, optional
        Places that the end effector passes on its way, in any order: positions (3,), poses, or `opt.Via`,
        which may have a time. Methods that march pass those with a time.
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
    one_of("method", method, METHODS)
    goal = as_goal(target)
    terms = default_terms(kappa, effort, base, goal.coupled)
    limits = (*default_limits(clearance, collision, obstacles, base_limits), *_places(also, via))
    problem = Problem(
        sms,
        q0,
        goal,
        duration,
        dt,
        terms,
        limits,
        joint_rates=joint_rates,
        momentum=momentum,
        locked=locked,
        mode=mode,
        wheel_momentum=wheel_momentum,
    )
    return plan_problem(problem, method, SearchOptions(time_limit=time_limit), progress)


def _places(also: Mapping[str, Any] | None, via: Sequence[Any]) -> list[Limit]:
    """Goals of other frames, and waypoints, numbered where they have no name of their own."""
    if also is not None and not isinstance(also, Mapping):
        raise InvalidValue("also", also, "must be goals by the names of frames")
    if not isinstance(via, Sequence):
        raise InvalidValue("via", via, "must be a sequence of places")
    goals = [Also(frame, goal) for frame, goal in (also or {}).items()]
    ways = [one if isinstance(one, Limit) else Via(one, name=f"via {i + 1}") for i, one in enumerate(via)]
    return [*goals, *ways]


@one_blas_thread()
def plan_problem(
    problem: Problem,
    method: str = "horizon",
    options: SearchOptions | None = None,
    progress: Progress | None = None,
) -> Trajectory:
    """Plan a problem by any method; `opt.solve` is its "horizon".

    Parameters
    ----------
    problem : Problem
        Methods that march keep its limits; of its terms, "step" takes what they say about a step
        (`Term.step_objective`), the others nothing.
    method : str
        As for `plan`.
    options : SearchOptions, optional
        For "horizon".
    progress : callable, optional
        Called with the share of the work done, 0 to 1.

    Raises
    ------
    InvalidValue
        The method does not know something that the problem has.
    """
    one_of("method", method, METHODS)
    if method == "paper" and not (problem.momentum is None and all(one.of_paper for one in problem.limits)):
        what = "waypoints, no second goal, no base limits and no momentum"
        raise InvalidValue("method", method, f"knows no {what}; take another one")
    if method == "paper" and any(one.moves for limit in problem.limits for one in limit.obstacles):
        raise InvalidValue("method", method, "knows no obstacles that move; take another one")
    if method != "horizon" and (problem.goal.moves or problem.locked):
        raise InvalidValue("method", method, "knows no moving goals and no locked joints; take 'horizon'")
    if method != "horizon" and not problem.goal.place(problem.duration).plain:
        raise InvalidValue("method", method, "knows no goals on the base and no free axis; take 'horizon'")
    still = _stand_still(problem)
    if still is not None:
        return still
    if method == "horizon":
        return solve(problem, options, progress)
    refused(problem)  # an overlap with an obstacle raises; from a start that is too near a march may get away
    plan = _marched(problem, method, progress)
    if plan.reached:
        return plan
    return with_limits_said(problem, plan, lambda other: _marched(other, method, None))


def _stand_still(problem: Problem) -> Trajectory | None:
    """The motion of an arm that is already there: none, whatever the paper's cost charges for it."""
    if problem.momentum is not None or problem.joint_rates.any() or problem.goal.moves:
        return None
    if not problem.goal.place(0.0).rests or (
        np.linalg.norm(problem.place_now.position - problem.tip0) >= ALREADY_THERE
    ):
        return None
    note = "the end effector is at its target from the start"
    still = measure(problem, np.zeros((problem.steps + 1, problem.sms.n)), note)
    error = max(float(still.position_error[0]), float(still.orientation_error[0]))
    return still if error < ALREADY_THERE and still.clear else None


def _marched(problem: Problem, method: str, progress: Progress | None) -> Trajectory:
    """The motion of single steps; for "step" the best of the marches on the different sides of the cone."""
    if method == "paper":
        kappa, limits, total = problem.kappa, problem.step_limits, problem.wheel_total
        paper = NonlinearStepper(problem.sms, problem.dt, kappa, limits, problem.mode, total)
        return marched(problem, paper, progress)
    if method != "step":
        return marched(problem, reference_stepper(problem, method), progress)
    stepper = Stepper.of(problem, limits=problem.step_limits)
    target = problem.goal.place(problem.duration).position
    sides = start_sides(problem.sms, problem.q0, target, problem.mode)
    plans = []
    for i, side in enumerate(sides):
        stepper.reset(side)
        plans.append(marched(problem, stepper, progress and partial(_part, progress, i, len(sides))))
    # Plans that arrive by cost, before the others by how near they come.
    return min(
        plans, key=lambda one: (not one.reached, one.cost_integral if one.reached else one.position_error[-1])
    )


def _part(progress: Progress, index: int, count: int, share: float) -> None:
    progress((index + share) / count)
