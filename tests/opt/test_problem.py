"""The problem: frozen, checked once, and solved the same by `plan` and `solve`."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from horizon_parts import GOAL, same
from own_parts import AbovePlane, LookAt

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import FfsmsError, InvalidValue
from ffsms_pin.opt.trajectory import measure


@pytest.fixture(scope="module")
def q0(planar: ffsms.SpaceManipulator) -> FloatArray:
    return planar.configuration([0.4, 0.7, -0.5])


@pytest.fixture(scope="module")
def plan(planar: ffsms.SpaceManipulator, q0: FloatArray) -> opt.Trajectory:
    return opt.solve(opt.Problem(planar, q0, GOAL, 6.0, 0.02))


# -- construction ---------------------------------------------------------------------------------------


def test_defaults_agree_with_the_documentation(planar: ffsms.SpaceManipulator, q0: FloatArray) -> None:
    problem = opt.Problem(planar, q0, GOAL)
    assert (problem.duration, problem.dt, problem.steps, problem.kappa) == (12.0, 0.01, 1200, 10.0)
    assert problem.terms == (opt.Coupling(), opt.Smooth(), opt.Effort())
    assert [limit.name for limit in problem.limits] == ["joints", "torques", "clearance"]
    assert isinstance(problem.goal, opt.Position)
    assert problem.momentum is None
    assert not problem.joint_rates.any()
    assert problem.free.all()
    # A momentum of zero is stored as None.
    assert opt.Problem(planar, q0, GOAL, momentum=np.zeros(6)).momentum is None
    # The step is adapted to a whole number of steps.
    assert opt.Problem(planar, q0, GOAL, 1.0, 0.3).dt == pytest.approx(1.0 / 3.0)
    longer = problem.lasting(24.0)
    assert (longer.duration, longer.steps) == (24.0, 1200)


def test_a_problem_is_frozen_and_copies_its_arguments(planar: ffsms.SpaceManipulator, q0: FloatArray) -> None:
    arguments, rates, terms = q0.copy(), np.array([0.1, 0.0, 0.0]), list[opt.Term]([opt.Coupling()])
    problem = opt.Problem(planar, arguments, GOAL, joint_rates=rates, terms=terms)
    arguments[7:], rates[:] = 9.0, 9.0
    terms.append(opt.Smooth())
    np.testing.assert_array_equal(problem.q0, q0)
    np.testing.assert_array_equal(problem.joint_rates, [0.1, 0.0, 0.0])
    assert problem.terms == (opt.Coupling(),)
    for array in (problem.q0, problem.joint_rates, problem.goal.place(0.0).position):
        assert not array.flags.writeable
    with pytest.raises(dataclasses.FrozenInstanceError):
        problem.duration = 3.0  # type: ignore[misc]


class Nothing:
    """An object that is neither a term nor a limit."""

    name = "nothing"


MIRROR = pin.SE3(np.diag([1.0, 1.0, -1.0]), np.zeros(3))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sms": "planar_3r"}, ("sms", "SpaceManipulator")),
        ({"q0": np.zeros(3)}, ("q0",)),
        ({"goal": [1.0, 0.0]}, ("goal must be a position",)),
        ({"goal": MIRROR}, ("goal.rotation", "rotation matrix")),
        ({"goal": lambda t: [1.0, 0.0]}, ("goal(0)",)),
        ({"duration": 0.0}, ("duration",)),
        ({"duration": np.inf}, ("duration",)),
        ({"duration": 0.01, "dt": 0.02}, ("duration", "one step")),
        ({"duration": 1e9}, ("duration", "adapt the duration or dt")),
        ({"duration": True}, ("duration",)),
        ({"dt": -0.01}, ("dt",)),
        ({"terms": [Nothing()]}, ("terms", "opt.Term")),
        ({"terms": [opt.JointLimits()]}, ("terms", "opt.Term")),
        ({"terms": [opt.Coupling]}, ("terms", "opt.Term")),
        ({"limits": [opt.Coupling()]}, ("limits", "opt.Limit")),
        (
            {"limits": [opt.JointLimits(), opt.JointLimits()]},
            ("limits", "joints", "must have different names"),
        ),
        ({"terms": [opt.Effort(1.0), opt.Effort(2.0)]}, ("terms", "effort", "must have different names")),
        ({"joint_rates": [0.1, 0.2]}, ("joint_rates",)),
        ({"joint_rates": [0.1, 0.2, np.nan]}, ("joint_rates",)),
        ({"momentum": [1.0, 2.0]}, ("momentum",)),
        ({"locked": ["elbow"]}, ("locked", "elbow", "joint_1, joint_2, joint_3")),
        ({"time_offset": -1.0}, ("time_offset",)),
        ({"extra_margins": {"torque": 0.1}}, ("extra_margins", "torque", "clearance")),
        ({"extra_margins": {"clearance": -0.1}}, ("extra_margins['clearance']",)),
    ],
)
def test_wrong_arguments_are_named(
    change: dict[str, Any],
    message: tuple[str, ...],
    planar: ffsms.SpaceManipulator,
    q0: FloatArray,
    refused: Callable[..., FfsmsError],
) -> None:
    arguments: dict[str, Any] = {"sms": planar, "q0": q0, "goal": GOAL} | change
    refused(lambda: opt.Problem(**arguments), InvalidValue, *message)


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: opt.Coupling(0.0), "kappa"),
        (lambda: opt.Coupling(weight=-1.0), "weight"),
        (lambda: opt.Effort(-1.0), "weight"),
        (lambda: opt.Smooth(np.nan), "weight"),
        (lambda: opt.BaseTurn(-0.1), "weight"),
        (lambda: opt.Position(GOAL, tolerance=0.0), "tolerance"),
        (lambda: opt.Position(GOAL, reach=-1.0), "reach"),
        (lambda: opt.Position(GOAL, velocity=[1.0, 2.0]), "velocity"),
        (lambda: opt.Pose(pin.SE3.Identity(), twist=np.zeros(3)), "twist"),
        (lambda: opt.Pose(pin.SE3.Identity(), orientation_reach=0.0), "orientation_reach"),
    ],
)
def test_terms_and_goals_are_checked_at_construction(make: Callable[[], Any], name: str) -> None:
    with pytest.raises(InvalidValue, match=name):
        make()


def test_a_start_outside_the_joint_limits_is_refused(planar: ffsms.SpaceManipulator) -> None:
    outside = planar.configuration([1.5, 0.0, 0.0])
    with pytest.raises(InvalidValue, match=r"joint 'joint_1'.*1\.5"):
        opt.Problem(planar, outside, GOAL)
    assert opt.Problem(planar, outside, GOAL, limits=[]).limits == ()


def test_a_moving_goal_has_the_velocity_of_its_path() -> None:
    def path(t: float) -> Any:
        rotation = pin.exp3(np.array([0.0, 0.1 * t, 0.0])) @ pin.exp3(np.array([0.0, 0.0, 0.2]))
        return pin.SE3(rotation, np.array([np.sin(t), t * t, 1.0]))

    place = opt.Moving(path).place(0.7)
    np.testing.assert_allclose(place.position, path(0.7).translation)
    assert place.velocity is not None
    assert place.angular_velocity is not None
    np.testing.assert_allclose(place.velocity, [np.cos(0.7), 1.4, 0.0], atol=1e-6)
    np.testing.assert_allclose(place.angular_velocity, [0.0, 0.1, 0.0], atol=1e-6)


# -- plan and solve ------------------------------------------------------------------------------------


def test_plan_and_solve_give_the_same_bits(
    planar: ffsms.SpaceManipulator, q0: FloatArray, plan: opt.Trajectory
) -> None:
    same(opt.plan(planar, q0, GOAL, 6.0, 0.02), plan)
    rates, momentum = [0.05, 0.0, -0.05], [0.02, 0.01, 0.0, 0.0, 0.0, 0.01]
    base = opt.BaseLimits(attitude=0.2)
    problem = opt.Problem(
        planar,
        q0,
        GOAL,
        4.0,
        0.04,
        terms=[opt.Coupling(5.0), opt.Smooth(), opt.Effort(1e-3), opt.BaseTurn(0.2)],
        limits=[opt.JointLimits(), opt.Clearance(0.02), base],
        joint_rates=rates,
        momentum=momentum,
        locked=["joint_3"],
    )
    planned = opt.plan(
        planar,
        q0,
        GOAL,
        4.0,
        0.04,
        5.0,
        clearance=0.02,
        base_limits=base,
        momentum=momentum,
        joint_rates=rates,
        locked=["joint_3"],
        effort=1e-3,
        base=0.2,
    )
    same(planned, opt.solve(problem))


def test_shares_and_active_instants(
    planar: ffsms.SpaceManipulator, q0: FloatArray, plan: opt.Trajectory
) -> None:
    assert plan.shares.keys() == {"coupling", "smooth", "effort"}
    assert plan.shares["coupling"] == pytest.approx(plan.cost_integral, rel=1e-12)
    assert plan.broken == {}
    assert plan.largest_alpha == np.abs(plan.alpha).max()
    # The joint reaches its rate limit after 1.6 s, keeps it for 0.8 s and returns to rest.
    ramp = np.clip(np.minimum(np.linspace(0.0, 4.0, 101), np.linspace(4.0, 0.0, 101)) / 1.6, 0.0, 1.0)
    rates = np.outer(ramp, [planar.limits.velocity[0], 0.0, 0.0])
    fast = measure(opt.Problem(planar, planar.configuration([-0.5, 0.7, -0.5]), GOAL, 4.0, 0.04), rates)
    instants = fast.binding["joints"]
    assert fast.broken == {}
    np.testing.assert_allclose(instants, np.linspace(1.6, 2.4, 41), atol=1e-9)


def test_files_keep_shares_and_violations_of_custom_parts(
    planar: ffsms.SpaceManipulator, q0: FloatArray, plan: opt.Trajectory, tmp_path: Path
) -> None:
    terms = [opt.Coupling(), LookAt((0.3, 1.2, 0.0))]
    limits = [opt.JointLimits(), AbovePlane((0.0, 1.0, 0.0), 0.52), opt.Clearance(0.5)]
    problem = opt.Problem(planar, q0, GOAL, 6.0, 0.02, terms=terms, limits=limits)
    judged = measure(problem, plan.joint_rates)
    assert judged.shares.keys() == {"coupling", "look at"}
    assert judged.broken.keys() == {"plane", "clearance"}
    assert {"plane", "clearance"} <= judged.binding.keys()
    assert "below the plane" in judged.note
    assert not judged.reached
    judged.save(tmp_path / "judged.npz")
    loaded = opt.Trajectory.load(tmp_path / "judged.npz")
    same(loaded, judged)
    assert loaded.largest_alpha == judged.largest_alpha
