"""The corridor through which a grasp on a client is approached, as a limit.

What is forbidden is a ball round the grasp without a cone in it. Room is the greater of the ways into the
cone and out of the ball.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion import Feature, Features
from ffsms_pin.opt.motion.frame import Frame
from ffsms_pin.opt.parts.inequality import Inequality

if TYPE_CHECKING:
    from ffsms_pin.opt.goals.goal import Goal

__all__ = ["Corridor"]


@dataclass(frozen=True, eq=False)
class Corridor(Inequality):
    """Near a grasp, the end effector stays in a cone that is fixed to it.

    Attributes
    ----------
    goal : Goal
        The grasp: a goal whose places are poses.
    deadline : float
        Time of the goal at the motion's deadline [s].
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
        See `Limit`; the goal's time is counted from the start of the whole motion [s].
    """

    goal: Goal
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
    step_margin = 0.0
    binding = 1e-3

    def room(self, m: Features) -> Any:
        """The greater of the ways into the cone and out of the ball."""
        cone, far = self._seen(m)
        return np.maximum(cone, far - self.length)

    def lack(self, m: Features) -> Feature:
        """Of whole motions, which are in the cone at last; the margin must not shut that at its tip."""
        cone, far = self._seen(m)
        late = m.times + self.began >= self.deadline - self.inside
        ball = far - np.where(late, math.inf, self.length)[None]
        in_hand = self.margin * m.stack.length + self.reserve
        lack: Feature = in_hand * np.minimum(far / self.length, 1.0) - np.maximum(cone, ball)
        return lack

    def _seen(self, m: Features) -> tuple[Feature, Feature]:
        """How far the end effector is inside the cone, and its distance from the grasp."""
        grasp = self._grasp(m)
        way, axis = m.tip - grasp, grasp.axis(self.axis)
        along = way.dot(axis)
        beside = (way - along * axis).norm()
        c, s = math.cos(self.half_angle), math.sin(self.half_angle)
        return self.slack - c * beside - s * along, way.norm()

    def _grasp(self, m: Features) -> Frame:
        """The grasp frame, which moves by itself: in a step that counts."""
        times = self.began + m.times
        places, place, turn = self.goal.places(times), {}, {}
        assert places.rotation is not None
        if m.step is not None:
            now = self.goal.place(float(times[0]))
            moves = (np.zeros(3) if one is None else one for one in (now.velocity, now.spin))
            place, turn = ({"by_time": one[:, None, None]} for one in moves)
        return Frame(places.position[:, None], places.rotation[:, :, None], place, turn, m.where)

    def note(self, room: float, time: float) -> str:
        """What is said of a motion that leaves it."""
        return (
            f"the approach is {-1e3 * room:.1f} mm outside its corridor at {time:.3g} s "
            f"(half angle {math.degrees(self.half_angle):.3g} deg within {self.length:.3g} m of the grasp)"
        )
