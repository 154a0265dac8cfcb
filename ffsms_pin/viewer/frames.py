"""A planned or simulated motion, thinned out to the frames that are shown, and the cameras on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Trajectory
from ffsms_pin.opt.terms import ideal_cosine
from ffsms_pin.simulation import Tracking
from ffsms_pin.simulation.interfaces import target_function
from ffsms_pin.system import SpaceManipulator, State

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
_FLAT = 1e-6  # [m] a motion that spreads less along z is planar, and best seen from above
_ABOVE, _OBLIQUE = (-0.12, -0.75, 1.5), (1.0, -1.5, 0.95)


@dataclass(frozen=True)
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
            raise InvalidValue(
                "result", result.q.shape, f"belongs to another robot: q must have {sms.nq} columns"
            )
        duration = float(result.t[-1] - result.t[0])
        count = min(max(2, round(duration * rate) + 1), MOST, len(result.t))
        rows = np.unique(np.linspace(0, len(result.t) - 1, count).round().astype(int))
        t = np.array(result.t[rows])
        places = None
        if target is not None:
            goal = target_function(target)
            places = np.array([goal(float(x)) for x in t])
        force, wrench = None, getattr(result, "contact_wrench", np.zeros((0, 0)))
        if wrench.any():
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
    def tips(self) -> FloatArray:
        """Places of the end effector (k, 3) [m]."""
        return np.array([state.end_effector_pose.translation for state in self.states])

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


def surroundings(frames: Frames, others: FloatArray | None = None) -> tuple[FloatArray, float]:
    """Centre (3,) and radius [m] of what the camera should see; `others` (k, 3) are further places in it."""
    sms, data = frames.sms, frames.sms.model.createData()
    half = 0.0 if sms.base_size is None else 0.5 * max(sms.base_size)
    points = [frames.tips]
    for q in frames.q[:: max(1, len(frames.t) // 20)]:
        pin.forwardKinematics(sms.model, data, q)
        base = np.array((data.oMi[1] * sms.base_box_placement).translation)
        points.append(base + half * np.vstack([np.eye(3), -np.eye(3)]))
        points.append(np.array([data.oMi[j].translation for j in range(2, sms.model.njoints)]))
    cloud = np.vstack([*points, *(more for more in (frames.target, others) if more is not None)])
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    return 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 1e-3)


def camera_place(name: str, frames: Frames, radius: float) -> FloatArray:
    """Where a camera is, from the middle of what it sees (3,) [m]; its radius is `radius` [m].

    The free one looks at a planar motion from above.
    """
    along, distance = CAMERAS[name], _DISTANCE
    if along is None:
        along = _ABOVE if np.ptp(frames.tips[:, 2]) < _FLAT else _OBLIQUE
        distance = _FREE_DISTANCE
    return np.asarray(distance * radius * np.array(along) / np.linalg.norm(along))


def camera_facts(frames: Frames, camera: str, radius: float, centre: FloatArray) -> dict[str, Any]:
    """What the page must know of the cameras, of which `camera` is the first.

    They see a ball of a radius [m] about a centre (3,) [m], about which they turn.
    """
    return {
        "camera": camera,
        "centre": rounded(centre),
        "cameras": {name: rounded(camera_place(name, frames, radius)) for name in CAMERAS},
        "riding": riding(frames, centre),
    }


def riding(frames: Frames, centre: FloatArray) -> list[list[float]]:
    """Poses of the scene, frame by frame, under which the base stays where it is at first.

    Each is a position [m] and a quaternion (x, y, z, w) of the scene's root; a camera turns about the centre.
    """
    first = pin.SE3(np.eye(3), -centre) * frames.bases[0]
    rows = np.array([pin.SE3ToXYZQUAT(first * base.inverse()) for base in frames.bases])
    for k in range(1, len(rows)):  # q and -q are one attitude: neighbours take the same sign
        if rows[k, 3:] @ rows[k - 1, 3:] < 0.0:
            rows[k, 3:] *= -1.0
    return [rounded(row) for row in rows]


def rounded(values: FloatArray) -> list[float]:
    """Numbers as they are read, not as they are computed."""
    return [round(float(value), 5) for value in values]
