"""The physical consistency of inertial parameters.

A body's ten parameters are consistent if some mass distribution has them. Let m be the mass, c the centre of
mass, I the inertia about the link's origin, and 1 the identity matrix. The parameters are consistent if and
only if the (4, 4) pseudo-inertia [[1/2 tr(I) 1 - I, m c], [(m c)^T, m]] is positive definite. It is written
as L L^T with a lower triangular matrix L, which has exponentials on its diagonal. Ten free numbers then give
all consistent bodies and no others.

References
----------
C. Rucker and P. M. Wensing, "Smooth parameterization of rigid-body inertia", IEEE Robotics and Automation
Letters 7 (2022). P. M. Wensing, S. Kim and J.-J. E. Slotine, "Linear matrix inequalities for physically
consistent inertial parameter identification", IEEE Robotics and Automation Letters 3 (2018).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.system.regressors import PER_BODY, parameters_of, pseudo_inertia

_LEAST = 1e-9  # smallest eigenvalue of a pseudo-inertia, relative to a body of the prior's size
_BELOW = np.tril_indices(4, -1)


def consistent(parameters: FloatArray, scale: FloatArray) -> bool:
    """Return whether parameters (10,) are consistent; `scale` (10,) are their typical magnitudes."""
    unit = _unit(scale)
    return bool(np.linalg.eigvalsh(pseudo_inertia(parameters) / np.outer(unit, unit))[0] > _LEAST)


def nearest_consistent(
    estimate: FloatArray,
    information: FloatArray,
    scales: FloatArray,
    free: Any,
    near: FloatArray | None = None,
) -> FloatArray:
    """Return the consistent parameters (b, 10) nearest to an estimate (b, 10) in the metric `information`.

    A consistent estimate is returned unchanged. `free` (b, 10) is True for the k unknown parameters; known
    parameters keep their values. `information` (k, k) is the information matrix of the unknown parameters.
    `scales` (b, 10) are typical magnitudes. If `near` (b, 10) is given, a short search begins there.
    """
    if all(map(consistent, estimate, scales)):
        return estimate
    from scipy.optimize import least_squares  # slow to load and rarely needed

    units = [_unit(scale) for scale in scales]
    root = np.linalg.cholesky(information + 1e-14 * np.trace(information) * np.eye(len(information))).T
    fixed = np.flatnonzero(~free.ravel())
    stiff = 1e6 / scales.ravel()[fixed]  # weights that fix known parameters
    unknown = np.flatnonzero(free.ravel())

    def bodies(p: FloatArray) -> FloatArray:
        factors = map(_lower, p.reshape(-1, PER_BODY))
        shares = (L @ L.T + 2.0 * _LEAST * np.eye(4) for L in factors)
        return np.array(
            [parameters_of(unit[:, None] * P * unit) for P, unit in zip(shares, units, strict=True)]
        )

    def residual(p: FloatArray) -> FloatArray:
        off = (bodies(p) - estimate).ravel()
        return np.concatenate([root @ off[unknown], stiff * off[fixed]])

    def slopes(p: FloatArray) -> FloatArray:
        J = np.zeros((p.size, p.size))
        for k, (numbers, unit) in enumerate(zip(p.reshape(-1, PER_BODY), units, strict=True)):
            own = slice(PER_BODY * k, PER_BODY * (k + 1))
            J[own, own] = _slopes(_lower(numbers), unit)
        return np.vstack([root @ J[unknown], stiff[:, None] * J[fixed]])

    start = []
    for parameters, unit in zip(estimate if near is None else near, units, strict=True):
        values, vectors = np.linalg.eigh(pseudo_inertia(parameters) / np.outer(unit, unit))
        floor = max(1e-3 * float(values[-1]), 1e-4) if near is None else 1e-8
        L = np.linalg.cholesky((vectors * np.maximum(values, floor)) @ vectors.T)
        start.append([*np.log(np.diag(L)), *L[_BELOW]])
    options = {"x_scale": "jac", "xtol": 1e-8, "ftol": 1e-8, "gtol": 1e-12}
    options["max_nfev"] = 200 if near is None else 20
    return bodies(least_squares(residual, np.ravel(start), slopes, **options).x)


def _slopes(L: FloatArray, unit: FloatArray) -> FloatArray:
    """Return the Jacobian (10, 10) of a body's parameters with respect to its ten free numbers."""
    changes = np.zeros((PER_BODY, 4, 4))
    diagonal, below = np.arange(4), np.arange(4, PER_BODY)
    changes[diagonal, diagonal, diagonal] = np.diag(L)
    changes[below, _BELOW[0], _BELOW[1]] = 1.0
    half = changes @ L.T
    P = (half + half.swapaxes(1, 2)) * np.outer(unit, unit)
    inertias = P[:, [1, 0, 0], [1, 0, 0]], P[:, [2, 2, 1], [2, 2, 1]]
    xx, yy, zz = (inertias[0] + inertias[1]).T
    return np.array([P[:, 3, 3], *P[:, :3, 3].T, xx, -P[:, 0, 1], yy, -P[:, 0, 2], -P[:, 1, 2], zz])


def _lower(numbers: FloatArray) -> FloatArray:
    L = np.diag(np.exp(np.clip(numbers[:4], -30.0, 30.0)))
    L[_BELOW] = numbers[4:]
    return L


def _unit(scale: FloatArray) -> FloatArray:
    """Return factors (4,) of the rows and columns of a pseudo-inertia, from magnitudes `scale` (10,)."""
    length = np.sqrt(scale[4] / scale[0])
    return np.asarray(np.sqrt(scale[0]) * np.array([length, length, length, 1.0]))
