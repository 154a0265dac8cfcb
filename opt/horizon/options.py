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
        taken [s, whatever the duration]. A motion on the fine spline that costs more goes on on the finest
        one, and a plan that does is compared with marches of the step. With 8e-4 no plan costs 1e-3 more
        than a march: those that are compared take long steps, which cost up to 1e-4 more than short ones.
    coarse, fine, finest : Grid
        The coarse spline has ten control points a joint, enough for a zigzag of three strokes; the fine one
        about doubles that; on the finest the winners end: there the last tenth, where most of the cost is
        left, is fine enough for a tenth of the fine one's cost.
    last_iterations : int
        On the finest spline.
    near_radius : float
        [rad or m] Joint goals near the start are looked for from postures within this.
    goal_radius, arrived_radius : float
        [arm lengths] Straight moves that end further away are tried only where less than half of the group
        ends nearer; those that end as near as `arrived_radius` count as ending there.
    corrections : int
        Of a motion whose finished form misses what its quadrature hit.
    limit_reserve : float
        [arm lengths] More in hand for a limit that a finished motion broke.
    rest_rate : float
        [rad/s] A plan that is faster at its end has not come to rest.
    most_reversals, least_reversal : float
        A motion with more changes of sign a joint than `most_reversals` chatters; smaller products of rates
        than `least_reversal` [(rad/s)^2] do not count.
    around_obstacles : float
        Among obstacles a plan that costs so many times what ends the search without them ends it.
    widest_cone : float
        By how much C~ may exceed max(0, cos(theta_a)), log 2 / kappa, for marches to be tried as plans: with
        a smaller kappa the cone is so wide that a march spirals and misses the deadline.
    long_way : float
        Marches are tried as well where the joints travel more than so many times as far as on the shortest
        straight move: the cheapest motions found are sometimes detours, and a march rarely is one.
    march_steps : int
        Steps of the marches that are starts.
    judged_steps : int
        Motions of more than twice as many steps are judged in so many while the search goes on.
    without : sequence of str
        Names of strategies that are left out (`strategies.STRATEGIES`), to see what each earns.
    """

    time_limit: float | None = None
    cost_tolerance: float = 8e-4
    coarse: Grid = _COARSE
    fine: Grid = _FINE
    finest: Grid = _FINEST
    last_iterations: int = 10
    near_radius: float = 1.0
    goal_radius: float = 0.05
    arrived_radius: float = 1e-3
    corrections: int = 4
    limit_reserve: float = 1e-4
    rest_rate: float = 1e-3
    most_reversals: int = 8
    least_reversal: float = 1e-8
    around_obstacles: float = 3.0
    widest_cone: float = 0.2
    long_way: float = 3.0
    march_steps: int = 30
    judged_steps: int = 1000
    without: tuple[str, ...] = ()
