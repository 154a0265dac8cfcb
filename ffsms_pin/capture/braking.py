"""Motions in which the joints come to rest after a capture or an abort, with a reacting base."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.client import AfterCapture
from ffsms_pin.geometry.payload import HeldClient
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.robot.base_motion import roll_out
from ffsms_pin.system.dynamics import floating_torque

_STEP = 0.02  # [s] nominal time step of a braking
_SLOWER = 1.25  # factor on the duration of the next motion that is tried
_LONGEST = 60.0  # [s] longest duration of a braking, without `coast`
_BACK = 0.0, 0.05, 0.15  # [m] additional clearances of final postures, because a motion may overshoot
_LEAST = 0.5  # [s] shortest duration; it avoids a jump of the torque when slow joints stop


@dataclass(frozen=True, eq=False)
class Braking:
    """A motion in which all joints come to rest; the base follows from the momentum equation.

    The joint rates decrease as 1 - 3 s^2 + 2 s^3, where s goes from 0 to 1, so the acceleration is zero at
    both ends. Joints that would pass a position limit stop early; all others come to rest together. For a
    motion to a given posture, a quintic displacement is added. The motion is a reference for `simulate`.

    Attributes
    ----------
    robot : SpaceManipulator
        The robot that brakes. A grasped client is part of the link that carries the end effector.
    t : ndarray, shape (N + 1,)
        Times since the start of the motion [s].
    q : ndarray, shape (N + 1, nq)
        Configurations.
    joint_rates : ndarray, shape (N + 1, n)
        Joint rates, linear between the nodes [rad/s or m/s].
    momentum : ndarray, shape (6,)
        Total momentum [linear; angular] [kg m/s; kg m^2/s], inertial axes, about the common centre of mass.
    torque_share : float
        The largest ratio of a required joint torque to the joint's torque limit.
    note : str
        The violated limits, with values; empty if all are satisfied.
    clearance : float
        The least distance [m] between the grasped client, the servicer's bodies and obstacles, minus the
        margin of the obstacle or client's shape; infinite if no clearance is required. The distance between
        two bodies of the servicer counts only if it is below the required clearance.
    nearest : str
        The names of the two bodies at the distance `clearance`.
    """

    robot: SpaceManipulator
    t: FloatArray
    q: FloatArray
    joint_rates: FloatArray
    momentum: FloatArray
    torque_share: float
    note: str = ""
    clearance: float = np.inf
    nearest: str = ""

    @property
    def duration(self) -> float:
        """The duration of the braking [s]."""
        return float(self.t[-1])

    @property
    def target(self) -> FloatArray:
        """The end effector's position (3,) [m] when the joints come to rest; the base may still drift."""
        return np.array(self.robot.at(self.q[-1]).end_effector_pose.translation)

    def sample(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return joint positions, rates and accelerations, each (n,), at t [s]; at rest after the end."""
        layout, times = self.robot.layout, self.t
        zero = np.zeros(self.robot.n)
        if t >= times[-1]:
            return layout.positions(self.q[-1]), zero, zero
        k = int(np.searchsorted(times, t, side="right")) - 1
        h = t - times[k]
        slope = (self.joint_rates[k + 1] - self.joint_rates[k]) / (times[k + 1] - times[k])
        rates = self.joint_rates[k] + h * slope
        return layout.positions(self.q[k]) + (0.5 * h) * (self.joint_rates[k] + rates), rates, slope


def brake(
    after: AfterCapture,
    torque_limit: ArrayLike | None = None,
    share: float = 0.5,
    coast: float = 0.0,
    room: HeldClient | None = None,
) -> Braking:
    """Return a `Braking` of short duration within the limits of joint accelerations and torques.

    The shortest duration at the acceleration limits is tried first; each next duration is 25 % longer. If the
    clearance is not kept, motions to other final postures are tried. The first posture is near the end of
    the fastest braking. The next postures are near the posture at the start, with increasing clearance. The
    first motion that keeps the required clearance is returned. If no motion keeps it with `share` of the
    torque limits, all motions are tried with the full torques.

    Parameters
    ----------
    after : AfterCapture
        The robot, with its state and momentum at the start of the motion.
    torque_limit : array_like, optional
        The torque limits [N m or N], one number or (n,). Default: those of the robot.
    share : float
        The share of the torque limits that the motion may use; the remainder is for the controller's
        corrections.
    coast : float
        The time for which the joints keep their rates before they brake [s].
    room : HeldClient, optional
        The grasped client, its required clearance and the obstacles. Default: no clearance is required.

    Returns
    -------
    Braking
        A motion of at least 0.5 s. If no motion within 60 s keeps `share` of the torque limits, because a
        fast rotation also loads joints at rest, the motion with the smallest torque share is returned. If no
        motion keeps the clearance, the motion with the largest clearance within the full torques is
        returned. In both cases the `note` of the motion names the violated limit.
    """
    robot = after.robot
    limits = robot.limits
    limit = limits.torque if torque_limit is None else torque_limit
    torques = checks.one_each("torque_limit", limit, robot.n, "N m", largest=np.inf)
    # The largest deceleration, half-way through the motion, is 1.5 times the mean.
    least = max(_LEAST, float((1.5 * np.abs(after.v[6:]) / limits.acceleration).max()))

    def fastest(end: FloatArray | None, most: float) -> Braking:
        duration, tried = least, list[Braking]()
        while not tried or (tried[-1].torque_share > most and duration <= _LONGEST):
            braking = _braking(after, duration, torques, coast, end)
            duration *= _SLOWER
            if end is None or _within_limits(braking) or duration > _LONGEST:
                tried.append(braking)
        best = (
            tried[-1]
            if tried[-1].torque_share <= most
            else min(tried, key=lambda braking: braking.torque_share)
        )
        return _noted(best, share, room)

    plain = fastest(None, share)
    if room is None or plain.clearance >= room.clearance:
        return plain
    first, last = (robot.layout.positions(q) for q in (after.q, plain.q[-1]))
    ends = [room.away(last, 0.0), *(room.away(first, more) for more in _BACK)]
    motions, whole = [plain], max(share, 1.0)
    for end, most in [*((end, share) for end in ends), *((end, whole) for end in (None, *ends))]:
        motions.append(fastest(end, most))
        if motions[-1].clearance >= room.clearance and motions[-1].torque_share <= most:
            return motions[-1]
    return max(motions, key=lambda braking: (braking.torque_share <= whole, braking.clearance))


def move_and_rest(
    after: AfterCapture, end: FloatArray, torque_limit: FloatArray, share: float = 0.5
) -> Braking | None:
    """Return a motion of the joints to rest at `end` (n,), within the limits of rates and accelerations.

    The displacement to `end` may use half of these limits; the whole motion may use `share` of
    `torque_limit` (n,) [N m or N]. Return None if the motion would take more than two minutes.
    """
    limits, start = after.robot.limits, after.robot.layout.positions(after.q)
    travel = np.abs(end - start) + 1e-9
    duration = max(
        _LEAST,
        float((1.5 * np.abs(after.v[6:]) / limits.acceleration).max()),
        float((1.875 * travel / (0.5 * limits.velocity)).max()),
        float(np.sqrt(5.78 * travel / (0.5 * limits.acceleration)).max()),
    )
    while duration <= 2.0 * _LONGEST:
        braking = _braking(after, duration, torque_limit, 0.0, end)
        if braking.torque_share <= share and _within_limits(braking):
            return braking
        duration *= _SLOWER
    return None


def _braking(
    after: AfterCapture, duration: float, torques: FloatArray, coast: float, end: FloatArray | None
) -> Braking:
    """Return a motion with constant rates for `coast` [s], then a braking of `duration` [s].

    A joint that would pass its position limit brakes earlier. If `end` (n,) is given, the joints come to rest
    there.
    """
    robot, whole, start = after.robot, coast + duration, after.v[6:]
    steps = max(2, round(whole / _STEP))
    t, joints, limits = np.linspace(0.0, whole, steps + 1), robot.layout.positions(after.q), robot.limits
    slack = np.where(start > 0.0, limits.upper - joints, joints - limits.lower)
    speeds = np.maximum(np.abs(start), checks.SMALLEST_POSITIVE)
    least = 1.5 * speeds / limits.acceleration
    # A joint that would pass its limit brakes before the others.
    coasts = np.clip(slack / speeds - 0.55 * least, 0.0, coast)
    # A joint travels half of its rate times its stopping time; 1.95 < 2 allows for the time steps.
    stops = np.maximum(np.minimum(duration, 1.95 * (slack / speeds - coasts)), least)
    s = np.clip((t[:, None] - coasts) / stops, 0.0, 1.0)
    rates = (1.0 - s**2 * (3.0 - 2.0 * s)) * start
    if end is not None:
        travel, s = end - joints - (coasts + 0.5 * stops) * start, np.clip((t - coast) / duration, 0.0, 1.0)
        rates += (30.0 / duration * (s * (1.0 - s)) ** 2)[:, None] * travel
    accelerations = np.diff(rates, axis=0) * (steps / whole)
    q, _ = roll_out(robot, after.q, rates[0], accelerations, whole / steps, after.momentum)
    needed = np.zeros(robot.n)
    for k in range(steps):
        v = robot.velocity(q[k], rates[k], after.momentum)
        for acceleration in (accelerations[max(k - 1, 0)], accelerations[k]):
            needed = np.maximum(needed, np.abs(floating_torque(robot, q[k], v, acceleration)))
    worst = float((needed / torques).max())
    return Braking(robot, frozen(t), frozen(q), frozen(rates), after.momentum, worst)


def _within_limits(braking: Braking) -> bool:
    """Return whether joint rates and accelerations are within their limits."""
    limits, rates = braking.robot.limits, braking.joint_rates
    accelerations = np.diff(rates, axis=0) / np.diff(braking.t)[:, None]
    return bool(
        (np.abs(rates) <= limits.velocity).all() and (np.abs(accelerations) <= limits.acceleration).all()
    )


def _noted(braking: Braking, share: float, room: HeldClient | None) -> Braking:
    """Return the braking with its clearance and a note of the violated limits."""
    robot, notes = braking.robot, []
    if room is not None:
        clearance, nearest = room.least(braking.q)
        braking = replace(braking, clearance=clearance, nearest=nearest)
        if clearance < room.clearance:
            near, required = 1e3 * clearance, 1e3 * room.clearance
            notes.append(f"in braking, {nearest} come within {near:.3g} mm, {required:.3g} mm are required")
    if braking.torque_share > share:
        notes.append(
            f"braking needs {100.0 * braking.torque_share:.3g} % of a joint's torque limit, "
            f"{100.0 * share:.3g} % are allowed"
        )
    beyond = robot.limits.violation(robot.layout.positions(braking.q[-1]))
    if beyond.any():
        i = int(np.argmax(beyond))
        unit = "rad" if robot.layout.turns[i] else "m"
        notes.append(
            f"joint '{robot.joint_names[i]}' comes to rest {beyond[i]:.3g} {unit} beyond its position limit"
        )
    return replace(braking, note="; ".join(notes))
