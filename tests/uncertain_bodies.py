"""Draw clients with uncertain mass and inertia."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

import ffsms_pin as ffsms

__all__ = ["drawn_client"]


def drawn_client(believed: ffsms.Client, rng: np.random.Generator, deviation: float) -> ffsms.Client:
    """Draw a client with the same initial motion; `believed` must have a diagonal inertia.

    Mass and inertia have the distribution that `ClientEstimate` assumes.
    """
    root = np.diag(np.sqrt(0.5 * np.trace(believed.inertia) - np.diag(believed.inertia)))
    x = rng.normal(size=(3, 3)) * deviation
    moments = root @ expm((x + x.T) / np.sqrt(2.0)) @ root
    mass = believed.mass * np.exp(deviation * rng.normal())
    inertia = np.trace(moments) * np.eye(3) - moments
    return ffsms.Client(mass, inertia, believed.start_pose, believed.start_twist)
