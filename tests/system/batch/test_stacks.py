"""Compare algebra on stacks of vectors and rotations with NumPy and Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ffsms_pin.system.batch.stacks import apply, cross, dot, exp3, log3, products, quaternions, skew


def test_rotations_of_stacks(rng: np.random.Generator) -> None:
    w = np.concatenate([rng.normal(size=(6, 3)), np.zeros((1, 3)), [[np.pi - 1e-9, 0.0, 0.0]]]).T
    R = exp3(w)
    running, product = products(R), np.eye(3)
    for k in range(w.shape[1]):
        np.testing.assert_allclose(R[..., k], pin.exp3(w[:, k]), atol=1e-12)
        product = product @ pin.exp3(w[:, k])
        np.testing.assert_allclose(running[..., k], product, atol=1e-12)
    small = w[:, np.linalg.norm(w, axis=0) < np.pi]
    np.testing.assert_allclose(log3(exp3(small)), small, atol=1e-8)
    for q, turned in zip(quaternions(R).T, R.transpose(2, 0, 1), strict=True):
        np.testing.assert_allclose(pin.Quaternion(q).toRotationMatrix(), turned, atol=1e-12)


def test_algebra_of_stacks(rng: np.random.Generator) -> None:
    a, b, A = rng.normal(size=(3, 2, 5)), rng.normal(size=(3, 1, 5)), rng.normal(size=(3, 3, 5))
    A = np.einsum("xyk,zyk->xzk", A, A) + np.eye(3)[..., None]
    np.testing.assert_allclose(cross(a, b), np.cross(a, b, axis=0), atol=1e-14)
    np.testing.assert_allclose(dot(a, b), np.sum(a * b, axis=0), atol=1e-14)
    for k in range(5):
        np.testing.assert_allclose(skew(a)[:, :, 1, k] @ b[:, 0, k], np.cross(a[:, 1, k], b[:, 0, k]))
        np.testing.assert_allclose(apply(A, b[:, 0])[:, k], A[..., k] @ b[:, 0, k])
        np.testing.assert_allclose(apply(A, a)[..., k], A[..., k] @ a[..., k])
