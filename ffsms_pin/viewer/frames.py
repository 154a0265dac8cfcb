"""The frames of an animated motion, and the directions of the cameras."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import FreeBody
from ffsms_pin.errors import InvalidValue
from ffsms_pin.geometry.convex_parts import outline
from ffsms_pin.geometry.obstacle import MovingBody
from ffsms_pin.opt import Obstacle, Path, Trajectory
from ffsms_pin.opt.costs import ideal_cosine
from ffsms_pin.opt.derivatives import BASE
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Tracking
from ffsms_pin.simulation.setup import target_function
from ffsms_pin.system import State

Result: TypeAlias = Trajectory | Tracking
Target: TypeAlias = ArrayLike | Callable[[float], ArrayLike]

MOST = 1800  # largest number of frames: a minute at 30 frames per second
FREE, ON_BASE = "free", "base"
DARK, WHITE = "dark", "white"
BACKGROUNDS = (DARK, WHITE)
# Directions from the scene to the cameras, inertial axes; None for directions that depend on the motion.
CAMERAS: Mapping[str, tuple[float, float, float] | None] = {
    FREE: None,
    "front": (1.0, 0.0, 0.0),
    "side": (0.0, -1.0, 0.0),
    "top": (0.0, -1e-3, 1.0),
    ON_BASE: None,
}
_ABOVE, _OBLIQUE = (-0.12, -0.75, 1.5), (1.0, -1.5, 0.95)
_INSTANTS = 25  # largest number of instants at which the cameras must show robot and client
BALL = 0.1  # [m] radius of a client without shapes


@dataclass(frozen=True, eq=False)
class Frames:
    """The k frames of an animation: times t (k,) [s], q (k, nq), v (k, nv), and target (k, 3) [m].

    `force` (k, 3) [N] is the contact force on the end effector at its largest magnitude between a frame and
    the next frame. Target and force are in inertial axes.
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
        """Select at most `MOST` rows of a result as frames, about `rate` per second; do not interpolate."""
        if result.q.shape[1] != sms.nq:
            problem = f"belongs to another robot: q must have {sms.nq} columns"
            raise InvalidValue("result", result.q.shape, problem)
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
        """The kinematics and coupling at each frame."""
        return [self.sms.at(q, v) for q, v in zip(self.q, self.v, strict=True)]

    @cached_property
    def bases(self) -> list[pin.SE3]:
        """The poses (pinocchio.SE3) of the root frame at each frame."""
        return [pin.XYZQUATToSE3(q[:7]) for q in self.q]

    @cached_property
    def points(self) -> FloatArray:
        """The origins of the joints and of the end effector (k, n + 1, 3), inertial axes [m]."""
        joints = np.array([self.sms.layout.positions(q) for q in self.q])
        own = self.sms.arm_stack().evaluate(joints.T).points.T
        pairs = zip(own, self.bases, strict=True)
        return np.array([rows @ base.rotation.T + base.translation for rows, base in pairs])

    @property
    def tips(self) -> FloatArray:
        """The positions of the end effector (k, 3), inertial axes [m]."""
        return self.points[:, -1]

    @cached_property
    def entropy(self) -> FloatArray:
        """The paper's H_norm (k,)."""
        return np.array([state.coupling.entropy for state in self.states])

    @cached_property
    def assistance(self) -> FloatArray:
        """The coupling assistance cos(theta_a) (k,); zero if the joints rest or there is no target."""
        if self.target is None:
            return np.zeros(len(self.t))
        pairs = zip(self.states, self.target - self.tips, strict=True)
        return np.array([state.coupling.assistance(state.v[6:], direction) for state, direction in pairs])

    @cached_property
    def ideal(self) -> FloatArray:
        """The cosine c* (k,) at which the paper's cost is smallest (`opt.costs.ideal_cosine`)."""
        return np.array([ideal_cosine(float(H), self.kappa) for H in self.entropy])


def tips_at(sms: SpaceManipulator, result: Result, times: Sequence[float]) -> FloatArray:
    """Return the positions (k, 3) [m] of the end effector at the first rows at or after times (k,) [s]."""
    rows = np.searchsorted(result.t, np.asarray(times) - 1e-9).clip(0, len(result.t) - 1)
    tips = [sms.at(result.q[row]).end_effector_pose.translation for row in rows]
    return np.reshape(tips, (-1, 3))


class DrawnClient(MovingBody, Protocol):
    """A moving body with shapes to draw, such as `ffsms_pin.Client` or the `ClientMotion` of a run."""

    @property
    def shapes(self) -> Sequence[Any]:
        """The pairs of a coal geometry and its placement in body axes."""
        ...


def path_points(path: Path, count: int) -> FloatArray:
    """Return points (count, 3) [m] of a path without its approach, in the frame to which it is fixed."""
    assert path.duration is not None
    return path.along(np.linspace(0.0, path.duration - path.approach_time, count)).positions.T


def path_pose(path: Path, frames: Frames, k: int) -> Any:
    """Return the pose (pinocchio.SE3) of the frame to which a path is fixed, at the animation's frame k."""
    if isinstance(path.frame, FreeBody):
        return path.frame.pose(float(frames.t[k]))
    return frames.bases[k] if path.on == BASE else pin.SE3.Identity()


def seen_points(
    frames: Frames, client: DrawnClient | None, obstacles: Sequence[Obstacle], path: Path | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the points (k, 3) [m] to show by a fixed camera, and by a camera that moves with the base.

    The points are on the robot, target, path, client and the client's obstacles at some instants, in inertial
    axes. For the moving camera, the points of each instant are moved as if the base were at its first pose.
    """
    rows = np.unique(np.linspace(0, len(frames.t) - 1, _INSTANTS).round().astype(int))
    sms, fixed, riding = frames.sms, [frames.tips], []
    half = np.zeros(3) if sms.base_size is None else 0.5 * np.array(sms.base_size)
    box = _moved(_corners(-half, half), sms.base_box_placement)
    body = None if client is None else _client_corners(client, obstacles)
    curve = np.zeros((0, 3)) if path is None else path_points(path, _INSTANTS)
    for k in rows:
        points = [frames.points[k], _moved(box, frames.bases[k])]
        if frames.target is not None:
            points.append(frames.target[[k]])
        if path is not None:
            points.append(_moved(curve, path_pose(path, frames, k)))
        if client is not None and body is not None:
            positions, attitudes = client.poses(frames.t[[k]])
            points.append(body @ attitudes[0].T + positions[0])
        fixed += points
        riding.append(_moved(np.vstack(points), frames.bases[0] * frames.bases[k].inverse()))
    return np.vstack(fixed), np.vstack(riding)


def _moved(points: FloatArray, pose: Any) -> FloatArray:
    """Transform points (k, 3) by a pose (pinocchio.SE3)."""
    return np.asarray(points @ pose.rotation.T + pose.translation)


def placed_outline(shape: Any, placement: Any) -> FloatArray:
    """Return points (k, 3) whose convex hull is the shape at its placement."""
    return _moved(outline(shape), placement)


def _corners(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the corners (8, 3) of the box between two opposite corners (3,)."""
    return np.array([np.where(side, high, low) for side in np.ndindex(2, 2, 2)])


def _client_corners(client: DrawnClient, obstacles: Sequence[Obstacle]) -> FloatArray:
    """Return the corners (8, 3) of the box around a client's shapes and its obstacles, body axes."""
    shapes = [*client.shapes, *((obstacle.shape, obstacle.pose) for obstacle in obstacles if obstacle.moves)]
    if not shapes:
        return _corners(np.full(3, -BALL), np.full(3, BALL))
    points = np.vstack([placed_outline(shape, placement) for shape, placement in shapes])
    return _corners(points.min(axis=0), points.max(axis=0))


def middle_and_radius(points: FloatArray) -> tuple[FloatArray, float]:
    """Return the middle (3,) and half the diagonal (1 mm or more) [m] of the box around points (k, 3)."""
    low, high = points.min(axis=0), points.max(axis=0)
    return 0.5 * (low + high), max(0.5 * float(np.linalg.norm(high - low)), 1e-3)


def camera_direction(name: str, frames: Frames) -> FloatArray:
    """Return the unit vector (3,) from the scene to a camera.

    The cameras "free" and "base" are above the scene if the end effector moves less than 1e-6 m along z.
    """
    along = CAMERAS[name]
    if along is None:
        along = _ABOVE if np.ptp(frames.tips[:, 2]) < 1e-6 else _OBLIQUE
    return np.asarray(np.array(along) / np.linalg.norm(along))
