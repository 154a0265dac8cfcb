"""The re-planning reference of a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

import pinocchio as pin

from ffsms_pin.capture import ClientEstimate, Replan, VisualReplanning
from ffsms_pin.checks import rigid_body
from ffsms_pin.identification import Identifier
from ffsms_pin.opt import Path, Replanning, ReplanOptions, Trajectory
from ffsms_pin.opt.plans import replannable
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.problems import bare_client, rendezvous, seen_client
from ffsms_pin.simulation import Sensors

Options = TypeVar("Options", bound=ReplanOptions)


def replanning(scenario: Scenario, sms: SpaceManipulator, plan: Trajectory | None = None) -> Replanning:
    """Return a reference that re-plans from the measured state, for one run.

    A client with a sensor is measured in the loop. Waypoints without a time get the time at which `plan`
    passes them, because the loop cannot detect passed waypoints.
    """
    if scenario.meet is not None:
        return rendezvous(scenario, sms).replanning(plan, replan_options(scenario, sms, Replan))
    reference, options = scenario.reference, replan_options(scenario, sms, ReplanOptions)
    client = None if scenario.client is None else seen_client(scenario, sms)
    problem = replannable(scenario.problem(sms, dt=reference.get("dt"), client=client), plan)
    if isinstance(problem.goal, Path) and problem.goal.timing == "fastest":  # the plan fixes the times
        if plan is None or plan.problem is None:
            problem = replace(problem, goal=replace(problem.goal, timing="given"))
        else:
            problem = replace(problem, goal=plan.problem.goal, duration=plan.duration)
    loop: dict[str, Any] = {"hold": reference.get("hold", 0.0), "plan": plan, "options": options}
    loop["learn"] = learner(scenario, sms)
    with scenario.named("reference"):
        if isinstance(client, ClientEstimate):
            return VisualReplanning(problem, bare_client(scenario, sms), client.sensor, client, **loop)
        return Replanning(problem, **loop)


def replan_options(scenario: Scenario, sms: SpaceManipulator, kind: type[Options]) -> Options:
    """Return the options of re-planning in the table [reference]."""
    return scenario.made(kind, "reference", jerk=scenario.per_joint(sms, "reference", "jerk"))


def learner(scenario: Scenario, sms: SpaceManipulator) -> Identifier | None:
    """Return the identifier of [learn], with the noise of [sensors]; None without that table."""
    table = scenario.learn
    if table is None:
        return None
    with scenario.named("learn"):
        sensors = scenario.made(Sensors, "sensors") if scenario.sensors else None
        known = {name: _known(f"known.{name}", value) for name, value in table.get("known", {}).items()}
        others = {key: table[key] for key in ("spread", "at_rest") if key in table}
        return Identifier(sms, list(table["unknown"]), sensors=sensors, known=known, **others)


def _known(name: str, value: Any) -> Any:
    """Return a known mass [kg], or the pinocchio.Inertia of a table of mass, inertia and com."""
    if not isinstance(value, Mapping):
        return value
    mass, tensor, com = rigid_body(name, value["mass"], value["inertia"], value.get("com", (0.0, 0.0, 0.0)))
    return pin.Inertia(mass, com, tensor)
