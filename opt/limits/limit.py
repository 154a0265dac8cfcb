"""Base classes of limits: rows of a step, a residual of whole motions, and a violation of a finished motion.

A subclass of `Inequality` defines the slack only; rows, residual and violation are derived from it.
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
from ffsms_pin.opt.rollouts import ARRIVAL_SHARE, RecordedRollouts, Rollouts

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
    """The bounds |at_rest + slope s'| <= most and |slope s'' + bend s'^2| <= most_change along a path.

    s is the share of the path, s' and s'' are its derivatives with respect to time. If `bend` is the
    derivative of `slope` with respect to s, the second sum is the rate of change of the first.
    """

    at_rest: FloatArray  # (c,)
    slope: FloatArray  # (c, K) at the instants of the motion
    most: FloatArray  # (c,); infinity: no bound
    most_change: FloatArray  # (c,); infinity: no bound
    bend: FloatArray | None = None  # (c, K); None: the derivative of `slope`


class Limit(ABC):
    """A condition that a motion must satisfy.

    A limit has rows for single steps, a residual for whole motions, and the violation by a finished motion. A
    user's own limit is a subclass, passed as `opt.Problem(limits=[...])`; see docs/own-parts.md.

    Attributes
    ----------
    name : str
        The key in `Trajectory.binding`.
    margin : float
        The safety margin in the unit of the residual, because penalties are soft and whole motions are
        evaluated at some instants only. In a search the limit is satisfied if its residual is below half
        of the margin.
    ends : sequence of FrameEnd
        Desired places of frames at the deadline, for the initial guesses of a search.
    joint_bounds : RobotLimits or None
        Hard bounds on rates, accelerations and positions of whole motions; a start outside is an error.
    in_braking : Limit or None
        The limit that must hold while the arm stops after a step; None if the rows of the step ensure this.
    refusal : str
        The message for a start that violates the limit. It contains "{note}", which is replaced by the note
        of the violation. If it is empty, the search starts anyway.
    blocks : bool
        True if a violation is a collision, from which a descent rarely recovers.
    obstacles : sequence of Obstacle
        The obstacles that a search must avoid.
    holds_attitude : bool
        True if the limit bounds the base's rotation. A search then prefers initial guesses with little base
        rotation, except in re-planning.
    eased_by_time : bool
        True if slower motions satisfy the limit more easily, so that a longer duration may be feasible.
    of_paper : bool
        True if `method="paper"`, in which all rows are hard, supports the limit.
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
        """Return the limit for a robot, when a problem or a stepper is created. Default: the limit itself."""
        return self

    @abstractmethod
    def rows(self, step: StepState) -> Rows | None:
        """Return rows that ensure the limit during a single step; None: no rows."""

    @abstractmethod
    def residual(self, m: Any) -> Formula:
        """Return the violation of the limit including its margin, zero if the margin is kept.

        The residual is a variable, or a list of variables, computed from `m`, the `opt.Variables` of whole
        motions. It is divided by the violation that has the same cost as a position error of one arm length.
        `m.extra_margin`, in the limit's own unit, must be added to the margin. A limit without a residual
        returns an empty list.
        """

    @abstractmethod
    def violation(self, motion: Rollouts) -> Violation:
        """Return the violation by one finished motion, evaluated at its nodes and their midpoints."""

    def violation_in_flight(self, motion: RecordedRollouts) -> Violation:
        """Return the violation by a recorded motion, at its rows. Default: `violation`."""
        return self.violation(motion)

    def speed_bound(self, motion: Rollouts) -> SpeedBound | None:
        """Return bounds on the speed along a path, for the fastest time law; None: satisfied at any speed.

        `motion` is the motion along the path with unit speed, ds/dt = 1, and without momentum.
        """
        return None


def prepared(limit: Limit, sms: SpaceManipulator) -> Limit:
    """Return the limit for a robot (`Limit.for_robot`); raise `PartError` if that method fails."""
    try:
        made = limit.for_robot(sms)
    except FfsmsError:
        raise
    except Exception as error:
        raise PartError(limit, "for_robot", f"failed with {type(error).__name__}: {error}") from error
    instance(f"{type(limit).__name__}.for_robot(sms)", made, Limit)
    return made


# The safety margin as a share of a bound, for `Limit.margin`. With a margin of 0.04, re-planned motions under
# a base limit of 1 degree missed their targets by up to 5 mm, with 0.08 by up to 0.05 mm.
SHARE = 0.08
# A violation as large as the bound has the same cost as a violation of a clearance by this share of the arm
# length.
SCALE = 0.03
# The excess over a joint limit that is attributed to control errors in flight: of a position [rad or m], and
# of a rate as a share of its limit.
POSITION_MARGIN, RATE_MARGIN = 1e-3, 0.04


class Inequality(Limit):
    """A limit as one formula, `slack(m)` >= 0.

    In a step the slack above `step_margin` decreases at most at a rate proportional to itself. If the slack
    depends on the joint rates, for example in a speed limit, it must be at least `step_margin` at the step's
    end. Steps before a limit is active (`when`) differ. In whole motions the violation of the safety margin
    is penalised. The violation by a finished motion is the magnitude of its least slack if this slack is
    below -`accuracy`.

    The attributes of the class are parameters with defaults for a slack in metres; docs/own-parts.md explains
    them. All except `margin`, `rate`, `softness`, `trusted`, `when` and `unit` are in the slack's unit.
    """

    unit: str = "m"  # the unit of the slack, for messages
    # the violation that has the same cost as a position error of one arm length; None: one arm length
    scale: float | None = None
    margin: float = 0.01  # the safety margin of whole motions as a share of `scale`; penalties are soft
    absolute_margin: float | None = None  # the same margin in the slack's unit; None: `margin` times `scale`
    rate: float = 2.0  # [1/s] in a step, the largest rate of decrease of the slack divided by the slack
    step_margin: float = 2e-3  # the safety margin of a step, for the motion within the step
    softness: float = 1.0  # the relaxation of a row per unit of the step's slack [unit/m]; 0: hard
    # The time at which the limit is active: "always", "deadline" or "last tenth". Before that, the slack of
    # a step may be negative by `trusted` [unit/s] times the remaining time.
    when: str = "always"
    trusted: float = 0.05
    active_below: float | None = None  # the slack below which the limit is active; None: 1.125 margins
    accuracy: float = 1e-6  # the largest violation of a satisfied limit
    largest_extra_margin: float = np.inf  # the upper bound on the additional margin `m.extra_margin`

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "room" in vars(cls):
            raise PartError(cls, "room", "has the new name slack(m); rename the method")

    @abstractmethod
    def slack(self, m: Variables) -> Any:
        """Return the slack at every instant, a `Variable` (S, K) or (c, S, K), or a list of these."""

    def bounded_margin(self, m: Variables) -> float:
        """Return the additional margin that a search requires, at most `largest_extra_margin`."""
        return min(m.extra_margin, self.largest_extra_margin)

    def at_active_instants(self, m: Variables) -> Variables:
        """Return whole motions at the instants at which the limit is active."""
        if self.when == "always":
            return m
        return m.during(*(m.last_tenth[[0, -1]] if self.when == "last tenth" else (m.last, m.last)))

    def time_until_active(self, step: StepState) -> float | None:
        """Return the time from the step's start until the limit is active [s]; None if always active."""
        if self.when == "always":
            return None
        late = (1.0 - ARRIVAL_SHARE) * (step.time + step.time_left)
        return step.time_left - (late if self.when == "last tenth" else 0.0)

    def slacks(self, m: Variables) -> Variable:
        """Return all slacks, stacked into one vector (c, S, K)."""
        return _stacked(formulas(self, "slack", m), m)

    def rows(self, step: StepState) -> Rows | None:
        """Return rows that bound the rate of the slack, or its end value if it depends on joint rates."""
        variables = step.variables
        at = variables.change(self.slacks(variables))
        finite = np.isfinite(at.value)
        if not finite.any():
            return None
        value, flow, drift, jump = (x[finite] for x in at)
        due, most = self.time_until_active(step), np.full(len(value), UNBOUNDED)
        if due is not None:  # the missing slack after a step at the present rates, and its rate of decrease
            margin = self._scale_and_margin(variables.rollouts)[1]
            missing = margin - value - step.dt * (flow @ step.rates + drift)
            spare = max(due - 10.0 * step.dt, 0.0)  # the limit must hold ten steps before it is active
            closing = self.rate * (missing - self.trusted * spare)
            if spare > 0.0:  # at most 1.5 times the mean rate over the remaining time
                closing = np.minimum(closing + self.trusted, 1.5 * missing / max(spare, 2.0 * step.dt))
            return Rows(flow, closing - drift, most, self.softness)
        slack = value - self.step_margin
        jumps = jump.any(axis=1)
        # The joint rates u at the step's end satisfy flow . u + drift >= -rate slack, or, if the slack
        # depends on rates, slack + dt (flow . u + drift) + jump . (u - rates) >= 0.
        share = np.where(jumps, step.dt, 1.0)
        G = share[:, None] * flow + jump
        least = -np.where(jumps, slack, self.rate * slack) - share * drift + jump @ step.rates
        return Rows(G, least, most, self.softness)

    def margin_violation(self, m: Variables) -> Variable:
        """Return the violation (c, S, K) of the safety margin by whole motions; it may be negative."""
        return self._scale_and_margin(m.rollouts)[1] + self.bounded_margin(m) - self.slacks(m)

    def residual(self, m: Variables) -> list[Variable]:
        """Return the violation of the safety margin divided by `scale`.

        If the limit is always active, the residual contains only the instants with a violation.
        """
        scale, active = self._scale_and_margin(m.rollouts)[0], self.at_active_instants(m)
        if always := active.where is None:
            violated = self.margin_violation(m).value > 0.0
            indices = np.nonzero(violated.any(axis=0) if violated.ndim == 3 else violated)
            if not indices[0].size:
                return []
            active = m.at(*indices)
        excess: Variable = np.maximum(self.margin_violation(active), 0.0) / scale  # type: ignore[assignment]
        if not excess.value.any():
            return []
        return [excess if always else excess.at_once()]

    def _scale_and_margin(self, motions: Rollouts) -> tuple[float, float]:
        """Return `scale` and `absolute_margin`, with their defaults for None."""
        scale = motions.stack.length if self.scale is None else self.scale
        return scale, self.margin * scale if self.absolute_margin is None else self.absolute_margin

    def violation(self, motion: Rollouts) -> Violation:
        """Return the largest violation; for `when` "always" parabolas estimate minima between nodes."""
        active = self.at_active_instants(Variables(motion))
        slacks, times = self.slacks(active).value[:, 0], active.times
        if not slacks.size:
            return Violation()
        # Penalties are soft, so by default the limit counts as active within 1.125 margins.
        binding = (
            1.125 * self._scale_and_margin(motion)[1] if self.active_below is None else self.active_below
        )
        binds = times[(slacks < binding).any(axis=0)]
        least = _least_between(slacks) if active.where is None else slacks
        i, k = np.unravel_index(int(np.argmin(least)), least.shape)
        if least[i, k] > -self.accuracy:  # the limit is satisfied
            return Violation(0.0, binds)
        return Violation(float(-least[i, k]), binds, self.note(float(least[i, k]), float(times[k])))

    def note(self, slack: float, time: float) -> str:
        """Return the message for a motion whose least slack, at a time [s], violates the limit."""
        return f"the limit '{self.name}' is violated by {-slack:.3g} {self.unit} at {time:.3g} s"


class AllOf(Limit):
    """A limit that consists of several inequalities, which may have different units."""

    @property
    @abstractmethod
    def parts(self) -> list[Inequality]:
        """The inequalities."""

    def rows(self, step: StepState) -> Rows | None:
        """Stack the rows of all inequalities."""
        return stacked([rows for part in self.parts if (rows := part.rows(step)) is not None])

    def residual(self, m: Variables) -> Any:
        """Return the residuals of all inequalities."""
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
    """Stack scalars (S, K) and vectors (c, S, K) into one vector."""
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
    """Replace values (c, K) at midpoints by minima of parabolas, and return them with the values at nodes.

    Each parabola goes through a midpoint and its neighbours. If it has no minimum between the neighbours, the
    value is unchanged.
    """
    least = values.copy()
    if values.shape[1] >= 3 and values.shape[1] % 2:
        finite = np.minimum(values, UNBOUNDED)
        before, here, after = finite[:, :-2:2], finite[:, 1:-1:2], finite[:, 2::2]
        bend, slope = 0.5 * (before + after) - here, 0.5 * (after - before)
        turns = np.abs(slope) < 2.0 * bend
        least[:, 1:-1:2] = here - np.where(turns, slope**2 / np.where(turns, 4.0 * bend, 1.0), 0.0)
    return least
