"""Compare the information filter with dense least squares."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.system.momentum_filter import MomentumFilter
from ffsms_pin.system.regressors import momentum_regressors

BODIES = [0, 2, 3]
RNG = np.random.default_rng(4)
BASIS = RNG.normal(size=(30, 5))
ROOT = RNG.normal(size=(6, 6))


def states(sms: ffsms.SpaceManipulator, count: int) -> tuple[FloatArray, FloatArray]:
    """Return random configurations (N, nq) and velocities (N, 6 + n)."""
    q = np.array([sms.configuration(joints) for joints in RNG.uniform(-1.5, 1.5, (count, sms.n))])
    q[:, :3] = RNG.normal(size=(count, 3))
    return q, RNG.normal(size=(count, sms.nv))


def dense(sms: ffsms.SpaceManipulator, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the weighted rows (6 N, 5) of x and the weighted momenta (6 N,) of the model."""
    about = np.zeros(3)
    Y = momentum_regressors(sms, q, v, about, BODIES) @ BASIS
    h = momentum_regressors(sms, q, v, about) @ sms.inertial_parameters
    return (ROOT @ Y).reshape(-1, 5), (ROOT @ h[..., None]).ravel()


@pytest.mark.parametrize("at_rest", [True, False])
def test_the_estimate_equals_dense_least_squares(at_rest: bool, planar: ffsms.SpaceManipulator) -> None:
    """A push divides the samples into two halves; the momentum of the second half is another unknown."""
    q, v = states(planar, 12)
    information = MomentumFilter(planar, BODIES, BASIS)
    for k in range(12):
        if k == 6:
            information.pushed(at_rest)
        information.add(information.equations(q[k], v[k])[0], ROOT.T @ ROOT)
    rows, momenta = dense(planar, q, v)
    halves = np.repeat(np.eye(2), 6, axis=0)
    constants = np.kron(halves[:, 1:] if at_rest else halves, -ROOT)
    x, misfit, *_ = np.linalg.lstsq(np.hstack([rows, constants]), -momenta, rcond=None)
    sums = information.without_momentum(False)
    estimate = -np.linalg.solve(sums[:-1, :-1], sums[:-1, -1])
    np.testing.assert_allclose(estimate, x[:5], rtol=1e-7, atol=1e-9)
    assert sums[-1, -1] + sums[:-1, -1] @ estimate == pytest.approx(float(misfit[0]), rel=1e-7)
    assert information.count(False) == 72 - constants.shape[1]


def test_rows_without_weight_have_no_unknown_momentum(planar: ffsms.SpaceManipulator) -> None:
    q, v = states(planar, 8)
    linear = np.diag([1.0, 2.0, 3.0, 0.0, 0.0, 0.0])
    information = MomentumFilter(planar, BODIES, BASIS)
    for a, b in zip(q, v, strict=True):
        information.add(information.equations(a, b)[0], linear)
    Y = momentum_regressors(planar, q, v, np.zeros(3), BODIES)[:, :3] @ BASIS
    Y = (np.sqrt([1.0, 2.0, 3.0])[:, None] * (Y - Y.mean(axis=0))).reshape(-1, 5)
    np.testing.assert_allclose(information.without_momentum(False)[:-1, :-1], Y.T @ Y, rtol=1e-9, atol=1e-9)
    assert information.count(False) == 24 - 3


def test_slopes_times_the_velocity_are_the_equations(planar: ffsms.SpaceManipulator) -> None:
    q, v = (array[0] for array in states(planar, 1))
    information = MomentumFilter(planar, BODIES, BASIS)
    Z, A = information.equations(q, v)
    before = Z.copy()
    slopes = information.slopes(q, A) @ v
    np.testing.assert_allclose(slopes[:-7].T, before[:, :-7], atol=1e-12)
    np.testing.assert_allclose(slopes[-1], before[:, -1], atol=1e-12)


def test_another_model_changes_no_equation(planar: ffsms.SpaceManipulator) -> None:
    """The equations are linear in x, so they are the same about a model at another x."""
    q, v = (array[0] for array in states(planar, 1))
    prior = planar.inertial_parameters.reshape(-1, 10)
    basis, x = np.zeros((3, 10, 3)), np.array([0.1, -0.2, 0.3])
    basis[range(3), :, range(3)] = prior[BODIES]
    information = MomentumFilter(planar, BODIES, basis.reshape(30, 3))
    before = information.equations(q, v)[0].copy()
    changed = prior.copy()
    changed[BODIES] *= 1.0 + x[:, None]
    other = planar.with_inertias([pin.Inertia.FromDynamicParameters(body) for body in changed])
    assert np.abs(other.at(q, v).momentum - planar.at(q, v).momentum).max() > 1e-2
    information.linearise_about(other, x)
    Z, A = information.equations(q, v)
    np.testing.assert_allclose(Z, before, atol=1e-10)
    np.testing.assert_allclose(information.slopes(q, A)[-1] @ v, before[:, -1], atol=1e-10)
