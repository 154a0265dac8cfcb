"""What can be said of a finished motion from its nodes alone: values in between, lengths, angles."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray

__all__ = ["angles_from_start", "path_ratio", "sampled"]


def sampled(
    t: float, times: FloatArray, positions: FloatArray, rates: FloatArray, accelerations: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Joint positions, rates and accelerations, each (n,), at time t [s].

    Parameters
    ----------
    t : float
        Before the start and after the end: the first and last positions, at rest.
    times : ndarray, shape (N + 1,)
        Of the nodes, evenly spaced from zero.
    positions, rates : ndarray, shape (N + 1, n)
        At the nodes.
    accelerations : ndarray, shape (N, n)
        Constant in each step.
    """
    n, end = accelerations.shape[1], float(times[-1])
    if t < 0.0:
        return positions[0].copy(), np.zeros(n), np.zeros(n)
    if t > end:
        return positions[-1].copy(), np.zeros(n), np.zeros(n)
    dt = end / (len(times) - 1)
    k = min(int(t / dt + 1e-9), len(times) - 2)
    h = t - times[k]
    position = positions[k] + h * (rates[k] + 0.5 * h * accelerations[k])
    return position, rates[k] + h * accelerations[k], accelerations[k].copy()


def path_ratio(path: FloatArray) -> float:
    """Length of a path (N + 1, 3) over the straight line between its ends; 1 where it stays."""
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    straight = float(np.linalg.norm(path[-1] - path[0]))
    return length / straight if straight > 0.0 else 1.0


def angles_from_start(quaternions: FloatArray) -> FloatArray:
    """Angle of each attitude from the first one (N + 1,) [rad], of unit quaternions (N + 1, 4)."""
    apart = np.abs(quaternions @ quaternions[0])
    return np.asarray(2.0 * np.arccos(np.minimum(apart, 1.0)))
