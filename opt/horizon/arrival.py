"""How whole motions arrive at the goal: as residuals, and what to aim at where the finished motion does not.

The descent sees the motion at the instants of a quadrature; the finished one is rolled out at its nodes.
Where the two differ, by a millimetre at a long arm's end, the descent is given another goal: beside the one
before by as much as the finished motion missed the true one, and with less reach where that motion ends at
the goal but is too far from it in the last tenth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals import Changed, Goal
from ffsms_pin.opt.goals.near import arrivals, beyond, end_errors
from ffsms_pin.opt.motion.feature import Feature
from ffsms_pin.opt.motion.features import Features
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.problem import ARRIVAL_SHARE, Problem
from ffsms_pin.opt.trajectory import Trajectory
from ffsms_pin.system.batch.stacks import dot

__all__ = ["Arrival", "arrival", "arrival_error", "corrected_goal"]


class Arrival(NamedTuple):
    """What a goal asks of S motions. A radian, a metre a second and a radian a second weigh like a metre.

    Attributes
    ----------
    end, tail : list of Feature
        At the deadline, and in the last tenth.
    end_share, late_share : ndarray, shape (S,)
        The largest error at the deadline as a share of the tolerance, and in the last tenth as a share of the
        reach.
    """

    end: list[Feature]
    tail: list[Feature]
    end_share: FloatArray
    late_share: FloatArray


def arrival(goal: Goal, motions: Motions) -> Arrival:
    """Residuals of the way to the goal beyond what is near enough."""
    (end, tail), m = arrivals(goal), Features(motions)
    late, last = slice(int(motions.last_tenth[0]), None), slice(motions.last, None)
    places, place = goal.places(motions.times[late]), goal.place(motions.duration)
    missed = places.missed(m.frame("tip", places.on).during(late)).parts
    asked = end.among([x.during(slice(-1, None)) for x in missed])
    near = tail.among([x.during(slice(0, len(motions.last_tenth))) for x in missed])
    moving = []
    if place.velocity is not None:
        moving.append((m.velocity.during(last) - place.velocity, goal.tolerance))
    if place.spin is not None:
        moving.append((m.spin.during(last) - place.spin, goal.tolerance))
    ends = [beyond(x, end.share * most) for x, most in asked] + [x for x, _ in moving]
    (way, reach), *turns = near  # of the way the distance counts alone
    tails = [np.maximum(way.norm() - tail.share * reach, 0.0)]
    tails += [beyond(x, tail.share * most) for x, most in turns]
    end_residuals, tail_residuals = ([x.at_once() for x in found] for found in (ends, tails))
    return Arrival(end_residuals, tail_residuals, _largest([*asked, *moving]), _largest(near))


def _largest(asked: list[tuple[Feature, float]]) -> FloatArray:
    """The largest of vectors as a share of what is allowed of each (S,)."""
    shares = [np.sqrt(dot(x.value, x.value)).max(axis=1) / most for x, most in asked]
    return np.asarray(np.max(shares, axis=0))


def arrival_error(goal: Goal, plan: Trajectory) -> float:
    """The largest error at the deadline [m, rad], and of velocities that the goal asks for [m/s, rad/s]."""
    last = float(plan.position_error[-1]), float(plan.orientation_error[-1])
    return float(end_errors(goal, *last, plan.contact_velocity, plan.duration).max())


def corrected_goal(problem: Problem, goal: Goal, plan: Trajectory) -> Goal | None:
    """The next goal, after a landing at `goal` gave this plan; None where the plan arrives."""
    within = arrival_error(problem.goal, plan) <= problem.goal.tolerance
    if plan.reached and within:
        return None
    place, q = problem.goal.place(problem.duration), plan.q[-1]
    missed = place.missed(place.seen(problem.sms.at(q).end_effector_pose, q))
    way, turn = missed.way.value[:, 0, 0], pin.exp3(missed.vector[:, 0, 0])
    last = plan.t >= ARRIVAL_SHARE * plan.duration - 1e-9
    late = max(
        float(plan.position_error[last].max()) / problem.goal.reach,
        float(plan.orientation_error[last].max()) / problem.goal.orientation_reach,
    )
    # What a corrected motion shall use of the reaches in the last tenth.
    nearer = 0.95 / late if late > 1.0 and within else 1.0
    return Changed(
        goal,
        lambda place: place.moved(way, turn),
        reach=nearer * goal.reach,
        orientation_reach=nearer * goal.orientation_reach,
    )
