"""A Kalman filter of a client's pose, twist, inertia and mass, from noisy and late measurements.

The state of the filter has the errors of position and velocity in inertial axes and, in body axes, the errors
theta of the attitude and dw of the angular velocity w. Let I be the inertia, dI its error, and
a = w' = I^-1 (I w x w) the angular acceleration of a free body. Then

    theta' = dw - w x theta,    dw' = I^-1 (I dw x w + I w x dw + dI w x w - dI a).

A Kalman filter (R. E. Kalman, "A new approach to linear filtering and prediction problems", Journal of Basic
Engineering 82, 1960) processes each measurement at the time at which it was made. From that time on the
client is predicted by its torque-free motion, so latency only increases the age of the estimate.

The error of the assumed inertia has six parameters, the entries of a symmetric matrix X. With this error, the
second moments of mass S = tr(I)/2 - I become S^1/2 exp(X) S^1/2. The inertia is then physically consistent
for every X (Lee, Wensing, Park, IEEE Transactions on Robotics 36, 2020). The tumbling motion determines the
inertia up to its scale. The scale, given by tr(X), and the mass are unobservable in free motion, so their
uncertainty does not decrease. The state has velocities instead of momenta, because measured
velocities do not depend on the inertia.

Let nu be the innovation of a measurement and P_nu its covariance. The measurement is refused as an outlier if
nu^T P_nu^-1 nu exceeds the 99.9 % quantile of the chi-squared distribution. If several refused measurements
agree with each other, the estimate is assumed to be wrong, and restarts from these measurements.
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
# The last _REFUSED refused measurements are stored. The estimate restarts from a stored measurement if _AGREE
# later refused measurements agree with it.
_REFUSED, _AGREE = 5, 3
# The state has twelve entries for the motion, five for the ratios of the inertia (X without its trace, in an
# orthonormal basis), and the errors of the logarithms of the inertia's scale and of the mass.
_SIZE, _FORM, _SCALE, _MASS = 19, slice(12, 17), 17, 18
_OF_PUSHES = 0.1  # relative standard deviation of velocity changes by impulses, due to uncertain masses
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
    """The estimate of a client by a Kalman filter; plans accept it in place of a `Client`.

    Parameters
    ----------
    first : Client
        The first measurement (see `capture.measured`), with the assumed mass and inertia.
    t : float
        The time of the first measurement [s].
    sensor : Camera
        The camera whose measurements update the estimate.
    mass_deviation : float
        The relative standard deviation of the mass; zero for a known mass.
    inertia_deviation : float
        The relative standard deviation of the principal inertias if they are equal; zero for a known inertia.
        For a rod or a plate, the deviations are up to 1.4 times as large.

    Attributes
    ----------
    refused, restarts : int
        The number of refused measurements and the number of restarts of the estimate.
    measured_at : float
        The time of the last accepted measurement [s].
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
        self._refused: list[tuple[Client, float]] = []  # refused since the last accepted measurement
        self._body, self._since, self._sensor = first, t, sensor
        self._assumed = first
        self._doubts = tuple(
            checks.share(name, value)
            for name, value in (("mass_deviation", mass_deviation), ("inertia_deviation", inertia_deviation))
        )
        # A principal inertia is the sum of two independent second moments of mass. If these are equal, its
        # relative deviation is smaller than theirs by the factor sqrt(2).
        moments = np.sqrt(2.0) * self._doubts[1]
        of_body = [*np.repeat(moments, 5), moments / np.sqrt(3.0), self._doubts[0]]
        self._P = np.diag(np.concatenate([sensor.deviations, of_body]) ** 2)
        self.measured_at = self._since
        self._gained = np.zeros(2)  # sums of |velocity changes| by impulses since `measured_at`

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
        """Return the estimated pose (pinocchio.SE3) at t [s]; see `Client.pose`."""
        return self._body.pose(t - self._since)

    def poses(self, times: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the estimated poses at several times [s], see `Client.poses`."""
        return self._body.poses(np.asarray(times) - self._since)

    def twist(self, t: float) -> FloatArray:
        """Return the estimated twist (6,) at t [s], see `Client.twist`."""
        return self._body.twist(t - self._since)

    def deviation(self, t: float, lever: float = 0.0) -> tuple[float, float]:
        """Return the standard deviations of a point's position [m] and of the attitude [rad] at t [s].

        Each standard deviation is the root of the summed variances of three axes. The point on the client is
        `lever` [m] away from the centre of mass; attitude errors count as perpendicular to the lever. The
        errors of the velocities increase the deviations with the time since the last update.
        """
        slopes, dt = np.zeros((6, _SIZE)), t - self._since
        slopes[:3, :3] = slopes[3:, 6:9] = np.eye(3)
        slopes[:3, 3:6] = slopes[3:, 9:12] = dt * np.eye(3)
        moved, turned = np.diag(slopes @ self._P @ slopes.T).reshape(2, 3).sum(axis=1).tolist()
        return float(np.sqrt(moved + lever**2 * turned)), float(np.sqrt(turned))

    def take(self, other: ClientEstimate) -> None:
        """Copy the state, the covariance and `measured_at` of `other`."""
        self._body, self._since, self._P = other._body, other._since, other._P
        self.measured_at, self._gained = other.measured_at, other._gained

    def pushed(
        self, t: float, impulse: FloatArray, turn: FloatArray, noise: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        """Apply an impulse (3,) [N s] and an angular impulse `turn` (3,) [N m s] at t [s].

        The angular impulse is about the centre of mass; both are in inertial axes. If t is before the last
        update, they act at the last update. Per axis, the changes of velocity and angular velocity get a
        standard deviation of a tenth of their magnitude; all impulses since the last accepted measurement
        share this error. `noise` has additional standard deviations per axis [N s], [N m s].
        """
        if t > self._since:
            self._predict(t)
        body, R = self._body, self._body.start_pose.rotation
        by_unit = np.linalg.inv(body.inertia)  # change of the angular velocity per unit angular impulse
        gained = np.stack([impulse / body.mass, by_unit @ R.T @ turn])
        twist = body.start_twist + np.append(gained[0], R @ gained[1])
        self._body = other_motion(body, body.start_pose, twist)
        before, self._gained = self._gained, self._gained + np.linalg.norm(gained, axis=1)
        shares = (_OF_PUSHES * self._gained) ** 2 - (_OF_PUSHES * before) ** 2
        self._P = self._P.copy()
        self._P[3:6, 3:6] += (shares[0] + (noise[0] / body.mass) ** 2) * np.eye(3)
        self._P[9:12, 9:12] += shares[1] * np.eye(3) + noise[1] ** 2 * by_unit @ by_unit.T

    def client(self) -> Client:
        """Return the estimated client, with the same time zero as the estimate."""
        return self._from_start(self._body)

    def spread(self) -> list[Client]:
        """Return clients that deviate by one standard deviation in independent directions of the state.

        There are twelve clients, six more if the inertia is uncertain, and one more if the mass is uncertain.
        To first order, the standard deviation of a function of the client is the root of the sum of the
        squared changes of the function over these clients.
        """
        return [self._from_start(body) for body in self._spread_bodies()]

    def spread_poses(self, t: float) -> list[pin.SE3]:
        """Return the poses (pinocchio.SE3) at t [s] of the clients of `spread`, at a lower cost."""
        return [body.pose(t - self._since) for body in self._spread_bodies()]

    def _spread_bodies(self) -> list[Client]:
        """Return the clients of `spread`, with their time zero at the last update."""
        uncertain = np.flatnonzero(np.diag(self._P))
        sizes, axes = np.linalg.eigh(self._P[np.ix_(uncertain, uncertain)])
        moves = np.zeros((_SIZE, len(uncertain)))
        moves[uncertain] = axes * np.sqrt(np.maximum(sizes, 0.0))
        return [self._moved(x) for x in moves.T]

    def _from_start(self, body: Client) -> Client:
        """Return `body`, whose time zero is the last update, with the estimate's time zero."""
        return other_motion(body, body.pose(-self._since), body.twist(-self._since))

    def _moved(self, x: FloatArray) -> Client:
        """Return the estimated client with motion, inertia and mass changed by a state error x (19,)."""
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
        """The estimated momentum (6,), see `Client.momentum`."""
        return self.client().momentum

    @property
    def start_pose(self) -> pin.SE3:
        """The estimated pose (pinocchio.SE3) at time zero, see `Client`."""
        return self.pose(0.0)

    @property
    def covariance(self) -> FloatArray:
        """The covariance (12, 12) of position, velocity, attitude and angular momentum at the last update.

        All are in inertial axes; the units are m, m/s, rad and kg m^2/s.
        """
        body, R, w = self._body, self._body.start_pose.rotation, _spin(self._body)
        slopes = np.eye(12, _SIZE)
        slopes[6:9, 6:9], slopes[9:, 6:9] = R, -R @ pin.skew(body.inertia @ w)
        slopes[9:, 9:12], slopes[9:, _FORM] = R @ body.inertia, R @ _changes(body, w)
        slopes[9:, _SCALE] = R @ body.inertia @ w
        return np.asarray(slopes @ self._P @ slopes.T)

    @one_blas_thread()
    def observe(self, seen: Client, t: float) -> bool:
        """Update the estimate by a measurement made at t [s]; return False if it is refused as an outlier.

        `seen` is the measurement (see `capture.measured`), with its time zero at t.

        Raises
        ------
        InvalidValue
            If t is before the last update, or `seen` has another mass or inertia than the first measurement.
        """
        if t < self._since:
            raise InvalidValue("t", t, f"must not be before the last update, at {self._since:g} s")
        assumed = self._assumed
        for name, close in (("mass", np.isclose), ("inertia", np.allclose)):
            if not close(getattr(seen, name), getattr(assumed, name)):
                first = " ".join(str(getattr(assumed, name)).split())
                message = (
                    f"must be the {name} of the first measurement, {first}: pass the same client as"
                    " `believed` to capture.measured"
                )
                raise InvalidValue(f"seen.{name}", getattr(seen, name), message)
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
        """Return the innovation (12,) of a measurement and the measurement matrix (12, 19)."""
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
        """Propagate the estimate and its covariance to the time t [s]."""
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
    """Return a `Client` unchanged, or the estimated client of a `ClientEstimate`."""
    if isinstance(body, ClientEstimate):
        return body.client()
    if not isinstance(body, Client):
        raise InvalidValue("client", body, "must be a Client, or a ClientEstimate")
    return body


def _spin(body: Client) -> FloatArray:
    """Return the angular velocity (3,) at the body's time zero, body axes."""
    return np.asarray(body.start_pose.rotation.T @ body.start_twist[3:])


def _root(inertia: FloatArray) -> FloatArray:
    """Return the square root (3, 3) of the second moments of mass of an inertia (3, 3)."""
    sizes, axes = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
    return np.asarray(axes * np.sqrt(np.maximum(sizes, 0.0)) @ axes.T)


def _of_moments(moments: FloatArray) -> FloatArray:
    """Return the inertias (..., 3, 3) from second moments of mass (..., 3, 3)."""
    return np.asarray(np.trace(moments, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - moments)


def _changes(body: Client, w: FloatArray) -> FloatArray:
    """Return the derivative (3, 5) of I w with respect to the state's entries of the inertia's ratios."""
    root = _root(body.inertia)
    return np.asarray((_of_moments(root @ _BASIS @ root) @ w).T)
