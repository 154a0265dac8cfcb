"""The estimation of the present state from noisy and delayed sensors, by filters and the momentum equation.

See docs/closed-loop.md.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, fields
from typing import Annotated

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation.wheels import SLOW, friction_torque
from ffsms_pin.checks import FloatArray, at_least_zero
from ffsms_pin.options import NotNegative, Unit
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation.devices import Sensors
from ffsms_pin.system.dynamics import inertia_matrix, over_base

_SETTLED = 5.0  # [s] time until a filter's gains are almost constant
_OUTLIER = 5.0  # standard deviations, exceeded by Gaussian noise about once in two million measurements


@dataclass(frozen=True)
class Estimator:
    """The parameters of the state estimator; noise and latency are those of the `Sensors`.

    The acceleration error of the nominal model is modelled as white noise. Each parameter is the square root
    of the spectral density of this noise. Larger values give the measurements more weight. The defaults suit
    mass errors of 30 % on arms that move at about 0.1 rad/s.

    Raises
    ------
    InvalidValue
        A number is negative; raised at the start of a run.
    """

    joint_acceleration: Annotated[NotNegative, Unit("rad/s^1.5")] = 5e-3
    """The error of the joint accelerations ([m/s^1.5] for prismatic joints)."""
    base_acceleration: Annotated[NotNegative, Unit("m/s^1.5")] = 5e-4
    """The error of the base's acceleration in the momentum equation."""
    base_angular_acceleration: Annotated[NotNegative, Unit("rad/s^1.5")] = 5e-4
    """The error of the base's angular acceleration in the momentum equation."""


class RunningEstimator:
    """The state estimator of a run.

    Joint positions and rates are filtered with the model's acceleration under the applied torques. The base's
    twist is that of the momentum equation, v = -M_b^-1 (M_bm qd + [0; h_w]), plus a bias. Here qd are the
    filtered joint rates, and h_w is the momentum of the wheels. The bias is filtered from the delayed
    measurements. The base's pose is filtered at the instant of the measurement, and integrated to the present
    with this twist.
    """

    def __init__(self, estimator: Estimator, sms: SpaceManipulator, sensors: Sensors, dt: float) -> None:
        for field in fields(estimator):
            at_least_zero(f"estimator.{field.name}", getattr(estimator, field.name))
        self._sms, self._dt, self._data = sms, dt, sms.model.createData()
        self._noises = (
            (sensors.joint_deviation, sensors.joint_rate_noise, estimator.joint_acceleration),
            (sensors.base_position_noise, sensors.base_velocity_noise, estimator.base_acceleration),
            (sensors.base_attitude_noise, sensors.base_rate_noise, estimator.base_angular_acceleration),
        )
        self._joint, self._shift, self._turn = (PositionAndRate(*noise) for noise in self._noises)
        self._model, self._viscous, self._coulomb = sms.model.copy(), sms.joint_damping, sms.joint_friction
        self._rubs = bool(self._viscous.any() or self._coulomb.any())
        self._age = round(sensors.base_latency / dt)
        self._joints = self._rates = self._bias = np.empty(0)
        self._spinning = np.zeros(3)
        self._pose = pin.SE3.Identity()  # the root's pose at the instant of the latest measurement
        # Root velocities by the momentum equation since the latest measurement.
        self._modelled: deque[FloatArray] = deque()
        self._travel = np.zeros(6)  # integral of these velocities [m; rad]

    @property
    def settled_deviations(self) -> tuple[float, float, float]:
        """The standard deviations of joint positions [rad], base position [m] and attitude [rad], per axis.

        They follow from the covariances of the filters after 5 s, or after 10,000 control steps if sooner.
        """
        filters = [PositionAndRate(*noise) for noise in self._noises]
        for filtering in filters:
            for _ in range(min(round(_SETTLED / self._dt), 10_000)):
                filtering.predict(self._dt)
                filtering.gains()
        joint, shift, turn = (filtering.deviation[0] for filtering in filters)
        return joint, shift, turn

    def update(
        self, q: FloatArray, v: FloatArray, tau: FloatArray | None, spinning: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the present estimates of q (nq,) and v (6 + n,) as new arrays; called once per control step.

        In the measured `q` and `v` the base is delayed, the joints are not. `tau` (n,) [N m] are the torques
        since the last call; the first call ignores them. `spinning` (3,) is the present momentum of the
        wheels in root axes [N m s], by default zero.
        """
        before, self._spinning = self._spinning, np.zeros(3) if spinning is None else spinning
        if tau is None or not self._modelled:
            self._begin(q, v)
        else:
            self._filter_joints(q, v, tau, (self._spinning - before) / self._dt)
            self._filter_base(q, v)
        estimate, velocity = q.copy(), np.empty_like(v)
        self._sms.layout.set_positions(estimate, self._joints)
        age = self._dt * (len(self._modelled) - 1)  # age of the pose [s], at first below the latency
        now = self._pose * pin.exp6(self._travel + age * self._bias)
        estimate[:7] = pin.SE3ToXYZQUAT(now)
        velocity[:6] = self._modelled[-1] + self._bias
        velocity[6:] = self._rates
        return estimate, velocity

    def _begin(self, q: FloatArray, v: FloatArray) -> None:
        self._joints, self._rates = self._sms.layout.positions(q), v[6:].copy()
        self._pose = pin.XYZQUATToSE3(q[:7])
        modelled = self._momentum_equation(q)
        self._bias = v[:6] - modelled
        self._modelled.append(modelled)

    def _momentum_equation(self, q: FloatArray) -> FloatArray:
        """Return the root velocity (6,), root axes, at zero total momentum and the estimated joint rates."""
        at = q.copy()
        self._sms.layout.set_positions(at, self._joints)
        M = inertia_matrix(self._sms, at)
        momentum = M[:6, 6:] @ self._rates
        momentum[3:] += self._spinning
        return -over_base(M, momentum)

    def _filter_joints(self, q: FloatArray, v: FloatArray, tau: FloatArray, taken: FloatArray) -> None:
        """Predict the joint positions and rates, and correct them by the measured q and v.

        `tau` (n,) are the joint torques, `taken` (3,) is the rate of the wheels' momentum in root axes [N m].
        """
        sms, dt = self._sms, self._dt
        before, velocity, force = q.copy(), np.empty(sms.nv), np.zeros(sms.nv)
        sms.layout.set_positions(before, self._joints)
        velocity[:6], velocity[6:] = self._modelled[-1] + self._bias, self._rates
        force[6:] = tau + self._friction()
        force[3:6] = -(taken + np.cross(velocity[3:6], self._spinning))
        acceleration = pin.aba(self._model, self._data, before, velocity, force)[6:]
        joints = self._joints + dt * (self._rates + 0.5 * dt * acceleration)
        rates = self._rates + dt * acceleration
        off, too_fast = sms.layout.difference(q, joints), v[6:] - rates
        self._joint.predict(dt)
        self._joint.inflate(float(np.abs(too_fast).max()))
        K_pp, K_pr, K_rp, K_rr = self._joint.gains()
        self._joints = joints + K_pp * off + K_pr * too_fast
        self._rates = rates + K_rp * off + K_rr * too_fast

    def _friction(self) -> FloatArray:
        """Return the friction torques (n,) [N m] of the robot's file at the estimated rates.

        The slope of the friction times the control step is added to the armature of the model, so that steep
        friction is integrated implicitly.
        """
        if not self._rubs:
            return np.zeros(self._sms.n)
        slow = 1.0 - np.tanh(self._rates / SLOW) ** 2
        slope = self._viscous + self._coulomb * slow / SLOW
        armature = self._sms.model.armature.copy()
        armature[6:] += self._dt * slope
        self._model.armature = armature
        return friction_torque(self._rates, self._viscous, self._coulomb)

    def _filter_base(self, q: FloatArray, v: FloatArray) -> None:
        dt, modelled = self._dt, self._modelled
        modelled.append(self._momentum_equation(q))
        self._travel += 0.5 * dt * (modelled[-2] + modelled[-1])
        if len(modelled) > self._age + 1:  # in the first steps each measurement is the initial state
            passed = 0.5 * dt * (modelled[0] + modelled[1])
            self._travel -= passed
            modelled.popleft()
            self._pose = self._pose * pin.exp6(passed + dt * self._bias)
        measured = pin.XYZQUATToSE3(q[:7])
        difference = self._pose.actInv(measured)
        off = np.concatenate([difference.translation, pin.log3(difference.rotation)])
        too_fast = v[:6] - modelled[0] - self._bias
        for filtering, error in ((self._shift, too_fast[:3]), (self._turn, too_fast[3:])):
            filtering.predict(dt)
            filtering.inflate(float(np.abs(error).max()))
        shift, turn = self._shift.gains(), self._turn.gains()
        K_pp, K_pr, K_rp, K_rr = (np.repeat(pair, 3) for pair in zip(shift, turn, strict=True))
        step = K_pp * off + K_pr * too_fast
        correction = pin.SE3(pin.exp3(step[3:]), step[:3])
        self._pose = self._pose * correction
        self._bias = self._bias + K_rp * off + K_rr * too_fast


def place_deviation(
    sms: SpaceManipulator, q: FloatArray, sensors: Sensors, estimator: RunningEstimator | None
) -> float:
    """Return the root-mean-square error [m] of the end-effector position at q (nq,), neglecting latency.

    The position follows from the estimated state, or without an estimator from the raw measurements.
    """
    if estimator is None:
        joint, shift, turn = sensors.joint_deviation, sensors.base_position_noise, sensors.base_attitude_noise
    else:
        joint, shift, turn = estimator.settled_deviations
    state = sms.at(q)
    lever = float(np.linalg.norm(state.end_effector_pose.translation - q[:3]))
    # Position errors act on each axis, attitude errors on the two axes across the lever, joint errors by J_m.
    joints = joint * float(np.linalg.norm(state.J_m[:3]))
    return math.sqrt(3.0 * shift**2 + 2.0 * (turn * lever) ** 2 + joints**2)


class PositionAndRate:
    """The covariance and gains of a Kalman filter for a position p and its rate r, both measured.

    The model is p' = r, r' = known acceleration + white noise; `acceleration_noise` is the square root of the
    spectral density of this noise [rad/s^1.5 or m/s^1.5]. The noises of the measurements are standard
    deviations, zero for perfect measurements. All joints share one filter, because their noises are equal;
    so do the three axes of the base's position, and those of its attitude.
    """

    def __init__(self, position_noise: float, rate_noise: float, acceleration_noise: float) -> None:
        self._R_p, self._R_r = position_noise**2, rate_noise**2
        self._density = acceleration_noise**2
        # The first measurement is the first estimate.
        self._pp, self._pr, self._rr = self._R_p, 0.0, self._R_r

    @property
    def deviation(self) -> tuple[float, float]:
        """The standard deviations of the present estimates of p and r."""
        return max(self._pp, 0.0) ** 0.5, max(self._rr, 0.0) ** 0.5

    def predict(self, dt: float) -> None:
        """Propagate the covariance by `dt` [s]."""
        pp, pr, rr, S = self._pp, self._pr, self._rr, self._density
        self._pp = pp + 2.0 * dt * pr + dt * dt * rr + S * dt**3 / 3.0
        self._pr = pr + dt * rr + 0.5 * S * dt * dt
        self._rr = rr + S * dt

    def inflate(self, rate_error: float) -> None:
        """Increase the covariance if a predicted rate and a noisy measurement differ by over 5 deviations.

        The model is then worse than assumed, for example because a body was captured. With the larger
        covariance the next gains weight the measurements more.
        """
        if self._R_r > 0.0 and rate_error * rate_error > _OUTLIER**2 * (self._rr + self._R_r):
            self._pp, self._pr = max(self._pp, self._R_p), 0.0
            self._rr = max(self._rr, rate_error * rate_error)

    def gains(self) -> tuple[float, float, float, float]:
        """Update the covariance by a measurement of p and r, and return the gains K_pp, K_pr, K_rp, K_rr.

        They correct the estimate as p += K_pp e_p + K_pr e_r and r += K_rp e_p + K_rr e_r; the innovations
        e_p and e_r are the measured minus the predicted values.
        """
        pp, pr, rr, R_p, R_r = self._pp, self._pr, self._rr, self._R_p, self._R_r
        if R_p == 0.0 and R_r == 0.0:
            self._pp = self._pr = self._rr = 0.0
            return 1.0, 0.0, 0.0, 1.0
        a, c = pp + R_p, rr + R_r
        determinant = a * c - pr * pr
        if determinant <= 0.0:  # position or rate are predicted and measured without error
            K_pp, K_rr = pp / a if a > 0.0 else 1.0, rr / c if c > 0.0 else 1.0
            self._pp, self._pr, self._rr = K_pp * R_p, 0.0, K_rr * R_r
            return K_pp, 0.0, 0.0, K_rr
        K_pp = (pp * c - pr * pr) / determinant
        K_pr = pr * R_p / determinant
        K_rp = pr * R_r / determinant
        K_rr = (rr * a - pr * pr) / determinant
        # The updated covariance is K R. In this form it stays symmetric and positive semidefinite.
        self._pp, self._pr, self._rr = K_pp * R_p, K_pr * R_r, K_rr * R_r
        return K_pp, K_pr, K_rp, K_rr
