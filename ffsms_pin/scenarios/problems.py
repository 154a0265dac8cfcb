"""The planning problem of a scenario: its goal, and every term and limit, made anew."""

from __future__ import annotations

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client, ClientEstimate
from ffsms_pin.errors import FrameNotFound, InvalidScenario, InvalidValue
from ffsms_pin.opt import (
    BaseLimits,
    BaseTurn,
    Clearance,
    Coupling,
    Effort,
    Goal,
    JointLimits,
    Limit,
    Problem,
    Smooth,
    Term,
    TorqueLimits,
)
from ffsms_pin.scenarios.clients import meeting
from ffsms_pin.scenarios.contents import Contents
from ffsms_pin.scenarios.keys import radians
from ffsms_pin.scenarios.obstacles import made_obstacles
from ffsms_pin.scenarios.parts import made_part, with_parts
from ffsms_pin.scenarios.targets import goal_of, other_goals, waypoints
from ffsms_pin.system import SpaceManipulator

__all__ = ["planning_problem"]


def planning_problem(
    contents: Contents,
    sms: SpaceManipulator,
    q0: FloatArray,
    dt: float | None,
    client: Client | ClientEstimate | None,
) -> Problem:
    """What `Scenario.problem` gives, for a start q0 (nq,) and the client that is met, if any.

    Raises
    ------
    InvalidScenario
        A value does not fit the robot, or a term or limit cannot be made.
    """
    plan = contents.plan
    goal = goal_of(contents.target, sms, q0) if client is None else _meeting(contents, client)
    try:
        return Problem(
            sms,
            q0,
            goal,
            contents.arrival,
            plan.get("dt", 0.01) if dt is None else dt,
            _terms(contents, goal),
            [*_limits(contents, client), *_places(contents, sms, q0)],
            contents.per_joint(sms, "start", "joint_rates"),
            plan.get("momentum"),
            plan.get("locked", ()),
            plan.get("mode", "floating"),
            contents.simulation.get("wheel_momentum") if plan.get("mode") == "rotation-floating" else None,
        )
    except InvalidValue as error:
        raise InvalidScenario(contents.source, str(error)) from None


def _terms(contents: Contents, goal: Goal) -> list[Term]:
    """Those that are there by default or by keys of [plan], and those of [[term]]."""
    plan = contents.plan
    terms: list[Term] = [Smooth()]
    if goal.coupled or "kappa" in plan:
        terms.insert(0, Coupling(plan.get("kappa", 10.0)))
    terms.append(Effort(plan["effort"]) if "effort" in plan else Effort())
    if plan.get("base", 0.0) > 0.0:
        terms.append(BaseTurn(plan["base"]))
    own = [
        made_part(contents.source, "term", i, row, contents.allow_import)
        for i, row in enumerate(contents.term, start=1)
    ]
    return with_parts(terms, own)


def _limits(contents: Contents, client: Client | ClientEstimate | None) -> list[Limit]:
    """Those that are there by default or by keys of [plan], and those of [[limit]]."""
    around = made_obstacles(contents.source, contents.obstacle, client)
    try:
        clear = Clearance(*contents.clearance, obstacles=around)
    except InvalidValue as error:
        raise InvalidScenario(contents.source, str(error)) from None
    limits: list[Limit] = [JointLimits(), TorqueLimits(), clear]
    if "base_limits" in contents.plan:
        limits.append(BaseLimits(**radians(contents.plan["base_limits"])))
    own = [
        clear
        if row["use"] == "clearance"
        else made_part(contents.source, "limit", i, row, contents.allow_import)
        for i, row in enumerate(contents.limit, start=1)
    ]
    return with_parts(limits, own)


def _places(contents: Contents, sms: SpaceManipulator, q0: FloatArray) -> list[Limit]:
    """Goals of other frames, and waypoints."""
    try:
        goals = other_goals(contents.also, sms, q0)
        for one in goals:
            one.for_robot(sms)  # looks for the frame
    except FrameNotFound as error:
        (i,) = [i for i, row in enumerate(contents.also, start=1) if row["frame"] == error.frame]
        raise InvalidScenario(contents.source, f"[[also]] {i} frame: {error}") from None
    for i, row in enumerate(contents.also, start=1):
        if row["frame"] == sms.end_effector:
            raise InvalidScenario(
                contents.source, f"[[also]] {i} frame = '{row['frame']}' is the end effector: use [target]"
            )
    return [*goals, *waypoints(contents.via, sms, q0)]


def _meeting(contents: Contents, client: Client | ClientEstimate) -> Goal:
    try:
        return meeting(contents.meet or {}, client)
    except InvalidValue as error:
        raise InvalidScenario(contents.source, f"[meet] {error}") from None
