"""A Kalman filter of a client's pose, twist, inertia and mass, from noisy and late measurements.

No force acts on a free body, so its initial state determines its motion. The estimated errors are those of
position and velocity and, in body axes, of the attitude theta and the angular velocity w. With an inertia I,
its error dI, and a = w' = I^-1 (I w x w) the errors of attitude and angular velocity evolve as

    theta' = dw - w x theta,    dw' = I^-1 (I dw x w + I w x dw + dI w x w - dI a),

and a Kalman filter of these numbers (Kalman 1960) processes every measurement at the time when it was made.
The torque-free motion of the client predicts any later time from there, so latency only makes the estimate
older.

The error of the assumed inertia has six parameters, the entries of a symmetric X: the second moments of mass
S = tr(I)/2 - I become S^1/2 exp(X) S^1/2, which is physically consistent for every X (Lee, Wensing, Park,
IEEE Transactions on Robotics 36, 2020). The tumbling motion determines the inertia's ratios. Its scale,
tr(X), and the mass are unobservable in free motion and stay as uncertain as they were. The state has the
velocity, not the momentum, because the velocity is measured for any inertia, and the momentum is no linear
function of a poorly known inertia.

A measurement is refused as an outlier if its innovation nu, of covariance S, has nu^T S^-1 nu above the 99.9
% quantile. If refused measurements agree with each other, the estimate is wrong, and it restarts from them.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin import checks
from ffsms_pin.capture.camera import Camera
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client, FreeBody, Shape
from ffsms_pin.client.client import other_motion
from ffsms_pin.errors import InvalidValue
from ffsms_pin.threads import one_blas_thread

_MOST_UNLIKELY = 32.90949040736021  # the 99.9 % quantile of chi-squared with 12 degrees of freedom
# The number of consecutive refused measurements that are compared; an estimate restarts from one with which
# three agree.
_REFUSED, _AGREE = 5, 3
# The state has twelve entries of the motion, five of the inertia's shape in an orthonormal basis of X without
# the scale, and the logarithms of the scale and of the mass.
_SIZE, _FORM, _SCALE, _MASS = 19, slice(12, 17), 17, 18
_OF_PUSHES = 0.1  # relative standard deviation of pushes, that of the masses that they are computed with
_BASIS = np.array(
    [
        np.diag([1, -1, 0]),
        np.diag([1, 1, -2]),
        np.eye(3)[[1, 0, 2]],
        np.eye(3)[[2, 1, 0]],
        np.eye(3)[[0, 2, 1]],
    ]
)
_BASIS[2:] *= 1.0 - np.eye(3)
_BASIS = _BASIS / np.linalg.norm(_BASIS, axis=(1, 2), keepdims=True)


class ClientEstimate:
    """An estimate of a client, for plans in place of a `Client`; measurements update it in a loop.

    It begins with a first measurement, made at t [s], with its own time zero at t and the assumed mass and
    inertia. `mass_deviation` is the relative standard deviation of the mass. `inertia_deviation` is that of
    equal principal inertias; for a rod or a plate the deviation is up to 1.4 times as large. Zero means that
    they are known. `refused` and `restarts` count refused measurements and restarts of the estimate;
    `measured_at` is the time of the last accepted measurement [s].
    """

    def __init__(
        self,
        first: Client,
        t: float,
        sensor: Camera,
        mass_deviation: float = 0.0,
        inertia_deviation: float = 0.0,
    ) -> None:
        self.refused = self.restarts = 0
        self._refused: list[tuple[Client, float]] = []  # the last ones, since the last accepted one
        self._body, self._since, self._sensor = first, t, sensor
        self._believed = first
        self._doubts = tuple(
            checks.share(name, value)
            for name, value in (("mass_deviation", mass_deviation), ("inertia_deviation", inertia_deviation))
        )
        # A principal inertia is the sum of two second moments.
        moments = np.sqrt(2.0) * self._doubts[1]
        of_body = [*np.repeat(moments, 5), moments / np.sqrt(3.0), self._doubts[0]]
        self._P = np.diag(np.concatenate([sensor.deviations, of_body]) ** 2)
        self.measured_at = self._since
        self._gained = np.zeros(2)  # changes of velocity and spin by all pushes since the last measurement

    @property
    def sensor(self) -> Camera:
        """The camera whose measurements update the estimate."""
        return self._sensor

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """The client's shapes."""
        return self._body.shapes

    @property
    def mass(self) -> float:
        """The assumed mass [kg]."""
        return self._body.mass

    @property
    def inertia(self) -> FloatArray:
        """The estimated inertia (3, 3), body axes [kg m^2]."""
        return self._body.inertia

    def pose(self, t: float) -> pin.SE3:
        """Return the pose as `Client.pose`."""
        return self._body.pose(t - self._since)

    def poses(self, times: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the poses as `Client.poses`."""
        return self._body.poses(np.asarray(times) - self._since)

    def twist(self, t: float) -> FloatArray:
        """Return the twist as `Client.twist`."""
        return self._body.twist(t - self._since)

    def deviation(self, t: float, lever: float = 0.0) -> tuple[float, float]:
        """Return one standard deviation of a client point's position at t [s] and of the attitude [m, rad].

        The point is `lever` [m] from the centre of mass. Present errors and those of the rates are included.
        """
        slopes, dt = np.zeros((6, _SIZE)), t - self._since
        slopes[:3, :3] = slopes[3:, 6:9] = np.eye(3)
        slopes[:3, 3:6] = slopes[3:, 9:12] = dt * np.eye(3)
        moved, turned = np.diag(slopes @ self._P @ slopes.T).reshape(2, 3).sum(axis=1).tolist()
        return float(np.sqrt(moved + lever**2 * turned)), float(np.sqrt(turned))

    def take(self, other: ClientEstimate) -> None:
        """Copy the state and covariance of `other`."""
        self._body, self._since, self._P = other._body, other._since, other._P
        self.measured_at, self._gained = other.measured_at, other._gained

    def pushed(
        self, t: float, impulse: FloatArray, turn: FloatArray, noise: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        """Add an impulse [N s] and an angular impulse [N m s] about the centre of mass, (3,) each, at t [s].

        Both are in inertial axes. Each axis has a relative standard deviation of a tenth, with a common error
        of all impulses since the last measurement, and additional standard deviations `noise` [N s], [N m s].
        """
        if t > self._since:
            self._predict(t)
        body, R = self._body, self._body.start_pose.rotation
        by_unit = np.linalg.inv(body.inertia)  # changes of the angular velocity, body axes
        gained = np.stack([impulse / body.mass, by_unit @ R.T @ turn])
        twist = body.start_twist + np.append(gained[0], R @ gained[1])
        self._body = other_motion(body, body.start_pose, twist)
        before, self._gained = self._gained, self._gained + np.linalg.norm(gained, axis=1)
        shares = (_OF_PUSHES * self._gained) ** 2 - (_OF_PUSHES * before) ** 2
        self._P = self._P.copy()
        self._P[3:6, 3:6] += (shares[0] + (noise[0] / body.mass) ** 2) * np.eye(3)
        self._P[9:12, 9:12] += shares[1] * np.eye(3) + noise[1] ** 2 * by_unit @ by_unit.T

    def client(self) -> Client:
        """Return the estimated client, with the time of the estimate."""
        return self._from_start(self._body)

    def spread(self) -> list[Client]:
        """Return clients one standard deviation away in independent directions.

        There are twelve for the motion, six more if the inertia is uncertain, and one if the mass is. The
        deviation of a function of the client is the root of the sum of the squares of its changes.
        """
        return [self._from_start(body) for body in self._spread_bodies()]

    def spread_poses(self, t: float) -> list[pin.SE3]:
        """Return the poses at a time t [s] of the clients of `spread`, in half the computing time."""
        return [body.pose(t - self._since) for body in self._spread_bodies()]

    def _spread_bodies(self) -> list[Client]:
        """Return the bodies of `spread`, with the time of the last measurement as time zero."""
        held = np.flatnonzero(np.diag(self._P))
        sizes, axes = np.linalg.eigh(self._P[np.ix_(held, held)])
        moves = np.zeros((_SIZE, len(held)))
        moves[held] = axes * np.sqrt(np.maximum(sizes, 0.0))
        return [self._moved(x) for x in moves.T]

    def _from_start(self, body: Client) -> Client:
        """Return a body at the last measurement as a client with the time of the estimate."""
        return other_motion(body, body.pose(-self._since), body.twist(-self._since))

    def _moved(self, x: FloatArray) -> Client:
        """Return the body with its motion, inertia and mass changed by x (19,)."""
        body = self._body
        turned = body.start_pose.rotation @ pin.exp3(x[6:9])
        pose = pin.SE3(turned, body.start_pose.translation + x[:3])
        inertia, (scale, mass) = body.inertia, np.exp(x[_SCALE:])
        if x[_FORM].any():
            from scipy.linalg import expm  # slow to load

            root = _root(inertia)
            inertia = _of_moments(root @ expm(np.tensordot(x[_FORM], _BASIS, 1)) @ root)
        twist = np.concatenate([body.start_twist[:3] + x[3:6], turned @ (_spin(body) + x[9:12])])
        return other_motion(body, pose, twist, mass * body.mass, scale * inertia)

    @property
    def momentum(self) -> FloatArray:
        """The momentum as `Client.momentum`."""
        return self.client().momentum

    @property
    def start_pose(self) -> pin.SE3:
        """The pose at time zero, see `Client`."""
        return self.pose(0.0)

    @property
    def covariance(self) -> FloatArray:
        """The covariance (12, 12) of position, velocity, attitude and angular momentum, inertial axes.

        It is that at the last measurement.
        """
        body, R, w = self._body, self._body.start_pose.rotation, _spin(self._body)
        slopes = np.eye(12, _SIZE)
        slopes[6:9, 6:9], slopes[9:, 6:9] = R, -R @ pin.skew(body.inertia @ w)
        slopes[9:, 9:12], slopes[9:, _FORM] = R @ body.inertia, R @ _changes(body, w)
        slopes[9:, _SCALE] = R @ body.inertia @ w
        return np.asarray(slopes @ self._P @ slopes.T)

    @one_blas_thread()
    def observe(self, seen: Client, t: float) -> bool:
        """Update the estimate by a measurement of time t [s]; return false if it is refused as an outlier.

        Raises `InvalidValue` if it was made before the last one, or is of another body than the first; see
        `measured`.
        """
        if t < self._since:
            raise InvalidValue("t", t, f"must not be before the last measurement, at {self._since:g} s")
        known = self._believed
        if not (np.isclose(seen.mass, known.mass) and np.allclose(seen.inertia, known.inertia)):
            message = f"must have mass and inertia of the estimated client, {known.mass:g} kg"
            raise InvalidValue("seen", seen.mass, message)
        self._predict(t)
        innovation, H = self._innovation(seen)
        noise = np.diag(self._sensor.deviations**2)
        S = H @ self._P @ H.T + noise
        if innovation @ np.linalg.solve(S, innovation) > _MOST_UNLIKELY:
            self._refuse(seen, t)
            return False
        self._refused = []
        K = np.linalg.solve(S, H @ self._P).T
        x = K @ innovation
        keep = np.eye(_SIZE) - K @ H
        self._P = keep @ self._P @ keep.T + K @ noise @ K.T
        self._body = self._moved(x)
        self.measured_at, self._gained = t, np.zeros(2)
        return True

    def _innovation(self, seen: Client) -> tuple[FloatArray, FloatArray]:
        """Return the innovation (12,) of a measurement and its derivative (12, 19) by the state."""
        body, R = self._body, self._body.start_pose.rotation
        turn = pin.log3(R.T @ seen.start_pose.rotation)
        shift = seen.start_pose.translation - body.start_pose.translation
        H = np.eye(12, _SIZE)
        H[9:, 6:9] = -pin.skew(_spin(body))
        moved, turning = (seen.start_twist - body.start_twist).reshape(2, 3)
        return np.concatenate([shift, moved, turn, R.T @ turning]), H

    def _refuse(self, seen: Client, t: float) -> None:
        """Refuse a measurement, and restart the estimate if refused measurements agree."""
        self.refused += 1
        self._refused = [*self._refused, (seen, t)][-_REFUSED:]
        for i in range(len(self._refused) - _AGREE):
            (first, then), *others = self._refused[i:]
            fresh = ClientEstimate(first, then, self._sensor, *self._doubts)
            if sum(fresh.observe(*other) for other in others) >= _AGREE:
                self.take(fresh)
                self._refused = []
                self.restarts += 1
                return

    def _predict(self, t: float) -> None:
        """Propagate the estimate and its covariance to a time."""
        from scipy.linalg import expm

        body, dt, inertia = self._body, t - self._since, self._body.inertia
        self._body = other_motion(body, body.pose(dt), body.twist(dt))
        self._since, w = t, 0.5 * (_spin(body) + _spin(self._body))
        acceleration = np.asarray(np.linalg.solve(inertia, np.cross(inertia @ w, w)))
        A = np.zeros((_SIZE, _SIZE))
        A[:3, 3:6] = A[6:9, 9:12] = np.eye(3)
        A[6:9, 6:9] = -pin.skew(w)
        torque = pin.skew(inertia @ w) - pin.skew(w) @ inertia
        form = -pin.skew(w) @ _changes(body, w) - _changes(body, acceleration)
        A[9:12, 9:12], A[9:12, _FORM] = np.linalg.solve(inertia, torque), np.linalg.solve(inertia, form)
        F = expm(A * dt)
        self._P = F @ self._P @ F.T


def as_client(body: FreeBody) -> Client:
    """Return a client unchanged, and an estimate as its estimated client."""
    if isinstance(body, ClientEstimate):
        return body.client()
    if not isinstance(body, Client):
        raise InvalidValue("client", body, "must be a Client, or a ClientEstimate")
    return body


def _spin(body: Client) -> FloatArray:
    """Return the angular velocity (3,) at the body's time zero, body axes."""
    return np.asarray(body.start_pose.rotation.T @ body.start_twist[3:])


def _root(inertia: FloatArray) -> FloatArray:
    """Return the square root (3, 3) of the second moments of mass, body axes."""
    sizes, axes = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
    return np.asarray(axes * np.sqrt(np.maximum(sizes, 0.0)) @ axes.T)


def _of_moments(moments: FloatArray) -> FloatArray:
    """Return the inertias (..., 3, 3) of second moments of mass."""
    return np.asarray(np.trace(moments, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - moments)


def _changes(body: Client, w: FloatArray) -> FloatArray:
    """Return the derivative (3, 5) of I w by the inertia's shape."""
    root = _root(body.inertia)
    return np.asarray((_of_moments(root @ _BASIS @ root) @ w).T)
