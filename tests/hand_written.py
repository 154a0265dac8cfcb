"""A term and a limit with slopes by hand, as parts were written before there were features."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin import opt
from ffsms_pin.checks import FloatArray

__all__ = ["Above", "Gaze"]


@dataclass(frozen=True)
class Gaze(opt.Term):
    """A camera on the end effector looks at a point (inertial axes [m]); its axis is in end-effector axes."""

    at: tuple[float, float, float]
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0)
    weight: float = 1.0  # on the integral of |r|^2 [1/m^2], beside the paper's cost integral [s]
    name = "gaze"

    def residual(self, motions: Any) -> list[opt.Residual]:
        way = np.array(self.at)[:, None, None] - motions.end_effector
        far = np.sqrt(np.sum(way**2, axis=0)) + 1e-9
        axis = np.einsum("xysk,y->xsk", motions.attitude, self.axis)
        root, found = np.sqrt(self.weight), []
        for i, unit in enumerate(np.eye(3)[..., None, None]):
            by_tip = axis[i] * way / far - unit
            by_turn = far * np.cross(unit, axis, axis=0)
            r = way[i] - far * axis[i]
            found.append(opt.Residual(root * r, by_tip=root * by_tip, by_turn=root * by_turn))
        return found

    def step_objective(self, step: Any) -> tuple[FloatArray, FloatArray]:
        """In a step: turn the camera to the point within about a second. u^T W u / 2 - w^T u."""
        way = np.array(self.at) - step.pose.translation
        wanted = np.cross(step.pose.rotation @ self.axis, way / np.linalg.norm(way))
        J = step.J_star[3:]
        return 1e-3 * J.T @ J, 1e-3 * J.T @ (wanted - step.tip_drift[3:])


@dataclass(frozen=True)
class Above(opt.Limit):
    """The end effector stays so high over a plane through the origin: normal . position >= height."""

    normal: tuple[float, float, float]  # of length 1, inertial axes
    height: float = 0.0  # [m]
    name = "above"
    margin = 0.01  # [arm lengths]

    def over(self, position: FloatArray) -> FloatArray:
        return np.tensordot(self.normal, position, axes=1) - self.height

    def rows(self, step: Any) -> opt.Rows:
        G = np.array(self.normal) @ step.J_star[:3]
        drifting = np.array(self.normal) @ step.tip_drift[:3]
        left = self.over(step.pose.translation) - self.reserve - 0.002
        least = -2.0 * left - drifting
        return opt.Rows(G[None], np.array([least]), np.array([opt.UNBOUNDED]), give=1.0)

    def residual(self, motions: Any) -> list[opt.Residual]:
        length = motions.stack.length
        lack = self.margin + (self.reserve - self.over(motions.end_effector)) / length
        slope = -np.array(self.normal)[:, None, None] * (lack > 0.0) / length
        return [opt.Residual(np.maximum(lack, 0.0), by_tip=slope)]

    def violation(self, motion: opt.Motions) -> opt.Violation:
        over = self.over(motion.end_effector)[0]
        k = int(np.argmin(over))
        near = motion.times[over < 1e-3]
        if over[k] > -1e-6:
            return opt.Violation(0.0, near)
        note = f"the end effector is {-1e3 * over[k]:.2f} mm below the plane at {motion.times[k]:.3g} s"
        return opt.Violation(-over[k], near, note)
