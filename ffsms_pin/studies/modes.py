"""Coupling used against coupling fought: one task, with the base held and with the base left to float."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.opt import BaseLimits, Problem, SearchOptions, Trajectory
from ffsms_pin.opt.planning.plan import plan_problem
from ffsms_pin.studies.extremes import why_not_reached
from ffsms_pin.studies.turn_back import Spent, spent, turn_back
from ffsms_pin.system import SpaceManipulator

__all__ = [
    "RESTORED_WITHIN",
    "STRATEGIES",
    "Strategy",
    "mode_numbers",
    "strategies",
]

STRATEGIES = ("held", "held-longer", "used", "restored", "straight")
"""held: attitude held by wheels all the time. held-longer: the same in the whole time that "used" takes.
used: coupling-informed, floating, then the wheels turn the base back. restored: floating, the attitude
restored by the arm alone. straight: resolved rates, floating, then turned back."""

RESTORED_WITHIN = np.radians(0.1)  # [rad] what "restored" leaves of the base's turn


class Strategy(NamedTuple):
    """One way to do the task: what wheels or thrusters do along the plan, and after it.

    `after` is None where the base is not turned back; `carried` is how far that carries the end effector [m].
    """

    plan: Trajectory
    during: Spent
    after: Spent | None = None
    carried: float = 0.0


def strategies(
    problem: Problem,
    options: SearchOptions | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> dict[str, Strategy]:
    """Plans for a problem of a robot with wheels or thrusters, whatever its mode, by `STRATEGIES`.

    `progress` is called with a strategy's name and the share of its plan that is done, 0 to 1.
    """
    sms = problem.sms
    held = replace(problem, mode="rotation-flying" if sms.wheels is None else "rotation-floating")
    floating = replace(problem, mode="floating", wheel_momentum=None)
    kept = [limit for limit in floating.limits if not isinstance(limit, BaseLimits)]
    restoring = replace(floating, limits=(*kept, BaseLimits(final_attitude=RESTORED_WITHIN)))

    def report(name: str) -> Callable[[float], None] | None:
        return None if progress is None else partial(progress, name)

    def made(name: str, problem: Problem) -> Trajectory:
        return plan_problem(problem, "horizon", options, report(name))

    found: dict[str, Strategy] = {}
    found["held"] = _spent(sms, made("held", held))
    found["used"] = _turned_back(sms, made("used", floating))
    after = found["used"].after
    longer = held.lasting(held.duration + (0.0 if after is None else float(after.t[-1])))
    found["held-longer"] = _spent(sms, made("held-longer", longer))
    found["restored"] = _spent(sms, made("restored", restoring))
    straight = plan_problem(floating, "resolved-rate", None, report("straight"))
    found["straight"] = _turned_back(sms, straight)
    return {name: found[name] for name in STRATEGIES}


def _spent(sms: SpaceManipulator, plan: Trajectory) -> Strategy:
    """A motion after which the base stays as it is."""
    return Strategy(plan, spent(sms, plan))


def _turned_back(sms: SpaceManipulator, plan: Trajectory) -> Strategy:
    """A floating motion, and the base turned back within as much time again."""
    after, carried = turn_back(sms, plan.q[-1], plan.q[0, 3:7], plan.duration)
    return Strategy(plan, spent(sms, plan), after, carried)


def mode_numbers(found: dict[str, Strategy]) -> dict[str, dict[str, Any]]:
    """One row a strategy, every key of a quantity ending in its unit.

    `wheel_energy_J` is the integral of the sum of |motor torque x wheel speed|. `carried_m` is how far the
    end effector is carried off its target while the base is turned back with the arm locked.
    """
    numbers = {}
    for name, one in found.items():
        parts = [one.during] if one.after is None else [one.during, one.after]
        numbers[name] = {
            "reached": one.plan.reached,
            "wheel_momentum_max_Nms": max(float(np.abs(x.momentum).max(initial=0.0)) for x in parts),
            "wheel_momentum_final_Nms": float(np.abs(parts[-1].momentum[-1]).max(initial=0.0)),
            "wheel_torque_max_Nm": max(float(np.abs(x.torque).max(initial=0.0)) for x in parts),
            "wheel_energy_J": sum(x.energy for x in parts),
            "propellant_kg": sum(x.propellant for x in parts),
            "time_s": one.plan.duration + (0.0 if one.after is None else float(one.after.t[-1])),
            "rotation_max_deg": float(np.degrees(one.plan.base_rotation.max())),
            "rotation_at_arrival_deg": float(np.degrees(one.plan.base_rotation[-1])),
            "carried_m": one.carried,
            "cost_integral_s": one.plan.cost_integral,
            "joint_travel_rad": one.plan.joint_travel,
            "note": why_not_reached(one.plan) or one.plan.note,
        }
    return numbers
