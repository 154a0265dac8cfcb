"""How a motion ends at its goal: the relative velocity, and what is missed."""

from __future__ import annotations

import math

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.goals.goal import Goal
from ffsms_pin.opt.goals.place import Place

__all__ = ["contact_velocity", "missed"]


def contact_velocity(place: Place, motion: Motions) -> FloatArray:
    """Velocity and angular velocity (6,) of a motion's end effector relative to a place at the deadline.

    A place without velocities counts as one that stands still.
    """
    wanted = [np.zeros(3) if one is None else one for one in (place.velocity, place.spin)]
    found = [motion.velocity[:, 0, motion.last], motion.spin[:, 0, motion.last]]
    return np.concatenate(found) - np.concatenate(wanted)


def missed(goal: Goal, distance: float, angle: float, contact: FloatArray) -> str:
    """What an exact goal is missed by at the deadline, in words; empty where it is met, or not exact.

    Parameters
    ----------
    goal : Goal
    distance, angle : float
        To the wanted position and attitude [m], [rad].
    contact : ndarray, shape (6,)
        See `contact_velocity`.
    """
    if not goal.exact:
        return ""
    speed, spin = float(np.linalg.norm(contact[:3])), float(np.linalg.norm(contact[3:]))
    if max(distance, angle, speed, spin) <= goal.tolerance:
        return ""
    most = goal.tolerance
    return (
        f"at contact the grasp is missed by {1e3 * distance:.2g} mm, {math.degrees(angle):.2g} deg, "
        f"{1e3 * speed:.2g} mm/s and {math.degrees(spin):.2g} deg/s; {1e3 * most:.2g} mm and mm/s, "
        f"{math.degrees(most):.2g} deg and deg/s are allowed"
    )
