"""`within_tolerance`, `reached` and their notes, also after numerical failures."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import PartError
from ffsms_pin.opt.trajectory import measure

TARGET = [1.0, 0.15, 0.0]


@pytest.fixture
def start(planar: ffsms.SpaceManipulator) -> Any:
    return planar.configuration(np.radians([1.0, 1.0, 1.0]))


def test_a_plan_within_the_default_tolerance_has_no_note(planar: ffsms.SpaceManipulator, start: Any) -> None:
    plan = opt.plan(planar, start, TARGET)
    assert plan.reached
    assert plan.within_tolerance
    assert plan.position_error[-1] <= opt.Position(TARGET).tolerance
    assert plan.note == ""


def test_reached_but_not_within_a_narrow_tolerance(planar: ffsms.SpaceManipulator, start: Any) -> None:
    plan = opt.plan(planar, start, opt.Position(TARGET, tolerance=1e-12))
    assert plan.reached
    assert not plan.within_tolerance
    assert f"the end is off by {1e3 * plan.position_error[-1]:.3g} mm; its tolerance is 1e-09 mm" in plan.note
    assert "binding" in plan.note or "no limit is active" in plan.note


def test_the_note_names_the_active_joint_limit(planar: ffsms.SpaceManipulator, start: Any) -> None:
    """The target is 3 mm beyond the end effector with all joints at their limits."""
    limits = planar.limits
    upper = limits.upper.copy()
    upper[:] = 0.3
    narrow = planar.with_limits(dataclasses.replace(limits, upper=upper, lower=-upper))
    corner = narrow.at(narrow.configuration([0.3, 0.3, 0.3])).end_effector_pose.translation
    inside = narrow.at(narrow.configuration([0.25, 0.25, 0.25])).end_effector_pose.translation
    beyond = corner + 0.003 * (corner - inside) / np.linalg.norm(corner - inside)
    plan = opt.plan(narrow, start, beyond, duration=20.0)
    if plan.within_tolerance:
        pytest.fail("the target is within reach")
    assert "position limit of 'joint_" in plan.note


def test_step_methods_report_the_position_error(planar: ffsms.SpaceManipulator, start: Any) -> None:
    plan = opt.plan(planar, start, [1.5, 0.15, 0.0], method="resolved-rate")
    assert not plan.reached
    assert not plan.within_tolerance
    assert f"{1e3 * plan.position_error[-1]:.3g} mm" in plan.note


@pytest.mark.parametrize("method", ["resolved-rate", "step", "paper", "least-disturbance"])
@pytest.mark.parametrize(
    ("target", "duration", "why"),
    [
        ([2.5, 0.15, 0.0], 4.0, "binding: the workspace"),
        ([0.3, 0.8, 0.0], 1.0, "acceleration limit of 'joint_"),
        ([-0.8, 0.3, 0.0], 20.0, "binding: "),
    ],
)
def test_step_methods_report_why_they_miss(
    planar: ffsms.SpaceManipulator, start: Any, target: list[float], duration: float, why: str, method: str
) -> None:
    plan = opt.plan(planar, start, target, duration, 0.05, method=method)
    assert not plan.within_tolerance
    assert why in plan.note


@pytest.mark.parametrize("on", ["inertial", "base"])
def test_an_attitude_of_no_posture_is_reported_as_out_of_the_workspace(
    planar: ffsms.SpaceManipulator, start: Any, on: str
) -> None:
    """The attitude is out of the arm's plane."""
    tilted = pin.SE3(pin.exp3(np.array([0.8, 0.0, 0.0])), np.array([0.9, 0.3, 0.0]))
    plan = opt.plan(planar, start, opt.Pose(tilted, on=on), 20.0, 0.1)
    assert not plan.within_tolerance
    assert "binding: probably the workspace" in plan.note


def test_velocities_and_attitudes_count_if_the_goal_has_them(
    planar: ffsms.SpaceManipulator, start: Any
) -> None:
    here = planar.at(start).end_effector_pose
    turned = pin.SE3(here.rotation @ pin.exp3(np.array([0.0, 0.0, 0.01])), here.translation)
    goals = {
        "": here,
        "0.573 deg": turned,
        "20 mm/s": opt.Pose(here, twist=[0.02, 0.0, 0.0, 0.0, 0.0, 0.0]),
        "1.15 deg/s": opt.Pose(here, twist=[0.0, 0.0, 0.0, 0.0, 0.0, 0.02]),
    }
    for note_part, goal in goals.items():
        problem = opt.Problem(planar, start, goal)
        still = measure(problem, np.zeros((problem.steps + 1, 3)))
        assert still.within_tolerance == (note_part == "")
        assert note_part in still.note
        assert bool(still.note) == bool(note_part)


def test_an_end_within_the_tolerance_that_comes_too_late_is_noted(
    planar: ffsms.SpaceManipulator, start: Any
) -> None:
    goal = opt.Position(planar.at(start).end_effector_pose.translation, tolerance=1e-3, reach=1e-2)
    problem = opt.Problem(planar, start, goal, duration=4.0)
    # Out and back within the last tenth.
    t = np.linspace(0.0, 4.0, problem.steps + 1)
    late = np.where(t > 3.6, np.sin(2.0 * np.pi * (t - 3.6) / 0.4), 0.0)
    plan = measure(problem, 0.3 * late[:, None] * np.ones(3))
    assert plan.within_tolerance
    assert not plan.reached
    assert "too late" in plan.note


def test_files_keep_within_tolerance(planar: ffsms.SpaceManipulator, start: Any, tmp_path: Path) -> None:
    problem = opt.Problem(planar, start, TARGET)
    missed = measure(problem, np.zeros((problem.steps + 1, 3)))
    for plan in (opt.plan(planar, start, TARGET), missed):
        plan.save(tmp_path / "plan.npz")
        assert opt.Trajectory.load(tmp_path / "plan.npz").within_tolerance == plan.within_tolerance


@pytest.mark.parametrize("bound", [1e9, 200.0, np.inf])
def test_joint_ranges_of_many_turns_count_as_unlimited(bound: float) -> None:
    arm = ffsms.load("space_arm_7")
    limits = dataclasses.replace(arm.limits, lower=np.full(7, -bound), upper=np.full(7, bound))
    robot = arm.with_limits(limits)
    assert np.isinf(robot.limits.upper).all()
    q0 = robot.configuration([0.1, 0.5, -0.4, 0.9, 0.3, 0.6, 0.2])
    target = robot.at(q0).end_effector_pose.translation + np.array([0.2, -0.3, 0.2])
    plan = opt.plan(robot, q0, target, duration=60.0)
    assert plan.reached
    assert plan.within_tolerance


def test_two_turns_to_each_side_are_a_limit(planar: ffsms.SpaceManipulator) -> None:
    limits = dataclasses.replace(planar.limits, upper=np.full(3, 4.0 * np.pi))
    assert (planar.with_limits(limits).limits.upper == 4.0 * np.pi).all()


class Failing(opt.Term):
    """A term that fails after `after` evaluations of its share."""

    name = "failing"

    def __init__(self, after: int, error: Exception | None) -> None:
        self.left, self.error = after, error

    def residual(self, motions: Any) -> Any:
        if self.left > 0:
            return []
        if self.error is not None:
            raise self.error
        return np.nan * motions.tip

    def share(self, motion: Any) -> float:
        self.left -= 1
        return 0.0


@pytest.mark.parametrize("error", [np.linalg.LinAlgError("Singular matrix"), FloatingPointError("underflow")])
@pytest.mark.parametrize("after", [0, 1])
def test_a_numerical_failure_gives_a_plan_with_a_note(
    planar: ffsms.SpaceManipulator, start: Any, error: Exception, after: int
) -> None:
    terms = [opt.Coupling(), opt.Smooth(), opt.Effort(), Failing(after, error)]
    # The tolerance is unreachable, so the search does not end with the first motion.
    goal = opt.Position([0.45, 0.75, 0.0], tolerance=1e-12)
    plan = opt.solve(opt.Problem(planar, start, goal, terms=terms))
    assert "numerical failure" in plan.note
    assert str(error) in plan.note
    still = not np.diff(plan.q, axis=0).any()
    assert still == (after == 0)
    assert plan.reached == (after == 1)
    assert ("the arm stays at rest" if still else "the best motion found before") in plan.note


@pytest.mark.parametrize("after", [0, 1])
def test_residuals_that_are_not_numbers_give_a_finite_plan(
    planar: ffsms.SpaceManipulator, start: Any, after: int
) -> None:
    goal = opt.Position([0.45, 0.75, 0.0], tolerance=1e-12)
    plan = opt.solve(opt.Problem(planar, start, goal, terms=[opt.Coupling(), Failing(after, None)]))
    assert np.isfinite(plan.q).all()
    assert np.isfinite(plan.position_error).all()
    assert plan.note


def test_a_failed_library_call_gives_a_plan_with_a_note(
    planar: ffsms.SpaceManipulator, start: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: Any) -> Any:
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(np.linalg, "solve", fails)
    plan = opt.plan(planar, start, TARGET)
    assert "numerical failure (Singular matrix)" in plan.note
    assert not plan.reached
    assert not plan.within_tolerance


def test_other_errors_of_a_term_are_raised(planar: ffsms.SpaceManipulator, start: Any) -> None:
    terms = [Failing(0, TypeError("a mistake"))]
    with pytest.raises(PartError, match="a mistake"):
        opt.solve(opt.Problem(planar, start, TARGET, terms=terms))
