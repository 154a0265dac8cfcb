"""The recursive estimation of inertial parameters by the conservation of momentum."""

from __future__ import annotations

import math
from collections import deque
from typing import Annotated

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, instance, number, vector
from ffsms_pin.errors import FfsmsError, InvalidValue
from ffsms_pin.identification.bodies import known_bodies, unknown_bodies
from ffsms_pin.identification.noise import NoiseModel
from ffsms_pin.identification.result import Identification, Solution, identification_of
from ffsms_pin.opt.replan.learning import Learner
from ffsms_pin.options import Bodies, Positive, Texts, Unit
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Sensors
from ffsms_pin.system.momentum_filter import MomentumFilter
from ffsms_pin.system.regressors import momentum_regressors

_PERIOD = 32  # number of samples with the same weights and noise bias, which change slowly with the posture
_REWEIGHTED = 64  # number of samples before the weights use an estimate, doubled after each new estimate
_NOISE = 4.0  # largest mean square of weighted residuals that noise explains
# Least share of the prior variances in the weights. Without it, samples without motion would get such large
# weights that their noise outweighs the samples with motion.
_DOUBT = 0.05**2
_LEAST_SCALE = 0.5  # lower bound of the factor on the noise's variance, reached with exact data
_ROUNDING = 1e-14  # rounding error of the information, relative to its largest eigenvalue
_CERTAIN = 0.3  # largest remaining share of the uncertainty at which plans use an estimate
_CHANGED = 3e-3  # least change of the unknown bodies' momentum, as a share, for which plans use an estimate
_FEWEST = 10  # number of samples before an estimate is used
_SIGNIFICANT = 4.0  # standard deviations of noise that the information of a direction must exceed
_ENOUGH = 30  # excess of equations over unknowns from which on the residuals scale the noise


class Identifier(Learner):
    """A recursive estimator of inertial parameters from measured configurations and velocities.

    Without external forces the total momentum about a fixed point is constant, and it is linear in the
    inertial parameters. Each sample adds up to six equations to sums of fixed size (`MomentumFilter`), in
    which the constant momentum is unknown, too. Wheels may turn if their momentum is given. The property
    `found` is the estimate.

    Parameters
    ----------
    sms : SpaceManipulator
        The prior model. Unobservable parameters keep its values.
    unknown : sequence of str
        Bodies whose ten parameters are estimated: "base", "payload" (an additional body fixed to the link
        that carries the end effector), and names of links or joints.
    sensors : Sensors, optional
        The noise of the measurements, which determines their weights and the correction of the bias. The
        default suits nearly exact measurements: the same deviation for all velocities, scaled by the
        residuals, and no bias. `identify` estimates the noise from the recording.
    known : mapping, optional
        Known values by the name of a body. If only a mass [kg] is given, this mass is not estimated. A
        `pinocchio.Inertia` replaces the model's inertia as prior; for "payload" it is in the frame of the
        link that carries the end effector. In a scenario file a body is a table of `mass`, `inertia` (about
        the centre of mass) and `com`.
    spread : float
        The prior standard deviation, as a share of m, m r and m r^2 for mass, first moments and inertias. m
        is the body's mass, and r its radius of gyration about the origin of its link's frame. `spread` is not
        used for a payload without a known inertia.
    at_rest : bool
        True if the total momentum is zero. Default: the momentum is constant and unknown.

    Raises
    ------
    InvalidValue
        A name is unknown or given twice, or a number is out of range.

    Attributes
    ----------
    sms : SpaceManipulator
        The prior model with the inertias of `known`.
    robot : SpaceManipulator
        The model about which the equations are linearised: `sms` with the priors of the unknown bodies.
    bodies : list of UnknownBody
        The unknown bodies and their priors.
    """

    unfiltered = True

    def __init__(
        self,
        sms: SpaceManipulator,
        unknown: Annotated[Texts, Unit()],
        *,
        sensors: Sensors | None = None,
        known: Annotated[Bodies | None, Unit("kg", "none")] = None,
        spread: Annotated[Positive, Unit()] = 1.0,
        at_rest: Annotated[bool, Unit()] = False,
    ) -> None:
        instance("sms", sms, SpaceManipulator)
        instance("sensors", sensors, Sensors, optional=True)
        instance("at_rest", at_rest, bool)
        stated = known_bodies(sms, {} if known is None else known)
        self.bodies = unknown_bodies(stated, unknown, spread)
        self.sms = robot = stated.sms
        self.noise = NoiseModel.of(robot, sensors)
        self.at_rest = at_rest
        inertias = list(robot.model.inertias)[1:]
        for body in self.bodies:  # inertias about which the equations are linear
            own = pin.Inertia.FromDynamicParameters(body.believed)
            inertias[body.index] = inertias[body.index] + own if body.added else own
        self.robot = robot.with_inertias(inertias)
        free = np.concatenate([body.free for body in self.bodies])
        deviations = np.concatenate([body.deviation for body in self.bodies])
        believed = np.concatenate([body.believed for body in self.bodies])
        self._free, self._scales = free, deviations[free]
        self._prior = believed[free] / self._scales  # the prior parameters in units of their deviations
        self._filter = MomentumFilter(
            self.robot, [body.index for body in self.bodies], np.diag(deviations)[:, free]
        )
        k = len(self._scales)
        self._bias, self._bias_now = np.zeros((k + 7, k + 7)), np.zeros((k + 7, k + 7))
        self._weight, self._reweighted = np.eye(6), float(_REWEIGHTED)
        self._weighting = np.zeros(k), np.eye(k)
        self._pose_noise: FloatArray | None = None
        self._origin: FloatArray | None = None
        self._late: deque[tuple[float, FloatArray, FloatArray, FloatArray | None]] = deque()
        self._time = -np.inf
        self._other = np.zeros((k + 1, k + 1))
        self._other_count = 0
        self._used: FloatArray | None = None
        self._near: FloatArray | None = None
        self._unseen: bool | None = None  # True if the samples have no linear velocity of the base

    def __repr__(self) -> str:
        names = ", ".join(body.name for body in self.bodies)
        return f"Identifier({self.sms.model.name}: {names}; {self.samples} samples)"

    @property
    def samples(self) -> int:
        """The number of samples."""
        return self._filter.samples

    def update(self, t: float, q: ArrayLike, v: ArrayLike, wheel_momentum: ArrayLike | None = None) -> None:
        """Add one sample.

        Parameters
        ----------
        t : float
            Time [s], later than the time of the previous sample.
        q : array_like, shape (nq,)
            Measured configuration in Pinocchio's layout.
        v : array_like, shape (6 + n,)
            Measured velocity in Pinocchio's layout. The linear velocity of the base is NaN if it is not
            measured. Then a sample adds three equations, of the angular momentum about the centre of mass, in
            which the linear velocity follows from the masses of `robot`. Either all samples have a measured
            linear velocity or none has.
        wheel_momentum : array_like, shape (w,), optional
            Spin momenta of the robot's wheels relative to the base [N m s]. Default: the wheels stand still.

        Raises
        ------
        InvalidValue
            A shape is wrong, a number is not finite, the time does not increase, or the linear velocity is
            measured in some samples only.
        """
        if not (isinstance(t, float) and math.isfinite(t)):
            t = number("t", t)
        if unseen := isinstance(v, np.ndarray) and bool(np.isnan(v[:3]).all()):
            v = np.concatenate([np.zeros(3), v[3:]])
        q, v = vector("q", q, self.robot.nq), vector("v", v, self.robot.nv)
        if self._unseen not in (None, unseen):
            text = "must be measured in all samples or in none; leave out the samples without it"
            raise InvalidValue("v[:3], the base's linear velocity,", "NaN" if unseen else v[:3], text)
        self._unseen = unseen
        if not t > self._time:
            raise InvalidValue("t", t, f"must be later than the previous sample at {self._time:g} s")
        self._time = t
        spins = None if wheel_momentum is None else self._spins(wheel_momentum)
        if self.noise.latency > 0.0:  # the base's pose and velocity are older than joints and wheels
            self._late.append((t, q, v, spins))
            if t - self._late[0][0] < self.noise.latency - 1e-9:
                return
            base_q, base_v = q[:7], v[:6]
            _, q, v, spins = self._late.popleft()
            q[:7], v[:6] = base_q, base_v
        if self._origin is None:
            self._origin = q[:3].copy()
        q[:3] -= self._origin
        self._add(q, v, spins, unseen)

    def _add(self, q: FloatArray, v: FloatArray, spins: FloatArray | None, unseen: bool) -> None:
        if unseen:  # relative to the centre of mass, the linear momentum is zero
            A, com = self._filter.momentum_map(q)
            q[:3] -= com
            v[:3] = _linear_velocity(A) @ v[3:]
        Z, A = self._filter.equations(q, v, spins)
        if self._pose_noise is None:
            self._pose_noise = self.noise.of_pose(Z[:, -1])
        if self.samples % _PERIOD == 0:
            if self.samples >= self._reweighted:
                self._reweighted *= 2.0
                self._weighting = self._parameters()
            self._weight, self._bias_now = self._weighed(q, A, self._pose_noise, unseen)
        self._bias += self._bias_now
        self._filter.add(Z, self._weight)

    def weigh_by(self, other: Identifier) -> None:
        """Compute the weights of later samples from the estimate of another identifier of the same bodies.

        The noise of the momentum is the noise of the velocities times the parameters, so weights depend on
        the estimate. By default the identifier uses its own estimate.
        """
        self._weighting, self._reweighted = other._parameters(), math.inf

    def _parameters(self) -> tuple[FloatArray, FloatArray]:
        solved = self.solution()
        return solved.x, (1.0 - _DOUBT) * solved.covariance + _DOUBT * np.eye(len(solved.x))

    def linearise_about(self, estimate: Identification) -> None:
        """Compute unmeasured linear velocities of the base from an estimate instead of the prior."""
        self.robot = estimate.sms
        change = np.concatenate([estimate[body.name].parameters - body.believed for body in self.bodies])
        self._filter.linearise_about(self.robot, change[self._free] / self._scales)

    def _weighed(
        self, q: FloatArray, A: FloatArray, pose_noise: FloatArray, unseen: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Return the weight of a sample, and the expected contribution of its noise to the information.

        Velocities multiply the unknown parameters, so their noise adds to the squares of the regression and
        would bias estimates towards the prior. `A` (6, 6 + n) maps velocities to the momentum of `robot`, and
        `pose_noise` (6, 6) is the covariance of the momentum due to the noise of poses.
        """
        rows = self._filter.slopes(q, A)
        if unseen:
            rows[:, :, 3:] += rows[:, :, :3] @ _linear_velocity(A)
            rows[:, :, :3] = 0.0
        noisy = rows * np.sqrt(self.noise.rates)
        x, covariance = self._weighting
        momentum = noisy[-1] + np.tensordot(x, noisy[:-7], 1)
        size = len(x)
        spread = (covariance @ noisy[:-7].reshape(size, -1)).reshape(size, 6, -1)
        S = momentum @ momentum.T + np.tensordot(spread, noisy[:-7], ((0, 2), (0, 2)))
        S = S + pose_noise
        weight, used = np.zeros((6, 6)), slice(3 if unseen else 0, 6)
        weight[used, used] = np.linalg.inv(S[used, used])
        biasing = rows * np.sqrt(self.noise.biasing)
        flat = biasing.swapaxes(1, 2).reshape(len(rows), -1)
        weighted = np.tensordot(biasing, weight, (1, 0)).reshape(len(rows), -1)
        return weight, np.asarray(flat @ weighted.T)

    def expected_information(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Return the expected information (k, k) from measuring the motion q (N, nq) and v (N, 6 + n).

        The information is in units of the prior deviations. The total momentum is unknown unless `at_rest`,
        and all states have the weight of the first state.
        """
        root, Y = self.expected_equations(q, v)
        if not self.at_rest:
            Y = Y - Y.mean(axis=0)
        flat = (root @ Y).reshape(-1, Y.shape[2])
        return np.asarray(flat.T @ flat)

    def expected_equations(self, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the root (6, 6) of the first state's weight, and the regressors (N, 6, k) of all states.

        The regressors are in units of the prior deviations.
        """
        about = q[0, :3]
        first = q[0].copy()
        first[:3] = 0.0
        A, _ = self._filter.momentum_map(first)
        weight, _ = self._weighed(first, A, self.noise.of_pose(A @ v[0]))
        Y = momentum_regressors(self.robot, q, v, about, self._filter.bodies) @ self._filter.basis
        return np.asarray(np.linalg.cholesky(weight).T), Y

    def _spins(self, wheel_momentum: ArrayLike) -> FloatArray:
        """Return the sum (3,) of the wheels' spin momenta, in the base's axes."""
        wheels = self.sms.wheels
        if wheels is None:
            raise InvalidValue("wheel_momentum", wheel_momentum, "must be left out: the robot has no wheels")
        return np.asarray(wheels.axes.T @ vector("wheel_momentum", wheel_momentum, len(wheels), "N m s"))

    def pushed(self) -> None:
        """Treat the total momentum as a new unknown constant from the next sample on.

        Call this method after an external force, such as that of thrusters. The information about the
        parameters is kept.
        """
        self._filter.pushed(self.at_rest)
        self.at_rest = False
        self._pose_noise = None

    def add_equations(self, rows: FloatArray, sides: FloatArray) -> None:
        """Add weighted linear equations: rows (R, 10 b) times the parameter change equal `sides` (R,).

        The change is relative to the prior. The residuals of these equations scale their noise, separately
        from the noise of the momentum.
        """
        Z = np.column_stack([rows @ self._filter.basis, -sides])
        self._other += Z.T @ Z
        self._other_count += len(Z)

    def solution(self) -> Solution:
        """Return the estimate in units of the prior deviations, without a check of consistency."""
        sums, count = self._filter.without_momentum(self.at_rest), self._filter.count(self.at_rest)
        G, g, c = sums[:-1, :-1], sums[:-1, -1], float(sums[-1, -1])
        k, other = len(G), self._other
        bias = self._bias[:k, :k]
        A, N = _significant(G - bias, bias, self.samples)
        B, M = _significant(other[:-1, :-1])
        a, b = N @ (g - self._bias[:k, -1]), M @ other[:-1, -1]
        learnt = max(len(A), len(B))
        scale = other_scale = 1.0
        for _ in range(4):
            # The factors A and B are used, because A^T A + B^T B would lose half of the digits of exact data.
            root, other_root = math.sqrt(scale), math.sqrt(other_scale)
            Q, R = np.linalg.qr(np.vstack([A / root, B / other_root, np.eye(k)]))
            back = np.linalg.inv(R)
            x = -back @ (Q.T @ np.concatenate([a / root, b / other_root, np.zeros(k)]))
            misfit = c + 2.0 * float(g @ x) + float(x @ G @ x)
            if count >= _ENOUGH + k:
                scale = max(misfit / (count - learnt), _LEAST_SCALE)
            if self._other_count >= _ENOUGH + k:
                others = float(other[-1, -1] + 2.0 * other[:-1, -1] @ x + x @ other[:-1, :-1] @ x)
                other_scale = max(others / (self._other_count - learnt), _LEAST_SCALE)
        # The noise of the regressors increases the covariance; `bias` is its contribution to G.
        inverse = back @ back.T
        noisy = inverse @ A.T @ N
        covariance = inverse + noisy @ (bias / scale) @ noisy.T
        whole = x + self._prior
        moved, beyond_noise = float(whole @ G @ whole), max(misfit - _NOISE * count, 0.0)
        unexplained = math.sqrt(beyond_noise / moved) if moved > 0.0 else 0.0
        total = count + self._other_count
        return Solution(x, 0.5 * (covariance + covariance.T), scale, total, unexplained)

    def uncertainty(self) -> float:
        """Return the remaining share of the uncertainty about the momentum of the motion so far.

        The share is the standard deviation of the momentum due to the estimated parameters, divided by the
        standard deviation due to the prior parameters. Before the first sample the share is 1.
        """
        if not self.samples:
            return 1.0
        G = self._filter.sums[:-7, :-7]
        before = float(np.trace(G))
        if not before > 0.0:
            return 1.0
        after = float(np.sum(G * self.solution().covariance))
        return math.sqrt(min(max(after / before, 0.0), 1.0))

    def learnt(self, last: SpaceManipulator) -> SpaceManipulator:
        """Return the robot with the estimated inertias, or `last` itself.

        `last` is returned if there are fewer than ten samples, if the estimate is too uncertain or physically
        inconsistent, or if it changes the momentum of the motion so far by less than 0.3 % of the unknown
        bodies' momentum.

        Parameters
        ----------
        last : SpaceManipulator
            The previously returned robot; at first the prior robot.
        """
        if self.samples < _FEWEST or self.uncertainty() > _CERTAIN:
            return last
        x, G = self.solution().x, self._filter.sums[:-7, :-7]
        change = x if self._used is None else x - self._used
        whole = x + self._prior
        if float(change @ G @ change) < _CHANGED**2 * float(whole @ G @ whole):
            return last
        self._used = x
        try:
            estimate = identification_of(self, self._near)
        except FfsmsError:  # an external force makes the numbers physically inconsistent
            return last
        self._near = np.array([estimate[body.name].parameters for body in self.bodies])
        return estimate.sms

    @property
    def found(self) -> Identification:
        """The physically consistent estimate from all samples so far, computed at each access."""
        return identification_of(self)


def _linear_velocity(A: FloatArray) -> FloatArray:
    """Return a map (3, 3 + n) from angular velocity and joint rates to linear velocity of the base.

    The linear momentum is assumed to be zero. `A` (6, 6 + n) maps velocities to momentum.
    """
    return np.asarray(-np.linalg.solve(A[:3, :3], A[:3, 3:]))


def _significant(
    G: FloatArray, bias: FloatArray | None = None, samples: int = 1
) -> tuple[FloatArray, FloatArray]:
    """Return a factor A (r, k) of the part of G that exceeds the noise of its `bias`, and N (r, k).

    The part is A^T A, and A^T N is the projector on its directions. The directions are eigenvectors of G
    relative to the noise, because the noise in a direction without information may exceed the information in
    another direction.
    """
    noise = _ROUNDING * max(float(np.linalg.eigvalsh(G)[-1]), 1e-300) * np.eye(len(G))
    if bias is not None:
        noise = noise + _SIGNIFICANT * math.sqrt(2.0 / max(samples, 1)) * bias
    L = np.linalg.cholesky(noise)
    inverse = np.linalg.inv(L)
    values, vectors = np.linalg.eigh(inverse @ (0.5 * (G + G.T)) @ inverse.T)
    chosen, root = vectors[:, values > 1.0].T, np.sqrt(values[values > 1.0])[:, None]
    return root * (chosen @ L.T), (chosen @ inverse) / root
