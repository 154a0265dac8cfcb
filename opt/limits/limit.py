"""What a limit is: rows of a step, a residual of whole motions, a violation of a finished motion."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray

if TYPE_CHECKING:
    from ffsms_pin.opt.goals.place import Place
    from ffsms_pin.opt.limits.clearance.obstacle import Obstacle
    from ffsms_pin.opt.limits.step_state import StepState
    from ffsms_pin.opt.motion.motions import Motions
    from ffsms_pin.opt.motion.robot_frame import RobotFrame
    from ffsms_pin.opt.parts.reading import Formula
    from ffsms_pin.opt.problem import Problem
    from ffsms_pin.opt.trajectory import Trajectory
    from ffsms_pin.system import SpaceManipulator

__all__ = [
    "UNBOUNDED",
    "ControlMaps",
    "ControlRows",
    "End",
    "Failed",
    "Limit",
    "Rows",
    "Violation",
    "stacked",
]

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
        never. A row must not give way only if it can always be kept.
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


class ControlMaps(NamedTuple):
    """Linear maps from a joint's M free control points to those of its motion, plus what is fixed.

    A spline lies within the range of its control points, so bounds on these hold at every instant.

    Attributes
    ----------
    rates, accelerations, positions : ndarray, shape (k, M)
    rates_fixed, accelerations_fixed, positions_fixed : ndarray, shape (k, n)
        What the state at the start adds.
    dt : float
        Step of the finished motion [s].
    """

    rates: FloatArray
    accelerations: FloatArray
    positions: FloatArray
    rates_fixed: FloatArray
    accelerations_fixed: FloatArray
    positions_fixed: FloatArray
    dt: float


class ControlRows(NamedTuple):
    """Rows lower <= matrix p_j + fixed_j <= upper for the control points p_j (M,) of every joint j.

    Attributes
    ----------
    kind : str
        "rate", "acceleration", "position": for messages.
    scale : float
        Makes rows of different kinds alike in size.
    matrix : ndarray, shape (k, M)
    fixed : ndarray, shape (k, n)
    lower, upper : ndarray, shape (n,)
    """

    kind: str
    scale: float
    matrix: FloatArray
    fixed: FloatArray
    lower: FloatArray
    upper: FloatArray


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
    """

    amount: float = 0.0
    instants: FloatArray = np.empty(0)
    note: str = ""


class End(NamedTuple):
    """Where a limit wants a frame of the robot at the deadline.

    Attributes
    ----------
    frame : RobotFrame
    place : Place
    """

    frame: RobotFrame
    place: Place


class Failed(NamedTuple):
    """A plan that does not reach.

    Attributes
    ----------
    problem : Problem
    plan : Trajectory
    motion : Motions
        The plan at its nodes and the middles between.
    again : callable
        Plans another problem, in a short search.
    """

    problem: Problem
    plan: Trajectory
    motion: Motions
    again: Callable[[Problem], Trajectory]


class Limit(ABC):
    """What must hold during a motion.

    A limit answers three questions, and the solvers only stack the answers. Make a subclass in a file of your
    own and hand it to `opt.Problem(limits=[...])`; docs/own-parts.md builds one.

    Attributes
    ----------
    name : str
        Key of `Trajectory.binding`.
    margin : float
        What the residual keeps in hand, in the residual's unit: a penalty gives way a little, and whole
        motions are watched at some instants only. A motion whose residual is below half of it counts as one
        that keeps the limit.
    of_goal : bool
        Whether a problem has the limit from its goal (`Goal.limits`); with another goal it goes.
    blocks : bool
        Whether something stands in the way where it is broken, such as a body: a descent rarely finds a way
        out of it, so the search follows such motions after others.
    obstacles : sequence of Obstacle
        What it keeps clear of. Where there are any, a search looks for ways round.
    holds_attitude : bool
        Whether it holds the base's attitude: a search then starts from motions that leave it as it was.
    bounds_joints : bool
        Whether it keeps the joints within the robot's limits: a start outside is an error then.
    eased_by_time : bool
        Whether a slower motion takes less of it: where it holds a plan back, a longer duration may do.
    of_paper : bool
        Whether `method="paper"` takes it: its rows never give way.
    """

    name: str
    margin: float = 0.0
    of_goal: bool = False
    blocks: bool = False
    obstacles: Sequence[Obstacle] = ()
    holds_attitude: bool = False
    bounds_joints: bool = False
    eased_by_time: bool = False
    of_paper: bool = True

    def for_robot(self, sms: SpaceManipulator) -> Limit:
        """The limit, prepared for a robot; called once by each solver. Default: itself."""
        return self

    def tightened(self, by: float) -> Limit:
        """The same limit with so much more in hand, in its own unit; default: the limit itself."""
        return self

    def later(self, by: float) -> Limit:
        """The same limit for a motion that begins `by` seconds later; default: the limit itself."""
        return self

    @abstractmethod
    def rows(self, step: StepState) -> Rows | None:
        """Rows that keep the limit through one step of the paper's method; None: nothing to keep."""

    @abstractmethod
    def residual(self, m: Any) -> Formula:
        """By how much motions break the limit or use up its margin, at least zero; an empty list: by nothing.

        Made of `m`, `opt.Features` of whole motions; with slopes by hand an `opt.Residual`.

        The unit is the limit's own over a scale that weighs like one arm's length of missed target.
        """

    @abstractmethod
    def violation(self, motion: Motions) -> Violation:
        """What a finished motion makes of it; `motion` is one, at its nodes and the middles between."""

    def ends(self) -> list[End]:
        """Where frames of the robot must be at the deadline, for motions that a search starts from."""
        return []

    def control_rows(self, maps: ControlMaps) -> list[ControlRows]:
        """Rows that the control points of whole motions keep strictly: for what is linear in them."""
        return []

    def check_start(self, problem: Problem, begin: Motions) -> str:
        """Why no motion keeps it from this start, in words; empty where one may.

        Parameters
        ----------
        problem : Problem
        begin : Motions
            A motion that stays at the start for a step.

        Raises
        ------
        InvalidValue
            Where the problem itself must be mended.
        """
        return ""

    def explain(self, failed: Failed) -> str:
        """What to say of it, in words, where it binds in a plan that does not reach; default: nothing."""
        return ""

    def settle(self, step: StepState, rates: FloatArray, braking: FloatArray) -> FloatArray:
        """Joint rates (n,) to take instead of the chosen `rates`, where rows alone do not see far enough.

        Parameters
        ----------
        step : StepState
        rates : ndarray, shape (n,)
            The solution of the step's programme [rad/s].
        braking : ndarray, shape (n,)
            Rates at the step's end of an arm that brakes as fast as its joints may [rad/s].
        """
        return rates
