"""Test the term that makes plans more informative about unknown parameters."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue
from ffsms_pin.identification import Excitation, Identifier
from ffsms_pin.opt.derivatives import Variables
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.simulation import Sensors

NOISE = Sensors(base_velocity_noise=2e-4, base_rate_noise=2e-5, joint_rate_noise=2e-4)


@pytest.fixture(scope="module")
def problem(planar: ffsms.SpaceManipulator) -> opt.Problem:
    q0 = planar.configuration(np.radians([1.0, 1.0, 1.0]))
    return opt.Problem(planar, q0, [0.45, 0.65, 0.0], 8.0, 0.1)


@pytest.fixture(scope="module")
def plan(problem: opt.Problem) -> opt.Trajectory:
    return opt.solve(problem)


def worst(identifier: Identifier, plan: opt.Trajectory) -> float:
    """Return the largest expected deviation of mass, m cx, m cy and Izz of the base."""
    G = identifier.expected_information(plan.q, plan.v)
    return float(np.sqrt(np.diag(np.linalg.inv(G + np.eye(len(G)))))[[0, 1, 2, 9]].max())


def test_a_plan_with_the_term_reaches_and_is_more_informative(
    planar: ffsms.SpaceManipulator, problem: opt.Problem, plan: opt.Trajectory
) -> None:
    identifier, excited = Identifier(planar, ["base"], sensors=NOISE), plan
    deviations = [worst(identifier, plan)]
    for _ in range(2):
        term = Excitation(identifier, excited)
        excited = opt.solve(replace(problem, terms=[*problem.terms, term]))
        assert excited.reached
        assert excited.clear
        deviations.append(worst(identifier, excited))
    assert deviations[1] < 0.7 * deviations[0]
    assert deviations[2] < 0.5 * deviations[0]


@pytest.mark.parametrize("at_rest", [False, True])
def test_the_mean_square_of_the_residual_is_the_weight(
    at_rest: bool, planar: ffsms.SpaceManipulator, problem: opt.Problem, plan: opt.Trajectory
) -> None:
    """At the plan itself the residual is minus the weighted momentum without its mean."""
    identifier = Identifier(planar, ["base", "link_2"], sensors=NOISE, at_rest=at_rest)
    term = Excitation(identifier, plan, weight=4.0, directions=20)
    motion = problem.motion(plan.joint_rates)
    values = np.stack([residual.value[:, 0, ::2] for residual in term.residual(Variables(motion))])
    assert values.shape == (20, 6, len(plan.t))
    assert np.mean(np.sum(values**2, axis=(0, 1))) == pytest.approx(4.0, rel=1e-6)


def test_a_slower_motion_is_compared_with_the_plan_at_the_same_share_of_its_duration(
    planar: ffsms.SpaceManipulator, problem: opt.Problem, plan: opt.Trajectory
) -> None:
    """At half the rates the residual is y / 2 - 2 y at all nodes."""
    identifier = Identifier(planar, ["base", "link_2"], sensors=NOISE, at_rest=True)
    term = Excitation(identifier, plan, weight=4.0, directions=20)
    motion = replace(problem, duration=16.0, dt=0.2).motion(0.5 * plan.joint_rates)
    values = np.stack([residual.value[:, 0, ::2] for residual in term.residual(Variables(motion))])
    assert np.mean(np.sum(values**2, axis=(0, 1))) == pytest.approx(4.0 * 1.5**2, rel=1e-6)


@pytest.mark.slow
@pytest.mark.long
def test_derivatives_of_the_excitation_term(
    planar: ffsms.SpaceManipulator, problem: opt.Problem, plan: opt.Trajectory
) -> None:
    opt.check(Excitation(Identifier(planar, ["base", "link_2"]), plan, directions=2), problem)


def test_invalid_arguments_of_excitation_are_refused(
    planar: ffsms.SpaceManipulator, problem: opt.Problem, plan: opt.Trajectory, refused: Any
) -> None:
    identifier = Identifier(planar, ["base"], sensors=NOISE)
    refused(lambda: Excitation(identifier, plan, weight=-1.0), InvalidValue, "weight")
    refused(lambda: Excitation(identifier, plan, directions=0), InvalidValue, "directions")
    plain: Any = "base"
    refused(lambda: Excitation(plain, plan), InvalidValue, "identifier")
    refused(lambda: Excitation(identifier, plain), InvalidValue, "plan")
    other = Identifier(ffsms.load("satellite_panda"), ["base"])
    refused(lambda: Excitation(other, plan), InvalidValue, "must be a plan of the identifier's robot")
    still = measure(problem, np.zeros_like(plan.joint_rates))
    refused(lambda: Excitation(identifier, still), InvalidValue, "must move the arm")
