"""Motions to rest after an aborted capture, such that servicer and client keep clear of each other.

Without thrusters, servicer and client drift with constant momenta. With the servicer's joints at rest, both
are free rigid bodies. The distance between them can then be predicted, with the uncertainty of the client's
estimate.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.capture.braking import Braking, move_and_rest
from ffsms_pin.capture.client_distances import FAR, ClientDistances
from ffsms_pin.capture.contact_load import DEVIATIONS
from ffsms_pin.capture.estimate import ClientEstimate
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import AfterCapture, Client, FreeBody
from ffsms_pin.errors import length_text
from ffsms_pin.geometry.bodies import clearance_stack
from ffsms_pin.geometry.distances import Poses
from ffsms_pin.system.batch.stacks import quaternions

_STEP, _MOST = 0.02, 6000  # [m] relative displacement in a time step; largest number of time steps
_LARGEST_TURN = 2.0  # chord of half a turn on a unit circle
_ON_THE_WAY = 0.2  # [s] time between two evaluated instants of a motion
_DRAWN, _BEST = 24, 3  # number of random postures; number of the best of them that are tried
_BLENDS = 1.0, 0.75, 0.5, 0.25  # shares of the displacement to a posture, tried in order


class ClosestApproach(NamedTuple):
    """The closest approach of two bodies that drift.

    Attributes
    ----------
    distance : float
        A lower bound of the least distance [m]. It allows for three standard deviations of the client's
        position and attitude, and for the motion between two evaluated instants.
    pair : str
        The two bodies that come closest.
    time : float
        The time from the end of the joint motion to the closest approach [s].
    span : float
        The time for which the motion is predicted [s].
    """

    distance: float
    pair: str
    time: float
    span: float

    @property
    def clear(self) -> bool:
        """True if `distance` is above zero, so that servicer and client do not touch within `span`."""
        return self.distance > 0.0

    def __str__(self) -> str:
        span = f"for {self.span / 60.0:.3g} min"
        if self.clear:
            far = "1 m or more" if self.distance >= FAR else f"{1e3 * self.distance:.3g} mm at least"
            return f"servicer and client keep clear of each other {span} ({far})"
        return (
            f"servicer and client may touch: closest after {self.time:.3g} s ({self.pair}, "
            f"{length_text(self.distance)} with three standard deviations), predicted {span}"
        )


@dataclass(frozen=True)
class Departure:
    """A motion of the servicer's joints to rest, and the closest approach to the client afterwards."""

    motion: Braking
    approach: ClosestApproach


def closest_approach(
    closeness: ClientDistances, rest: AfterCapture, client: FreeBody, t: float, span: float
) -> ClosestApproach:
    """Predict the closest approach of a client and a servicer with its joints at rest.

    The prediction covers `span` [s] from the client's time t [s] on; `rest` is the servicer's state at t. If
    the uncertain attitude makes a contact possible, the distance from the client's bounding ball is also
    used, because it does not depend on the attitude.
    """
    free = rest.at_rest()
    speed = float(np.linalg.norm(client.twist(t)[:3] - free.start_twist[:3]))
    spin = float(np.linalg.norm(client.twist(t)[3:]) + np.linalg.norm(free.start_twist[3:]))
    reach = closeness.radius + 2.0 * float(np.linalg.norm(client.pose(t).translation - rest.q[:3]))
    steps = int(np.clip(np.ceil(span * (speed + spin * reach) / _STEP), 100, _MOST))
    times = np.linspace(0.0, span, steps + 1)
    q = _drifting(rest, free, times)
    places, attitudes = client.poses(t + times)
    moved, turned = _uncertainty(client, t + times)
    chord = closeness.radius * np.minimum(turned, _LARGEST_TURN)
    # Between two instants the distance is smaller by at most the displacement in half a time step.
    between = 0.5 * span / steps * (speed + spin * reach)
    reduction = moved + chord + between
    near = closeness.nearest(q, places, attitudes, near=FAR + float(reduction.max()))
    distance, pair = near.distance - reduction, near.pair
    # If the attitude is very uncertain, the distance from the bounding ball can be the larger lower bound.
    if distance.min() <= 0.0 and chord.max() > _STEP:
        ball = closeness.around()
        from_ball = ball.nearest(q, places, attitudes, near=FAR).distance - moved - between
        distance = np.maximum(distance, from_ball)
    k = int(distance.argmin())
    return ClosestApproach(float(distance[k]), closeness.names[int(pair[k])], float(times[k]), span)


def departure(
    closeness: ClientDistances,
    alone: AfterCapture,
    plain: Braking,
    drifts: tuple[bool, bool],
    postures: list[FloatArray],
    client: FreeBody,
    t: float,
    span: float,
    torque_limit: FloatArray,
    share: float,
) -> Departure:
    """Return the first motion to rest after which servicer and client keep clear of each other.

    The braking `plain` is tried first, then motions to `postures` and to random postures, each also part of
    the way. The motion itself must also keep clear of the client. If no motion is found, `plain` or a motion
    that keeps clear is returned, whichever has the largest distance of its closest approach.

    Parameters
    ----------
    closeness : ClientDistances
        The distances between servicer and client.
    alone : AfterCapture
        The servicer without the client, at the present time.
    plain : Braking
        The braking from the present state.
    drifts : tuple of two bools
        The first is true if no base law holds the base's position, so that the base translates with the
        linear momentum. The second is true if no base law holds the base's attitude, so that the base rotates
        with the angular momentum.
    postures : list of ndarray
        Joint positions (n,) at which the joints may rest. If the list is empty, only `plain` is tried.
        Joints that the first posture does not move are not moved in random postures.
    client : Client or ClientEstimate
        The client or its estimate.
    t : float
        The client's present time [s].
    span : float
        The time for which servicer and client must keep clear of each other [s].
    torque_limit, share : ndarray, float
        The torque limits (n,) [N m or N], and the share of them that the motion may use.
    """
    robot, n = alone.robot, alone.robot.n
    start, momentum = robot.layout.positions(alone.q), alone.momentum * np.repeat(drifts, 3)

    def approach(q: FloatArray, later: float) -> ClosestApproach:
        rest = AfterCapture(robot, q, robot.velocity(q, np.zeros(n), momentum), momentum, 0.0)
        return closest_approach(closeness, rest, client, t + later, span)

    def tried(motion: Braking) -> Departure:
        return Departure(motion, approach(motion.q[-1], motion.duration))

    tries = [tried(plain)]
    if not postures or (tries[0].approach.clear and _clear_on_the_way(closeness, plain, client, t)):
        return tries[0]
    ranked = sorted(_drawn(alone, postures[0]), key=lambda q: -approach(q, 0.0).distance)
    others = [robot.layout.positions(q) for q in ranked[:_BEST]]
    for motion in _motions(alone, start, [*postures, *others], torque_limit, share):
        if _clear_on_the_way(closeness, motion, client, t):
            tries.append(tried(motion))
            if tries[-1].approach.clear:
                return tries[-1]
    return max(tries, key=lambda attempt: attempt.approach.distance)


def _drawn(alone: AfterCapture, posture: FloatArray) -> list[FloatArray]:
    """Return configurations (nq,) with random positions of the joints that `posture` moves."""
    limits, rng = alone.robot.limits, np.random.default_rng(0)
    here = alone.robot.layout.positions(alone.q)
    low, high = np.maximum(limits.lower, here - np.pi), np.minimum(limits.upper, here + np.pi)
    postures = []
    for joints in rng.uniform(low, high, (_DRAWN, len(here))):
        q = alone.q.copy()
        alone.robot.layout.set_positions(q, np.where(posture == here, here, joints))
        postures.append(q)
    return postures


def _motions(
    alone: AfterCapture,
    start: FloatArray,
    postures: list[FloatArray],
    torque_limit: FloatArray,
    share: float,
) -> Iterator[Braking]:
    for posture in postures:
        for blend in _BLENDS:
            motion = move_and_rest(alone, start + blend * (posture - start), torque_limit, share)
            if motion is not None:
                yield motion


def _clear_on_the_way(closeness: ClientDistances, motion: Braking, client: FreeBody, t: float) -> bool:
    """Return whether the robot does not touch the client and keeps the clearance between its own bodies.

    A distance that is too small at the start must not decrease further. The uncertainty of the client's
    estimate is not considered.
    """
    stride = max(1, round(_ON_THE_WAY / (motion.duration / (len(motion.t) - 1))))
    rows = np.unique([*range(0, len(motion.t), stride), len(motion.t) - 1])
    q = motion.q[rows]
    near = closeness.nearest(q, *client.poses(t + motion.t[rows])).distance
    if near.min() < min(0.0, float(near[0])) - 1e-4:
        return False
    own = clearance_stack(motion.robot, "auto", closeness.clearance)
    if own is None:
        return True
    joints = np.array([motion.robot.layout.positions(row) for row in q]).T
    values = own.values(Poses.of(joints), closeness.clearance).min(axis=0)
    return bool(values.min() >= min(closeness.clearance, float(values[0])) - 1e-4)


def _drifting(rest: AfterCapture, free: Client, times: FloatArray) -> FloatArray:
    """Return configurations (K, nq) at `times` (K,) of a servicer that drifts as the rigid body `free`."""
    places, attitudes = free.poses(times)
    root = free.start_pose.actInv(pin.XYZQUATToSE3(rest.q[:7]))
    q = np.tile(rest.q, (len(times), 1))
    q[:, :3] = places + attitudes @ root.translation
    q[:, 3:7] = quaternions(np.moveaxis(attitudes @ root.rotation, 0, -1)).T
    return q


def _uncertainty(client: FreeBody, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return three standard deviations (K,) of a client's position [m] and attitude [rad] at `times` (K,)."""
    if not isinstance(client, ClientEstimate):
        return np.zeros(len(times)), np.zeros(len(times))
    # The deviations grow smoothly, so an interpolation between 20 times is exact enough.
    few = np.linspace(times[0], times[-1], 20)
    deviations = np.array([client.deviation(float(time)) for time in few])
    moved, turned = (np.interp(times, few, DEVIATIONS * column) for column in deviations.T)
    return moved, turned
