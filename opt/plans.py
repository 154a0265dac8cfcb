"""Functions that plan motions from a start to a target: `plan`, and `plan_many` in several processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from inspect import signature
from itertools import repeat
from typing import Any, TypedDict, Unpack

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import common_length, one_of, optional_callable, positive
from ffsms_pin.errors import InvalidValue, UnknownOption, numerical_errors
from ffsms_pin.geometry.obstacle import Obstacle
from ffsms_pin.opt.costs import Coupling
from ffsms_pin.opt.evaluation import Violation
from ffsms_pin.opt.goals.goal import Goal, as_goal
from ffsms_pin.opt.goals.path import Path
from ffsms_pin.opt.goals.pose_constraints import FrameGoal, Waypoint, inertial_place, standing_goal
from ffsms_pin.opt.limits.alpha_box import AlphaBox
from ffsms_pin.opt.limits.base_limits import BaseLimits
from ffsms_pin.opt.limits.clearance import Clearance
from ffsms_pin.opt.problem import Problem, default_limits, default_terms
from ffsms_pin.opt.rollouts import RecordedRollouts
from ffsms_pin.opt.search import SearchOptions, solve
from ffsms_pin.opt.search.diagnosis import joint_limits_used, noted, reasons, refused, with_limit_notes
from ffsms_pin.opt.search.path_steps import plan_path_stepwise
from ffsms_pin.opt.search.search import starts_within
from ffsms_pin.opt.step.state import Progress
from ffsms_pin.opt.step.stepwise import plan_stepwise
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.processes import map_in_processes
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.threads import one_blas_thread

METHODS = ("horizon", "step", "paper", "resolved-rate", "least-disturbance", "minimum-effort")


class PlanOptions(TypedDict, total=False):
    """The further arguments of `plan`.

    `clearance` and `collision` are fields of `opt.Clearance`; `momentum`, `joint_rates`, `locked` and
    `wheel_momentum` of `opt.Problem`; `time_limit` of `opt.SearchOptions`. `base_limits` is an
    `opt.BaseLimits`. `effort` is the weight of `opt.Effort`, and `base` of `opt.BaseTurn`. `also` maps names
    of other frames to their goals at the deadline, see `opt.FrameGoal`.
    """

    clearance: float
    collision: str
    base_limits: BaseLimits | None
    momentum: ArrayLike | None
    joint_rates: ArrayLike | None
    locked: Sequence[str]
    wheel_momentum: ArrayLike | None
    effort: float | None
    base: float
    time_limit: float | None
    also: Mapping[str, Any] | None


@numerical_errors("the plan")
def plan(
    sms: SpaceManipulator,
    q0: ArrayLike,
    target: Any,
    duration: float = Problem.duration,
    dt: float = Problem.dt,
    kappa: float = Coupling.kappa,
    *,
    method: str = "horizon",
    obstacles: Sequence[Obstacle] = (),
    via: Sequence[Any] = (),
    mode: str = Problem.mode,
    progress: Progress | None = None,
    **options: Unpack[PlanOptions],
) -> Trajectory:
    """Plan a coupling-informed motion from `q0` to `target`, by building and solving an `opt.Problem`.

    Parameters
    ----------
    sms, q0, duration, dt, mode
        See `opt.Problem`.
    target
        The `goal` of `opt.Problem`.
    kappa : float
        Sharpness of C~, see `opt.Coupling`. The paper states no value; with 10, C~ is close to
        max(0, cos(theta_a)).
    method : str
        "horizon": optimisation of the whole motion from several initial guesses (docs/planner.md). It reaches
        targets that single steps miss, but takes longer to compute. "step": a quadratic program (QP) in each
        step, rolled out once for each side of the cone of zero cost; the best rollout is the plan. "paper":
        the paper's cost as printed, minimised step by step, with a schedule for const8. It does not support
        attitudes, moving obstacles, base limits, momentum, `also` or `via`. "resolved-rate",
        "least-disturbance", "minimum-effort": classical methods that move straight to the target, under the
        limits of "step" (docs/planner.md).
    obstacles : sequence of Obstacle
        The obstacles, see `opt.Clearance`.
    via : sequence, optional
        Waypoints of the end effector in any order: positions (3,), poses, or `opt.Waypoint`, which may have a
        time. Single steps ignore waypoints without a time, and their plans usually miss these waypoints.
    progress : callable, optional
        A function that is called with the completed share of the work, 0 to 1.
    **options
        `clearance`, `collision`, `base_limits`, `momentum`, `joint_rates`, `locked`, `wheel_momentum`,
        `effort`, `base`, `time_limit`, `also`: see `PlanOptions`. `effort`, `base`, `locked` and `time_limit`
        are options of "horizon" only.

    Returns
    -------
    Trajectory
        The plan; if it does not reach the target, `reached` is false and `note` has the reason.

    Raises
    ------
    InvalidValue
        If a shape is wrong, a number is out of range, the start is outside the joint limits or overlaps an
        obstacle, the target is inside an obstacle, or the method does not support an option.
    UnknownOption
        If an argument is misspelt.
    """
    _check_options("opt.plan", options)
    one_of("method", method, METHODS)
    optional_callable("progress", progress)
    for name, default in _OF_HORIZON.items():
        value = options.get(name, default)
        if method != "horizon" and np.any(value != default):
            raise InvalidValue(name, value, f"is not an option of method '{method}'; use method 'horizon'")
    goal = as_goal(target, "target")
    terms = default_terms(kappa, options.get("effort"), options.get("base", 0.0), goal.coupled)
    limits = default_limits(
        options.get("clearance", Clearance.clearance),
        options.get("collision", Clearance.collision),
        obstacles,
        options.get("base_limits"),
    )
    problem = Problem(
        sms,
        q0,
        goal,
        duration,
        dt,
        terms,
        [*limits, *_other_goals(options.get("also")), *_waypoints(via, positive("duration", duration, "s"))],
        options.get("joint_rates"),
        options.get("momentum"),
        options.get("locked", ()),
        mode,
        options.get("wheel_momentum"),
    )
    return plan_problem(problem, method, SearchOptions(time_limit=options.get("time_limit")), progress)


# Options of `plan` for "horizon" only, and their defaults.
_OF_HORIZON: Mapping[str, float | None] = {"effort": None, "base": 0.0, "time_limit": None}


def _check_options(function: str, options: Mapping[str, Any]) -> None:
    """Raise `UnknownOption` for an option that `plan` does not take."""
    named = [name for name in signature(plan).parameters if name != "options"]
    known = [*named, *PlanOptions.__annotations__]
    for name, value in options.items():
        if name not in known:
            raise UnknownOption(function, name, value, known)


def _other_goals(also: Mapping[str, Any] | None) -> list[FrameGoal]:
    """Return the goals of other frames from `plan(also=...)`."""
    if not (also is None or isinstance(also, Mapping)):
        raise InvalidValue("also", also, "must map names of frames to their goals, or be None")
    for frame in also or {}:
        if not isinstance(frame, str):
            raise InvalidValue("also", frame, "must have names of frames as keys")
    return [FrameGoal(frame, standing_goal(goal, f"also[{frame!r}]")) for frame, goal in (also or {}).items()]


def _waypoints(via: Sequence[Any], duration: float) -> list[Waypoint]:
    """Return the waypoints from `plan(via=...)`; positions and poses get names with their number."""
    kinds = "a position (3,) [m], a pinocchio.SE3, a homogeneous matrix (4, 4) or an opt.Waypoint"
    if isinstance(via, str) or not isinstance(via, Sequence | np.ndarray):
        remedy = f"must be a sequence of waypoints, each {kinds}; a single one is via=[waypoint]"
        raise InvalidValue("via", via, remedy)
    kinds += " (a single waypoint is via=[[x, y, z]])"
    waypoints = []
    for i, waypoint in enumerate(via):
        place = None if isinstance(waypoint, Waypoint) else inertial_place(waypoint, f"via[{i}]", kinds)
        waypoints.append(waypoint if place is None else Waypoint(place, name=f"via {i + 1}"))
        if (time := waypoints[-1].time) is not None and time > duration:
            name = f"time of waypoint '{waypoints[-1].name}'"
            raise InvalidValue(name, time, f"must not be after the deadline at {duration:g} s")
    return waypoints


def lacking(problem: Problem, method: str) -> str:
    """Return a message with the features of a problem that a method does not support; empty without any."""
    limits = problem.limits if method == "paper" else ()
    steps_along = method != "paper" and isinstance(problem.goal, Path)
    features = {
        "moving goals": method != "horizon" and problem.goal.moves and not steps_along,
        'timing="fastest"': steps_along and method != "horizon" and problem.goal.timing == "fastest",
        "locked joints": method != "horizon" and problem.locked,
        "goals on the base or free axes": method != "horizon" and not problem.place.plain and not steps_along,
        "attitudes": method == "paper" and np.isfinite(problem.place.attitude).all(),
        "momentum": method == "paper" and problem.momentum is not None,
        "waypoints, second goals or base limits": not all(limit.of_paper for limit in limits),
        "moving obstacles": any(obstacle.moves for limit in limits for obstacle in limit.obstacles),
    }
    return " and ".join(f"does not support {feature}" for feature, used in features.items() if used)


@numerical_errors("the plan")
@one_blas_thread()
def plan_problem(
    problem: Problem,
    method: str = "horizon",
    options: SearchOptions | None = None,
    progress: Progress | None = None,
) -> Trajectory:
    """Plan a problem by a method of `plan`; the method "horizon" is `opt.solve`.

    The method "step" uses the terms' `Term.step_objective`, except along an `opt.Path`; other step-by-step
    methods ignore terms. An unsupported feature raises `InvalidValue`.
    """
    one_of("method", method, METHODS)
    if unsupported := lacking(problem, method):
        raise InvalidValue("method", method, f"{unsupported}; use 'horizon'")
    # If the robot is at rest at its goal, it stays there within the limits, regardless of the cost.
    if starts_within(problem, 1e-6, 1e-6) and problem.goal.place(0.0).rests:
        note = "the end effector is at its target from the start"
        still = measure(problem, np.zeros((problem.steps + 1, problem.sms.n)), note)
        if still.clear:
            return still
    if method == "horizon":
        return solve(problem, options, progress)
    # Raises for an overlap or a target inside an obstacle. The result is unused, because steps may start
    # nearer than the clearance.
    refused(problem)
    if isinstance(problem.goal, Path):
        return plan_path_stepwise(problem, method, progress)
    plan = plan_stepwise(problem, method, progress)
    if plan.reached and plan.within_tolerance:
        return plan
    if not plan.reached:
        plan = with_limit_notes(problem, plan, lambda other: plan_stepwise(other, method))
    return noted(plan, plan.note, *reasons(problem, plan, joint_limits_used(problem, plan)))


def plan_many(
    sms: SpaceManipulator,
    q0: ArrayLike | Sequence[ArrayLike],
    target: Any,
    duration: ArrayLike = Problem.duration,
    dt: float = Problem.dt,
    kappa: float = Coupling.kappa,
    *,
    jobs: int | None = None,
    progress: Callable[[float], None] | None = None,
    **options: Any,
) -> list[Trajectory]:
    """Plan N motions in several processes, and return the plans in the order of the arguments.

    `q0`, `target` and `duration` each have one value for all motions, or N values. The other arguments are
    the arguments of `plan`. Without `time_limit` each result equals the result of `plan` bit for bit.

    Parameters
    ----------
    q0 : array_like, shape (nq,) or (N, nq)
        The configurations at the start.
    target : array_like, shape (3,) or (N, 3), or a target of `plan`, or sequence of these
        The targets. With several processes, functions of time must be picklable.
    duration : float or array_like, shape (N,)
        The durations [s].
    jobs : int, optional
        The number of processes; with 1 no further process is started. Default: the usable cores. With
        several processes a script must make the call below `if __name__ == "__main__":`, because each process
        imports the script.
    progress : callable, optional
        A function that is called with the share of planned motions, 0 to 1.

    Raises
    ------
    InvalidValue
        If sequences have different lengths, or the number of jobs is not from 1 to 1024.
    UnknownOption
        If an argument is misspelt.
    TasksFailed
        If planning raises errors for some motions; the exception has these errors, and the plans of the other
        motions.

    Examples
    --------
    >>> plans = opt.plan_many(sms, q0, targets, duration=12.0)
    """
    if isinstance(target, Iterator):
        target = list(target)
    arguments = {"q0": q0, "target": target, "duration": duration}
    rows = {name: row for name, value in arguments.items() if (row := _rows(name, value)) is not None}
    count = common_length(rows)
    columns = [rows.get(name, repeat(value, count)) for name, value in arguments.items()]
    _check_options("opt.plan_many", options)
    work = partial(_plan, sms, {"dt": dt, "kappa": kappa, **options})
    plans = map_in_processes(work, list(zip(*columns, strict=True)), jobs, progress)
    # Arrays from another process are writable; `replace` freezes them.
    return [replace(plan) for plan in plans]


def _plan(sms: SpaceManipulator, settings: dict[str, Any], task: tuple[Any, Any, Any]) -> Trajectory:
    """Plan one of many motions."""
    return plan(sms, *task, **settings)


def _rows(name: str, value: Any) -> list[Any] | None:
    """Return the values for all motions as a list; None if all motions have the same value."""

    def is_target(item: Any) -> bool:
        return isinstance(item, (pin.SE3, Goal)) or callable(item)

    if is_target(value):
        return None
    if name == "target" and isinstance(value, np.ndarray) and value.shape[-2:] == (4, 4):
        return None if value.ndim == 2 else list(value)
    if isinstance(value, Sequence) and any(is_target(item) for item in value):
        return list(value)
    single = 0 if name == "duration" else 1
    try:
        dimensions = np.ndim(value)
    except ValueError:  # rows have different lengths; `plan` checks each row
        return list(value)
    if dimensions == single and np.size(value):
        return None
    if dimensions not in (1, single + 1):
        raise InvalidValue(name, value, "must be one value for all motions, or a sequence of N values")
    return list(value if isinstance(value, Sequence) else np.asarray(value))


class _StepBox(AlphaBox):
    """The box on alpha that re-planning adds to a problem.

    A flown motion is not checked against this box, because it is not a limit of the user's problem.
    """

    def violation_in_flight(self, motion: RecordedRollouts) -> Violation:
        """Return no violation."""
        return Violation()


def replannable(problem: Problem, plan: Trajectory | None = None) -> Problem:
    """Return the problem for re-planning in a closed loop.

    The paper's box on alpha is added if `problem` does not have it, as for plans by single steps. A waypoint
    without a time gets the time at which `plan` is nearest to it, because the loop cannot measure which
    waypoints were passed. Without a `plan` it stays without a time.
    """
    limits = list(problem.limits)
    if not any(isinstance(limit, AlphaBox) for limit in limits):
        problem = replace(problem, limits=(*limits, _StepBox()))
    if plan is None:
        return problem
    limits = [
        limit.timed(plan) if isinstance(limit, Waypoint) and limit.time is None else limit
        for limit in problem.limits
    ]
    return replace(problem, limits=limits)
