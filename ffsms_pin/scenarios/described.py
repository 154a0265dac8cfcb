"""The conditions of a closed loop in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ffsms_pin.scenarios.definition import Scenario

__all__ = ["described"]


def described(scenario: Scenario) -> dict[str, str]:
    """What the scenario says about its closed loop, in words, by table; the library's defaults are not told.

    Parameters
    ----------
    scenario : Scenario

    Returns
    -------
    dict
        Always with "control", the law, and "reference".
    """
    reference = scenario.reference
    words = {
        "control": _words({"law": scenario.law, **scenario.control}),
        "reference": _words({"kind": "plan", **reference}),
    }
    for name in ("simulation", "plant", "friction", "actuator", "sensors", "estimator"):
        if values := getattr(scenario, name):
            words[name] = _words(values)
    for name in ("also", "via", "disturbance", "capture", "fault", "term", "limit"):
        several = getattr(scenario, name)
        for i, values in enumerate(several, start=1):
            words[name if len(several) == 1 else f"{name} {i}"] = _words(values)
    if scenario.contact:
        words["contact"] = _words(scenario.contact)
    for name in ("client", "meet", "wheels", "thrusters", "attitude"):
        if (found := getattr(scenario, name)) is not None:
            words[name] = _words({key: value for key, value in found.items() if value is not None})
            words[name] = words[name] or "as by default"
    if scenario.watchdog is not None:
        words["watchdog"] = _words(scenario.watchdog) or "as by default"
    for name in ("base_limits", "momentum", "locked", "effort", "base", "time_limit"):
        if name in scenario.plan:
            words[f"plan.{name}"] = _value(scenario.plan[name])
    return words


def _words(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} {_value(value)}" for key, value in values.items())


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"({_words(value)})"
    if isinstance(value, tuple):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
