"""What every term and every limit has to pass, the packaged ones and two of one's own (`own_parts`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from horizon_parts import COARSE, node_rates, spline_of
from part_cases import (
    GOAL,
    LIMITS,
    MODES,
    POINT,
    ROBOTS,
    TERMS,
    Tight,
    aside,
    elbow_aside,
    finished,
    problem_of,
    use_of,
)
from slopes import by_differences, by_slopes, motions

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.motions import Motions, Smoothing
from ffsms_pin.opt.batch.residual import Residuals
from ffsms_pin.opt.limits.base import BaseLimits
from ffsms_pin.opt.step.march import march
from ffsms_pin.opt.step.of_problem import problem_stepper
from ffsms_pin.opt.step.stepper import Stepper
from ffsms_pin.opt.trajectory import measure

SPOTS = ("via", "via at any time", "also")
# A step does not know whether a place was passed already.
STEPPED = [name for name in LIMITS if name != "via at any time"]
# Those that whole motions see as residuals, and robots; the distances of many meshes would take minutes.
PENALISED = [
    (name, robot)
    for name in LIMITS
    if name != "joints"
    for robot in ROBOTS
    if (name, robot) != ("shapes", ROBOTS[1])
]


def size_of(residuals: Residuals) -> float:
    """The largest residual; zero where there is none."""
    return max((float(np.abs(one.value).max(initial=0.0)) for one in residuals), default=0.0)


Free = Callable[[str], opt.Trajectory]
Marched = Callable[[str], FloatArray]


@pytest.fixture(scope="module")
def free(planar: ffsms.SpaceManipulator) -> Free:
    """The plan that nothing but its joints limits, in the mode of a part."""
    found: dict[str, opt.Trajectory] = {}

    def plan(part: str) -> opt.Trajectory:
        mode = MODES.get(part, "floating")
        if mode not in found:
            found[mode] = opt.solve(problem_of(planar, part))
        return found[mode]

    return plan


@pytest.fixture(scope="module")
def marched(planar: ffsms.SpaceManipulator) -> Marched:
    """Joint rates of a march that nothing but its joints limits, in the mode of a part."""
    found: dict[str, FloatArray] = {}

    def rates(part: str) -> FloatArray:
        mode = MODES.get(part, "floating")
        if mode not in found:
            found[mode] = rates_of_march(problem_of(planar, part))
        return found[mode]

    return rates


def rates_of_march(problem: opt.Problem) -> FloatArray:
    stepper = problem_stepper(problem, terms=())
    return march(stepper, problem.q0, problem.joint_rates, GOAL, problem.duration).rates


# -- slopes --------------------------------------------------------------------------------------------


def check_slopes(
    problem: opt.Problem, residual_of: Callable[[Motions], Residuals], rng: np.random.Generator
) -> Residuals:
    """By control points: the chain rule of the library against central differences."""
    spline = spline_of(problem, COARSE, free_end=True)
    p = 0.15 * rng.normal(size=(1, spline.size, problem.sms.n))
    residuals = residual_of(motions(problem, spline, p))
    slopes = by_slopes(problem, spline, p, residuals)
    differences = by_differences(problem, spline, p, residual_of)
    size = float(np.abs(differences).max())
    assert size > 1e-4
    # In space the turn of the base follows by a quadrature of its own, which leaves something out.
    tolerance = 1e-5 if problem.sms.n == 3 else 2e-3
    np.testing.assert_allclose(slopes, differences, rtol=0.0, atol=tolerance * max(size, 1e-2))
    return residuals


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("name", list(TERMS))
def test_slopes_of_terms(name: str, robot: str, rng: np.random.Generator) -> None:
    check_slopes(problem_of(ffsms.load(robot), name), TERMS[name].residual, rng)


@pytest.mark.parametrize("smoothing", [Smoothing(0.3, 0.03), Smoothing(0.03, 0.002)])
def test_slopes_of_the_smoothed_cost(
    planar: ffsms.SpaceManipulator, smoothing: Smoothing, rng: np.random.Generator
) -> None:
    term = opt.Coupling(4.0)
    check_slopes(problem_of(planar), lambda at: term.residual(replace(at, smoothing=smoothing)), rng)


@pytest.mark.parametrize(("name", "robot"), PENALISED)
def test_slopes_of_limits(name: str, robot: str, rng: np.random.Generator) -> None:
    """Of what a motion uses beyond the limit; the joints have rows of their own instead."""
    sms = ffsms.load(robot)
    problem = problem_of(sms, name)
    spline = spline_of(problem, COARSE, free_end=True)
    p = 0.15 * np.random.default_rng(20250705).normal(size=(1, spline.size, sms.n))
    tight, limit = LIMITS[name](sms, use_of(problem, node_rates(problem, spline, p[0])))
    problem, limit = replace(problem, sms=tight), limit.for_robot(tight)
    residuals = check_slopes(problem, limit.residual, rng)
    assert size_of(residuals) > limit.margin


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("made", [aside(True, turned=True), elbow_aside(turned=True)], ids=["via", "also"])
def test_slopes_of_places_with_an_attitude(made: Tight, robot: str, rng: np.random.Generator) -> None:
    sms = ffsms.load(robot)
    problem = problem_of(sms)
    spline = spline_of(problem, COARSE, free_end=True)
    p = 0.15 * np.random.default_rng(20250705).normal(size=(1, spline.size, sms.n))
    _, limit = made(sms, use_of(problem, node_rates(problem, spline, p[0])))
    check_slopes(problem, limit.for_robot(sms).residual, rng)


# -- with and without ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(TERMS))
def test_a_term_is_smaller_with_it_than_without(
    name: str, planar: ffsms.SpaceManipulator, free: Free
) -> None:
    term = TERMS[name]
    plain: list[opt.Term] = [opt.Smooth(), opt.Effort()]
    if isinstance(term, opt.Coupling):
        without = opt.solve(problem_of(planar, terms=plain))
        share = replace(measure(problem_of(planar, terms=[term]), without.joint_rates)).shares[term.name]
    else:
        plain.append(opt.Coupling())
        share = term.share(finished(problem_of(planar, name), free(name).joint_rates))
    terms = [one for one in plain if one.name != term.name] + [term]
    plan = opt.solve(problem_of(planar, name, terms=terms))
    assert plan.reached
    assert plan.shares.keys() == {one.name for one in terms}
    # The plan without it spares the joints already: its default decides between motions of like cost.
    assert plan.shares[term.name] < (0.98 if name == "effort" else 0.9) * share


@pytest.mark.parametrize("name", list(TERMS))
def test_shares_are_integrals_of_squares(name: str, planar: ffsms.SpaceManipulator, free: Free) -> None:
    """Worked out from the trajectory's own arrays."""
    term, T = TERMS[name], 6.0
    if isinstance(term, (opt.WheelEnergy, opt.Propellant)):
        term = replace(term, rounding=1e-7)
    plan = measure(problem_of(planar, name, terms=[term]), free(name).joint_rates)
    rates, accelerations = plan.joint_rates, plan.joint_accelerations
    middles = 0.5 * (rates[1:] + rates[:-1])
    spins = np.sum(plan.v[:, 3:6] ** 2, axis=1)
    looks = []
    for q in plan.q:
        pose = planar.at(q).end_effector_pose
        way = np.array(POINT) - pose.translation
        looks.append(1.0 - pose.rotation[:, 0] @ way / np.linalg.norm(way))
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
        "own": 10.0 * np.trapezoid(looks, plan.t),
        "wheel momentum": 3.0 * (T / 8.0) ** 2 * np.trapezoid(np.sum(plan.wheel_momentum**2, axis=1), plan.t),
        "wheel energy": 3.0 * (T / 8.0) ** 3 * plan.wheel_energy,
        **dict.fromkeys(
            [name for name in TERMS if "propellant" in name],
            3.0 * (T / 8.0) ** 2 * 1e3 * plan.propellant,
        ),
    }[name]
    assert plan.shares[term.name] == pytest.approx(expected, rel=2e-2 if name == "smooth" else 5e-3)


@pytest.mark.parametrize("name", list(LIMITS))
def test_plans_keep_a_limit_and_break_it_without(
    name: str, planar: ffsms.SpaceManipulator, free: Free
) -> None:
    problem, usual = problem_of(planar, name), free(name)
    sms, limit = LIMITS[name](planar, use_of(problem, usual.joint_rates))
    limits = [limit] if name == "joints" else [opt.JointLimits(), limit]
    held = problem_of(sms, name, limits=limits)
    without = measure(held, usual.joint_rates)
    assert not without.reached
    assert not without.clear
    assert without.broken.keys() == {limit.name}
    assert without.note
    plan = opt.solve(held)
    assert plan.reached, plan.note
    assert plan.broken == {}
    assert plan.note == ""
    # It is used nearly up, or binds nowhere because the way led round it.
    instants = plan.binding.get(limit.name, np.empty(0))
    assert ((instants >= 0.0) & (instants <= 6.0)).all()


@pytest.mark.parametrize("name", STEPPED)
def test_marches_keep_a_limit_and_break_it_without(
    name: str, planar: ffsms.SpaceManipulator, marched: Marched
) -> None:
    problem, usual = problem_of(planar, name), marched(name)
    sms, limit = LIMITS[name](planar, use_of(problem, usual))
    limits = [limit] if name == "joints" else [opt.JointLimits(), limit]
    held = problem_of(sms, name, limits=limits)
    assert measure(held, usual).broken.keys() == {limit.name}
    rates = rates_of_march(held)
    plan = measure(held, rates)
    assert plan.broken == {}, plan.note
    # The arm goes as far as it may: it does not just stay.
    assert np.abs(rates).max() > 0.02


# -- violation, residual and rows ----------------------------------------------------------------------


@pytest.mark.parametrize(("name", "robot"), PENALISED)
def test_violation_agrees_with_the_residual(name: str, robot: str) -> None:
    """A motion without residual breaks nothing; one that breaks the limit has more than the margin."""
    sms = ffsms.load(robot)
    problem = problem_of(sms, name, joint_rates=None)
    spline, rng = spline_of(problem, COARSE), np.random.default_rng(7)
    # All joints one way: so the planar arm folds towards its base.
    p = 0.15 * (1.0 + 0.3 * rng.normal(size=(spline.size, sms.n)))
    tight, limit = LIMITS[name](sms, use_of(problem, node_rates(problem, spline, p)))
    problem, limit = replace(problem, sms=tight), limit.for_robot(tight)
    seen = {"kept": 0, "broken": 0}
    for share in (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0, 1.1, 1.3):
        motion = finished(problem, node_rates(problem, spline, share * p))
        size, violation = size_of(limit.residual(motion)), limit.violation(motion)
        assert size >= 0.0
        assert (violation.amount > 0.0) == bool(violation.note)
        assert ((violation.instants >= 0.0) & (violation.instants <= problem.duration)).all()
        if violation.amount > 0.0:
            seen["broken"] += 1
            assert size > 0.9 * limit.margin
            assert violation.instants.size
        if size == 0.0:
            seen["kept"] += 1
            assert violation.amount == 0.0
        if size > 1.1 * limit.margin:
            assert violation.amount > 0.0
    # The spatial arm starts with less room than the folded planar one; a place aside is kept by none.
    assert seen["kept"] >= (1 if robot == ROBOTS[0] and name not in SPOTS else 0)
    assert seen["broken"] >= 1


@pytest.mark.parametrize("name", STEPPED)
def test_steps_at_rest_within_a_limit_may_stay_at_rest(name: str, planar: ffsms.SpaceManipulator) -> None:
    """Rows of a motion's start, where nothing is used up, allow zero rates."""
    problem = problem_of(planar, name)
    moved = np.tile([0.05, -0.04, 0.06], (problem.steps + 1, 1))
    sms, limit = LIMITS[name](planar, use_of(problem, moved))
    stepper = Stepper(sms, 0.02, 10.0, [limit], mode=problem.mode)
    built = stepper.build(problem.q0, np.zeros(3), GOAL, 6.0)
    still = np.zeros(len(built.g))
    assert built.violation(still) <= 1e-12
    assert len(built.l) >= 1


@pytest.fixture(scope="module")
def fast(planar: ffsms.SpaceManipulator) -> ffsms.SpaceManipulator:
    """An arm whose joints may turn faster than the paper's box lets them."""
    limits = replace(planar.limits, velocity=np.full(3, 3.0), acceleration=np.full(3, 6.0))
    return planar.with_limits(limits)


def test_the_papers_box_in_marches(fast: ffsms.SpaceManipulator) -> None:
    goal, largest = np.array([0.3, -0.8, 0.0]), {}
    for box in (False, True):
        limits: list[opt.Limit] = [opt.JointLimits(), opt.AlphaBox()][: 1 + box]
        problem = problem_of(fast, goal=goal, duration=2.0, limits=limits)
        rates = march(Stepper(fast, 0.02, 10.0, limits), problem.q0, np.zeros(3), goal, 2.0).rates
        plan = measure(replace(problem, limits=[opt.JointLimits(), opt.AlphaBox()]), rates)
        largest[box] = plan.largest_alpha
        assert plan.broken.get("alpha box", 0.0) == pytest.approx(max(0.0, largest[box] - 1.0), abs=1e-9)
    assert largest[False] > 1.2
    assert largest[True] <= 1.0 + 1e-9


def test_the_papers_box_in_whole_motions(fast: ffsms.SpaceManipulator, rng: np.random.Generator) -> None:
    problem = problem_of(fast, duration=2.0)
    spline, box = spline_of(problem, COARSE, free_end=True), opt.AlphaBox()
    p = 1.5 * rng.normal(size=(1, spline.size, 3))
    residuals = box.residual(motions(problem, spline, p))
    assert size_of(residuals) > 0.1
    slopes = by_slopes(problem, spline, p, residuals)
    differences = by_differences(problem, spline, p, box.residual)
    np.testing.assert_allclose(slopes, differences, rtol=0.0, atol=1e-5 * np.abs(differences).max())
    # A motion without residual breaks nothing.
    for share in (0.0, 0.3, 0.6, 1.0):
        motion = finished(problem, node_rates(problem, spline, share * p[0]))
        if size_of(box.residual(motion)) == 0.0:
            assert box.violation(motion).amount == 0.0
        if box.violation(motion).amount > 0.1:
            assert size_of(box.residual(motion)) > box.margin


# -- names ---------------------------------------------------------------------------------------------


def test_no_two_packaged_parts_share_a_name() -> None:
    parts: list[type[opt.Term]] = [opt.Coupling, opt.Smooth, opt.Effort, opt.BaseTurn]
    parts += [opt.WheelMomentum, opt.WheelEnergy, opt.Propellant]
    limits: list[type[opt.Limit]] = [opt.JointLimits, opt.Clearance, BaseLimits, opt.AlphaBox]
    limits.append(opt.WheelLimits)
    names = [part.name for part in parts] + [limit.name for limit in limits]
    assert len(set(names)) == len(names)
