"""The planning problem of a scenario: its goal, and every term and limit, made anew.

Terms and limits are the library's by a short name, or a user's own by an import path.
"""

from __future__ import annotations

import importlib
import inspect
import os
import re
import sys
from collections.abc import Mapping
from importlib.machinery import PathFinder
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client, ClientEstimate
from ffsms_pin.errors import FfsmsError, InvalidScenario
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
from ffsms_pin.scenarios.keys import radians
from ffsms_pin.scenarios.plan_tables import PACKAGED, is_own
from ffsms_pin.scenarios.task import goal_of, made_obstacles, meeting, other_goals, waypoints
from ffsms_pin.system import SpaceManipulator

if TYPE_CHECKING:
    from ffsms_pin.scenarios.definition import Scenario

__all__ = ["planning_problem"]

_KINDS: Mapping[str, type] = {"term": Term, "limit": Limit}
_NAME = r"[A-Za-z_]\w*"
_IMPORT_PATH = re.compile(rf"{_NAME}(\.{_NAME})*:{_NAME}")

Part = TypeVar("Part", Term, Limit)


def planning_problem(
    scenario: Scenario,
    sms: SpaceManipulator,
    q0: FloatArray,
    dt: float | None,
    client: Client | ClientEstimate | None,
) -> Problem:
    """What `Scenario.problem` gives, for a start q0 (nq,) and the client that is met, if any."""
    plan = scenario.plan
    with scenario.named():
        goal = goal_of(scenario.target, sms, q0) if client is None else meeting(scenario.meet or {}, client)
        return Problem(
            sms,
            q0,
            goal,
            scenario.arrival,
            plan.get("dt", 0.01) if dt is None else dt,
            _terms(scenario, goal),
            [*_limits(scenario, client), *_places(scenario, sms, q0)],
            scenario.per_joint(sms, "start", "joint_rates"),
            plan.get("momentum"),
            plan.get("locked", ()),
            plan.get("mode", "floating"),
            scenario.simulation.get("wheel_momentum") if plan.get("mode") == "rotation-floating" else None,
        )


def _terms(scenario: Scenario, goal: Goal) -> list[Term]:
    """Those that are there by default or by keys of [plan], and those of [[term]]."""
    plan = scenario.plan
    terms: list[Term] = [Smooth()]
    if goal.coupled or "kappa" in plan:
        terms.insert(0, Coupling(plan.get("kappa", 10.0)))
    terms.append(Effort(plan["effort"]) if "effort" in plan else Effort())
    if plan.get("base", 0.0) > 0.0:
        terms.append(BaseTurn(plan["base"]))
    own = [_made_part(scenario, "term", i, row) for i, row in enumerate(scenario.term, start=1)]
    return _with_parts(terms, own)


def _limits(scenario: Scenario, client: Client | ClientEstimate | None) -> list[Limit]:
    """Those that are there by default or by keys of [plan], and those of [[limit]]."""
    around = made_obstacles(scenario.source, scenario.obstacle, client)
    clear = Clearance(*scenario.clearance, obstacles=around)
    limits: list[Limit] = [JointLimits(), TorqueLimits(), clear]
    if "base_limits" in scenario.plan:
        limits.append(BaseLimits(**radians(scenario.plan["base_limits"])))
    own = [
        clear if row["use"] == "clearance" else _made_part(scenario, "limit", i, row)
        for i, row in enumerate(scenario.limit, start=1)
    ]
    return _with_parts(limits, own)


def _places(scenario: Scenario, sms: SpaceManipulator, q0: FloatArray) -> list[Limit]:
    """Goals of other frames, and waypoints."""
    for i, row in enumerate(scenario.also, start=1):
        if row["frame"] == sms.end_effector:
            raise InvalidScenario(
                scenario.source, f"[[also]] {i} frame = '{row['frame']}' is the end effector: use [target]"
            )
    goals = other_goals(scenario.also, sms, q0)
    for one in goals:
        one.for_robot(sms)  # looks for the frame
    return [*goals, *waypoints(scenario.via, sms, q0)]


def _with_parts(given: list[Part], more: list[Part]) -> list[Part]:
    """Both lists; a part of the second takes the place of one of the same name in the first."""
    names = [part.name for part in more]
    return [part for part in given if part.name not in names] + more


def _made_part(scenario: Scenario, kind: str, number: int, values: Mapping[str, Any]) -> Any:
    """One term or limit of a file: the row `number` of [[kind]], from 1.

    Modules of a user's own are looked for in the file's folder first, and imported, which runs their code,
    only where the scenario allows it. `InvalidScenario`: the class is not there, is no term or limit, does
    not take the values, or may not be imported.
    """
    source, use = scenario.source, values["use"]
    title = f"[[{kind}]] {number} use = '{use}'"
    arguments = {key: value for key, value in values.items() if key != "use"}
    if not is_own(use):
        part = PACKAGED[kind][use]
        return _called(source, title, part, radians(arguments))
    if not _IMPORT_PATH.fullmatch(use):
        raise InvalidScenario(source, f"{title} must be written package.module:Class")
    if not scenario.allow_import:
        raise InvalidScenario(
            source,
            f"{title} would run the code of that module: allow it, if you trust it, with --allow-import "
            "(in Python: scenario(..., allow_import=True))",
        )
    part = _imported(source, title, use)
    if not (isinstance(part, type) and issubclass(part, _KINDS[kind])):
        raise InvalidScenario(source, f"{title} is no subclass of opt.{_KINDS[kind].__name__}")
    made = _called(source, title, part, arguments)
    if not isinstance(getattr(made, "name", None), str):
        raise InvalidScenario(source, f"{title} has no `name`: give the class one, a text")
    return made


def _imported(source: Path, title: str, use: str) -> Any:
    """What an import path names, with the file's folder first on sys.path while it is imported."""
    module_name, _, class_name = use.partition(":")
    folder = str(source.resolve().parent)
    importlib.invalidate_caches()
    sys.path.insert(0, folder)
    try:
        module = importlib.import_module(module_name)
    except Exception as error:  # whatever the user's code raises
        raise InvalidScenario(source, f"{title} cannot be imported from {folder} ({_line(error)})") from error
    finally:
        sys.path.remove(folder)
    # A module is loaded once by its name: one of the same name from another folder would be taken for it.
    package = module_name.partition(".")[0]
    here = PathFinder.find_spec(package, [folder])
    loaded = getattr(sys.modules[package], "__file__", None) or "elsewhere"
    if here is not None and here.origin and os.path.realpath(here.origin) != os.path.realpath(loaded):
        raise InvalidScenario(
            source,
            f"{title}: another module '{package}' is loaded already ({loaded}); give yours another name",
        )
    if not hasattr(module, class_name):
        raise InvalidScenario(source, f"{title}: module '{module_name}' has no {class_name}")
    return getattr(module, class_name)


def _called(source: Path, title: str, part: Any, arguments: Mapping[str, Any]) -> Any:
    try:
        inspect.signature(part).bind(**arguments)
    except TypeError as error:
        known = ", ".join(name for name in inspect.signature(part).parameters if not name.startswith("_"))
        raise InvalidScenario(
            source, f"{title} does not take these keys: {error} (it takes: {known or 'none'})"
        ) from None
    try:
        return part(**arguments)
    except FfsmsError as error:
        raise InvalidScenario(source, f"{title}: {error}") from None
    except Exception as error:  # whatever the user's code raises
        raise InvalidScenario(source, f"{title} cannot be made of these values ({_line(error)})") from error


def _line(error: Exception) -> str:
    """An error of a user's code in one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"
