"""Define axes of wheels, and positions and directions of thrusters, for tests."""

from __future__ import annotations

import numpy as np

PYRAMID = [[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]
# Two thrusters on each face of a cube of 1 m push inwards. They can produce every force and every torque.
PLACES = np.array([[0.5, s * 0.5, 0.0] for s in (1, -1)] + [[-0.5, s * 0.5, 0.0] for s in (1, -1)])
PLACES = np.concatenate([PLACES, np.roll(PLACES, 1, axis=1), np.roll(PLACES, 2, axis=1)])
WAYS = np.array([[-1.0, 0, 0]] * 2 + [[1.0, 0, 0]] * 2)
WAYS = np.concatenate([WAYS, np.roll(WAYS, 1, axis=1), np.roll(WAYS, 2, axis=1)])
