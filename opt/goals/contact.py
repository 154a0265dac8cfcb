"""How a motion ends at its goal: the relative velocity, and what is missed."""

from __future__ import annotations

import math

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals.goal import Goal
from ffsms_pin.opt.goals.place import Place
from ffsms_pin.opt.motion.motions import Motions

__all__ = ["contact_velocity", "end_errors", "late", "missed"]


def contact_velocity(place: Place, motion: Motions) -> FloatArray:
    """Velocity and angular velocity (6,) of a motion's end effector relative to a place at the deadline.

    A place without velocities counts as one that stands still.
    """
    wanted = [np.zeros(3) if one is None else one for one in (place.velocity, place.spin)]
    found = [motion.velocity[:, 0, motion.last], motion.spin[:, 0, motion.last]]
    return np.concatenate(found) - np.concatenate(wanted)


def end_errors(goal: Goal, distance: float, angle: float, contact: FloatArray, duration: float) -> FloatArray:
    """Of position, attitude, velocity and angular velocity at the deadline (4,) [m, rad, m/s, rad/s].

    Zero for a velocity that is not asked for.

    Parameters
    ----------
    goal : Goal
    distance, angle : float
        To the wanted position and attitude [m], [rad].
    contact : ndarray, shape (6,)
        See `contact_velocity`.
    duration : float
        [s]
    """
    place = goal.place(duration)
    asked = [goal.exact or one is not None for one in (place.velocity, place.spin)]
    speeds = np.linalg.norm(np.split(contact, 2), axis=1) * asked
    return np.array([distance, angle, *speeds])


def missed(goal: Goal, errors: FloatArray) -> str:
    """By how much the end misses a goal beyond its tolerance, in words; empty where it is within.

    Parameters
    ----------
    goal : Goal
    errors : ndarray, shape (4,)
        See `end_errors`.
    """
    if not errors.max() > goal.tolerance:
        return ""
    units = zip(errors, (1e3, math.degrees(1.0)) * 2, ("mm", "deg", "mm/s", "deg/s"), strict=True)
    told = [(error, size, unit) for error, size, unit in units if goal.exact or error > 0.0]
    found = ", ".join(f"{size * error:.3g} {unit}" for error, size, unit in told)
    allowed = ", ".join(f"{size * goal.tolerance:.2g} {unit}" for _, size, unit in told)
    what = "at contact the grasp is missed by" if goal.exact else "the end is off by"
    return f"{what} {found}; its tolerance is {allowed}"


def late(goal: Goal, distance: float, angle: float) -> str:
    """By how much a motion that ends within the tolerance is too far off in the last tenth; empty if not.

    Parameters
    ----------
    goal : Goal
    distance, angle : float
        The largest in the last tenth of the time [m], [rad].
    """
    if distance <= goal.reach and angle <= goal.orientation_reach:
        return ""
    return (
        f"too late: up to {1e3 * distance:.3g} mm and {math.degrees(angle):.3g} deg off in the last tenth of "
        f"the time, where {1e3 * goal.reach:.3g} mm and {math.degrees(goal.orientation_reach):.3g} deg may be"
    )
