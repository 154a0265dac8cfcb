"""Limits: rows of a step, a residual of whole motions, and the violation of a finished motion.

An `Inequality` is a limit as one formula, the slack, from which rows, penalty and verdict follow.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray, instance
from ffsms_pin.errors import FfsmsError, PartError
from ffsms_pin.opt.derivatives import Variable, Variables
from ffsms_pin.opt.evaluation import UNBOUNDED, Formula, Rows, Violation, formulas, residuals_of, stacked
from ffsms_pin.opt.rollouts import ARRIVAL_SHARE, Rollouts

if TYPE_CHECKING:
    from ffsms_pin.geometry.obstacle import Obstacle
    from ffsms_pin.opt.derivatives import RobotFrame
    from ffsms_pin.opt.goals.goal import Place
    from ffsms_pin.opt.step.state import StepState
    from ffsms_pin.robot import SpaceManipulator
    from ffsms_pin.system import RobotLimits


class FrameEnd(NamedTuple):
    """The desired place of a frame of the robot at the deadline, required by a limit."""

    frame: RobotFrame
    place: Place


class SpeedBound(NamedTuple):
    """Bounds on quantities of a motion along a path that are `at_rest` plus `slope` times its speed ds/dt."""

    at_rest: FloatArray  # (c,)
    slope: FloatArray  # (c, K) at the instants of the motion
    most: FloatArray  # (c,) bounds on the absolute values
    most_change: FloatArray  # (c,) bounds on the absolute rates of change [1/s]; infinity: no bound


class Limit(ABC):
    """A condition that a motion must satisfy: rows of a step, a residual and a verdict, which solvers stack.

    An own limit is a subclass, passed as `opt.Problem(limits=[...])`; docs/own-parts.md has an example.

    Attributes
    ----------
    name : str
        The key in `Trajectory.binding`.
    margin : float
        The safety margin of the residual, in its unit, because penalties are soft and whole motions are
        evaluated at some instants only. With a residual below half of it the limit counts as satisfied.
    ends : sequence of FrameEnd
        Desired places of frames at the deadline, for the initial guesses of a search.
    joint_bounds : RobotLimits or None
        Hard bounds on rates, accelerations and positions of whole motions; a start outside is an error.
    in_braking : Limit or None
        A limit that must also hold if the arm stops after a step, if the rows of a single step are not
        sufficient.
    refusal : str
        The message for a start that violates the limit, if no motion from there can satisfy it; "{note}" is
        that of the violation. If empty, the search starts anyway.
    blocks, obstacles : bool and sequence of Obstacle
        True if a violation is a collision, from which a descent rarely recovers; and the obstacles that a
        search must avoid.
    holds_attitude : bool
        True if the limit holds the base's attitude, so that a search starts from motions that keep the
        attitude.
    eased_by_time : bool
        True if slower motions satisfy the limit more easily, so that a longer duration may be feasible.
    of_paper : bool
        True if `method="paper"` supports the limit, because its rows are always hard.
    """

    name: str = ""
    margin: float = 0.0
    ends: Sequence[FrameEnd] = ()
    joint_bounds: RobotLimits | None = None
    in_braking: Limit | None = None
    refusal: str = ""
    blocks: bool = False
    obstacles: Sequence[Obstacle] = ()
    holds_attitude: bool = False
    eased_by_time: bool = False
    of_paper: bool = True

    def for_robot(self, sms: SpaceManipulator) -> Limit:
        """Return the limit prepared for a robot; each solver calls it once. Default: the limit itself."""
        return self

    @abstractmethod
    def rows(self, step: StepState) -> Rows | None:
        """Return rows that keep the limit through one step of the paper's method; None: no rows."""

    @abstractmethod
    def residual(self, m: Any) -> Formula:
        """Return the violation of the limit with its margin, at least zero; an empty list: none.

        The residual is a variable computed from `m`, the `opt.Variables` of whole motions, divided by the
        violation that weighs like a position error of one arm length. `m.extra_margin` is to be added to the
        margin, in the limit's own unit.
        """

    @abstractmethod
    def violation(self, motion: Rollouts) -> Violation:
        """Return the violation by one finished motion, at its nodes and the middles between them."""

    def speed_bound(self, motion: Rollouts) -> SpeedBound | None:
        """Return bounds on the speed along a path, for the fastest time law; None: satisfied at any speed.

        `motion` is that of unit speed, ds/dt = 1, without momentum.
        """
        return None


def prepared(limit: Limit, sms: SpaceManipulator) -> Limit:
    """Return the limit for a robot (`Limit.for_robot`); raise `PartError` for an error in it."""
    try:
        made = limit.for_robot(sms)
    except FfsmsError:
        raise
    except Exception as error:
        raise PartError(limit, "for_robot", f"failed with {type(error).__name__}: {error}") from error
    instance("limit.for_robot", made, Limit)
    return made


# The safety margin as a share of a limit, for `Limit.margin`. With half of it, re-planned motions under a
# base limit of 1 degree missed their targets by up to 5 mm, with this value by a hundredth of that.
SHARE = 0.08
# The violation by a whole limit weighs like a clearance violation of this number of arm lengths.
SCALE = 0.03


class Inequality(Limit):
    """A limit as one formula: `slack(m)` >= 0.

    In a step the slack shrinks at most at a rate proportional to itself; a slack that depends on the joint
    rates, such as that of a speed, is at or above zero at the step's end. In whole motions the violation of
    the safety margin is a penalty. The least slack of the finished motion is the verdict.

    The attributes of the class are parameters, each with a default for a slack in metres;
    docs/own-parts.md explains them. All except `margin`, `rate`, `trusted`, `when` and `unit` are in the
    slack's unit.
    """

    unit: str = "m"  # the unit of the slack, for messages
    scale: float | None = None  # the slack that weighs like an error of one arm length; None: that length
    margin: float = 0.01  # the safety margin of whole motions as a share of `scale`, for soft penalties
    absolute_margin: float | None = None  # the same margin in the slack's unit; None: `margin` times `scale`
    rate: float = 2.0  # [1/s] the largest relative rate of decrease of the slack, for braking
    step_margin: float = 2e-3  # the safety margin of a step, for the motion within it
    softness: float = 1.0  # the violation of a step's row per unit of its slack variable [unit/m]; 0: hard
    # "always", "deadline" or "last tenth": the time at which the limit is active. Before that the slack of a
    # step may be negative by `trusted` [unit/s] times the remaining time.
    when: str = "always"
    trusted: float = 0.05
    active_below: float | None = None  # the slack below which it counts as active; None: 1.125 margins
    accuracy: float = 1e-6  # the violation up to which it counts as satisfied
    largest_extra_margin: float = np.inf  # bound of the additional margin, in the slack's unit

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "room" in vars(cls):
            raise PartError(cls, "room", "is called slack(m): rename the method")

    @abstractmethod
    def slack(self, m: Variables) -> Any:
        """Return the slack at every instant: a `Variable` (S, K) or (c, S, K), or a list of these."""

    def bounded_margin(self, m: Variables) -> float:
        """Return the additional margin of motions, bounded by `largest_extra_margin`."""
        return min(m.extra_margin, self.largest_extra_margin)

    def at_active_instants(self, m: Variables) -> Variables:
        """Return whole motions at the instants at which the limit is active."""
        if self.when == "always":
            return m
        return m.during(*(m.last_tenth[[0, -1]] if self.when == "last tenth" else (m.last, m.last)))

    def time_until_active(self, step: StepState) -> float | None:
        """Return the time until the limit is active, in a step [s]; None: it is always active."""
        if self.when == "always":
            return None
        late = (1.0 - ARRIVAL_SHARE) * (step.time + step.time_left)
        return step.time_left - (late if self.when == "last tenth" else 0.0)

    def slacks(self, m: Variables) -> Variable:
        """Stack all slacks into one vector (c, S, K)."""
        return _stacked(formulas(self, "slack", m), m)

    def rows(self, step: StepState) -> Rows | None:
        """Return rows of a step that bound the rate of the slack, or the slack at its end if that jumps."""
        seen = step.variables
        at = seen.change(self.slacks(seen))
        asked = np.isfinite(at.value)
        if not asked.any():
            return None
        value, flow, drift, jump = (x[asked] for x in at)
        due, most = self.time_until_active(step), np.full(len(value), UNBOUNDED)
        if due is not None:  # the missing slack at the step's end, and the rate at which it must shrink
            missing = self._scale_and_margin(seen.rollouts)[1] - value - step.dt * (flow @ step.rates + drift)
            spare = max(due - 10.0 * step.dt, 0.0)  # the limit must hold ten steps before it is active
            closing = self.rate * (missing - self.trusted * spare)
            if spare > 0.0:  # at most 1.5 times the mean rate over the remaining time
                closing = np.minimum(closing + self.trusted, 1.5 * missing / max(spare, 2.0 * step.dt))
            return Rows(flow, closing - drift, most, self.softness)
        left = value - self.step_margin
        jumps = jump.any(axis=1)
        # With u: flow . u + drift >= -rate left; or left + dt (flow . u + drift) + jump . (u - rates) >= 0.
        share = np.where(jumps, step.dt, 1.0)
        G = share[:, None] * flow + jump
        least = -np.where(jumps, left, self.rate * left) - share * drift + jump @ step.rates
        return Rows(G, least, most, self.softness)

    def margin_violation(self, m: Variables) -> Variable:
        """Return the violation (c, S, K) of the safety margin by whole motions, negative without one."""
        return self._scale_and_margin(m.rollouts)[1] + self.bounded_margin(m) - self.slacks(m)

    def residual(self, m: Variables) -> list[Variable]:
        """Return the violation of the safety margin over `scale`, at the instants at which there is any."""
        scale, counted = self._scale_and_margin(m.rollouts)[0], self.at_active_instants(m)
        if always := counted.where is None:
            lacks = self.margin_violation(m).value > 0.0
            lacking = np.nonzero(lacks.any(axis=0) if lacks.ndim == 3 else lacks)
            if not lacking[0].size:
                return []
            counted = m.at(*lacking)
        lack: Variable = np.maximum(self.margin_violation(counted), 0.0) / scale  # type: ignore[assignment]
        if not lack.value.any():
            return []
        return [lack if always else lack.at_once()]

    def _scale_and_margin(self, motions: Rollouts) -> tuple[float, float]:
        """Return `scale` and `absolute_margin`."""
        scale = motions.stack.length if self.scale is None else self.scale
        return scale, self.margin * scale if self.absolute_margin is None else self.absolute_margin

    def violation(self, motion: Rollouts) -> Violation:
        """Return the largest violation, also between instants, by the parabola through three of them."""
        counted = self.at_active_instants(Variables(motion))
        left, times = self.slacks(counted).value[:, 0], counted.times
        if not left.size:
            return Violation()
        # Penalties are soft, so the limit counts as active within 1.125 margins.
        binding = (
            1.125 * self._scale_and_margin(motion)[1] if self.active_below is None else self.active_below
        )
        binds = times[(left < binding).any(axis=0)]
        least = _least_between(left) if counted.where is None else left
        i, k = np.unravel_index(int(np.argmin(least)), least.shape)
        if least[i, k] > -self.accuracy:  # counts as satisfied
            return Violation(0.0, binds)
        return Violation(float(-least[i, k]), binds, self.note(float(least[i, k]), float(times[k])))

    def note(self, slack: float, time: float) -> str:
        """Return the message for a motion that violates the limit: the least slack, and its time [s]."""
        return f"the limit '{self.name}' is violated by {-slack:.3g} {self.unit} at {time:.3g} s"


class AllOf(Limit):
    """A group of inequalities with units of their own that are one limit."""

    @property
    @abstractmethod
    def parts(self) -> list[Inequality]:
        """The inequalities."""

    def rows(self, step: StepState) -> Rows | None:
        """Stack the rows of all inequalities."""
        return stacked([rows for part in self.parts if (rows := part.rows(step)) is not None])

    def residual(self, m: Variables) -> Any:
        """Return the list of residuals of all inequalities."""
        return [residuals_of(part, m) for part in self.parts]

    def violation(self, motion: Rollouts) -> Violation:
        """Return the largest violation of any inequality, with all notes and instants."""
        violations = [part.violation(motion) for part in self.parts]
        amount = max((violation.amount for violation in violations), default=0.0)
        notes = [violation.note for violation in violations if violation.note]
        instants = np.unique(np.concatenate([np.empty(0), *(item.instants for item in violations)]))
        return Violation(amount, instants, self.joined(notes) if notes else "")

    def joined(self, notes: list[str]) -> str:
        """Return the notes of violated inequalities as one message."""
        return "; ".join(notes)


def _stacked(slacks: list[Variable], m: Variables) -> Variable:
    """Stack numbers and vectors into one vector."""
    if len(slacks) == 1 and slacks[0].ndim == 3:
        return slacks[0]
    rows = [row for x in slacks for row in ([x] if x.ndim == 2 else [x[i] for i in range(len(x))])]
    shape = m.rollouts.rates.shape[1:]
    value = np.stack([row.value for row in rows]) if rows else np.zeros((0, *shape))

    def slopes() -> dict[str, FloatArray]:
        stacked_slopes: dict[str, FloatArray] = {}
        for i, row in enumerate(rows):
            for name, slope in row.slopes.items():
                if name not in stacked_slopes:
                    stacked_slopes[name] = np.zeros((len(rows), *slope.shape[:-2], *shape))
                stacked_slopes[name][i] = slope
        return stacked_slopes

    return Variable(value, slopes, m.where)


def _least_between(values: FloatArray) -> FloatArray:
    """Return the least values (c, K) of curves around their instants, nodes and middles.

    The value at a middle is the minimum of the parabola through the middle and its neighbours, if there is
    one.
    """
    least = values.copy()
    if values.shape[1] >= 3 and values.shape[1] % 2:
        finite = np.minimum(values, UNBOUNDED)
        before, here, after = finite[:, :-2:2], finite[:, 1:-1:2], finite[:, 2::2]
        bend, slope = 0.5 * (before + after) - here, 0.5 * (after - before)
        turns = np.abs(slope) < 2.0 * bend
        least[:, 1:-1:2] = here - np.where(turns, slope**2 / np.where(turns, 4.0 * bend, 1.0), 0.0)
    return least
