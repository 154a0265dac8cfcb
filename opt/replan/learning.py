"""The online estimation of masses for re-planning, by scale factors or by another estimator."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.problem import Problem
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.momentum_filter import MomentumFilter
from ffsms_pin.system.regressors import PER_BODY

# The modes with a constant total momentum, which includes the momentum of the wheels in the second mode.
_CONSERVING = ("floating", "rotation-floating")
_NOISE = 1e-3  # [m/s, rad/s] standard deviation of the base's measured velocity and angular velocity
_PRIOR = 0.2  # prior standard deviation of the factors
_LEAST, _MOST = 0.5, 2.0  # bounds on the factors


class Learner(ABC):
    """An estimator of inertial parameters for re-planning.

    Examples are `identification.Identifier` and `ScaleFactors`, the default.

    Attributes
    ----------
    unfiltered : bool
        True if `update` requires the unfiltered measurements, False if it requires the filtered state.
    """

    unfiltered: bool = False

    @abstractmethod
    def update(
        self, t: float, q: FloatArray, v: FloatArray, wheel_momentum: FloatArray | None = None
    ) -> bool | None:
        """Add the measured state q (nq,), v (6 + n,) at t [s]; return True if a re-plan is due at once.

        It is due if the robot has changed, for example by a capture. `wheel_momentum` (w,) are the measured
        momenta of the wheels [N m s].
        """

    @abstractmethod
    def pushed(self) -> None:
        """Treat the total momentum as unknown from the next state on, because a push has changed it."""

    @abstractmethod
    def learnt(self, last: SpaceManipulator) -> SpaceManipulator:
        """Return the estimated robot, or `last` if the change is small or the estimate is too uncertain."""

    @property
    def shown(self) -> tuple[FloatArray, FloatArray] | None:
        """The information of the motion about scale factors, see `ScaleFactors.shown`; default: None."""
        return None

    def observe_robot(self, robot: SpaceManipulator) -> None:
        """Use the controller's estimate of the robot. By default the estimate is ignored."""
        return

    def expect_noise(self) -> None:
        """Adapt the estimation to noisy measurements. By default the estimation is unchanged."""
        return


class ModelledLaw(Protocol):
    """A control law with a model of the robot, such as `control.ComputedTorque`."""

    sms: SpaceManipulator


class ScaleFactors(Learner):
    """The default `Learner`: factors on the mass and inertia of each arm body, and on the base's inertia.

    The factors (n + 1,) are the unknowns of a `MomentumFilter`, which `identification.Identifier` uses with
    the ten parameters of each unknown body. If wheels hold the attitude, only the linear momentum of base and
    arm is constant, and a sample has three equations. Thrusters change the momentum, so in their modes the
    factors remain 1. A common scale of all masses is unobservable, so the base's mass is fixed. A prior keeps
    unobservable factors at 1.

    With exact sensors the constant momentum is that of the first sample. With `noisy` sensors it is
    estimated, because the first sample is as noisy as any other.

    If factors from exact measurements are out of bounds, other errors than those of masses are present, and
    all factors are set to 1. Factors from noisy measurements may be out of bounds if the excitation is low.
    Then the best factors within the bounds are used, because plans would jump if all factors were set to 1.
    """

    def __init__(self, sms: SpaceManipulator, mode: str = "floating") -> None:
        # The number of constant components of the [linear; angular] momentum of base and arm.
        self._kept = dict(zip(_CONSERVING, (6, 3), strict=True)).get(mode, 0)
        self.noisy = False
        self.observe_robot(sms)

    def observe_robot(self, robot: SpaceManipulator) -> None:
        """Restart from the controller's estimate of the robot, with all factors 1."""
        self._sms = self.known = robot
        base = robot.model.inertias[1]
        self._scale = 1.0 / (_NOISE * np.repeat([float(base.mass), float(np.trace(base.inertia)) / 3.0], 3))
        self._scale[self._kept :] = 0.0
        self.factors: FloatArray = np.ones(robot.n + 1)
        self._forget()

    def _forget(self) -> None:
        """Restart the estimation without changing the factors in use."""
        self._filter = MomentumFilter(self._sms, range(self._sms.n + 1), _scale_basis(self._sms))
        self._begin_momentum()

    def _begin_momentum(self) -> None:
        self._first: FloatArray | None = None
        self._last: FloatArray | None = None

    def pushed(self) -> None:
        """Keep the information about the factors; the momentum is a new unknown from the next sample on."""
        self._filter.pushed(at_rest=not self.noisy)
        self._begin_momentum()

    def update(
        self, t: float, q: FloatArray, v: FloatArray, wheel_momentum: FloatArray | None = None
    ) -> bool:
        """Add a measured state; return True if a body was captured, which restarts the estimation.

        `t` and `wheel_momentum` are ignored. If wheels hold the attitude, only the linear momentum is used,
        which does not depend on the wheels.
        """
        if not self._kept:
            return False
        Z, jumped = self._filter.equations(q, v)[0].copy(), False
        # A body was captured if the momentum changes between samples by more than thirty times the noise.
        if self._last is not None:
            step = (Z - self._last) @ np.concatenate([(self.factors - 1.0) / _PRIOR, np.zeros(6), [1.0]])
            jumped = bool(np.abs(self._scale * step).max() > 30.0)
        if jumped:
            self._forget()
        weight = np.diag(self._scale**2)
        if self._first is None:
            self._first = Z.copy()
            self._first[:, -7:-1] = 0.0  # the unknown is the change of the momentum since this sample
            weight *= 2.0  # a prior for this change: zero, with the noise of one sample
        self._last = Z
        self._filter.add(Z - self._first, weight)
        return jumped

    def expect_noise(self) -> None:
        """Estimate the constant momentum from all samples, and keep the factors within their bounds."""
        self.noisy = True

    def _sums(self) -> tuple[FloatArray, FloatArray]:
        """Return the information matrix G (n + 1, n + 1) of x without the prior, and G x (n + 1,).

        x is the vector of the factors minus one, divided by the prior's standard deviation.
        """
        sums = self._filter.without_momentum(at_rest=not self.noisy)
        return sums[:-1, :-1], -sums[:-1, -1]

    def solve(self) -> FloatArray:
        """Return the factors (n + 1,) estimated from the samples since the last restart."""
        G, g = self._sums()
        G = G + np.eye(len(g))
        factors = np.asarray(1.0 + _PRIOR * np.linalg.solve(G, g), dtype=np.float64)
        if (factors >= _LEAST).all() and (factors <= _MOST).all():
            return factors
        if not self.noisy:
            return np.ones_like(factors)
        from scipy.optimize import lsq_linear  # slow to load, and few runs need it

        L = np.linalg.cholesky(G)
        bounds = (_LEAST - 1.0) / _PRIOR, (_MOST - 1.0) / _PRIOR
        return np.asarray(1.0 + _PRIOR * lsq_linear(L.T, np.linalg.solve(L, g), bounds).x)

    @property
    def shown(self) -> tuple[FloatArray, FloatArray]:
        """The information matrix G (n + 1, n + 1) of the estimate of r, without the prior, and G r (n + 1,).

        r is the vector of the factors minus one.
        """
        G, g = self._sums()
        return G / _PRIOR**2, g / _PRIOR

    def learnt(self, last: SpaceManipulator) -> SpaceManipulator:
        """Return the robot with the estimated factors; the same object until a factor changes by 2e-3."""
        if np.abs(self.solve() - self.factors).max() > 2e-3:
            self.known = self.robot()
        return self.known

    def robot(self) -> SpaceManipulator:
        """Return the robot with the estimated factors, and store them in `factors`."""
        self.factors = self.solve()
        change = self._filter.basis @ ((self.factors - 1.0) / _PRIOR)
        bodies = (self._sms.inertial_parameters + change).reshape(-1, PER_BODY)
        return self._sms.with_inertias([pin.Inertia.FromDynamicParameters(body) for body in bodies])


def _scale_basis(sms: SpaceManipulator) -> FloatArray:
    """Return the parameter changes of all bodies (10 (n + 1), n + 1) per prior deviation of each factor."""
    _, *arm = sms.inertial_parameters.reshape(-1, PER_BODY)
    turning = pin.Inertia(0.0, np.zeros(3), np.array(sms.model.inertias[1].inertia)).toDynamicParameters()
    basis = np.zeros((sms.n + 1, sms.n + 1, PER_BODY))
    for factor, parameters in enumerate([*arm, turning]):
        basis[factor, (factor + 1) % (sms.n + 1)] = _PRIOR * parameters
    return basis.reshape(sms.n + 1, -1).T


def learner_of(problem: Problem, learn: Learner | None) -> Learner:
    """Return `learn`, by default `ScaleFactors`; raise `InvalidValue` if it does not suit the problem."""
    if learn is None:
        return ScaleFactors(problem.sms, problem.mode)
    if not isinstance(learn, Learner):
        text = "must be an identification.Identifier or another opt.Learner"
        raise InvalidValue("learn", learn, text)
    if problem.mode not in _CONSERVING:
        text = f"must be left out in mode '{problem.mode}', because thrusters change the total momentum"
        raise InvalidValue("learn", learn, text)
    return learn
