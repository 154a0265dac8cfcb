"""Limits: rows of a step, a residual of whole motions, and the violation of a finished motion.

An `Inequality` is a limit as one formula: rows, penalty and verdict follow from what is left.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray, instance, put
from ffsms_pin.errors import FfsmsError, PartError
from ffsms_pin.opt.derivatives import Feature, Features
from ffsms_pin.opt.evaluation import UNBOUNDED, Formula, Rows, Violation, formulas, residuals_of, stacked
from ffsms_pin.opt.rollouts import ARRIVAL_SHARE, Motions

if TYPE_CHECKING:
    from ffsms_pin.geometry.obstacle import Obstacle
    from ffsms_pin.opt.derivatives import RobotFrame
    from ffsms_pin.opt.goals.goal import Place
    from ffsms_pin.opt.step.state import StepState
    from ffsms_pin.robot import SpaceManipulator
    from ffsms_pin.system import RobotLimits


class End(NamedTuple):
    """Where a limit wants a frame of the robot at the deadline."""

    frame: RobotFrame
    place: Place


class Limit(ABC):
    """What must hold during a motion: answers to three questions, which the solvers only stack.

    Make a subclass in a file of your own and hand it to `opt.Problem(limits=[...])`; docs/own-parts.md
    builds one.

    Attributes
    ----------
    name : str
        Key of `Trajectory.binding`.
    margin : float
        What the residual keeps in hand, in its unit: a penalty gives way a little, and whole motions are
        watched at some instants only. With a residual below half of it the limit counts as kept.
    reserve, began : float
        What rows and residual keep in hand beyond that, in the limit's own unit (`tightened`); and when the
        motion began, in the limit's own times [s] (`later`).
    ends : sequence of End
        Where frames of the robot must be at the deadline, for motions that a search starts from.
    joint_bounds : RobotLimits or None
        Rates, accelerations and positions that whole motions never leave; a start outside is an error.
    in_braking : Limit or None
        What a step keeps also were the arm to stop after it, where rows of one step do not see far enough.
    refusal : str
        What to say of a start that breaks it, where no motion from there will do; "{note}" is the
        violation's. Empty: the search tries.
    of_goal : bool
        Whether a problem made the limit of its goal (`Goal.limits`); set by the problem. A problem that is
        rebuilt with another goal has the limits of that goal instead.
    blocks, obstacles : bool and sequence of Obstacle
        Whether something stands in the way where it is broken: a descent rarely finds a way out of it. What
        it keeps clear of: a search looks for ways round.
    holds_attitude : bool
        Whether it holds the base's attitude: a search then starts from motions that leave it as it was.
    eased_by_time : bool
        Whether a slower motion takes less of it: where it holds a plan back, a longer duration may do.
    of_paper : bool
        Whether `method="paper"` takes it: its rows never give way.
    """

    name: str
    margin: float = 0.0
    reserve: float = 0.0
    began: float = 0.0
    ends: Sequence[End] = ()
    joint_bounds: RobotLimits | None = None
    in_braking: Limit | None = None
    refusal: str = ""
    of_goal: bool = False
    blocks: bool = False
    obstacles: Sequence[Obstacle] = ()
    holds_attitude: bool = False
    eased_by_time: bool = False
    of_paper: bool = True

    def for_robot(self, sms: SpaceManipulator) -> Limit:
        """The limit, prepared for a robot; called once by each solver. Default: itself."""
        return self

    @abstractmethod
    def rows(self, step: StepState) -> Rows | None:
        """Rows that keep the limit through one step of the paper's method; None: nothing to keep."""

    @abstractmethod
    def residual(self, m: Any) -> Formula:
        """By how much motions break the limit or use up its margin, at least zero; an empty list: by nothing.

        A feature made of `m`, the `opt.Features` of whole motions, in the limit's own unit over a scale that
        weighs like one arm's length of missed target.
        """

    @abstractmethod
    def violation(self, motion: Motions) -> Violation:
        """What a finished motion makes of it; `motion` is one, at its nodes and the middles between."""


def tightened(limit: Limit, by: float) -> Limit:
    """The same limit with so much more in hand, in its own unit."""
    return _changed(limit, reserve=limit.reserve + by)


def later(limit: Limit, by: float) -> Limit:
    """The same limit for the rest of a motion, from `by` seconds on; also where that has another goal."""
    return _changed(limit, began=limit.began + by, of_goal=False)


def made_of_goal(limit: Limit) -> Limit:
    """Return the limit marked as one that a problem made of its goal."""
    return _changed(limit, of_goal=True)


def prepared(limit: Limit, sms: SpaceManipulator) -> Limit:
    """The limit for a robot (`Limit.for_robot`), with what it was told before."""
    try:
        made = limit.for_robot(sms)
    except FfsmsError:
        raise
    except Exception as error:
        raise PartError(limit, "for_robot", f"failed with {type(error).__name__}: {error}") from error
    instance("limit.for_robot", made, Limit)
    told = {name: getattr(limit, name) for name in ("reserve", "began", "of_goal")}
    return made if all(getattr(made, name) == one for name, one in told.items()) else _changed(made, **told)


def _changed(limit: Limit, **values: Any) -> Limit:
    """A copy with other attributes."""
    made = copy.copy(limit)
    put(made, **values)
    return made


# Share of a limit kept in hand, as `Limit.margin`. With half of it re-planned motions ended up to 5 mm off
# their targets under a base limit of 1 degree, with this a hundredth of that.
SHARE = 0.08
# What a whole limit weighs: as much as a lack of clearance of this many arm lengths.
SCALE = 0.03


class Inequality(Limit):
    """What is left of something, `room(m)`, stays at or above zero: a whole limit.

    In a step room shrinks at most at a rate proportional to what is left; what depends on the joint rates
    themselves, such as a speed, must be there at the step's end. In whole motions what it lacks is a penalty,
    and at the end the least of it is the verdict.

    Attributes of the class say how, each with a default for room in metres; docs/own-parts.md explains them.
    """

    unit: str = "m"  # of room, for messages
    scale: float | None = None  # so much of room weighs like a target missed by an arm's length; None: that
    margin: float = 0.01  # share of `scale` that whole motions keep in hand: a penalty gives way a little
    in_hand: float | None = None  # the same in room's unit; None: `margin` times `scale`
    rate: float = 2.0  # [1/s] room may shrink at most so fast relative to itself, so that the arm can brake
    step_margin: float = 2e-3  # what a step keeps in hand, in room's unit: for what happens within it
    # How far a step's row gives way per unit of its slack, in room's unit per metre; 0: never.
    give: float = 1.0
    # "always", "deadline" or "last tenth": when there must be room. Before that a step may go without as much
    # as the arm is trusted to make up in the time that is left, in room's unit a second.
    when: str = "always"
    trusted: float = 0.05
    binding: float | None = None  # with less room it binds; None: with a little more than is kept in hand
    accuracy: float = 1e-6  # a lack of no more than this counts as kept, in room's unit
    most_reserve: float = np.inf  # of `Limit.reserve` no more than this is kept, in room's unit

    @abstractmethod
    def room(self, m: Features) -> Any:
        """What is left at every instant: a `Feature` (S, K) or (c, S, K), or a list of these."""

    @property
    def kept(self) -> float:
        """What of `reserve` is kept, in room's unit."""
        return min(self.reserve, self.most_reserve)

    def counted(self, m: Features) -> Features:
        """Whole motions at the instants at which there must be room."""
        if self.when == "always":
            return m
        return m.during(*(m.last_tenth[[0, -1]] if self.when == "last tenth" else (m.last, m.last)))

    def due(self, step: StepState) -> float | None:
        """How long until there must be room, in a step [s]; None: there always must."""
        if self.when == "always":
            return None
        late = (1.0 - ARRIVAL_SHARE) * (step.time + step.time_left)
        return step.time_left - (late if self.when == "last tenth" else 0.0)

    def rooms(self, m: Features) -> Feature:
        """What is left, all of it one below the other, (c, S, K)."""
        return _stacked(formulas(self, "room", m), m)

    def rows(self, step: StepState) -> Rows | None:
        """Rows of a step: what moves uses room up slowly, what jumps leaves room at the step's end."""
        seen = step.features
        at = seen.change(self.rooms(seen))
        asked = np.isfinite(at.value)
        if not asked.any():
            return None
        value, flow, drift, jump = (x[asked] for x in at)
        due, most = self.due(step), np.full(len(value), UNBOUNDED)
        if due is not None:  # what is missing at the step's end, and how fast it must shrink
            missing = self._kept(seen.motions)[1] - value - step.dt * (flow @ step.rates + drift)
            spare = max(due - 10.0 * step.dt, 0.0)  # ten steps before it is due it should be there
            closing = self.rate * (missing - self.trusted * spare)
            if spare > 0.0:  # at most 1.5 times the mean speed of what is left
                closing = np.minimum(closing + self.trusted, 1.5 * missing / max(spare, 2.0 * step.dt))
            return Rows(flow, closing - drift, most, self.give)
        left = value - self.kept - self.step_margin
        jumps = jump.any(axis=1)
        # With u: flow . u + drift >= -rate left; or left + dt (flow . u + drift) + jump . (u - rates) >= 0.
        share = np.where(jumps, step.dt, 1.0)
        G = share[:, None] * flow + jump
        least = -np.where(jumps, left, self.rate * left) - share * drift + jump @ step.rates
        return Rows(G, least, most, self.give)

    def lack(self, m: Features) -> Feature:
        """What room lacks of what whole motions keep in hand, (c, S, K); below zero where there is enough."""
        return self._kept(m.motions)[1] + self.kept - self.rooms(m)

    def residual(self, m: Features) -> list[Feature]:
        """What room lacks of what is kept in hand, over `scale`, where it lacks some."""
        scale, counted = self._kept(m.motions)[0], self.counted(m)
        if always := counted.where is None:
            lacks = self.lack(m).value > 0.0
            lacking = np.nonzero(lacks.any(axis=0) if lacks.ndim == 3 else lacks)
            if not lacking[0].size:
                return []
            counted = m.at(*lacking)
        lack: Feature = np.maximum(self.lack(counted), 0.0) / scale  # type: ignore[assignment]
        if not lack.value.any():
            return []
        return [lack if always else lack.at_once()]

    def _kept(self, motions: Motions) -> tuple[float, float]:
        """`scale` and `in_hand`."""
        scale = motions.stack.length if self.scale is None else self.scale
        return scale, self.margin * scale if self.in_hand is None else self.in_hand

    def violation(self, motion: Motions) -> Violation:
        """The greatest lack, also between instants: there the parabola through three of them counts."""
        counted = self.counted(Features(motion))
        left, times = self.rooms(counted).value[:, 0], counted.times
        if not left.size:
            return Violation()
        # A penalty gives way a little: the limit binds where a little more is left than is kept in hand.
        binding = 1.125 * self._kept(motion)[1] if self.binding is None else self.binding
        binds = times[(left < binding).any(axis=0)]
        least = _least_between(left) if counted.where is None else left
        i, k = np.unravel_index(int(np.argmin(least)), least.shape)
        if least[i, k] > -self.accuracy:  # it counts as kept
            return Violation(0.0, binds)
        return Violation(float(-least[i, k]), binds, self.note(float(least[i, k]), float(times[k])))

    def note(self, room: float, time: float) -> str:
        """What is said of a motion that breaks the limit: the least room, and when [s]."""
        return f"the limit '{self.name}' is broken by {-room:.3g} {self.unit} at {time:.3g} s"


class AllOf(Limit):
    """Inequalities in units of their own that are given, kept and reported together."""

    @property
    @abstractmethod
    def parts(self) -> list[Inequality]:
        """The inequalities."""

    def rows(self, step: StepState) -> Rows | None:
        """Of all of them."""
        return stacked([rows for part in self.parts if (rows := part.rows(step)) is not None])

    def residual(self, m: Features) -> Any:
        """Of all of them."""
        return [residuals_of(part, m) for part in self.parts]

    def violation(self, motion: Motions) -> Violation:
        """The largest amount of any of them."""
        found = [part.violation(motion) for part in self.parts]
        amount = max((one.amount for one in found), default=0.0)
        notes = [one.note for one in found if one.note]
        instants = np.unique(np.concatenate([np.empty(0), *(one.instants for one in found)]))
        return Violation(amount, instants, self.told(notes) if notes else "")

    def told(self, notes: list[str]) -> str:
        """What is said of a motion that breaks some: their notes, in one."""
        return "; ".join(notes)


def _stacked(rooms: list[Feature], m: Features) -> Feature:
    """Numbers and vectors one below the other, as one vector."""
    if len(rooms) == 1 and rooms[0].ndim == 3:
        return rooms[0]
    rows = [row for one in rooms for row in ([one] if one.ndim == 2 else [one[i] for i in range(len(one))])]
    shape = m.motions.rates.shape[1:]
    value = np.stack([row.value for row in rows]) if rows else np.zeros((0, *shape))

    def slopes() -> dict[str, FloatArray]:
        found: dict[str, FloatArray] = {}
        for i, row in enumerate(rows):
            for name, slope in row.slopes.items():
                if name not in found:
                    found[name] = np.zeros((len(rows), *slope.shape[:-2], *shape))
                found[name][i] = slope
        return found

    return Feature(value, slopes, m.where)


def _least_between(values: FloatArray) -> FloatArray:
    """Least values (c, K) of curves around their instants: two steps' ends and the middle between.

    At a middle it is that of the parabola through it and its neighbours, where this turns between them.
    """
    least = values.copy()
    if values.shape[1] >= 3 and values.shape[1] % 2:
        finite = np.minimum(values, UNBOUNDED)
        before, here, after = finite[:, :-2:2], finite[:, 1:-1:2], finite[:, 2::2]
        bend, slope = 0.5 * (before + after) - here, 0.5 * (after - before)
        turns = np.abs(slope) < 2.0 * bend
        least[:, 1:-1:2] = here - np.where(turns, slope**2 / np.where(turns, 4.0 * bend, 1.0), 0.0)
    return least
