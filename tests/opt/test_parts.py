"""Plans and steps with and without each term and limit, packaged and custom (`own_parts`).

Their derivatives are checked in `test_part_slopes.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from motions import HASTY
from part_cases import (
    GOAL,
    LIMITS,
    MODES,
    POINT,
    STEPPED,
    TERMS,
    limited_quantities,
    problem_of,
    rates_of_step_rollout,
    rollout_of,
)

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.base_limits import BaseLimits
from ffsms_pin.opt.step.stepper import Stepper
from ffsms_pin.opt.trajectory import measure

Free = Callable[[str], opt.Trajectory]
StepRates = Callable[[str], FloatArray]


@pytest.fixture(scope="module")
def free(planar: ffsms.SpaceManipulator) -> Free:
    """The plans with joint limits alone, by the mode of a part."""
    cache: dict[str, opt.Trajectory] = {}

    def plan(part: str) -> opt.Trajectory:
        mode = MODES.get(part, "floating")
        if mode not in cache:
            cache[mode] = opt.solve(problem_of(planar, part))
        return cache[mode]

    return plan


@pytest.fixture(scope="module")
def plan_stepwise(planar: ffsms.SpaceManipulator) -> StepRates:
    """The joint rates of rollouts with joint limits alone, by the mode of a part."""
    cache: dict[str, FloatArray] = {}

    def rates(part: str) -> FloatArray:
        mode = MODES.get(part, "floating")
        if mode not in cache:
            cache[mode] = rates_of_step_rollout(problem_of(planar, part))
        return cache[mode]

    return rates


@pytest.mark.parametrize("name", list(TERMS))
def test_a_term_lowers_its_share(name: str, planar: ffsms.SpaceManipulator, free: Free) -> None:
    term = TERMS[name]
    plain: list[opt.Term] = [opt.Smooth(), opt.Effort()]
    if isinstance(term, (opt.Coupling, opt.Effort)):  # included in the default terms
        plain = [other for other in (*plain, opt.Coupling()) if other.name != term.name]
        without = opt.solve(problem_of(planar, terms=plain))
        share = replace(measure(problem_of(planar, terms=[term]), without.joint_rates)).shares[term.name]
    else:
        plain.append(opt.Coupling())
        share = term.share(rollout_of(problem_of(planar, name), free(name).joint_rates))
    terms = [other for other in plain if other.name != term.name] + [term]
    plan = opt.solve(problem_of(planar, name, terms=terms))
    assert plan.reached
    assert plan.shares.keys() == {other.name for other in terms}
    assert plan.shares[term.name] < 0.9 * share


@pytest.mark.parametrize("name", list(TERMS))
def test_shares_agree_with_the_arrays_of_the_trajectory(
    name: str, planar: ffsms.SpaceManipulator, free: Free
) -> None:
    term, T = TERMS[name], 6.0
    if isinstance(term, (opt.WheelEnergy, opt.Propellant)):
        term = replace(term, rounding=1e-7)
    plan = measure(problem_of(planar, name, terms=[term]), free(name).joint_rates)
    rates, accelerations = plan.joint_rates, plan.joint_accelerations
    middles = 0.5 * (rates[1:] + rates[:-1])
    spins = np.sum(plan.v[:, 3:6] ** 2, axis=1)
    alignments = []
    for q in plan.q:
        pose = planar.at(q).end_effector_pose
        displacement = np.array(POINT) - pose.translation
        alignments.append(1.0 - pose.rotation[:, 0] @ displacement / np.linalg.norm(displacement))
    expected = {
        "coupling": plan.cost_integral,
        "soft coupling": 2.0 * plan.cost_integral,
        "smooth": (T / 8.0) ** 4 * np.sum(accelerations**2) * plan.dt,
        "effort": 0.01
        * (T / 8.0) ** 2
        * np.sum(rates[1:] ** 2 + rates[:-1] ** 2 + 4.0 * middles**2)
        * plan.dt
        / 6.0,
        "base turn": 32.0 * 100.0 * (T / 8.0) ** 2 * np.trapezoid(spins, plan.t),
        "own": 10.0 * np.trapezoid(alignments, plan.t),
        "wheel momentum": 3.0 * (T / 8.0) ** 2 * np.trapezoid(np.sum(plan.wheel_momentum**2, axis=1), plan.t),
        "wheel energy": 3.0 * (T / 8.0) ** 3 * plan.wheel_energy,
        **dict.fromkeys(
            [name for name in TERMS if "propellant" in name],
            3.0 * (T / 8.0) ** 2 * 1e3 * plan.propellant,
        ),
    }[name]
    assert plan.shares[term.name] == pytest.approx(expected, rel=2e-2 if name == "smooth" else 5e-3)


@pytest.mark.parametrize("name", list(LIMITS))
def test_plans_keep_a_limit_that_free_plans_violate(
    name: str, planar: ffsms.SpaceManipulator, free: Free
) -> None:
    problem, unconstrained = problem_of(planar, name), free(name)
    sms, limit = LIMITS[name](planar, limited_quantities(problem, unconstrained.joint_rates))
    limits = [limit] if name == "joints" else [opt.JointLimits(), limit]
    limited = problem_of(sms, name, limits=limits)
    without = measure(limited, unconstrained.joint_rates)
    assert not without.reached
    assert not without.clear
    assert without.broken.keys() == {limit.name}
    assert without.note
    plan = opt.solve(limited, HASTY)
    assert plan.reached, plan.note
    assert plan.broken == {}
    assert (plan.note == "") == plan.within_tolerance
    # The limit is active, or the plan avoids it.
    instants = plan.binding.get(limit.name, np.empty(0))
    assert ((instants >= 0.0) & (instants <= 6.0)).all()


@pytest.mark.parametrize("name", STEPPED)
def test_rollouts_keep_a_limit_that_free_rollouts_violate(
    name: str, planar: ffsms.SpaceManipulator, plan_stepwise: StepRates
) -> None:
    problem, unconstrained = problem_of(planar, name), plan_stepwise(name)
    sms, limit = LIMITS[name](planar, limited_quantities(problem, unconstrained))
    limits = [limit] if name == "joints" else [opt.JointLimits(), limit]
    limited = problem_of(sms, name, limits=limits)
    assert measure(limited, unconstrained).broken.keys() == {limit.name}
    rates = rates_of_step_rollout(limited)
    plan = measure(limited, rates)
    assert plan.broken == {}, plan.note
    # The arm moves.
    assert np.abs(rates).max() > 0.02


@pytest.mark.parametrize("name", STEPPED)
def test_steps_at_rest_within_a_limit_may_stay_at_rest(name: str, planar: ffsms.SpaceManipulator) -> None:
    """Rows at the start of a motion allow zero rates."""
    problem = problem_of(planar, name)
    moving_rates = np.tile([0.05, -0.04, 0.06], (problem.steps + 1, 1))
    sms, limit = LIMITS[name](planar, limited_quantities(problem, moving_rates))
    stepper = Stepper(sms, 0.02, 10.0, [limit], mode=problem.mode)
    built = stepper.build(problem.q0, np.zeros(3), GOAL, 6.0)
    still = np.zeros(len(built.g))
    assert built.violation(still) <= 1e-12
    assert len(built.l) >= 1


def test_no_two_packaged_parts_share_a_name() -> None:
    parts: list[type[opt.Term]] = [opt.Coupling, opt.Smooth, opt.Effort, opt.BaseTurn]
    parts += [opt.WheelMomentum, opt.WheelEnergy, opt.Propellant]
    limits: list[type[opt.Limit]] = [opt.JointLimits, opt.Clearance, BaseLimits, opt.AlphaBox]
    limits += [opt.WheelLimits, opt.TorqueLimits, opt.Corridor]
    names = [part.name for part in parts] + [limit.name for limit in limits]
    assert len(set(names)) == len(names)
