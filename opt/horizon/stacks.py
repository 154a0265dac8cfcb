"""Small algebra on stacks of vectors: numpy's own functions cost several times this on three entries."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray

__all__ = ["cross", "exp3", "log3", "products", "quaternions", "skew"]


def skew(v: FloatArray) -> FloatArray:
    """[v]x of a stack of vectors (..., 3): matrices (..., 3, 3)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """A x b of stacks (..., 3), broadcast against each other."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    x = a1 * b2
    out = np.empty((*x.shape, 3))
    np.subtract(x, a2 * b1, out=out[..., 0])
    np.subtract(a2 * b0, a0 * b2, out=out[..., 1])
    np.subtract(a0 * b1, a1 * b0, out=out[..., 2])
    return out


def exp3(w: FloatArray) -> FloatArray:
    """Rotations (..., 3, 3) of a stack of rotation vectors (..., 3) [rad]."""
    angle = np.sqrt(np.einsum("...i,...i->...", w, w))[..., None, None]
    K = skew(w)
    small = angle < 1e-6
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1.0, np.sin(safe) / safe)
    second = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    rotation: FloatArray = np.eye(3) + first * K + second * (K @ K)
    return rotation


def log3(R: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3) [rad] of rotations (..., 3, 3), by quaternions: sound up to half a turn."""
    q = quaternions(R.reshape(-1, 3, 3))
    q *= np.where(q[:, 3:] < 0.0, -1.0, 1.0)
    size = np.linalg.norm(q[:, :3], axis=1, keepdims=True)
    factor = np.where(size < 1e-9, 2.0, 2.0 * np.arctan2(size, q[:, 3:]) / np.maximum(size, 1e-300))
    return np.asarray((factor * q[:, :3]).reshape(R.shape[:-1]))


def products(start: FloatArray, turns: FloatArray) -> FloatArray:
    """Running products start, start turn_0, start turn_0 turn_1, ...: (N + 1, 3, 3) of turns (N, 3, 3)."""
    out = np.empty((len(turns) + 1, 3, 3))
    out[0] = start
    for k, turn in enumerate(turns):
        np.matmul(out[k], turn, out=out[k + 1])
    return out


def quaternions(R: FloatArray) -> FloatArray:
    """Unit quaternions (x, y, z, w), shape (N, 4), of rotations (N, 3, 3), without jumps of sign.

    The largest column of 4 q q^T, so that nothing is lost near half a turn.

    Reference: I. Y. Bar-Itzhack, "New method for extracting the quaternion from a rotation matrix", 2000.
    """
    K = np.empty((len(R), 4, 4))
    trace = np.einsum("kii->k", R)
    K[:, 3, 3] = 1.0 + trace
    for i in range(3):
        K[:, i, i] = 1.0 + 2.0 * R[:, i, i] - trace
        for j in range(i):
            K[:, i, j] = K[:, j, i] = R[:, i, j] + R[:, j, i]
        a, b = (i + 1) % 3, (i + 2) % 3
        K[:, i, 3] = K[:, 3, i] = R[:, b, a] - R[:, a, b]
    largest = np.argmax(np.einsum("kii->ki", K), axis=1)
    q = K[np.arange(len(R)), largest]
    q /= np.linalg.norm(q, axis=1)[:, None]
    turned = np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0)
    signs = np.cumprod(np.append(-1.0 if q[0, 3] < 0.0 else 1.0, turned))
    result: FloatArray = q * signs[:, None]
    return result
