"""A planned or simulated motion, thinned out to the frames that are shown, and the cameras on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Trajectory
from ffsms_pin.opt.costs import ideal_cosine
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Tracking
from ffsms_pin.simulation.interfaces import target_function
from ffsms_pin.system import State

Result: TypeAlias = Trajectory | Tracking
Target: TypeAlias = ArrayLike | Callable[[float], ArrayLike]

MOST = 1800  # frames; a minute at 30 a second
FREE, ON_BASE = "free", "base"
# Direction to the camera from what it sees, inertial axes, by name; those of None are found for each scene.
CAMERAS: Mapping[str, tuple[float, float, float] | None] = {
    FREE: None,
    "front": (1.0, 0.0, 0.0),
    "side": (0.0, -1.0, 0.0),
    "top": (0.0, -1e-3, 1.0),
    ON_BASE: None,
}
# Distance of a camera in radii of what it should see. From 1.64 on it sees all of it in the worst case, which
# directions along an axis come near to.
_FREE_DISTANCE, _DISTANCE = 1.3, 1.65
_ABOVE, _OBLIQUE = (-0.12, -0.75, 1.5), (1.0, -1.5, 0.95)


@dataclass(frozen=True, eq=False)
class Frames:
    """The instants t (k,) [s] that are shown: q (k, nq), v (k, nv), target (k, 3) [m] in inertial axes.

    And the force (k, 3) [N] on the end effector, of a contact the largest until the next instant.
    """

    sms: SpaceManipulator
    t: FloatArray
    q: FloatArray
    v: FloatArray
    target: FloatArray | None
    kappa: float
    force: FloatArray | None = None

    @classmethod
    def of(
        cls, sms: SpaceManipulator, result: Result, target: Target | None, kappa: float, rate: float
    ) -> Frames:
        """Rows of a result, about `rate` a second; none is made up between them."""
        if result.q.shape[1] != sms.nq:
            words = f"belongs to another robot: q must have {sms.nq} columns"
            raise InvalidValue("result", result.q.shape, words)
        duration = float(result.t[-1] - result.t[0])
        count = min(max(2, round(duration * rate) + 1), MOST, len(result.t))
        rows = np.unique(np.linspace(0, len(result.t) - 1, count).round().astype(int))
        t = np.array(result.t[rows])
        places = None if target is None else np.array([*map(target_function(target), t.tolist())])
        force = None
        if isinstance(result, Tracking) and (wrench := result.contact_wrench).any():
            size, ends = np.linalg.norm(wrench[:, :3], axis=1), [*rows[1:], len(result.t)]
            peaks = [a + int(np.argmax(size[a:b])) for a, b in zip(rows, ends, strict=True)]
            force = np.array(wrench[peaks, :3])
        return cls(sms, t, np.array(result.q[rows]), np.array(result.v[rows]), places, kappa, force)

    @cached_property
    def states(self) -> list[State]:
        """Kinematics and coupling at each frame."""
        return [self.sms.at(q, v) for q, v in zip(self.q, self.v, strict=True)]

    @cached_property
    def bases(self) -> list[pin.SE3]:
        """Poses of the base's root."""
        return [pin.XYZQUATToSE3(q[:7]) for q in self.q]

    @cached_property
    def points(self) -> FloatArray:
        """Origins of the joints, and the end effector, (k, n + 1, 3) [m]."""
        joints = np.array([self.sms.layout.positions(q) for q in self.q])
        own = self.sms.arm_stack().evaluate(joints.T).points.T
        pairs = zip(own, self.bases, strict=True)
        return np.array([rows @ base.rotation.T + base.translation for rows, base in pairs])

    @property
    def tips(self) -> FloatArray:
        """Places of the end effector (k, 3) [m]."""
        return self.points[:, -1]

    @cached_property
    def entropy(self) -> FloatArray:
        """The paper's H_norm (k,)."""
        return np.array([state.coupling.entropy for state in self.states])

    @cached_property
    def assistance(self) -> FloatArray:
        """cos(theta_a) (k,); zero where nothing moves or there is no target."""
        if self.target is None:
            return np.zeros(len(self.t))
        ways = zip(self.states, self.target - self.tips, strict=True)
        return np.array([state.coupling.assistance(state.v[6:], way) for state, way in ways])

    @cached_property
    def ideal(self) -> FloatArray:
        """c* (k,), the cosine at which the paper's cost is zero."""
        return np.array([ideal_cosine(float(H), self.kappa) for H in self.entropy])


def tips_at(sms: SpaceManipulator, result: Result, times: Sequence[float]) -> FloatArray:
    """Return the places of the end effector (k, 3) [m] in the rows of a result at times [s]."""
    rows = np.searchsorted(result.t, np.asarray(times) - 1e-9).clip(0, len(result.t) - 1)
    tips = [sms.at(result.q[row]).end_effector_pose.translation for row in rows]
    return np.reshape(tips, (-1, 3))


def surroundings(frames: Frames, others: FloatArray | None = None) -> tuple[FloatArray, float]:
    """Centre (3,) and radius [m] of what the camera should see; `others` (k, 3) are further places in it."""
    sms, every = frames.sms, max(1, len(frames.t) // 20)
    half = 0.0 if sms.base_size is None else 0.5 * max(sms.base_size)
    sides = half * np.vstack([np.eye(3), -np.eye(3)])
    boxes = [base.act(sms.base_box_placement.translation) + sides for base in frames.bases[::every]]
    further = [more for more in (frames.target, others) if more is not None]
    cloud = np.vstack([frames.tips, *frames.points[::every], *boxes, *further])
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    return 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 1e-3)


def camera_place(name: str, frames: Frames, radius: float) -> FloatArray:
    """Where a camera is, from the middle of what it sees (3,) [m]; its radius is `radius` [m].

    The free one looks at a planar motion, which spreads less than a micrometre along z, from above.
    """
    along, distance = CAMERAS[name], _DISTANCE
    if along is None:
        along, distance = _ABOVE if np.ptp(frames.tips[:, 2]) < 1e-6 else _OBLIQUE, _FREE_DISTANCE
    return np.asarray(distance * radius * np.array(along) / np.linalg.norm(along))
