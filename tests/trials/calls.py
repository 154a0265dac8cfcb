"""Calls of the public interface with one or two arguments that are wrong.

What can be called is found by looking: the functions and classes of the public packages, the methods of the
objects that they make, every quantity of a state, and `simulate` with every kind of condition.
"""

from __future__ import annotations

import inspect
import random
from collections.abc import Callable, Iterator
from functools import cache
from itertools import islice
from typing import Any

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import control, inspection, opt, simulation
from trials.good import good_arguments, motion, planar, things
from trials.judge import Trial
from trials.values import bad_value

__all__ = ["trial"]

PACKAGES = (ffsms, opt, control, simulation, inspection)
# What the library makes and hands out or only derives from, not what a user calls; and `view`, which serves a
# page to a browser.
NOT_CALLED = {
    "State", "Tracking", "Trajectory", "Scenario", "Step", "StepProblem", "JointLaw", "Controller",
    "Reference", "Change", "Fault", "JointReport", "LinkReport", "Report", "view",
    "Goal", "Limit", "Inequality", "Features", "Rows", "Term", "Violation", "BaseLaw",
}  # fmt: skip
CONDITIONS = {
    "friction": simulation.JointFriction, "actuator": simulation.Actuator, "sensors": simulation.Sensors,
    "disturbances": simulation.Wrench, "watchdog": simulation.Watchdog, "events": simulation.Capture,
    "estimator": simulation.Estimator,
}  # fmt: skip


def trial(seed: int) -> Trial:
    """One call."""
    rng = random.Random(f"call {seed}")
    name, signature, call = rng.choice(_callables())
    arguments = _spoiled_arguments(rng, name, signature)
    told = ", ".join(f"{key}={_short(arguments[key])}" for key in arguments)
    return Trial(f"{name}({told})", lambda: _all_of(call(**arguments)))


def _spoiled_arguments(rng: random.Random, name: str, signature: inspect.Signature) -> dict[str, Any]:
    """Arguments of which one or two are wrong; optional ones are left out half of the time."""
    good = good_arguments(name.rpartition(".")[2])
    plain = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    named = [one for one in signature.parameters.values() if one.kind in plain]
    wrong = rng.sample([one.name for one in named], k=min(len(named), rng.choice((1, 1, 1, 2))))
    arguments: dict[str, Any] = {}
    for one in named:
        known = good.get(one.name)
        if one.name in wrong:
            arguments[one.name] = bad_value(rng, known)
        elif one.default is inspect.Parameter.empty or (one.name in good and rng.random() < 0.5):
            arguments[one.name] = known
    return arguments


@cache
def _callables() -> list[tuple[str, inspect.Signature, Callable[..., Any]]]:
    """Names, parameters and functions; methods are looked up anew in each trial."""
    found: list[tuple[str, inspect.Signature, Callable[..., Any]]] = []
    for package in PACKAGES:
        for name in package.__all__:
            value = getattr(package, name)
            if callable(value) and name not in NOT_CALLED and not _is_error(value):
                found.append((f"{package.__name__}.{name}", inspect.signature(value), value))
    for name, thing in things().items():
        for method in _methods(thing):
            parameters = inspect.signature(getattr(thing, method))
            if parameters.parameters:
                found.append((f"{name}.{method}", parameters, _method(name, method)))
    found += [
        (f"simulate with {kind.__name__}", inspect.signature(kind), _condition(key, kind))
        for key, kind in CONDITIONS.items()
    ]
    found.append(("every quantity of a state.at", inspect.signature(planar().at), _every_quantity))
    return found


def _methods(thing: Any) -> list[str]:
    """Names of the public methods, class methods among them."""
    kind = type(thing)
    public = [name for name in dir(kind) if not name.startswith("_")]
    found = [(name, getattr(kind, name)) for name in public]
    return [name for name, value in found if inspect.isfunction(value) or inspect.ismethod(value)]


def _method(name: str, method: str) -> Callable[..., Any]:
    return lambda **arguments: getattr(things()[name], method)(**arguments)


def _condition(key: str, kind: Callable[..., Any]) -> Callable[..., Any]:
    """A closed loop of a few steps under one condition."""

    def run(**arguments: Any) -> Any:
        condition = {key: kind(**arguments)}
        return ffsms.simulate(planar(), motion(), control.PD(planar()), dt=0.01, **condition)

    return run


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
