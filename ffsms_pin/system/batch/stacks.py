"""Linear algebra on stacks of vectors (3, ...) and matrices (3, 3, ...), with the stack's axes last.

With this order numpy's inner loops run along the stack, which is long, and not along three components.
"""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel

_TINY = 1e-150  # [rad] added to angles, so that sin(x) / x is 1 at zero angle
_NEXT, _AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])
# Indices of the first and second factor of the six terms of a cross product.
_FIRST, _SECOND = np.append(_NEXT, _AFTER), np.append(_AFTER, _NEXT)


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the dot product a . b over the first axis of two stacks of the same shape."""
    return np.asarray(np.einsum("i...,i...->...", a, b))


def apply(A: FloatArray, b: FloatArray) -> FloatArray:
    """Return A b for stacks of matrices (x, y, ...) and vectors (y, ...) or matrices (y, z, ...)."""
    vectors = A.ndim == b.ndim + 1
    return np.asarray(np.einsum("xy...,y...->x..." if vectors else "xy...,yz...->xz...", A, b))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the cross product a x b of stacks (3, ...), broadcast against each other."""
    both: FloatArray = a.take(_FIRST, 0) * b.take(_SECOND, 0)
    return both[:3] - both[3:]


def skew(v: FloatArray) -> FloatArray:
    """Return the matrices [v]x (3, 3, ...) of a stack of vectors (3, ...)."""
    out = np.zeros((3, *v.shape))
    out[0, 1], out[0, 2], out[1, 2] = -v[2], v[1], -v[0]
    out[1, 0], out[2, 0], out[2, 1] = v[2], -v[1], v[0]
    return out


def diagonal(A: FloatArray) -> FloatArray:
    """Return the diagonals (3, ...) of matrices (3, 3, ...) as a view."""
    return np.asarray(np.einsum("xx...->x...", A))


def exp3(w: FloatArray) -> FloatArray:
    """Return the rotations (3, 3, ...) of a stack of rotation vectors (3, ...) [rad]."""
    square = dot(w, w)
    angle = np.sqrt(square) + _TINY
    half = np.sin(0.5 * angle) / angle
    K = skew((np.sin(angle) / angle) * w)
    second = 2.0 * half * half
    K += w[:, None] * (second * w)
    diagonal(K)[...] += 1.0 - second * square
    return K


def log3(R: FloatArray) -> FloatArray:
    """Return the rotation vectors (3, ...) [rad] of rotations (3, 3, ...), accurate up to half a turn."""
    return kernel.rotation_vectors(R).reshape(R.shape[1:])


def rotations(quaternion: FloatArray) -> FloatArray:
    """Return the rotations (3, 3, ...) of unit quaternions (x, y, z, w), shape (4, ...)."""
    K, w = skew(quaternion[:3]), quaternion[3]
    R: FloatArray = 2.0 * (apply(K, K) + w * K)
    diagonal(R)[...] += 1.0
    return R


def products(turns: FloatArray) -> FloatArray:
    """Return the running products R_0, R_0 R_1, ... of rotations R (3, 3, ..., N) along the last axis."""
    out, done = turns.copy(), 1
    while done < turns.shape[-1]:  # entry k is the product of the last `done` rotations up to k
        out[..., done:] = apply(out[..., :-done], out[..., done:])
        done *= 2
    return out


def quaternions(R: FloatArray) -> FloatArray:
    """Return unit quaternions (x, y, z, w), shape (4, N), of rotations (3, 3, N).

    The first quaternion has w >= 0, and the dot product of adjacent quaternions is not negative. The column
    of 4 q q^T with the largest diagonal entry is used, so that no accuracy is lost near half a turn.

    Reference: I. Y. Bar-Itzhack, "New method for extracting the quaternion from a rotation matrix", Journal
    of Guidance, Control, and Dynamics 23 (2000).
    """
    K = np.empty((4, 4, R.shape[-1]))
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    K[:3, :3] = R + R.transpose(1, 0, 2)
    diagonal(K)[:3] = 1.0 + 2.0 * diagonal(R) - trace
    K[:3, 3] = K[3, :3] = R[_AFTER, _NEXT] - R[_NEXT, _AFTER]
    K[3, 3] = 1.0 + trace
    largest = np.argmax(diagonal(K), axis=0)
    q: FloatArray = np.ascontiguousarray(K[largest, :, np.arange(len(largest))].T)
    q = q / np.sqrt(dot(q, q))
    turned = np.where(dot(q[:, 1:], q[:, :-1]) < 0.0, -1.0, 1.0)
    return q * np.cumprod(np.append(-1.0 if q[3, 0] < 0.0 else 1.0, turned))
