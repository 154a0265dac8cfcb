"""Joints that brake to rest after a capture, and what the base does meanwhile."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.client.capture import AfterCapture
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.base_motion import roll_out
from ffsms_pin.system.dynamics import floating_torque

__all__ = ["Braking", "brake"]

_STEP = 0.02  # [s]
_SLOWER = 1.25  # times as long, where a torque is too large
_LONGEST = 60.0  # [s]
_PEAK = 1.5  # of the deceleration, times the mean one
_LEAST = 0.5  # [s] so that drives see no jump, however slow the joints are


@dataclass(frozen=True, eq=False)
class Braking:
    """A motion in which all joints come to rest together, and the base as the momentum equation says.

    The rates fall as 1 - 3 s^2 + 2 s^3 with s from 0 to 1, so neither end has a jump of the acceleration.
    It is a reference for a closed loop (`simulate`), which may go on after it: the joints then rest.

    Attributes
    ----------
    robot : SpaceManipulator
    t : ndarray, shape (N + 1,)
        From the capture on [s].
    q : ndarray, shape (N + 1, nq)
    joint_rates : ndarray, shape (N + 1, n)
        Linear in between.
    momentum : ndarray, shape (6,)
        Total [linear; angular], inertial axes, about the common centre of mass.
    torque_share : float
        The largest joint torque that it needs, as a share of its limit.
    duration : float
        Of braking and of the rest after it [s].
    note : str
        What of the joints' limits it breaks; empty where none.
    """

    robot: SpaceManipulator
    t: FloatArray
    q: FloatArray
    joint_rates: FloatArray
    momentum: FloatArray
    torque_share: float
    duration: float
    note: str = ""

    @property
    def target(self) -> FloatArray:
        """Where the end effector is when the joints rest (3,) [m]; it moves on if the whole does."""
        return np.array(self.robot.at(self.q[-1]).end_effector_pose.translation)

    def sample(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Joint positions, rates and accelerations, each (n,), at t [s]; at rest after the braking."""
        t = checks.number("t", t)
        layout, times = self.robot.layout, self.t
        nothing = np.zeros(self.robot.n)
        if t >= times[-1]:
            return layout.positions(self.q[-1]), nothing, nothing
        k = int(np.searchsorted(times, t, side="right")) - 1
        h = t - times[k]
        slope = (self.joint_rates[k + 1] - self.joint_rates[k]) / (times[k + 1] - times[k])
        rates = self.joint_rates[k] + h * slope
        return layout.positions(self.q[k]) + (0.5 * h) * (self.joint_rates[k] + rates), rates, slope


def brake(
    after: AfterCapture,
    torque_limit: ArrayLike | None = None,
    share: float = 0.5,
    hold: float = 0.0,
    coast: float = 0.0,
) -> Braking:
    """The fastest braking of this form that the joints' accelerations and torques allow.

    Parameters
    ----------
    after : AfterCapture
    torque_limit : array_like, optional
        One number or (n,) [N m]. Default: the robot's.
    share : float
        Of the torque limits that the motion may need; the rest is for what a controller corrects.
    hold : float
        Rest after the braking [s].
    coast : float
        Time for which the joints keep their rates before they brake [s].

    Returns
    -------
    Braking
        Of at least 0.5 s. Where no braking within 60 s keeps the limits, the one that needs the least share
        of the torques, with a `note`: a client that turns fast pulls at the joints also when they rest.
    """
    checks.instance("after", after, AfterCapture)
    robot = after.robot
    limits = robot.limits
    torques = (
        limits.torque if torque_limit is None else checks.per_joint("torque_limit", torque_limit, robot.n)
    )
    if not (torques >= checks.SMALLEST_POSITIVE).all():
        raise InvalidValue("torque_limit", torque_limit, f"must be {checks.SMALLEST_POSITIVE:g} N m or more")
    share = checks.positive("share", share)
    hold = checks.at_least_zero("hold", hold, "s")
    coast = checks.at_least_zero("coast", coast, "s")
    rates = after.v[6:]
    duration = max(_LEAST, float((_PEAK * np.abs(rates) / limits.acceleration).max()))
    found: list[Braking] = []
    while not found or (found[-1].torque_share > share and duration <= _LONGEST):
        found.append(_braking(after, duration, torques, hold, coast))
        duration *= _SLOWER
    best = found[-1] if found[-1].torque_share <= share else min(found, key=lambda one: one.torque_share)
    return _noted(best, share)


def _braking(after: AfterCapture, duration: float, torques: FloatArray, hold: float, coast: float) -> Braking:
    robot, whole = after.robot, coast + duration
    steps = max(2, round(whole / _STEP))
    t = np.linspace(0.0, whole, steps + 1)
    s = np.clip((t - coast) / duration, 0.0, 1.0)
    rates = (1.0 - s**2 * (3.0 - 2.0 * s))[:, None] * after.v[6:]
    accelerations = np.diff(rates, axis=0) * (steps / whole)
    q, _ = roll_out(robot, after.q, rates[0], accelerations, whole / steps, after.momentum)
    needed = np.zeros(robot.n)
    for k in range(steps):
        v = robot.velocity(q[k], rates[k], after.momentum)
        for acceleration in (accelerations[max(k - 1, 0)], accelerations[k]):
            change = np.concatenate([np.zeros(6), acceleration])
            needed = np.maximum(needed, np.abs(floating_torque(robot, q[k], v, change)))
    worst = float((needed / torques).max())
    return Braking(robot, frozen(t), frozen(q), frozen(rates), after.momentum, worst, whole + hold)


def _noted(braking: Braking, share: float) -> Braking:
    robot, notes = braking.robot, []
    if braking.torque_share > share:
        notes.append(
            f"braking needs {100.0 * braking.torque_share:.3g} % of a joint's torque limit, "
            f"{100.0 * share:.3g} % are allowed"
        )
    beyond = robot.limits.violation(robot.layout.positions(braking.q[-1]))
    if beyond.any():
        i = int(np.argmax(beyond))
        notes.append(f"joint '{robot.joint_names[i]}' comes to rest {beyond[i]:.3g} beyond its limit")
    if not notes:
        return braking
    return replace(braking, note="; ".join(notes))
