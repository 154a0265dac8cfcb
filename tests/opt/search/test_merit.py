"""The merit of whole motions: its gradient, its Hessian, and shares of goal and limits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from horizon_parts import moving_problem, node_rates, planar_problem, spline_of, trajectory_of

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.derivatives import Variables
from ffsms_pin.opt.search.control_qp import ControlQP
from ffsms_pin.opt.search.gauss_newton import Candidates, Model, Weights, linearise, motions_of
from ffsms_pin.opt.search.spline import Grid, RateSpline

SOFT = Weights(1e2, 10.0, 1.0, 0.3, 0.03)
STRAIGHT_STAGE = Weights(1.0, 1e3, 10.0)


def model_of(problem: opt.Problem, spline: RateSpline) -> Model:
    return Model(problem, problem.goal, spline, ControlQP(problem, spline))


def check_gradient(
    problem: opt.Problem, spline: RateSpline, p: FloatArray, weights: Weights, rng: np.random.Generator
) -> Candidates:
    """Check the gradient against finite differences of the merit at a dozen control points."""
    model, h = model_of(problem, spline), 1e-6
    candidates = linearise(model, p, weights)
    for index in rng.choice(p.size, 12, replace=False):
        step = np.zeros(p.size)
        step[index] = h
        ahead, behind = (
            linearise(model, p + sign * step.reshape(p.shape), weights, below=-np.inf) for sign in (1.0, -1.0)
        )
        slope = float(ahead.merit[0] - behind.merit[0]) / (2.0 * h)
        assert 2.0 * candidates.gradient[0, index] == pytest.approx(slope, rel=1e-5, abs=1e-6)
    return candidates


@pytest.mark.parametrize("with_attitude", [False, True])
@pytest.mark.parametrize("weights", [SOFT, STRAIGHT_STAGE])
def test_gradient_and_hessian_of_the_merit(
    planar: ffsms.SpaceManipulator, weights: Weights, with_attitude: bool, rng: np.random.Generator
) -> None:
    """All terms are included; the clearance is so wide that many rows are active."""
    goal: Any = np.array([0.7, 0.5, 0.0])
    if with_attitude:
        goal = pin.SE3(pin.utils.rotate("z", 1.3), goal)
    terms = [opt.Coupling(4.0), opt.Smooth(1e-3), opt.Effort(1e-3), opt.BaseTurn(1.0)]
    limits = [opt.JointLimits(), opt.Clearance(0.35)]
    problem = planar_problem(planar, goal=goal, terms=terms, limits=limits)
    spline = spline_of(problem)
    p = rng.uniform(-0.15, 0.15, (1, spline.size, 3))
    candidates = check_gradient(problem, spline, p, weights, rng)
    assert candidates.limit_share[0] > 5.0  # in margins
    # A candidate above `below` has no derivatives; the other candidate keeps its own.
    both = np.concatenate([1.1 * p, p])
    pair = linearise(model_of(problem, spline), both, weights, below=np.array([0.0, np.inf]))
    assert not pair.hessian[0].any()
    np.testing.assert_allclose(pair.hessian[1], candidates.hessian[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(pair.gradient[1], candidates.gradient[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(candidates.hessian[0], candidates.hessian[0].T, rtol=1e-10, atol=1e-12)
    assert np.linalg.eigvalsh(candidates.hessian[0])[0] > -1e-9


def test_gradient_with_moving_joints_a_moving_goal_and_a_twist(
    planar: ffsms.SpaceManipulator, rng: np.random.Generator
) -> None:
    def path(t: float) -> Any:
        return pin.SE3(pin.utils.rotate("z", 0.3 * t), np.array([0.7 - 0.02 * t, 0.5 + 0.01 * t, 0.0]))

    pose = pin.SE3(pin.utils.rotate("z", 1.3), np.array([0.7, 0.5, 0.0]))
    for goal in (opt.Moving(path), opt.Pose(pose, twist=[0.02, 0.01, 0.0, 0.0, 0.0, 0.1])):
        problem = moving_problem(planar, goal=goal)
        spline = spline_of(problem, free_end=True)
        p = rng.uniform(-0.15, 0.15, (1, spline.size, 3))
        check_gradient(problem, spline, p, SOFT, rng)


def test_candidates_do_not_depend_on_others_in_the_stack(
    planar: ffsms.SpaceManipulator, rng: np.random.Generator
) -> None:
    problem = planar_problem(planar)
    spline = spline_of(problem)
    p = rng.uniform(-0.15, 0.15, (3, spline.size, 3))
    stacked = linearise(model_of(problem, spline), p, SOFT)
    for i in range(3):
        single = linearise(model_of(problem, spline), p[[i]], SOFT)
        selected = stacked.take([i])
        for name in (
            "merit",
            "objective",
            "end_share",
            "late_share",
            "limit_share",
            "gradient",
            "hessian",
        ):
            np.testing.assert_allclose(
                getattr(selected, name), getattr(single, name), rtol=1e-9, atol=1e-12, err_msg=name
            )
    joined = stacked.take([0, 1]).join(stacked.take([2]))
    np.testing.assert_array_equal(joined.hessian, stacked.hessian)
    joined.put(np.array([0]), stacked.take([2]))
    assert joined.merit[0] == stacked.merit[2]


def test_merit_and_errors_agree_with_the_finished_motion(
    planar: ffsms.SpaceManipulator, rng: np.random.Generator
) -> None:
    """Compare quadratures with sums over the nodes."""
    problem = planar_problem(planar, dt=0.005)
    spline = spline_of(problem, Grid(24, 8, 4))
    p = 0.05 * rng.normal(size=(1, spline.size, 3)) + 0.1
    candidates = linearise(model_of(problem, spline), p, Weights(1.0, 1.0))
    plan = trajectory_of(problem, node_rates(problem, spline, p[0]))
    motions = motions_of(problem, spline, p)
    cost = problem.cost_terms[0].cost(Variables(motions))
    assert cost[0] == pytest.approx(plan.shares["coupling"], rel=0.02)
    assert candidates.objective[0] == pytest.approx(sum(plan.shares.values()), rel=0.02)
    assert candidates.end_share[0] == pytest.approx(plan.position_error[-1] / 1e-3, rel=1e-3)
    late = plan.t >= 0.9 * 6.0 - 1e-9
    assert candidates.late_share[0] == pytest.approx(plan.position_error[late].max() / 0.02, rel=1e-2)
    assert (candidates.limit_share[0] > 1.0) == bool({"clearance", "torques"} & set(plan.broken))
