"""Terms and limits as formulas: derivatives, rows and verdicts, and named mistakes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hand_written import Above
from part_cases import LIMITS, TERMS, problem_of, rollout_of

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import FfsmsError, PartError
from ffsms_pin.opt.evaluation import residuals_of
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.opt.trajectory import measure

AT, NORMAL, HEIGHT = (1.0, 1.2, 0.0), (-0.456, -0.890, 0.0), -0.885


@dataclass(frozen=True)
class GazeFormula(opt.Term):
    at: tuple[float, float, float] = AT
    weight: float = 0.1
    name = "gaze"

    def residual(self, m: opt.Variables) -> Any:
        displacement = self.at - m.tip
        return np.sqrt(self.weight) * (
            displacement - displacement.norm() * m.frame("tip").axis([1.0, 0.0, 0.0])
        )


@dataclass(frozen=True)
class AboveFormula(opt.Inequality):
    name = "above"

    def slack(self, m: opt.Variables) -> Any:
        return m.tip.dot(NORMAL) - HEIGHT


class Formula(opt.Term):
    """A term with a function of the variables as residual."""

    name = "formula"

    def __init__(self, formula: Callable[[opt.Variables], Any]) -> None:
        self.formula = formula

    def residual(self, m: opt.Variables) -> Any:
        return self.formula(m)


def reach(sms: ffsms.SpaceManipulator, term: opt.Term, limit: opt.Limit) -> opt.Problem:
    q0 = sms.configuration(np.radians([23.0, 40.0, -29.0]))
    terms = [opt.Coupling(), opt.Smooth(), opt.Effort(), term]
    limits = [opt.JointLimits(), limit]
    return opt.Problem(sms, q0, [0.45, 0.75, 0.0], duration=8.0, dt=0.02, terms=terms, limits=limits)


def test_a_formula_and_a_hand_written_limit_give_the_same_plan(planar: ffsms.SpaceManipulator) -> None:
    by_hand = opt.solve(reach(planar, GazeFormula(), Above(NORMAL, HEIGHT)))
    formula = opt.solve(reach(planar, GazeFormula(), AboveFormula()))
    assert formula.reached
    np.testing.assert_allclose(formula.q, by_hand.q, rtol=0.0, atol=1e-8)
    assert formula.shares["gaze"] == pytest.approx(by_hand.shares["gaze"], rel=1e-6)


def test_rows_of_a_formula_agree_with_hand_written_rows(
    planar: ffsms.SpaceManipulator, rng: np.random.Generator
) -> None:
    q = planar.configuration(rng.uniform(-0.5, 0.5, 3))
    momentum = np.array([0.1, -0.2, 0.0, 0.0, 0.0, 0.05])
    step = StepState(planar, q, rng.normal(size=3), 0.01, 3.0, momentum)
    by_hand, formula = Above(NORMAL, HEIGHT).rows(step), AboveFormula().rows(step)
    assert formula is not None
    for value, other in zip(formula[:3], by_hand[:3], strict=True):
        np.testing.assert_allclose(value, other, atol=1e-12)
    assert formula.softness == by_hand.softness


ELBOWS = {3: "link_3", 7: "panda_link5"}
FORMULAS: dict[str, Callable[[opt.Variables], Any]] = {
    "frame": lambda m: m.frame(ELBOWS[m.stack.n]) - [0.1, 0.2, 0.3],
    "frame's axis": lambda m: m.frame(ELBOWS[m.stack.n]).axis([0.6, 0.0, 0.8]),
    "base's axis": lambda m: m.base.axis([0.6, 0.0, 0.8]).cross(m.tip),
    "turn": lambda m: m.frame(ELBOWS[m.stack.n]).rotation_vector_from(np.eye(3)),
    "turn of the end effector": lambda m: m.tip.rotation_vector_from(np.eye(3)).norm(),
    "angle of a frame": lambda m: m.frame(ELBOWS[m.stack.n]).angle_from(np.eye(3)),
    "turn of the base": lambda m: m.base_rotation_vector,
    "speeds": lambda m: [m.velocity.norm() / (0.1 + m.angular_velocity.norm()), m.base_angular_velocity],
    "entropy": lambda m: np.log(m.entropy) * m.rates + np.exp(-m.time),
    "joints": lambda m: [np.sin(m.joints) * m.rates**2, m.joints[1] - m.joints[0]],
    "accelerations": lambda m: m.accelerations.sum() * m.joints[0],
    "numpy": lambda m: np.maximum(m.tip[0], m.tip[1]) + np.arctan2(m.tip[1], m.tip[0]) - abs(m.tip[2] - 1),
    "goal": lambda m: (m.goal - m.tip).norm() / np.hypot(m.velocity[0], 0.1),
}


@pytest.mark.parametrize("robot", ["planar_3r", "satellite_panda"])
@pytest.mark.parametrize("name", list(FORMULAS))
def test_derivatives_of_variables(name: str, robot: str) -> None:
    assert opt.check(Formula(FORMULAS[name]), problem_of(ffsms.load(robot))) < 1e-5


@pytest.mark.parametrize("name", list(TERMS))
def test_packaged_terms_pass_the_check(name: str) -> None:
    assert opt.check(TERMS[name], problem_of(ffsms.load("planar_3r"), name)) < 1e-5


@pytest.mark.parametrize("limit", [opt.BaseLimits(0.1, 0.05, 0.02, 0.03), opt.AlphaBox(), opt.WheelLimits()])
def test_packaged_limits_pass_the_check(limit: opt.Limit) -> None:
    part = "wheels' torque" if isinstance(limit, opt.WheelLimits) else ""
    assert opt.check(limit, problem_of(ffsms.load("planar_3r"), part)) < 1e-4
    assert set(LIMITS) > {"attitude", "own"}


def test_a_number_is_added_to_all_components_of_a_vector(planar: ffsms.SpaceManipulator) -> None:
    class Mixed(opt.Inequality):
        name = "mixed"

        def slack(self, m: opt.Variables) -> Any:
            return 3.0 + m.tip + m.tip[0] - m.velocity.norm()

    assert opt.check(Mixed(), problem_of(planar)) < 1e-4


def test_check_names_a_wrong_derivative(planar: ffsms.SpaceManipulator) -> None:
    class Wrong(GazeFormula):
        def residual(self, m: opt.Variables) -> Any:
            right = super().residual(m)
            return m.variable(right.value, {**right.slopes, "by_turn": 1.1 * right.slopes["by_turn"]})

    with pytest.raises(PartError, match=r"Wrong\.residual has a wrong slope: by_turn\[\d\] of variable 0"):
        opt.check(Wrong(), problem_of(planar))


def test_check_reports_rows_with_a_wrong_sign(planar: ffsms.SpaceManipulator) -> None:
    class Wrong(Above):
        def rows(self, step: Any) -> opt.Rows:
            rows = super().rows(step)
            return rows._replace(G=-rows.G)

    problem = problem_of(planar)
    assert opt.check(Above((1.0, 0.0, 0.0), 2.0), problem) < 1e-5
    with pytest.raises(PartError, match=r"Wrong\.rows increase the violation"):
        opt.check(Wrong((1.0, 0.0, 0.0), 2.0), problem)


class PlainResidual(GazeFormula):
    def residual(self, m: opt.Variables) -> Any:
        displacement = np.array(AT)[:, None, None] - m.end_effector
        return np.sqrt(self.weight) * (displacement - np.linalg.norm(displacement, axis=0) * m.attitude[:, 0])


class Mixed(GazeFormula):
    """A term that loses the derivatives of the length alone."""

    def residual(self, m: opt.Variables) -> Any:
        displacement = self.at - m.tip
        return np.sqrt(self.weight) * (
            displacement - np.linalg.norm(displacement, axis=0) * m.tip.axis([1.0, 0.0, 0.0])
        )


class PlainSlack(AboveFormula):
    def slack(self, m: opt.Variables) -> Any:
        return np.einsum("x,xsk->sk", NORMAL, m.end_effector) - HEIGHT


@pytest.mark.parametrize(
    ("part", "text"),
    [
        (
            PlainResidual(),
            r"PlainResidual\.residual returns a plain array without slopes: compute it from m\.tip, m\.frame",
        ),
        (Mixed(), r"Mixed\.residual loses slopes: .* use x\.norm\(\)"),
        (PlainSlack(), r"PlainSlack\.slack returns a plain array .* compute it from m\.tip, m\.frame"),
    ],
)
def test_a_part_without_slopes_is_refused_by_the_problem(
    planar: ffsms.SpaceManipulator, part: Any, text: str
) -> None:
    parts = {"limits": [opt.JointLimits(), part]} if isinstance(part, opt.Limit) else {"terms": [part]}
    with pytest.raises(PartError, match=text):
        problem_of(planar, **parts)


@pytest.mark.parametrize(
    ("formula", "text"),
    [
        (lambda m: None, "must return a variable, or a list of these; got NoneType"),
        (lambda m: 1.0, "returns a plain array without slopes"),
        (lambda m: opt.Variable(np.zeros((2, 5))), r"must return shape \(S, K\) = \(1, 17\) .* got \(2, 5\)"),
        (lambda m: np.zeros((2, 5)) + m.tip, "failed with ValueError: operands could not be broadcast"),
        (lambda m: m.nothing, "failed with AttributeError"),
        (lambda m: m.entropy[0], "index must be left out, because this variable is a number"),
    ],
)
def test_mistakes_name_the_part(
    planar: ffsms.SpaceManipulator, formula: Callable[[opt.Variables], Any], text: str
) -> None:
    motion = rollout_of(problem_of(planar), 0.1 * np.ones((9, 3)))
    with pytest.raises(FfsmsError, match=text) as caught:
        residuals_of(Formula(formula), motion)
    if isinstance(caught.value, PartError):
        assert str(caught.value).startswith("Formula.residual ")
        assert (caught.value.part, caught.value.method) == ("Formula", "residual")


class Wrong(opt.Limit):
    """A limit that returns a wrong value."""

    name = "wrong"

    def __init__(self, returned: Any) -> None:
        self.returned = returned

    def residual(self, m: Any) -> list[opt.Variable]:
        return []

    def rows(self, step: Any) -> Any:
        return self.returned() if callable(self.returned) else self.returned

    def violation(self, motion: opt.Rollouts) -> Any:
        return self.rows(None)


@pytest.mark.parametrize(
    ("returned", "text"),
    [
        (3.0, "must return opt.Rows or None; got float"),
        (opt.Rows(np.zeros((1, 2)), np.zeros(1), np.ones(1)), r"must return G \(k, 3\), .* got \(\(1, 2\)"),
        (lambda: [1, 2][3], "failed with IndexError: list index out of range"),
    ],
)
def test_mistakes_in_rows_name_the_limit(planar: ffsms.SpaceManipulator, returned: Any, text: str) -> None:
    planner = opt.StepPlanner(planar, limits=[Wrong(returned)])
    with pytest.raises(PartError, match=rf"Wrong\.rows {text}"):
        planner.step(planar.configuration(np.zeros(3)), np.zeros(3), [0.7, 0.5, 0.0], 4.0)


def test_mistakes_in_verdicts_name_the_limit(planar: ffsms.SpaceManipulator) -> None:
    with pytest.raises(PartError, match=r"Wrong\.violation must return an opt\.Violation; got float"):
        measure(problem_of(planar, limits=[Wrong(3.0)]), np.zeros((301, 3)))


def test_a_share_that_is_no_float_names_the_term(planar: ffsms.SpaceManipulator) -> None:
    class Vast(opt.Effort):
        def share(self, motion: opt.Rollouts) -> float:
            return 10**400

    with pytest.raises(PartError, match=r"Vast\.share must return a number"):
        measure(problem_of(planar, terms=[Vast()]), np.zeros((301, 3)))


@dataclass(frozen=True)
class Elbow(opt.Inequality):
    """A limit that keeps a joint near a position at the times of `when`."""

    when: str = "always"
    name = "elbow"
    absolute_margin = 0.01
    binding = 1e-3
    at = np.array([0.601, 0.24, 0.0])  # 0.3 m from the goal, the length of the last link

    def slack(self, m: Any) -> Any:
        return 0.02 - (m.frame("joint_3") - self.at).norm()


@pytest.mark.parametrize("when", ["deadline", "last tenth"])
def test_a_limit_may_apply_at_the_end_only(planar: ffsms.SpaceManipulator, when: str) -> None:
    q0 = planar.configuration([0.2, 0.4, -0.3])
    free, kept = (
        opt.Problem(planar, q0, [0.75, 0.5, 0.0], 6.0, 0.05, limits=[opt.JointLimits(), *limits])
        for limits in ([], [Elbow(when)])
    )
    data, frame = planar.model.createData(), planar.model.getFrameId("joint_3")

    def distances(plan: opt.Trajectory) -> FloatArray:
        values = []
        for q in plan.q:
            pin.framesForwardKinematics(planar.model, data, q)
            values.append(np.linalg.norm(data.oMf[frame].translation - Elbow.at))
        return np.array(values)

    plan, free_plan = opt.solve(kept), opt.solve(free)
    assert plan.reached, plan.note
    late = plan.t >= (0.9 * 6.0 - 1e-9 if when == "last tenth" else 6.0)
    assert distances(plan)[late].max() <= 0.02
    assert distances(plan)[0] > 0.05
    assert distances(free_plan)[-1] > 0.03
    violating = measure(kept, free_plan.joint_rates)
    assert violating.broken["elbow"] == pytest.approx(distances(free_plan)[late].max() - 0.02, abs=1e-6)
    assert opt.check(Elbow(when), kept) < 1e-4


def test_rows_of_a_limit_at_the_deadline_require_enough_speed(planar: ffsms.SpaceManipulator) -> None:
    """The row is inactive early; late it requires a little more than distance over time left."""
    q0 = planar.configuration([0.2, 0.4, -0.3])
    limit, rates = Elbow("deadline"), np.zeros(3)
    least = []
    for time_left in (30.0, 2.0):
        rows = limit.rows(StepState(planar, q0, rates, 0.01, time_left))
        assert rows is not None
        least.append(float(rows.lower[0]))
    data = planar.model.createData()
    pin.framesForwardKinematics(planar.model, data, q0)
    displacement = float(np.linalg.norm(data.oMf[planar.model.getFrameId("joint_3")].translation - Elbow.at))
    assert least[0] < 0.0
    assert (displacement - 0.01) / 2.0 < least[1] <= 1.5 * (displacement - 0.01) / (2.0 - 0.1) + 1e-9
