"""What a limit is: rows of a step, a residual of whole motions, a violation of a finished motion."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray, instance, put
from ffsms_pin.errors import FfsmsError, PartError

if TYPE_CHECKING:
    from ffsms_pin.geometry.obstacle import Obstacle
    from ffsms_pin.opt.goals.place import Place
    from ffsms_pin.opt.motion.frame import RobotFrame
    from ffsms_pin.opt.motion.motions import Motions
    from ffsms_pin.opt.parts.reading import Formula
    from ffsms_pin.opt.step.state import StepState
    from ffsms_pin.robot import SpaceManipulator
    from ffsms_pin.system import JointLimits

# What stands for "no bound" in a quadratic programme; finite, so that sums stay numbers.
UNBOUNDED = 1e20


class Rows(NamedTuple):
    """Rows lower <= G u <= upper, up to a slack, in the joint rates u at the step's end.

    Attributes
    ----------
    G : ndarray, shape (k, n)
    lower, upper : ndarray, shape (k,)
        `UNBOUNDED` with its sign where a row has one side only.
    give : float
        How far a row gives way per unit of the programme's slack, in the row's unit per metre a second; 0:
        never, for what can always be kept.
    """

    G: FloatArray
    lower: FloatArray
    upper: FloatArray
    give: float = 0.0


def stacked(rows: list[Rows]) -> Rows | None:
    """Rows one below the other, which all give way alike; None: no rows."""
    if len(rows) < 2:
        return rows[0] if rows else None
    G, lower, upper = (np.concatenate(parts) for parts in zip(*(one[:3] for one in rows), strict=True))
    return Rows(G, lower, upper, max(one.give for one in rows))


class Violation(NamedTuple):
    """What a finished motion makes of a limit.

    Attributes
    ----------
    amount : float
        How far the limit is broken at most, in its own unit; zero where it is kept.
    instants : ndarray, shape (k,)
        Times at which the limit binds: where less than a small share of it is left, or it is broken [s].
    note : str
        What is broken, with values and units, in words; empty where the limit is kept.
    nearest : str
        What comes nearest to what, in words, of a limit that `blocks`: for a plan that it holds back.
    overlap : str
        What is inside an obstacle, in words: no motion can start like that.
    """

    amount: float = 0.0
    instants: FloatArray = np.empty(0)
    note: str = ""
    nearest: str = ""
    overlap: str = ""


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
    joint_bounds : JointLimits or None
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
    joint_bounds: JointLimits | None = None
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
