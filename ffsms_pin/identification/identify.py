"""Identify inertial parameters from a recorded motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation.wheels import friction_torque
from ffsms_pin.checks import FloatArray, at_least_zero, whole
from ffsms_pin.errors import InvalidValue
from ffsms_pin.identification.identifier import Identifier
from ffsms_pin.identification.noise import NoiseModel
from ffsms_pin.identification.recording import Recording, recording_of
from ffsms_pin.identification.result import Identification
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Sensors, Tracking
from ffsms_pin.system.regressors import PER_BODY, torque_regressor

_BLOCK = 0.1  # [s] over which torques are averaged: accelerations are differences of noisy velocities
_TORQUE_SHARE = 1e-3  # of the largest torque, taken where no noise of torques is stated


def identify(
    sms: SpaceManipulator,
    tracking: Tracking | None = None,
    *,
    recording: Any = None,
    unknown: Sequence[str] = ("base",),
    known: Mapping[str, Any] | None = None,
    sensors: Sensors | None = None,
    wheel_momentum: Any = None,
    use_torques: bool | None = None,
    torque_noise: float = 0.0,
    spread: float = 1.0,
    at_rest: bool = False,
    passes: int = 2,
) -> Identification:
    """Estimate masses, centres of mass and inertias from a motion of the floating robot.

    The total momentum is constant; see `Identifier`, which this is for whole recordings. Torques, where they
    are used, add the joints' equations of motion, which fix the scale of all parameters. The recording is
    checked first: a gap in time, a frozen sensor or degrees raise an error and are not fitted.

    Parameters
    ----------
    sms : SpaceManipulator
        The model that is believed.
    tracking : Tracking, optional
        A simulated motion: that of the plant, without the noise of sensors.
    recording : tuple of array_like, optional
        In place of `tracking`: t (N,) [s], q (N, nq), v (N, 6 + n), and optionally joint torques, one row a
        sample or one a step [N m]. All are Pinocchio's: quaternions (x, y, z, w), the root's velocity in the
        root's axes.
    unknown : sequence of str
        As for `Identifier`: "base", "payload", links.
    known : mapping, optional
        As for `Identifier`: masses [kg] or a pinocchio.Inertia, by name.
    sensors : Sensors, optional
        Noise of the recording. Default: what the velocities show by themselves.
    wheel_momentum : array_like, shape (N, w), optional
        The spin momenta of the robot's wheels [N m s] for `recording`; a `Tracking` has its own.
    use_torques : bool, optional
        Default: whether `recording` has them. A Tracking's torques are used if this is True. The damping and
        friction of the robot's file are counted; another friction would be taken for inertia.
    torque_noise : float
        Standard deviation of measured torques [N m].
    spread, at_rest : float, bool
        As for `Identifier`.
    passes : int
        The number of passes over the recording. From the second on, the weights are those of the estimate
        before. With one pass the result is that of an `Identifier` with the same `sensors`.

    Returns
    -------
    Identification
        Its `note` says what the motion does not show.

    Raises
    ------
    InvalidValue
        A wrong shape or name, or a recording that cannot be a motion of the robot without forces from
        outside.
    """
    options: dict[str, Any] = {"sensors": sensors, "known": known, "spread": spread, "at_rest": at_rest}
    identifier = Identifier(sms, unknown, **options)
    noise = at_least_zero("torque_noise", torque_noise, "N m")
    passes = whole("passes", passes, 1, 10)
    made = recording_of(sms, tracking, recording, wheel_momentum, use_torques is True)
    if use_torques and made.tau is None:
        raise InvalidValue("use_torques", use_torques, "must be left out: the recording has no torques")
    wheels = [None] * len(made.t) if made.wheel_momentum is None else made.wheel_momentum
    for _ in range(passes):
        before, identifier = identifier, Identifier(sms, unknown, **options)
        if before.samples:
            identifier.weigh_by(before)
        if not identifier.noise.stated:
            identifier.noise = NoiseModel.shown_by(made.v)
        for t, q, v, spins in zip(made.t, made.q, made.v, wheels, strict=True):
            identifier.update(t, q, v, spins)
        if made.tau is not None and use_torques is not False:
            identifier.add_equations(*torque_equations(identifier, made, noise))
    return identifier.found


def torque_equations(
    identifier: Identifier, recording: Recording, torque_noise: float
) -> tuple[FloatArray, FloatArray]:
    """Return the joints' equations of motion as weighted rows (R, 10 b) and right sides (R,).

    A row times the change of the unknown bodies' parameters is the right side. Regressor and torques are
    averaged over blocks of a tenth of a second, in which the noise of the accelerations largely cancels.
    """
    robot, bodies, tau = identifier.robot, identifier.bodies, recording.tau
    assert tau is not None
    t, q, v = recording.t, recording.q, recording.v
    dt, n = np.diff(t), robot.n
    size = max(1, min(round(_BLOCK / float(np.median(dt))), len(dt)))
    deviation = max(torque_noise, _TORQUE_SHARE * float(np.abs(tau).max()), 1e-9)
    columns = np.concatenate([np.arange(PER_BODY) + PER_BODY * body.index for body in bodies])
    believed, armature = robot.inertial_parameters, np.array(robot.model.armature)[6:]
    rows, sides = [], []
    for first in range(0, len(dt) - size + 1, size):
        Y, force = np.zeros((n, PER_BODY * (1 + n))), np.zeros(n)
        for k in range(first, first + size):
            rate = (v[k + 1] - v[k]) / dt[k]
            between = pin.interpolate(robot.model, q[k], q[k + 1], 0.5)
            full = torque_regressor(robot, between, 0.5 * (v[k] + v[k + 1]), rate)
            Y += full[6:] / size
            rates = 0.5 * (v[k] + v[k + 1])[6:]
            rubbing = friction_torque(rates, robot.joint_damping, robot.joint_friction)
            force += (tau[k] + rubbing - armature * rate[6:]) / size
        M = pin.crba(robot.model, robot.model.createData(), q[first])[6:]
        span = float(t[first + size] - t[first])
        covariance = (2.0 / span**2) * (M * identifier.noise.rates) @ M.T
        covariance += deviation**2 / size * np.eye(n)
        W = np.linalg.inv(np.linalg.cholesky(covariance))
        rows.append(W @ Y[:, columns])
        sides.append(W @ (force - Y @ believed))
    return np.concatenate(rows), np.concatenate(sides)
