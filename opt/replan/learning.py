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

# Modes with a constant total momentum; in the second mode it includes that of the wheels.
_CONSERVING = ("floating", "rotation-floating")
_PRIOR = 0.2  # prior standard deviation of the factors
_LEAST, _MOST = 0.5, 2.0  # bounds on the factors; factors beyond them result from errors of another kind


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
        """Add a measured state at t [s]; return True if the robot has changed, for example by a capture."""

    @abstractmethod
    def pushed(self) -> None:
        """Estimate a new constant total momentum from the next state on."""

    @abstractmethod
    def learnt(self, last: SpaceManipulator) -> SpaceManipulator:
        """Return the estimated robot, or `last` if the change is small or the estimate too uncertain."""

    @property
    def shown(self) -> tuple[FloatArray, FloatArray] | None:
        """The information of the motion about scale factors (see `ScaleFactors`); default: None."""
        return None

    def observe_robot(self, robot: SpaceManipulator) -> None:
        """Use the controller's estimate of the robot. Default: it is ignored."""
        return

    def expect_noise(self) -> None:
        """Adapt the estimation to noisy measurements. Default: it is unchanged."""
        return


class ModelledLaw(Protocol):
    """A control law with a model of the robot, such as `control.ComputedTorque`."""

    sms: SpaceManipulator


class ScaleFactors(Learner):
    """The default `Learner`: factors (n + 1,) on the arm's masses and inertias, and on the base's inertia.

    The total momentum of a floating system is constant and linear in the factors, so each sample adds six
    equations, which do not depend on the torques. If wheels hold the attitude, only the linear momentum is
    constant, and there are three equations. Thrusters change the momentum, so in their modes the model is
    unchanged. The scale is unobservable from momentum, so the base's mass is fixed. A prior keeps
    unobservable factors at 1. With `noisy` sensors the constant momentum is estimated, too, because the first
    sample is as noisy as any other.

    If factors from exact measurements are out of bounds, errors other than those of masses are present, and
    all factors are 1. Factors from noisy measurements may be out of bounds if the excitation is low. Then the
    best factors within the bounds are used, because a return of all factors to 1 would make the plans jump.
    """

    def __init__(self, sms: SpaceManipulator, mode: str = "floating") -> None:
        self._sms, self._data = sms, sms.model.createData()
        # The constant components of the [linear; angular] momentum.
        self._kept = dict(zip(_CONSERVING, (6, 3), strict=True)).get(mode, 0)
        self.factors: FloatArray = np.ones(sms.n + 1)
        self.known = sms
        base = sms.model.inertias[1]
        mass, lever = float(base.mass), np.array(base.lever)
        self._point = pin.Inertia(mass, lever, np.zeros((3, 3)))
        self._turning = pin.Inertia(0.0, lever, np.array(base.inertia))
        size, noise = float(np.trace(base.inertia)) / 3.0, 1e-3  # [m/s, rad/s] of the base, per sample
        self._scale = 1.0 / (noise * np.repeat([mass, size], 3))[: self._kept, None]
        self.noisy = False
        self._first: FloatArray | None
        self._last: FloatArray | None
        self._forget()

    def _forget(self) -> None:
        """Initialise the sums of the least squares A x = -c + (momentum error of the first sample)."""
        count = len(self.factors)
        self._G, self._g = np.eye(count) / _PRIOR**2, np.zeros(count)
        self._begin_momentum()

    def observe_robot(self, robot: SpaceManipulator) -> None:
        """Restart with the factors of the controller's estimate."""
        self._sms = self.known = robot
        self.factors = np.ones(robot.n + 1)
        self._forget()

    def _begin_momentum(self) -> None:
        """Initialise the sums of one constant momentum."""
        self._sum_A, self._sum_c = np.zeros((self._kept, len(self.factors))), np.zeros(self._kept)
        self._samples, self._first, self._last = 0, None, None

    def pushed(self) -> None:
        """Keep the estimate after a push, and estimate another momentum from the next sample on."""
        self._G, self._g = self._sums()
        self._begin_momentum()

    def update(
        self, t: float, q: FloatArray, v: FloatArray, wheel_momentum: FloatArray | None = None
    ) -> bool:
        """Add a measured state; return whether the robot has changed.

        The time and the wheels are ignored, because only the linear momentum is used if they hold the
        attitude.
        """
        if not self._kept:
            return False
        parts, jumped = self._momenta(q, v), False
        if self._last is not None:  # more than thirty times the noise: a body was captured
            step = (parts - self._last) * self._scale
            jumped = bool(np.abs(step @ np.concatenate([[1.0], self.factors])).max() > 30.0)
        if jumped:
            self._forget()
        if self._first is None:
            self._first = parts
        self._last = parts
        change = (parts - self._first) * self._scale
        # The sum of factor times part is constant; with factor = 1 + x: A x = -(sum of all changes).
        A, c = change[:, 1:], change.sum(axis=1)
        self._G += A.T @ A
        self._g -= A.T @ c
        self._sum_A, self._sum_c, self._samples = self._sum_A + A, self._sum_c + c, self._samples + 1
        return jumped

    def expect_noise(self) -> None:
        """Estimate the constant momentum, too, and keep the factors within their bounds."""
        self.noisy = True

    def _momenta(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Return the constant rows of the momenta of base mass, arm bodies and base inertia."""
        model, data = self._sms.model, self._data
        pin.forwardKinematics(model, data, q, v)
        place, twist = data.oMi[1], data.v[1]
        arm = [data.oMi[i].act(model.inertias[i] * data.v[i]) for i in range(2, self._sms.n + 2)]
        parts = [place.act(self._point * twist), *arm, place.act(self._turning * twist)]
        return np.stack([part.vector for part in parts], axis=1)[: self._kept]

    def solve(self) -> FloatArray:
        """Return the factors (n + 1,) estimated from the measurements so far."""
        G, g = self._sums()
        factors = np.asarray(1.0 + np.linalg.solve(G, g), dtype=np.float64)
        if (factors >= _LEAST).all() and (factors <= _MOST).all():
            return factors
        if not self.noisy:
            return np.ones_like(factors)
        from scipy.optimize import lsq_linear  # slow to load, and few runs need it

        L = np.linalg.cholesky(G)
        bounds = _LEAST - 1.0, _MOST - 1.0
        return np.asarray(1.0 + lsq_linear(L.T, np.linalg.solve(L, g), bounds).x)

    def _sums(self) -> tuple[FloatArray, FloatArray]:
        if not self.noisy:
            return self._G, self._g
        # The best constant for factors x is the mean of c + A x, with a prior of one sample's noise.
        shares = self._sum_A.T / (self._samples + 1)
        return self._G - shares @ self._sum_A, self._g + shares @ self._sum_c

    @property
    def shown(self) -> tuple[FloatArray, FloatArray]:
        """The information matrix G (n + 1, n + 1) of the estimate of x, without the prior, and G x (n + 1,).

        x is the vector of the factors minus one.
        """
        G, g = self._sums()
        return G - np.eye(len(g)) / _PRIOR**2, g

    def learnt(self, last: SpaceManipulator) -> SpaceManipulator:
        """Return the robot with the estimated factors; the same object if no factor has changed much."""
        if np.abs(self.solve() - self.factors).max() > 2e-3:
            self.known = self.robot()
        return self.known

    def robot(self) -> SpaceManipulator:
        """Return the robot with the estimated factors, and store them in `factors`."""
        self.factors = self.solve()
        *arm, base = self.factors.tolist()
        shares = zip(list(self._sms.model.inertias)[1:], [1.0, *arm], [base, *arm], strict=True)
        bodies = [
            pin.Inertia(mass * body.mass, body.lever, turn * body.inertia) for body, mass, turn in shares
        ]
        return self._sms.with_inertias(bodies)


def learner_of(problem: Problem, learn: Learner | None) -> Learner:
    """Return the learner of a problem, by default scale factors; raise `InvalidValue` for a wrong `learn`."""
    if learn is None:
        return ScaleFactors(problem.sms, problem.mode)
    if not isinstance(learn, Learner):
        text = "must be an identification.Identifier or another opt.Learner"
        raise InvalidValue("learn", learn, text)
    if problem.mode not in _CONSERVING:
        text = f"must be left out in mode '{problem.mode}': thrusters change the momentum that it learns from"
        raise InvalidValue("learn", learn, text)
    return learn
