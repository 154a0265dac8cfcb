"""How a limit brings a frame of the robot near a place: rows of single steps, residuals of whole motions.

In steps: far from the place and early the frame may do what it likes. The way that is left must shrink once
it is as long as what the arm is trusted to make up in the time that is left; a frame that is further away
goes on as fast as it takes to be there in time.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals.missed import Missed, excess
from ffsms_pin.opt.goals.place import Place
from ffsms_pin.opt.limits.limit import UNBOUNDED, Rows, stacked
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Indices, Residual, Residuals
from ffsms_pin.opt.motion.robot_frame import FrameValues, RobotFrame
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.batch.stacks import exp3

__all__ = ["Near"]

_RATE = 2.0  # [1/s] What the way is too long by shrinks at this rate.
_HURRY = 1.5  # times the mean speed of what is left: the most that a frame far away is asked for
_BEFORE = 10  # steps before it is due the frame should be there
# How fast an arm is trusted to make up a way, and a turn, in steps [m/s, rad/s].
_TRUSTED = (0.05, 0.1)


class Near(NamedTuple):
    """A frame of the robot that should come near a place.

    Attributes
    ----------
    stack : ArmStack
    frame : RobotFrame
    place : Place
    """

    stack: ArmStack
    frame: RobotFrame
    place: Place

    def rows(self, step: StepState, asked: list[tuple[float, float, float]]) -> Rows | None:
        """Rows of a step that bring it so near [m], [rad] within so long [s], for each that is asked."""
        position, rotation, J, drift = self._at_step(step)
        missed = self.place.missed(position, rotation)
        ways = (missed.way, J[:3], drift[:3]), (missed.turn, missed.rows @ J[3:], missed.rows @ drift[3:])
        found = [
            _row(way, slope, own, step, one[i], _TRUSTED[i], one[2])
            for i, (way, slope, own) in enumerate(ways)
            for one in asked
            if len(way)
        ]
        return stacked(found)

    def _at_step(self, step: StepState) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Position, attitude, Jacobian (6, n) and drift (6,) of the frame, in the place's axes."""
        if self.frame.is_tip and not self.place.moves_with_base:
            return step.pose.translation, step.pose.rotation, step.J_star, step.tip_drift
        seen = self.frame.seen(*self.stack.poses(step.joints[:, None]))
        at = FrameValues(*(one[..., 0] for one in seen))
        J = np.concatenate([at.linear, at.angular])
        if self.place.moves_with_base:
            return at.position, at.rotation, J, np.zeros(6)
        R = pin.Quaternion(step.q[3:7]).toRotationMatrix()
        # The root's motion by the joints, and by the total momentum (6, n + 1).
        root = np.column_stack([step.reaction, step.drift])
        linear = R @ (root[:3] + np.cross(root[3:], at.position, axisa=0, axisc=0))
        moved = np.concatenate([linear, R @ root[3:]])
        J = moved[:, :-1] + np.concatenate([R @ at.linear, R @ at.angular])
        return step.q[:3] + R @ at.position, R @ at.rotation, J, moved[:, -1]

    def missed(self, motions: Motions) -> Missed:
        """What motions miss at their instants, (3, S, K)."""
        return self.place.missed(*self.frame.poses(motions, self.place.on))

    def beyond(
        self,
        motions: Motions,
        where: tuple[Indices, Indices],
        missed: Missed,
        allowed: tuple[float, float],
        scales: tuple[float, float],
        later: FloatArray | None = None,
    ) -> Residuals:
        """Residuals of what is missed beyond allowed distances and angles, those that are none left out.

        Parameters
        ----------
        motions : Motions
        where : (ndarray of int, ndarray of int), shape (V,) each
            Motions and instants.
        missed : Missed
            There, (3, V).
        allowed, scales : (float, float)
            Of the distance [m] and of the angle [rad]: what is allowed, and factors on what is beyond.
        later : ndarray, shape (V,), optional
            So much later than the instants [s] it was measured, the frame moving on as it did.
        """
        ways = ("by_place", missed.way, None), ("by_turn", missed.turn, missed.by_turn())
        found: Residuals = []
        for (name, e, slope), most, scale in zip(ways, allowed, scales, strict=True):
            kept = np.flatnonzero(np.linalg.norm(e, axis=0) > most)
            if not kept.size:
                continue
            value, by = excess(e[:, kept], None if slope is None else slope[..., kept], most)
            s, k = (np.tile(one[kept], len(value)) for one in where)
            by = scale * by.transpose(1, 0, 2).reshape(3, -1)
            more: dict[str, Any] = {}
            if later is not None:
                h = np.tile(later[kept], len(value))
                more = {"by_velocity" if name == "by_place" else "by_spin": h * by}
                if name == "by_turn":
                    by = np.einsum("yxv,yv->xv", exp3(h * motions.spin[:, s, k]), by)
            slopes = self.frame.slopes(motions, (s, k), on=self.place.on, **{name: by})
            values = scale * value.ravel()
            found.append(Residual(values, motion=s, instants=k, over_time=False, **slopes, **more))
        return found


def _row(
    way: FloatArray,
    J: FloatArray,
    drift: FloatArray,
    step: StepState,
    allowed: float,
    trusted: float,
    time_left: float,
) -> Rows:
    """One row for a way [m], or a turn [rad], that is left.

    Parameters
    ----------
    way : ndarray, shape (r,)
    J : ndarray, shape (r, n)
        Velocity of the frame a joint rate, the base reacting.
    drift : ndarray, shape (r,)
        Velocity of the frame that the total momentum gives.
    step : StepState
    allowed : float
        How long the way may be in the end.
    trusted : float
        How fast the arm is trusted to make it up [m/s or rad/s].
    time_left : float
        Until it is due [s].
    """
    dt = step.dt
    way = way - dt * (J @ step.rates + drift)  # where the step ends
    length = float(np.linalg.norm(way))
    unit = way / max(length, 1e-12)
    spare = max(time_left - _BEFORE * dt, 0.0)
    closing = _RATE * (length - allowed - trusted * spare)
    if spare > 0.0:
        closing = min(closing + trusted, _HURRY * (length - allowed) / max(spare, 2.0 * dt))
    least = closing - float(unit @ drift)
    return Rows((unit @ J)[None], np.array([least]), np.array([UNBOUNDED]), give=1.0)
