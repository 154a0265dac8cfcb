"""The step: an inspectable programme, its solution, and every limit with and without its row."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
from typing import Any

import numpy as np
import pytest
from scipy.optimize import nnls

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.clearances import CollisionMode
from ffsms_pin.opt.cone import cone_direction, lateral_direction
from ffsms_pin.opt.marching import march
from ffsms_pin.opt.polish import ActiveRows
from ffsms_pin.opt.rate_bounds import rate_bounds
from ffsms_pin.opt.schedule import reference_speed
from ffsms_pin.opt.step_kinetics import step_kinetics
from ffsms_pin.opt.step_qp import StepProblem, StepSolver

TARGET = np.array([0.45, 0.75, 0.0])


def random_state(planar: ffsms.SpaceManipulator, seed: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    q = planar.configuration(rng.uniform(0.5 * planar.limits.lower, 0.5 * planar.limits.upper))
    return q, rng.uniform(-0.3, 0.3, planar.n)


def test_step_kinetics_are_those_of_the_state(planar: ffsms.SpaceManipulator) -> None:
    for seed in range(5):
        q, _ = random_state(planar, seed)
        fast, state = step_kinetics(planar, q), planar.at(q)
        np.testing.assert_allclose(fast.J_v, state.J_star[:3], atol=1e-13)
        np.testing.assert_allclose(fast.position, state.end_effector_pose.translation, atol=1e-13)
        assert fast.entropy == pytest.approx(state.coupling.entropy, abs=1e-12)
        # Columns of V up to sign.
        np.testing.assert_allclose(np.abs(fast.V.T @ state.coupling.V), np.eye(3), atol=1e-6)


def plain_programme(
    sms: ffsms.SpaceManipulator, q: FloatArray, rates: FloatArray, target: FloatArray, left: float
) -> StepProblem:
    """The matrices of docs/convex-step.md, term by term, in the basis V of the planner."""
    dt, w, n = 0.01, opt.StepWeights(), sms.n
    kinetics = step_kinetics(sms, q)
    V, A, velocity = kinetics.V, kinetics.J_v @ kinetics.V, kinetics.J_v @ rates
    way = target - kinetics.position
    distance = np.linalg.norm(way)
    towards = tuple((way / distance).tolist())
    cos_ideal = opt.ideal_cosine(kinetics.entropy, 10.0)
    e = np.array(cone_direction(towards, lateral_direction(towards, tuple(velocity.tolist())), cos_ideal))
    now = max(0.0, float(velocity @ e))
    gain = dt * float(np.abs(e @ kinetics.J_v) @ sms.limits.acceleration)
    speed = min(reference_speed(float(distance) / max(cos_ideal, 0.2), now, left, dt), now + gain)
    H, g = np.zeros((n + 2, n + 2)), np.zeros(n + 2)
    S = np.column_stack([A, -e, np.zeros(3)])
    H += w.direction * S.T @ S
    H[:n, :n] += w.effort * np.eye(n) + w.change * V.T @ V
    H[n, n] += w.speed
    H[n + 1, n + 1] += w.clearance
    g[:n], g[n], g[n + 1] = -w.change * V.T @ rates, -w.speed * speed, w.clearance
    points = opt.StepPlanner(sms).clearances
    assert points is not None
    value, gradient = points.evaluate(q)
    m = len(value)
    lower, upper = rate_bounds(sms.layout.positions(q), rates, sms.limits, dt)
    box = np.ones(n)
    if rates @ rates > 1.0:
        halfway = 0.5 * (np.clip(rates, lower, upper) + np.clip(0.0, lower, upper))
        box = np.maximum(1.0, np.abs(V.T @ halfway))
    return StepProblem(
        H=H,
        g=g,
        C=np.block([[V, np.zeros((n, 2))], [gradient @ V, np.zeros((m, 1)), np.ones((m, 1))]]),
        l=np.concatenate([lower, -2.0 * (value - 0.012)]),
        u=np.concatenate([upper, np.full(m, 1e20)]),
        lower=np.concatenate([-box, [0.0, 0.0]]),
        upper=np.concatenate([box, [1e20, 1e20]]),
    )


@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda"])
def test_the_built_programme_is_that_of_the_plain_formulas(name: str) -> None:
    """One planner for all states, fast ones among them: nothing of one is left in the next."""
    sms = ffsms.load(name)
    rng, planner = np.random.default_rng(7), opt.StepPlanner(sms)
    middle, half = 0.5 * (sms.limits.upper + sms.limits.lower), 0.5 * (sms.limits.upper - sms.limits.lower)
    for k in range(30):
        q = sms.configuration(middle + 0.9 * half * rng.uniform(-1.0, 1.0, sms.n))
        rates = (0.1, 0.9)[k % 2] * sms.limits.velocity * rng.uniform(-1.0, 1.0, sms.n)
        planner.reset()
        built, plain = planner.build(q, rates, TARGET, 6.0), plain_programme(sms, q, rates, TARGET, 6.0)
        for found, expected in zip(built, plain, strict=True):
            np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)


def test_the_built_programme_is_solved_to_its_optimality_conditions(planar: ffsms.SpaceManipulator) -> None:
    """Feasible, and the gradient is a non-negative combination of the active rows."""
    for seed in range(20):
        q, rates = random_state(planar, seed)
        problem = opt.StepPlanner(planar).build(q, rates, TARGET, 6.0)
        x, solved = StepSolver(problem.g.size, len(problem.l)).solve(problem)
        assert solved
        assert problem.violation(x) < 1e-8
        rows = np.vstack([problem.C, np.eye(x.size)])
        low, high = np.concatenate([problem.l, problem.lower]), np.concatenate([problem.u, problem.upper])
        active = np.vstack([rows[rows @ x > high - 1e-7], -rows[rows @ x < low + 1e-7]])
        gradient = problem.H @ x + problem.g
        residual = float(np.linalg.norm(gradient)) if active.size == 0 else nnls(active.T, -gradient)[1]
        assert residual < 1e-7

        step = opt.StepPlanner(planar).step(q, rates, TARGET, 6.0)
        assert step.solved
        V = step_kinetics(planar, q).V
        np.testing.assert_allclose(step.joint_rates, V @ x[:3], atol=1e-6)
        np.testing.assert_allclose(V @ step.alpha, step.joint_rates, atol=1e-12)


def test_the_cost_of_an_unhindered_step_is_zero(planar: ffsms.SpaceManipulator) -> None:
    q, rates, planner = planar.configuration([0.4, 0.7, -0.5]), np.zeros(3), opt.StepPlanner(planar)
    for k in range(50):  # speeding up, the acceleration limits have a say
        rates = planner.step(q, rates, TARGET, 12.0 - 0.01 * k).joint_rates
    step = planner.step(q, rates, TARGET, 11.5)
    assert step.cost < 1e-9
    assert step.cost == pytest.approx(opt.step_cost(step.cos_theta, step.entropy, 10.0))
    state = planar.at(q)
    towards = TARGET - state.end_effector_pose.translation
    assert step.cos_theta == pytest.approx(state.coupling.assistance(step.joint_rates, towards), abs=1e-9)
    assert step.entropy == pytest.approx(state.coupling.entropy, abs=1e-12)


def test_at_the_target_the_arm_stays(planar: ffsms.SpaceManipulator) -> None:
    q = planar.configuration([0.4, 0.7, -0.5])
    here = planar.at(q).end_effector_pose.translation
    step = opt.StepPlanner(planar).step(q, np.zeros(3), here, 1.0)
    np.testing.assert_allclose(step.joint_rates, 0.0, atol=1e-6)
    assert step.cos_theta == 0.0


def loosened(planar: ffsms.SpaceManipulator, **changes: FloatArray) -> ffsms.SpaceManipulator:
    return planar.with_limits(dataclasses.replace(planar.limits, **changes))


def extremes(trajectory: opt.Trajectory) -> dict[str, FloatArray]:
    return {
        "position": np.abs(trajectory.joint_positions).max(axis=0),
        "velocity": np.abs(trajectory.joint_rates).max(axis=0),
        "acceleration": np.abs(trajectory.joint_accelerations).max(axis=0),
    }


@pytest.mark.parametrize("limit", ["velocity", "acceleration", "position"])
def test_a_joint_limit_holds_with_its_rows_and_breaks_without(
    planar: ffsms.SpaceManipulator, limit: str
) -> None:
    infinite = np.full(3, np.inf)
    changes = {
        "velocity": {"velocity": infinite},
        "acceleration": {"acceleration": 100.0 * planar.limits.acceleration},
        "position": {"lower": -infinite, "upper": infinite},
    }[limit]
    bound = planar.limits.upper if limit == "position" else getattr(planar.limits, limit)
    start = planar.configuration(np.deg2rad([60.0, 30.0, -10.0]))
    target, duration = TARGET, 4.0
    if limit == "position":  # where the arm would be with its first joint 24 degrees beyond the limit
        beyond = planar.configuration(np.deg2rad([105.0, 30.0, -10.0]))
        target = planar.at(beyond).end_effector_pose.translation

    def worst(sms: ffsms.SpaceManipulator) -> FloatArray:
        planner = opt.StepPlanner(sms, collision="off")
        return extremes(march(planner, start, target, duration))[limit]

    assert (worst(planar) <= bound + 1e-9).all()
    assert (worst(loosened(planar, **changes)) > bound + 1e-3).any()


def test_the_base_box_is_kept_clear_with_its_rows_and_entered_without(
    planar: ffsms.SpaceManipulator,
) -> None:
    start = planar.configuration(np.deg2rad([75.0, 60.0, 20.0]))
    inside = planar.at(start).base_pose.act(np.array([0.1, 0.15, 0.0]))

    def least(collision: CollisionMode) -> float:
        planner = opt.StepPlanner(planar, collision=collision)
        trajectory = march(planner, start, inside, 6.0)
        points = opt.StepPlanner(planar).clearances
        assert points is not None
        return min(float(points.evaluate(q).value.min()) for q in trajectory.q)

    assert least(collision="points") >= 0.01
    assert least(collision="off") < 0.0


def test_alpha_stays_in_the_papers_box_where_rates_could_leave_it(planar: ffsms.SpaceManipulator) -> None:
    """With generous joint limits only |alpha_i| <= 1 is left to hold the rates."""
    fast = loosened(planar, velocity=np.full(3, 50.0), acceleration=np.full(3, 500.0))
    trajectory = march(opt.StepPlanner(fast), planar.configuration([0.4, 0.7, -0.5]), TARGET, 0.2)
    largest = np.abs(trajectory.alpha).max()
    assert 0.999 < largest <= 1.0 + 1e-6


def test_a_step_is_deterministic(planar: ffsms.SpaceManipulator) -> None:
    q, rates = random_state(planar, 3)
    first = opt.StepPlanner(planar).step(q, rates, TARGET, 5.0)
    second = opt.StepPlanner(planar).step(q, rates, TARGET, 5.0)
    assert np.array_equal(first.joint_rates, second.joint_rates)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"q": np.zeros(9)}, "q"),
        ({"q": np.zeros(10)}, "quaternion"),
        ({"joint_rates": [0.0, np.nan, 0.0]}, "joint_rates"),
        ({"target": [1.0, 2.0]}, "target"),
        ({"time_left": "soon"}, "time_left"),
    ],
)
def test_bad_arguments_are_named(
    planar: ffsms.SpaceManipulator, change: dict[str, object], name: str
) -> None:
    arguments: dict[str, Any] = {"q": planar.configuration([0, 0, 0]), "joint_rates": np.zeros(3)}
    arguments |= {"target": TARGET, "time_left": 1.0} | change
    with pytest.raises(InvalidValue, match=name):
        opt.StepPlanner(planar).step(**arguments)


def test_defaults_are_the_documented_ones() -> None:
    signature = inspect.signature(opt.StepPlanner)
    assert signature.parameters["dt"].default == 0.01
    assert signature.parameters["kappa"].default == 10.0


# -- the rows of the step before -----------------------------------------------------------------------


def test_steps_that_start_from_the_last_rows_are_those_of_a_fresh_planner() -> None:
    """So are those of ProxQP, which is given the whole programme at every step."""
    planar = ffsms.load("planar_3r")
    start = planar.configuration(np.deg2rad([60.0, 30.0, -10.0]))
    beyond = planar.configuration(np.deg2rad([105.0, 30.0, -10.0]))
    target = planar.at(beyond).end_effector_pose.translation  # into a joint limit
    planner = opt.StepPlanner(planar)
    trajectory = march(planner, start, target, 4.0)
    planner.reset()
    asked, changed, n = 0, 0, planar.n
    for k in range(len(trajectory.t) - 1):
        arguments = (trajectory.q[k], trajectory.joint_rates[k], target, 4.0 - trajectory.t[k])
        fresh, built = opt.StepPlanner(planar), opt.StepPlanner(planar)
        fresh.reset(planner.side)
        built.reset(planner.side)
        step = planner.step(*arguments)
        asked += planner.asked_solver
        problem = built.build(*arguments)
        solver = StepSolver(problem.g.size, len(problem.l))
        x, solved = solver.solve(problem)
        assert solved
        assert solver.asked
        V = step_kinetics(planar, trajectory.q[k]).V
        np.testing.assert_allclose(step.joint_rates, V @ x[:n], rtol=0.0, atol=1e-9)
        expected = fresh.step(*arguments)
        np.testing.assert_allclose(step.joint_rates, expected.joint_rates, rtol=0.0, atol=1e-9)
        changed += not np.array_equal(step.joint_rates, expected.joint_rates)
    assert asked < 0.2 * len(trajectory.t)
    assert changed == 0


def random_programme(rng: np.random.Generator, n: int, rows: int) -> StepProblem:
    B, C = rng.normal(size=(n, n)), rng.normal(size=(rows, n))
    inside = C @ rng.uniform(-0.9, 0.9, n)  # of all rows: the programme has a solution
    return StepProblem(
        H=B @ B.T + 0.1 * np.eye(n),
        g=3.0 * rng.normal(size=n),
        C=C,
        l=inside - rng.uniform(0.05, 1.0, rows),
        u=inside + rng.uniform(0.05, 1.0, rows),
        lower=np.full(n, -1.0),
        upper=np.ones(n),
    )


def optimality_gap(problem: StepProblem, x: FloatArray) -> float:
    """How far the gradient at a feasible x is from a combination of the active rows with the right signs."""
    rows = np.vstack([problem.C, np.eye(x.size)])
    low, high = np.concatenate([problem.l, problem.lower]), np.concatenate([problem.u, problem.upper])
    active = np.vstack([rows[rows @ x > high - 1e-9], -rows[rows @ x < low + 1e-9]])
    gradient = problem.H @ x + problem.g
    return float(np.linalg.norm(gradient)) if active.size == 0 else float(nnls(active.T, -gradient)[1])


def test_random_programmes_one_after_the_other_are_solved_to_the_last_digits() -> None:
    """Unrelated problems: the last one's rows are of no use, and must do no harm."""
    rng, solver, by_rows = np.random.default_rng(5), StepSolver(5, 8), 0
    for _ in range(200):
        problem = random_programme(rng, 5, 8)
        x, solved = solver.solve(problem)
        assert solved
        assert problem.violation(x) < 1e-12
        assert optimality_gap(problem, x) < 1e-10
        by_rows += not solver.asked
    assert by_rows > 0


def test_only_the_right_rows_are_taken_for_the_solution() -> None:
    """min |x - (2, 0.5)|^2 / 2 on |x_i| <= 1: x_1 at its upper bound, x_2 free."""
    rows = ActiveRows(2, 2)
    rows.matrix[:2] = np.eye(2)
    rows.vector[:] = [-2.0, -0.5, -1.0, -1.0, 1.0, 1.0]
    for sides in ([0, 0], [1, 0], [-1, 0], [1, 1], [1, -1]):
        rows.choose(np.array(sides, dtype=np.int8))
        x, certain = rows.solve(0, 0)
        assert certain is (sides == [1, 0])
        if certain:
            np.testing.assert_allclose(x, [1.0, 0.5], rtol=0.0, atol=1e-15)
        # From any of them the right ones are found, all at once or one by one.
        for blocks, singles in ((3, 0), (0, 4)):
            rows.choose(np.array(sides, dtype=np.int8))
            assert rows.solve(blocks, singles)[1]
    rows.vector[:2] = np.nan
    assert not rows.solve(2, 2)[1]


# -- what other parts of the library use ---------------------------------------------------------------


def test_preferred_rates_are_taken_as_far_as_the_limits_allow(planar: ffsms.SpaceManipulator) -> None:
    q, rates = random_state(planar, 3)
    planner = opt.StepPlanner(planar, collision="off")
    lower, upper = rate_bounds(planar.layout.positions(q), rates, planar.limits, planner.dt)
    inside = 0.3 * lower + 0.7 * upper
    step = planner.advance(q, rates, TARGET, 5.0, prefer=inside)
    np.testing.assert_allclose(step.joint_rates, inside, rtol=0.0, atol=1e-9)
    outside = np.array([5.0, -5.0, inside[2]])
    step = planner.advance(q, rates, TARGET, 5.0, prefer=outside)
    np.testing.assert_allclose(step.joint_rates, np.clip(outside, lower, upper), rtol=0.0, atol=1e-9)
    # The step's own aim is back in the next one.
    assert np.array_equal(
        planner.step(q, rates, TARGET, 5.0).joint_rates,
        opt.StepPlanner(planar, collision="off").step(q, rates, TARGET, 5.0).joint_rates,
    )


def test_a_planner_like_another_keeps_its_settings(planar: ffsms.SpaceManipulator) -> None:
    weights = opt.StepWeights(change=1e-4)
    planner = opt.StepPlanner(planar, 0.02, 5.0, 0.02, "off", weights, "resolved-rate", momentum=np.ones(6))
    same, other = planner.like(), planner.like(dt=0.1, aim="step")
    for made in (same, other):
        assert (made.sms, made.kappa, made.clearance) == (planar, 5.0, 0.02)
        assert (made.collision, made.weights) == ("off", weights)
        assert made.momentum is not None
        assert made.momentum.tolist() == [1.0] * 6
    assert (same.dt, same.aim, other.dt, other.aim) == (0.02, "resolved-rate", 0.1, "step")


def test_another_step_length_is_that_of_another_planner(planar: ffsms.SpaceManipulator) -> None:
    q, rates = random_state(planar, 2)
    planner = opt.StepPlanner(planar, 0.01)
    planner.dt = 0.05
    expected = opt.StepPlanner(planar, 0.05).step(q, rates, TARGET, 5.0)
    assert np.array_equal(planner.step(q, rates, TARGET, 5.0).joint_rates, expected.joint_rates)


def test_a_copied_planner_goes_on_as_the_first(planar: ffsms.SpaceManipulator) -> None:
    q, rates = random_state(planar, 3)
    planner = opt.StepPlanner(planar)
    planner.reset([0.0, -1.0, 0.0])
    planner.step(q, rates, TARGET, 5.0)
    copies = [copy.deepcopy(planner), pickle.loads(pickle.dumps(planner))]
    other, later = random_state(planar, 4)
    expected = planner.step(other, later, TARGET, 4.0)
    for made in copies:
        assert np.array_equal(made.step(other, later, TARGET, 4.0).joint_rates, expected.joint_rates)
        built = zip(made.build(q, rates, TARGET, 5.0), planner.build(q, rates, TARGET, 5.0), strict=True)
        assert all(np.array_equal(a, b) for a, b in built)


def test_arguments_of_any_kind_give_the_same_step(planar: ffsms.SpaceManipulator) -> None:
    q, rates = random_state(planar, 3)
    expected = opt.StepPlanner(planar).step(q, rates, TARGET, 5.0).joint_rates
    strided = np.zeros((planar.n, 2))
    strided[:, 0] = rates
    for arguments in (
        (q.tolist(), rates.tolist(), TARGET.tolist(), 5),
        (q, strided[:, 0], TARGET, np.float64(5.0)),
    ):
        found = opt.StepPlanner(planar).step(*arguments).joint_rates
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)
