"""The corridor through which a grasp on a client is approached, as a limit.

What is forbidden is a ball round the grasp without a cone in it. How deep a point is in there: the lesser of
its ways to the cone and out of the ball.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client, ClientEstimate
from ffsms_pin.opt.limits.limit import UNBOUNDED, Limit, Rows, Violation
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Residual, Residuals
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.system.batch.stacks import dot

__all__ = ["Corridor"]

_RATE = 2.0  # [1/s] A step may use up what is left at most so fast.
_BINDING = 1e-3  # [m] with less than this left the corridor binds


class _Depth(NamedTuple):
    """How deep points are in what is forbidden (S, K) [m], and the slopes (3, S, K) by the points."""

    depth: FloatArray
    slope: FloatArray


@dataclass(frozen=True, eq=False)
class Corridor(Limit):
    """Near a grasp, the end effector stays in a cone that is fixed to the client.

    Attributes
    ----------
    client : Client
    grasp : pinocchio.SE3
        In the client's body axes.
    deadline : float
        Time of the client at the motion's deadline [s].
    length : float
        The corridor counts within this distance of the grasp [m].
    half_angle : float
        [rad]
    axis : ndarray, shape (3,)
        Unit vector of the direction of approach, in grasp axes.
    slack : float
        By how much the cone is wider than its tip at the grasp [m]: at the grasp the end effector may miss by
        so much.
    inside: float
        Whole motions are looked for that are in the corridor for so long before the deadline [s]: which
        instants belong into it is then settled, and none is pushed out of the ball on the wrong side.
    reserve : float
        What they keep in hand beyond the margin, at the cone and round the ball [m].
    began : float
        See `Limit`; the client's time is counted from the start of the whole motion [s].
    """

    client: Client | ClientEstimate
    grasp: Any
    deadline: float
    length: float
    half_angle: float
    axis: FloatArray
    slack: float
    inside: float
    reserve: float = 0.0
    began: float = 0.0
    of_goal: bool = True
    name = "corridor"
    refusal = "the start is beside the corridor: {note}; move the start, or take a shorter standoff"
    margin = 4e-3  # [arm lengths] between two instants a path may cut the mouth's edge

    def rows(self, step: StepState) -> Rows | None:
        """Seen from the client, the end effector goes no deeper than its depth allows: a row of one plane."""
        t = np.array([self.deadline - step.time_left])
        here = step.pose.translation[:, None, None]
        found = self._depth(here, *self._frames(t), 0.0)
        body, twist = self.client.pose(float(t[0])), self.client.twist(float(t[0]))
        moving = twist[:3] + np.cross(twist[3:], step.pose.translation - body.translation)
        slope = found.slope[:, 0, 0]
        most = -_RATE * float(found.depth[0, 0]) + slope @ (moving - step.tip_drift[:3])
        return Rows((slope @ step.J_star[:3])[None], np.array([-UNBOUNDED]), np.array([most]), give=1.0)

    def residual(self, motions: Motions) -> Residuals:
        """The depth and the margin, in arm lengths, where that is above zero."""
        length = motions.stack.length
        margin = self.margin * length + self.reserve
        times = self._times(motions)
        late = times >= self.deadline - self.inside
        found = self._depth(motions.end_effector, *self._frames(times), margin, late)
        s, k = np.nonzero(found.depth > 0.0)
        if not s.size:
            return []
        value = found.depth[s, k] / length
        return [Residual(value, motion=s, instants=k, by_tip=found.slope[:, s, k] / length)]

    def violation(self, motion: Motions) -> Violation:
        """The greatest depth."""
        found = self._depth(motion.end_effector, *self._frames(self._times(motion)), 0.0)
        depth = found.depth[0]
        k = int(np.argmax(depth))
        binds = motion.times[depth > -_BINDING]
        if depth[k] <= 1e-9:
            return Violation(0.0, binds)
        note = (
            f"the approach is {1e3 * depth[k]:.1f} mm outside its corridor at {motion.times[k]:.3g} s "
            f"(half angle {math.degrees(self.half_angle):.3g} deg within {self.length:.3g} m of the grasp)"
        )
        return Violation(float(depth[k]), binds, note)

    def _times(self, motions: Motions) -> FloatArray:
        """Of the client, at a motion's instants."""
        return np.asarray(self.began + motions.times)

    def _frames(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions of the grasp and directions of approach (3, K), inertial axes."""
        positions, attitudes = self.client.poses(times)
        grasps = positions + attitudes @ self.grasp.translation
        return grasps.T, (attitudes @ (self.grasp.rotation @ self.axis)).T

    def _depth(
        self,
        tip: FloatArray,
        grasp: FloatArray,
        axis: FloatArray,
        margin: float,
        late: NDArray[np.bool_] | bool = False,
    ) -> _Depth:
        """Of positions (3, S, K), with so much in hand at the cone and round the ball; `late`: cone only."""
        way = tip - grasp[:, None]
        far = np.sqrt(dot(way, way))
        along = dot(way, axis[:, None])
        across = way - along * axis[:, None]
        beside = np.sqrt(dot(across, across))
        c, s = math.cos(self.half_angle), math.sin(self.half_angle)
        # The margin must not shut the cone at its tip, where the goal is: it grows with the distance.
        spare = margin * np.minimum(far / self.length, 1.0)
        to_cone = c * beside + s * along - self.slack + spare
        cone_slope = c * across / np.maximum(beside, 1e-12) + s * axis[:, None]
        unit = way / np.maximum(far, 1e-12)
        cone_slope = cone_slope + np.where(far < self.length, margin / self.length, 0.0) * unit
        out = self.length + margin - far
        nearer = (to_cone <= out) | late
        return _Depth(np.where(nearer, to_cone, out), np.where(nearer, cone_slope, -unit))
