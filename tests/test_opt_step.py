"""The step: an inspectable programme, its solution, and every limit with and without its row."""

from __future__ import annotations

import dataclasses
import inspect
from typing import Any

import numpy as np
import pytest
from scipy.optimize import nnls

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.clearances import CollisionMode
from ffsms_pin.opt.marching import march
from ffsms_pin.opt.step_kinetics import step_kinetics
from ffsms_pin.opt.step_qp import StepSolver

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
    free = ffsms.SpaceManipulator(planar.model, "end_effector", planar.base_size)
    free.limits = dataclasses.replace(planar.limits, **changes)
    return free


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
