"""What the descent must aim at so that the finished motion does what the problem asks.

The descent sees the motion at the instants of a quadrature; the finished one is rolled out at its nodes.
Where the two differ, by a millimetre at a long arm's end or by a corner of the base between two instants, the
descent is given another goal: beside the true one by as much as the finished motion missed it, and with less
reach where that motion ends at the goal but is too far from it in the last tenth; and limits with more in
hand where it broke one.
"""

from __future__ import annotations

import pinocchio as pin

from ffsms_pin.opt.goals import Changed, Goal
from ffsms_pin.opt.goals.contact import end_errors
from ffsms_pin.opt.problem import ARRIVAL_SHARE, Problem
from ffsms_pin.opt.trajectory import Trajectory

__all__ = ["arrival_error", "corrected_goal"]

_SPARE = 0.95  # of the reaches: what a corrected motion shall use of them in the last tenth


def arrival_error(goal: Goal, plan: Trajectory) -> float:
    """The largest error at the deadline [m, rad], and of velocities that the goal asks for [m/s, rad/s]."""
    last = float(plan.position_error[-1]), float(plan.orientation_error[-1])
    return float(end_errors(goal, *last, plan.contact_velocity, plan.duration).max())


def corrected_goal(problem: Problem, goal: Goal, plan: Trajectory) -> Goal | None:
    """The next goal, after a landing at `goal` gave this plan; None where the plan arrives."""
    if plan.reached and arrival_error(problem.goal, plan) <= problem.goal.tolerance:
        return None
    place, q = problem.goal.place(problem.duration), plan.q[-1]
    missed = place.missed(place.seen(problem.sms.at(q).end_effector_pose, q))
    way, turn = missed.way.value[:, 0, 0], pin.exp3(missed.vector[:, 0, 0])
    late, nearer = _late_share(problem.goal, plan), 1.0
    if late > 1.0 and arrival_error(problem.goal, plan) <= problem.goal.tolerance:
        nearer = _SPARE / late
    return Changed(
        goal,
        lambda place: place.moved(way, turn),
        reach=nearer * goal.reach,
        orientation_reach=nearer * goal.orientation_reach,
    )


def _late_share(goal: Goal, plan: Trajectory) -> float:
    """The largest error in the last tenth, as a share of the goal's reaches."""
    late = plan.t >= ARRIVAL_SHARE * plan.duration - 1e-9
    errors = (plan.position_error, goal.reach), (plan.orientation_error, goal.orientation_reach)
    return max(float(error[late].max()) / reach for error, reach in errors)
