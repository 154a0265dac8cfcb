"""Define axes of wheels, and positions and directions of thrusters, for tests."""

from __future__ import annotations

import numpy as np

PYRAMID = [[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]
# Two thrusters on each face of a cube of 1 m push inwards. They can produce every force and every torque.
THRUSTER_POSITIONS = np.array(
    [[0.5, s * 0.5, 0.0] for s in (1, -1)] + [[-0.5, s * 0.5, 0.0] for s in (1, -1)]
)
THRUSTER_POSITIONS = np.concatenate(
    [THRUSTER_POSITIONS, np.roll(THRUSTER_POSITIONS, 1, axis=1), np.roll(THRUSTER_POSITIONS, 2, axis=1)]
)
THRUSTER_DIRECTIONS = np.array([[-1.0, 0, 0]] * 2 + [[1.0, 0, 0]] * 2)
THRUSTER_DIRECTIONS = np.concatenate(
    [THRUSTER_DIRECTIONS, np.roll(THRUSTER_DIRECTIONS, 1, axis=1), np.roll(THRUSTER_DIRECTIONS, 2, axis=1)]
)
