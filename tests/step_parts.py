"""Define limits and steppers for tests of single steps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.evaluation import Rows, Violation
from ffsms_pin.opt.limits.alpha_box import AlphaBox
from ffsms_pin.opt.limits.limit import Limit
from ffsms_pin.opt.step.state import StepState, rate_bounds, roll_out_steps
from ffsms_pin.opt.step.stepper import DesiredMotion, Stepper, StepWeights, step_qp
from ffsms_pin.robot.base_motion import roll_out

TARGET = np.array([0.45, 0.75, 0.0])


def random_state(sms: ffsms.SpaceManipulator, seed: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    q = sms.configuration(rng.uniform(0.5 * sms.limits.lower, 0.5 * sms.limits.upper))
    return q, rng.uniform(-0.3, 0.3, sms.n)


def path(
    sms: ffsms.SpaceManipulator, q0: FloatArray, rates: FloatArray, dt: float, momentum: Any = None
) -> FloatArray:
    return roll_out(sms, q0, rates[0], np.diff(rates, axis=0) / dt, dt, momentum)[0]


def distance_to(sms: ffsms.SpaceManipulator, q: FloatArray, target: FloatArray) -> float:
    return float(np.linalg.norm(sms.at(q).end_effector_pose.translation - target))


class StepLimit(Limit):
    """A limit of single steps only, without residual and violation."""

    name = "step"

    def residual(self, motions: Any) -> list[Any]:
        return []

    def violation(self, motion: Any) -> Violation:
        return Violation()


class StepJoints(StepLimit):
    """The rows of the robot's joint limits."""

    def for_robot(self, sms: ffsms.SpaceManipulator) -> StepJoints:
        made = StepJoints()
        made.joint_bounds = sms.limits
        return made

    def rows(self, step: StepState) -> Rows:
        return Rows(np.eye(step.sms.n), *rate_bounds(step.joints, step.rates, step.sms.limits, step.dt))


class StepClearance(StepLimit):
    """The rows of clearances of points or shapes."""

    def __init__(self, kept: float = 0.01, collision: str = "points") -> None:
        self._clearance = opt.Clearance(kept, collision)

    def for_robot(self, sms: ffsms.SpaceManipulator) -> StepClearance:
        made = StepClearance()
        made._clearance = self._clearance.for_robot(sms)
        return made

    def rows(self, step: StepState) -> Rows | None:
        return self._clearance.rows(step)


class StepBase(StepLimit):
    """The rows of limits on the base's motion."""

    def __init__(self, bounds: Any) -> None:
        self._bounds, self.in_braking = bounds, bounds.in_braking

    def rows(self, step: StepState) -> Rows | None:
        rows: Rows | None = self._bounds.rows(step)
        return rows


class StepRows(StepLimit):
    """The rows that a function returns."""

    def __init__(self, rows: Callable[[StepState], Rows | None]) -> None:
        self._rows = rows

    def rows(self, step: StepState) -> Rows | None:
        return self._rows(step)


def desired_motion(
    step: StepState, target: FloatArray, cosine: float, side: FloatArray, rotation: FloatArray | None = None
) -> DesiredMotion:
    """Return the desired motion of a step without limits."""
    return step_qp(step, target, cosine, side, rotation, StepWeights(), [])[0]


def make_stepper(
    sms: ffsms.SpaceManipulator,
    dt: float = 0.01,
    kappa: float = 10.0,
    collision: str = "points",
    base: Any = None,
    **options: Any,
) -> Stepper:
    """Return a stepper with joint limits, clearance, box of alpha and, if given, base limits."""
    limits: list[Limit] = [StepJoints(), AlphaBox(), StepClearance(0.01, collision)]
    if base is not None:
        limits.append(StepBase(base))
    return Stepper(sms, dt, kappa, limits, **options)


class StepRollout(NamedTuple):
    """The joint rates (N + 1, n) at the nodes, and a note on steps that failed."""

    rates: FloatArray
    note: str


def plan_stepwise(
    stepper: Stepper, q0: FloatArray, target: FloatArray, duration: float, rotation: FloatArray | None = None
) -> StepRollout:
    """Return a step rollout from rest."""
    return StepRollout(*roll_out_steps(stepper, q0, np.zeros(stepper.sms.n), target, duration, rotation))
