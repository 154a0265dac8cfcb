"""Calls of the public interface with one or two arguments that are wrong.

What can be called is found by looking: the functions and classes of every package below `ffsms_pin`, the
methods of the objects that they make, every quantity of a state, and `simulate` with every kind of condition.
"""

from __future__ import annotations

import inspect
import pkgutil
import random
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from importlib import import_module
from itertools import islice
from typing import Any

import numpy as np
from motions import HASTY

import ffsms_pin as ffsms
from ffsms_pin import control, opt, simulation
from ffsms_pin.errors import DependencyMissing
from ffsms_pin.opt.plans import plan_problem
from ffsms_pin.opt.replan.options import ReplanOptions
from trials.good import good_arguments, motion, planar, problem, things
from trials.judge import Trial
from trials.values import bad_value

__all__ = ["trial"]

# Whole packages, names in a package, and methods that no user calls, and why.
NOT_CALLED = {
    "takes words of a command line, which tests/cli misspells": {"ffsms_pin.cli"},
    "draws what other calls made": {"ffsms_pin.plotting", "ffsms_pin.view", "ffsms_pin.viewer"},
    "what the library makes and hands out, or only derives from": {
        "ffsms_pin.State", "ffsms_pin.Tracking", "ffsms_pin.Scenario",
        "ffsms_pin.campaigns.Campaign", "ffsms_pin.campaigns.Report",
        "ffsms_pin.client.AfterCapture", "ffsms_pin.client.Braking", "ffsms_pin.client.Shape",
        "ffsms_pin.control.BaseCommand", "ffsms_pin.control.BaseLaw", "ffsms_pin.control.BaseView",
        "ffsms_pin.contact.Load", "ffsms_pin.contact.Scene", "ffsms_pin.contact.Touch",
        "ffsms_pin.control.JointLaw", "ffsms_pin.engine.Outcome",
        "ffsms_pin.inspection.Change", "ffsms_pin.inspection.Fault", "ffsms_pin.inspection.JointReport",
        "ffsms_pin.inspection.LinkReport", "ffsms_pin.inspection.Report",
        "ffsms_pin.opt.Features", "ffsms_pin.opt.Motions", "ffsms_pin.opt.Corridor", "ffsms_pin.opt.Goal",
        "ffsms_pin.opt.Inequality", "ffsms_pin.opt.Limit",
        "ffsms_pin.opt.Rows", "ffsms_pin.opt.Step", "ffsms_pin.opt.StepProblem", "ffsms_pin.opt.Term",
        "ffsms_pin.opt.Trajectory", "ffsms_pin.opt.Violation", "ffsms_pin.scenarios.Attempt",
        "ffsms_pin.scenarios.ClientMotion", "ffsms_pin.scenarios.Comparison",
        "ffsms_pin.scenarios.Outcome", "ffsms_pin.scenarios.Robustness", "ffsms_pin.scenarios.Timing",
        "ffsms_pin.scenarios.client_motion", "ffsms_pin.simulation.Controller",
        "ffsms_pin.simulation.Instant", "ffsms_pin.simulation.Reference",
        "ffsms_pin.simulation.Supervisor",
    },
    "the solvers' own, within `opt`": {
        "ffsms_pin.opt.goals.Changed", "ffsms_pin.opt.goals.Place", "ffsms_pin.opt.goals.as_goal",
        "ffsms_pin.opt.motion.Residuals", "ffsms_pin.system.batch.ArmStack",
        "ffsms_pin.system.batch.ArmValues",
    },
    "reads what `campaign` wrote, for `merge` and `report`, which say what is wrong with the folder": {
        "campaign.from_specification",
    },
    "asked at every step of a loop, with the loop's own arrays": {
        "ffsms_pin.coupling.Coupling", "ffsms_pin.coupling.cosine",
        "ffsms_pin.coupling.decompose", "dump.moment", "wheels.total", "wheels.friction_torque",
        "thrusters.flow", "step planner.advance", "obstacle.track",
    },
}  # fmt: skip
CONDITIONS = {
    "friction": simulation.JointFriction, "actuator": simulation.Actuator, "sensors": simulation.Sensors,
    "disturbances": simulation.Wrench, "watchdog": simulation.Watchdog, "events": simulation.Capture,
    "estimator": simulation.Estimator,
}  # fmt: skip
OWN_FUNCTIONS = ("progress", "work", "lost", "prepare")
# What a user writes of a part.
OWN_PARTS: dict[Any, tuple[str, ...]] = {
    opt.Term: ("residual", "share", "cost", "step_objective"),
    opt.Limit: ("residual", "rows", "violation", "for_robot"),
    opt.Inequality: ("room",),
}


def trial(seed: int) -> Trial:
    """One call."""
    rng = random.Random(f"call {seed}")
    name, signature, call = rng.choice(_callables())
    arguments = _spoiled_arguments(rng, name, signature)
    told = ", ".join(f"{key}={_short(arguments[key])}" for key in arguments)
    return Trial(f"{name}({told})", lambda: _all_of(call(**arguments)))


def _spoiled_arguments(rng: random.Random, name: str, signature: inspect.Signature) -> dict[str, Any]:
    """Arguments of which one or two are wrong; optional ones are left out half of the time.

    But for `jobs` and `plants`, whose defaults are all cores and minutes of work.
    """
    good = good_arguments(name.rpartition(".")[2])
    plain = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    named = [one for one in signature.parameters.values() if one.kind in plain]
    wrong = rng.sample([one.name for one in named], k=min(len(named), rng.choice((1, 1, 1, 2))))
    arguments: dict[str, Any] = {}
    for one in named:
        known = good.get(one.name, None if one.default is inspect.Parameter.empty else one.default)
        if one.name in wrong:
            value = bad_value(rng, known)
            # `int` can be called: what a user's own function raises comes through as it is.
            arguments[one.name] = None if value is int and one.name in OWN_FUNCTIONS else value
        elif one.default is inspect.Parameter.empty or (
            one.name in good and (one.name in ("jobs", "plants") or rng.random() < 0.5)
        ):
            arguments[one.name] = known
    return arguments


@cache
def _callables() -> list[tuple[str, inspect.Signature, Callable[..., Any]]]:
    """Names, parameters and functions; methods are looked up anew in each trial."""
    left_out = set[str]().union(*NOT_CALLED.values())
    found = [
        (name, inspect.signature(value), value) for name, value in _public().items() if name not in left_out
    ]
    for name, make in things().items():
        thing = make()
        for method in _methods(thing):
            parameters = inspect.signature(getattr(thing, method))
            if parameters.parameters and f"{name}.{method}" not in left_out:
                found.append((f"{name}.{method}", parameters, _method(name, method)))
    found += [
        (f"simulate with {kind.__name__}", inspect.signature(kind), _condition(key, kind))
        for key, kind in CONDITIONS.items()
    ]
    found += [
        ("solve with SearchOptions", inspect.signature(opt.SearchOptions), _searched),
        ("replan with ReplanOptions", inspect.signature(ReplanOptions), _replanned),
    ]
    found += [
        (
            f"plan with {kind.__name__}.{name}",
            inspect.signature(lambda answer: None),
            partial(_planned, kind, name),
        )
        for kind, names in OWN_PARTS.items()
        for name in names
    ]
    found.append(("every quantity of a state.at", inspect.signature(planar().at), _every_quantity))
    return found


def _public() -> dict[str, Callable[..., Any]]:
    """The functions and classes of all packages, each by the first name that it has."""
    left_out = set[str]().union(*NOT_CALLED.values())
    walked = pkgutil.walk_packages(ffsms.__path__, "ffsms_pin.", onerror=lambda _: None)
    packages = ["ffsms_pin", *sorted(one.name for one in walked if one.ispkg)]
    found: dict[str, Callable[..., Any]] = {}
    seen: set[int] = set()
    for package in packages:
        try:
            module = import_module(package)
        except DependencyMissing:
            continue
        for name in getattr(module, "__all__", ()):
            value = getattr(module, name)
            plain = inspect.isfunction(value) or (inspect.isclass(value) and not _is_error(value))
            if plain and id(value) not in seen and package not in left_out:
                seen.add(id(value))
                found[f"{package}.{name}"] = value
    return found


def _methods(thing: Any) -> list[str]:
    """Names of the public methods of the library's own, class methods among them."""
    kind = type(thing)
    found = [(name, getattr(kind, name)) for name in dir(kind) if not name.startswith("_")]
    return [
        name
        for name, value in found
        if (inspect.isfunction(value) or inspect.ismethod(value)) and value.__module__.startswith("ffsms_pin")
    ]


def _method(name: str, method: str) -> Callable[..., Any]:
    return lambda **arguments: getattr(things()[name](), method)(**arguments)


def _condition(key: str, kind: Callable[..., Any]) -> Callable[..., Any]:
    """A closed loop of a few steps under one condition."""

    def run(**arguments: Any) -> Any:
        condition = {key: kind(**arguments)}
        return ffsms.simulate(planar(), motion(), control.PD(planar()), dt=0.01, **condition)

    return run


def _searched(**arguments: Any) -> Any:
    return opt.solve(problem(), opt.SearchOptions(**arguments))


def _replanned(**arguments: Any) -> Any:
    reference = opt.Replanning(problem(), options=ReplanOptions(**arguments))
    return ffsms.simulate(planar(), reference, control.PD(planar()), dt=0.05)


def _planned(kind: Any, name: str, answer: Any) -> None:
    """Plans with a part of a user's own."""
    own = _part(kind, name, answer)
    parts = {"terms": (opt.Coupling(), own)} if kind is opt.Term else {"limits": (opt.JointLimits(), own)}
    for method in ("horizon", "step"):
        plan_problem(replace(problem(), **parts), method, HASTY)


def _part(kind: Any, name: str, answer: Any) -> Any:
    """A part one of whose methods gives this answer, and fails where it is a text; the others say nothing."""

    def method(*_: Any) -> Any:
        if isinstance(answer, str):
            raise ValueError(answer)
        return answer

    usual: dict[str, Callable[..., Any]] = {
        "residual": lambda *_: [],
        "rows": lambda *_: None,
        "violation": lambda *_: opt.Violation(),
    }
    quiet = {key: value for key, value in usual.items() if key in kind.__abstractmethods__}
    return type("Own", (kind,), {"name": "own", **quiet, name: method})()


def _every_quantity(**arguments: Any) -> None:
    state = planar().at(**arguments)
    # `at` takes any finite velocity and says that what is made of it may overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        for name in dir(type(state)):
            if not name.startswith("_"):
                getattr(state, name)


def _is_error(value: Any) -> bool:
    return inspect.isclass(value) and issubclass(value, (Exception, Warning))


def _all_of(result: Any) -> Any:
    """The result; of an iterator what it yields, up to a few."""
    return list(islice(result, 3)) if isinstance(result, Iterator) else result


def _short(value: Any) -> str:
    text = " ".join(repr(value).split()).encode("ascii", "backslashreplace").decode()
    return text if len(text) <= 60 else text[:57] + "..."
