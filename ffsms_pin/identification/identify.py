"""The identification of inertial parameters from a recorded motion."""

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

_BLOCK = 0.1  # [s] averaging time of torques, because accelerations are differences of noisy velocities
_TORQUE_SHARE = 1e-3  # least standard deviation of torques, as a share of the largest torque


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
    base_velocity: str = "local",
) -> Identification:
    """Estimate masses, centres of mass and inertias from a motion of the floating robot.

    An `Identifier` processes the whole recording. It uses the constant total momentum; torques add the
    joints' equations of motion, which determine the scale of all parameters. The recording is checked first.
    For example, a gap in time, a frozen sensor, or values in degrees raise an error.

    Parameters
    ----------
    sms : SpaceManipulator
        The prior model.
    tracking : Tracking, optional
        A simulated motion; the plant's true motion is used, without the noise of sensors.
    recording : tuple of array_like, optional
        A measured motion in place of `tracking`: t (N,) [s], q (N, nq), v (N, 6 + n), and optionally joint
        torques [N m], one row per sample or per step between samples. q and v are in Pinocchio's layout:
        quaternions (x, y, z, w), the root's velocity in the root's axes. If the position or the linear
        velocity of the base is not measured, its columns q[:, :3] or v[:, :3] are NaN. Without the linear
        velocity the angular momentum alone is used, and two passes are added.
    unknown : sequence of str
        The unknown bodies, as in `Identifier`: "base", "payload", links.
    known : mapping, optional
        The known values by name, as in `Identifier`: masses [kg] or a pinocchio.Inertia.
    sensors : Sensors, optional
        Noise of the recording. Default: estimated from the velocities, also for sensors without noise.
    wheel_momentum : array_like, shape (N, w), optional
        The spin momenta of the robot's wheels [N m s] for `recording`; a `Tracking` has its own.
    use_torques : bool, optional
        True to use torques. Default: True if `recording` has torques; False for a Tracking. The damping and
        friction of the robot's file are included; any other friction would be mistaken for inertia.
    torque_noise : float
        Standard deviation of measured torques [N m]; at least 0.1 % of the largest torque is used.
    spread, at_rest : float, bool
        Arguments of `Identifier`.
    passes : int
        The number of passes over the recording. From the second pass on, the weights follow the previous
        estimate. If `sensors` with noise are given, one pass without torques gives the result of an
        `Identifier`.
    base_velocity : {"local", "mixed", "inertial"}
        The axes of the root's velocity in `recording`: "local", the root's own; "mixed", inertial axes for
        the linear and the root's axes for the angular velocity, as in MuJoCo's `qvel`; "inertial", inertial
        axes for both.

    Returns
    -------
    Identification
        The estimated bodies and the robot with these bodies; `note` lists the unobservable parameters.

    Raises
    ------
    InvalidValue
        A shape or name is wrong, or the recording cannot be a motion of the robot without external forces.
    """
    options: dict[str, Any] = {"sensors": sensors, "known": known, "spread": spread, "at_rest": at_rest}
    identifier = Identifier(sms, unknown, **options)
    noise = at_least_zero("torque_noise", torque_noise, "N m")
    passes = whole("passes", passes, 1, 10)
    made = recording_of(sms, tracking, recording, wheel_momentum, use_torques is True, base_velocity)
    if use_torques and made.tau is None:
        raise InvalidValue("use_torques", use_torques, "must be left out: the recording has no torques")
    unseen = bool(np.isnan(made.v[:, :3]).any())
    if unseen and made.tau is not None and use_torques is not False:
        text = "must be False, because the linear velocity of the base is not measured"
        raise InvalidValue("use_torques", use_torques, text)
    wheels = [None] * len(made.t) if made.wheel_momentum is None else made.wheel_momentum
    for _ in range(passes + 2 * unseen):
        before, identifier = identifier, Identifier(sms, unknown, **options)
        if before.samples:
            identifier.weigh_by(before)
            if unseen:
                identifier.linearise_about(before.found)
        if not identifier.noise.stated:
            identifier.noise = NoiseModel.shown_by(made.t, made.v)
        for t, q, v, spins in zip(made.t, made.q, made.v, wheels, strict=True):
            identifier.update(t, q, v, spins)
        if made.tau is not None and use_torques is not False:
            identifier.add_equations(*torque_equations(identifier, made, noise))
    return identifier.found


def torque_equations(
    identifier: Identifier, recording: Recording, torque_noise: float
) -> tuple[FloatArray, FloatArray]:
    """Return the joints' equations of motion as weighted rows (R, 10 b) and right sides (R,).

    A row times the change of the unknown bodies' parameters equals its right side. Regressor and torques are
    averaged over blocks of 0.1 s, in which the noise of the accelerations largely cancels. Blocks in which a
    joint is beyond its limits are left out, because its stop adds a torque.
    """
    robot, bodies, tau = identifier.robot, identifier.bodies, recording.tau
    assert tau is not None
    t, q, v = recording.t, recording.q, recording.v
    dt, n = np.diff(t), robot.n
    size = max(1, min(round(_BLOCK / float(np.median(dt))), len(dt)))
    deviation = max(torque_noise, _TORQUE_SHARE * float(np.abs(tau).max()), 1e-9)
    columns = np.concatenate([np.arange(PER_BODY) + PER_BODY * body.index for body in bodies])
    believed, armature = robot.inertial_parameters, np.array(robot.model.armature)[6:]
    stopped = np.array([robot.limits.violation(robot.layout.positions(row)).any() for row in q])
    rows, sides = [], []
    for first in range(0, len(dt) - size + 1, size):
        if stopped[first : first + size + 1].any():
            continue
        Y, force = np.zeros((n, PER_BODY * (1 + n))), np.zeros(n)
        for k in range(first, first + size):
            rate = (v[k + 1] - v[k]) / dt[k]
            between = pin.interpolate(robot.model, q[k], q[k + 1], 0.5)
            full = torque_regressor(robot, between, 0.5 * (v[k] + v[k + 1]), rate)
            Y += full[6:] / size
            rates = 0.5 * (v[k] + v[k + 1])[6:]
            friction = friction_torque(rates, robot.joint_damping, robot.joint_friction)
            force += (tau[k] + friction - armature * rate[6:]) / size
        M = pin.crba(robot.model, robot.model.createData(), q[first])[6:]
        span = float(t[first + size] - t[first])
        covariance = (2.0 / span**2) * (M * identifier.noise.rates) @ M.T
        covariance += deviation**2 / size * np.eye(n)
        W = np.linalg.inv(np.linalg.cholesky(covariance))
        rows.append(W @ Y[:, columns])
        sides.append(W @ (force - Y @ believed))
    if not rows:
        text = "has no block of 0.1 s with all joints within their limits; set use_torques=False"
        raise InvalidValue("recording q", q[0], text)
    return np.concatenate(rows), np.concatenate(sides)
