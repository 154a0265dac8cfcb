"""The numbers that the search was tuned with, each with its unit and why."""

from __future__ import annotations

from dataclasses import dataclass

from ffsms_pin.opt.horizon.spline import Grid

__all__ = ["SearchOptions"]

_COARSE, _FINE, _FINEST = Grid(6, 3, 2), Grid(12, 5, 3), Grid(24, 8, 4)


@dataclass(frozen=True)
class SearchOptions:
    """Numbers of the search; the defaults were tuned on the packaged robots.

    Attributes
    ----------
    time_limit : float, optional
        After so long [s] the best plan so far is returned; it is looked at between motions. Default: no
        limit.
    cost_tolerance : float
        Of motions that cost at most so much more than the cheapest one found, the one of least effort is
        taken [s, for motions up to 8 s].
    coarse, fine, finest : Grid
        The coarse spline has ten control points a joint, enough for a zigzag of three strokes; the fine one
        about doubles that; on the finest the winners end: there the last tenth, where most of the cost is
        left, is fine enough for a tenth of the fine one's cost.
    nearly_free : float
        A motion on the fine spline that costs more [s, for motions up to 8 s] goes on on the finest one.
    last_iterations : int
        On the finest spline.
    near : float
        [rad or m] Joint goals near the start are looked for from postures within this.
    near_goal, there : float
        [arm lengths] Straight moves that end further away are tried only where less than half of the group
        ends nearer; those that end as near as `there` count as ending there.
    straight : int
        Straight moves that are tried where nothing else arrives.
    landings : int
        Of a motion whose finished form misses what its quadrature hit.
    spare : float
        [arm lengths] More in hand for a limit that a finished motion broke.
    moving : float
        [rad/s] A plan that is faster at its end has not come to rest.
    turns, still : float
        A motion with more changes of sign a joint than `turns` chatters; smaller products of rates than
        `still` [(rad/s)^2] do not count.
    widest : float
        By how much C~ may exceed max(0, cos(theta_a)), log 2 / kappa, for marches to be tried as plans: with
        a smaller kappa the cone is so wide that a march spirals and misses the deadline.
    march_steps : int
        Steps of the marches that are starts.
    """

    time_limit: float | None = None
    cost_tolerance: float = 1e-3
    coarse: Grid = _COARSE
    fine: Grid = _FINE
    finest: Grid = _FINEST
    nearly_free: float = 1e-3
    last_iterations: int = 10
    near: float = 1.0
    near_goal: float = 0.05
    there: float = 1e-3
    straight: int = 6
    landings: int = 3
    spare: float = 1e-4
    moving: float = 1e-3
    turns: int = 8
    still: float = 1e-8
    widest: float = 0.2
    march_steps: int = 30
