"""The residuals of a goal: derivatives by control points, and errors as shares of the tolerance."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from horizon_parts import spline_of
from slopes import check_arrival, motions

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.search.gauss_newton import arrival


@pytest.fixture(scope="module", params=["planar_3r", "satellite_panda"])
def sms(request: pytest.FixtureRequest) -> ffsms.SpaceManipulator:
    return ffsms.load(request.param)


def goals(sms: ffsms.SpaceManipulator, q0: Any) -> dict[str, opt.Goal]:
    """Return goals of several kinds away from the end effector's start."""
    here = sms.at(q0).end_effector_pose
    turned = pin.exp3(np.array([0.3, 0.2, -0.1])) @ here.rotation
    there = pin.SE3(turned, here.translation + np.array([0.2, 0.1, 0.1]))

    def path(t: float) -> Any:
        turned = pin.exp3(np.array([0.02 * t, 0.0, 0.05 * t])) @ there.rotation
        return pin.SE3(turned, there.translation + np.array([0.01 * t, 0.0, -0.02 * t]))

    return {
        "position": opt.Position(there.translation),
        "velocity": opt.Position(there.translation, velocity=[0.03, -0.02, 0.01]),
        "pose": opt.Pose(there),
        "twist": opt.Pose(there, twist=[0.03, -0.02, 0.01, 0.1, 0.05, -0.02]),
        "moving": opt.Moving(path),
    }


@pytest.mark.parametrize("name", ["position", "velocity", "pose", "twist", "moving"])
def test_derivatives_and_errors_of_goals(
    sms: ffsms.SpaceManipulator, name: str, rng: np.random.Generator
) -> None:
    middle = np.clip(np.full(sms.n, 0.2), sms.limits.lower, sms.limits.upper)
    q0 = sms.configuration(middle, pin.SE3(pin.exp3(np.array([0.3, -0.2, 0.5])), np.array([0.1, 0.2, 0.3])))
    goal = goals(sms, q0)[name]
    problem = opt.Problem(sms, q0, goal, 8.0, joint_rates=0.1 * rng.normal(size=sms.n), terms=[], limits=[])
    spline = spline_of(problem, free_end=True)
    p = 0.1 * rng.normal(size=(1, spline.size, sms.n))
    rollouts = motions(problem, spline, p)
    result = arrival(goal, rollouts)
    # In space the base attitude follows by quadrature, so the derivatives are approximate.
    check_arrival(problem, spline, p, exact=sms.n == 3)

    place, end = goal.place(8.0), rollouts.last
    errors = [float(np.linalg.norm(place.position - rollouts.end_effector[:, 0, end]))]
    if place.rotation is not None:
        errors.append(float(np.linalg.norm(pin.log3(place.rotation @ rollouts.attitude[:, :, 0, end].T))))
    if place.velocity is not None:
        errors.append(float(np.linalg.norm(place.velocity - rollouts.velocity[:, 0, end])))
    if place.angular_velocity is not None:
        errors.append(float(np.linalg.norm(place.angular_velocity - rollouts.angular_velocity[:, 0, end])))
    assert len(errors) == {"position": 1, "velocity": 2, "pose": 2}.get(name, 4)
    assert result.end_share[0] == pytest.approx(max(errors) / goal.tolerance, rel=1e-9)


def test_residuals_vanish_well_within_the_tolerance(planar: ffsms.SpaceManipulator) -> None:
    """Within 0.4 of the tolerance and 0.9 of the reach all residuals are zero."""
    q0 = planar.configuration([0.4, 0.7, -0.5])
    here = planar.at(q0).end_effector_pose.translation
    for offset, zero in ((3.9e-4, True), (4.1e-4, False)):
        goal = opt.Position(here + np.array([offset, 0.0, 0.0]))
        problem = opt.Problem(planar, q0, goal, 6.0, 0.02)
        spline = spline_of(problem)
        result = arrival(goal, motions(problem, spline, np.zeros((1, spline.size, 3))))
        assert all(not residual.value.any() for residual in result.end) == zero
        assert not any(residual.value.any() for residual in result.tail)
        assert result.end_share[0] == pytest.approx(offset / 1e-3)
