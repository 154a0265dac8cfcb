"""The goal as residuals of whole motions: at the deadline, and in the last tenth (const8)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals import Goal
from ffsms_pin.opt.goals.near import arrivals, beyond
from ffsms_pin.opt.motion.feature import Feature
from ffsms_pin.opt.motion.features import Features
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Residuals
from ffsms_pin.system.batch.stacks import dot

__all__ = ["Arrival", "arrival"]


class Arrival(NamedTuple):
    """What a goal asks of S motions. A radian, a metre a second and a radian a second weigh like a metre.

    Attributes
    ----------
    end, tail : list of Residual
        At the deadline, and in the last tenth.
    end_share, late_share : ndarray, shape (S,)
        The largest error at the deadline as a share of the tolerance, and in the last tenth as a share of the
        reach.
    """

    end: Residuals
    tail: Residuals
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
    end_residuals, tail_residuals = (
        [one for x in found for one in x.residuals(over_time=False)] for found in (ends, tails)
    )
    return Arrival(end_residuals, tail_residuals, _largest([*asked, *moving]), _largest(near))


def _largest(asked: list[tuple[Feature, float]]) -> FloatArray:
    """The largest of vectors as a share of what is allowed of each (S,)."""
    shares = [np.sqrt(dot(x.value, x.value)).max(axis=1) / most for x, most in asked]
    largest: FloatArray = np.max(shares, axis=0)
    return largest
