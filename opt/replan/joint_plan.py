"""A plan of the joints' motion: rates at nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.trajectory import Trajectory

__all__ = ["JointPlan"]


@dataclass(frozen=True, eq=False)
class JointPlan:
    """Joint rates at nodes, linear between them.

    Attributes
    ----------
    start : float
        Time of the first node [s].
    dt : float
        [s]
    positions, rates : ndarray, shape (N + 1, n)
        At the nodes [rad], [rad/s].
    miss : float
        Distance to the goal at the deadline, as foreseen [m].
    lack : float
        The largest residual of a limit as a share of the limit's margin; from 1 on the limit itself is
        broken.
    """

    start: float
    dt: float
    positions: FloatArray
    rates: FloatArray
    miss: float
    lack: float = 0.0

    @classmethod
    def of_rates(
        cls, start: float, dt: float, joints: FloatArray, rates: FloatArray, miss: float, lack: float = 0.0
    ) -> JointPlan:
        """From the joints (n,) at the first node and the rates (N + 1, n)."""
        travel = np.cumsum(0.5 * dt * (rates[1:] + rates[:-1]), axis=0)
        return cls(start, dt, joints + np.vstack([np.zeros(len(joints)), travel]), rates, miss, lack)

    @classmethod
    def of_trajectory(cls, plan: Trajectory, start: float = 0.0) -> JointPlan:
        """The joint motion of a trajectory that begins at `start`."""
        return cls(start, plan.dt, plan.joint_positions, plan.joint_rates, float(plan.position_error[-1]))

    def sample(self, t: float) -> tuple[FloatArray, FloatArray]:
        """Joint positions and rates, each (n,), at t [s]; beyond the ends at rest."""
        place = (t - self.start) / self.dt
        k = min(max(int(place + 1e-9), 0), len(self.rates) - 2)
        h = (place - k) * self.dt
        if h > self.dt * (1.0 + 1e-6):
            return self.positions[-1], np.zeros_like(self.rates[-1])
        slope = (self.rates[k + 1] - self.rates[k]) / self.dt
        return self.positions[k] + h * (self.rates[k] + 0.5 * h * slope), self.rates[k] + h * slope

    def rates_at(self, times: FloatArray) -> FloatArray:
        """Joint rates (k, n) at times (k,) [s]; zero after the last node."""
        nodes = self.start + self.dt * np.arange(len(self.rates))
        return np.stack([np.interp(times, nodes, column, right=0.0) for column in self.rates.T], axis=1)
