"""How the base really reacts: inertial factors estimated from the measured motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.system import SpaceManipulator

__all__ = ["ReactionEstimate"]

_PRIOR = 0.2  # standard deviation of the factors before anything is measured
_NOISE = 1e-3  # [m/s, rad/s] what the base's measured velocity may be off by in a sample
_JUMP = 30.0  # changes of the momentum in one sample beyond so many times the noise are no noise
_KEPT = {"floating": 6, "rotation-floating": 3}  # components of [linear; angular] momentum that stay
_LEAST, _MOST = 0.5, 2.0  # beyond these the motion is not explained by masses


class ReactionEstimate:
    """Factors on the arm's masses (and inertias) and on the base's inertia that explain the measured motion.

    The total momentum of a floating system stays what it was at the first sample, and it is linear in the
    factors: each sample gives six equations, whatever the torques. Momentum has no scale of its own, so the
    base's mass is the unit. The estimate is the least-squares one with a prior around the model, so factors
    that the motion does not show stay at 1. With noisy sensors the first sample is as noisy as any other, and
    the constant momentum is estimated too. What external forces do counts as an error of the masses.

    Where wheels hold the attitude the linear momentum alone is constant: three equations. Thrusters push from
    outside, so in their modes the model is kept.

    Factors are within 0.5 and 2. Where exact measurements ask for others, something else than masses is at
    work, and the model is kept. Noisy ones ask for others as well where the motion shows little, so there the
    best factors within the bounds are taken: to drop them all at once would make the plans jump.

    Parameters
    ----------
    sms, mode : SpaceManipulator, str
        The model, and what of its base is held, and by what (see `opt.Problem`).

    Attributes
    ----------
    noisy : bool
        Whether what is observed is noisy; False: the first sample's momentum is taken as it is.
    factors : ndarray, shape (n + 1,)
        Of the arm's bodies, then of the base's inertia.
    """

    def __init__(self, sms: SpaceManipulator, mode: str = "floating") -> None:
        self._sms, self._data = sms, sms.model.createData()
        self._kept = _KEPT.get(mode, 0)
        self._count = sms.n + 1
        self.factors: FloatArray = np.ones(self._count)
        base = sms.model.inertias[1]
        mass, lever = float(base.mass), np.array(base.lever)
        self._point = pin.Inertia(mass, lever, np.zeros((3, 3)))
        self._turning = pin.Inertia(0.0, lever, np.array(base.inertia))
        size = float(np.trace(base.inertia)) / 3.0
        self._scale = 1.0 / (_NOISE * np.repeat([mass, size], 3))[: self._kept, None]
        self.noisy = False
        self._first: FloatArray | None = None
        self._last: FloatArray | None = None
        self._forget()

    def _forget(self) -> None:
        """Start the sums of the least squares: A x = -c + (by what the first sample's momentum is off)."""
        self._G = np.eye(self._count) / _PRIOR**2
        self._g = np.zeros(self._count)
        self._sum_A, self._sum_c = np.zeros((self._kept, self._count)), np.zeros(self._kept)
        self._samples = 0

    def observe(self, q: FloatArray, v: FloatArray) -> bool:
        """Take in a measured state, Pinocchio's; whether it is that of another robot than before."""
        if not self._kept:
            return False
        parts = self._momenta(q, v)
        jumped = self._jumped(parts)
        if self._first is None or jumped:
            # The first sample; or a body was captured, and what was learnt is of another robot.
            self._forget()
            self._first = parts
        self._last = parts
        change = (parts - self._first) * self._scale
        A = change[:, 1:]
        # sum of factor times part is constant; with factor = 1 + x: A x = -(sum of all changes).
        c = change.sum(axis=1)
        self._G += A.T @ A
        self._g -= A.T @ c
        self._sum_A, self._sum_c, self._samples = self._sum_A + A, self._sum_c + c, self._samples + 1
        return jumped

    def _jumped(self, parts: FloatArray) -> bool:
        """Whether the momentum, as estimated so far, changes more in one sample than noise explains."""
        if self._last is None:
            return False
        step = (parts - self._last) * self._scale
        return bool(np.abs(step @ np.concatenate([[1.0], self.factors])).max() > _JUMP)

    def _momenta(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """Momenta of base mass, arm bodies and base inertia, about the inertial origin: rows that stay."""
        model, data = self._sms.model, self._data
        pin.forwardKinematics(model, data, q, v)
        parts = np.empty((6, self._count + 1))
        place, twist = data.oMi[1], data.v[1]
        parts[:, 0] = place.act(self._point * twist).vector
        for i in range(self._sms.n):
            parts[:, i + 1] = data.oMi[i + 2].act(model.inertias[i + 2] * data.v[i + 2]).vector
        parts[:, -1] = place.act(self._turning * twist).vector
        return parts[: self._kept]

    def solve(self) -> FloatArray:
        """The factors (n + 1,) by what was measured until now."""
        G, g = self._G, self._g
        if self.noisy:
            # The best constant for factors x is the mean of c + A x, with a prior of one sample's noise.
            G = G - self._sum_A.T @ self._sum_A / (self._samples + 1)
            g = g + self._sum_A.T @ self._sum_c / (self._samples + 1)
        factors = np.asarray(1.0 + np.linalg.solve(G, g), dtype=np.float64)
        if (factors >= _LEAST).all() and (factors <= _MOST).all():
            return factors
        return 1.0 + _bounded(G, g, _LEAST - 1.0, _MOST - 1.0) if self.noisy else np.ones_like(factors)

    def robot(self) -> SpaceManipulator:
        """The robot with the estimated factors, which `factors` then holds."""
        self.factors = self.solve()
        model = self._sms.model.copy()
        for i, factor in enumerate(self.factors[:-1]):
            model.inertias[i + 2] = _scaled(model.inertias[i + 2], float(factor), float(factor))
        model.inertias[1] = _scaled(model.inertias[1], 1.0, float(self.factors[-1]))
        return self._sms.with_inertias(model)


def _bounded(G: FloatArray, g: FloatArray, least: float, most: float) -> FloatArray:
    """The x (k,) within bounds that makes x^T G x / 2 - g^T x least."""
    # Imported here: it takes a tenth of a second, and few runs need it.
    from scipy.optimize import lsq_linear

    L = np.linalg.cholesky(G)
    return np.asarray(lsq_linear(L.T, np.linalg.solve(L, g), (least, most)).x)


def _scaled(body: Any, mass: float, inertia: float) -> Any:
    return pin.Inertia(mass * body.mass, body.lever, inertia * body.inertia)
