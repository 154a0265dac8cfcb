"""Distances between a servicer's bodies and the obstacles on a client."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.geometry.bodies import BodyStack, chosen_mode
from ffsms_pin.geometry.distances import Poses
from ffsms_pin.geometry.obstacle import named
from ffsms_pin.opt import Obstacle
from ffsms_pin.opt.flown import LeastClearance
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.batch.stacks import rotations

FAR = 1.0  # [m] beyond this distance only a lower bound is computed
_CHUNK = 2000  # configurations in one evaluation


class LeastDistance(NamedTuple):
    """The least distances (K,) [m] at K configurations, and the indices (K,) of the nearest body pairs."""

    distance: FloatArray
    pair: np.ndarray[Any, np.dtype[np.intp]]


class ClientDistances:
    """The distances between a servicer's bodies and the obstacles on a client.

    The gripper may touch a nozzle or ring, so obstacles with `piece_of`, the convex pieces of these guides,
    are included only if `guides` is true.

    Parameters
    ----------
    sms : SpaceManipulator
        The servicer.
    obstacles : sequence of Obstacle
        Obstacles, of which only those on the client are used. Their poses are in the client's body frame.
    clearance : float
        The required distance [m].
    collision : str
        The collision geometry, see `opt.Clearance`.
    guides : bool
        True to include obstacles with `piece_of`.

    Attributes
    ----------
    names : sequence of str
        The names of the m pairs of bodies.
    radius : float
        The radius [m] of the client's bounding ball about the origin of its body frame.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        obstacles: Sequence[Obstacle],
        clearance: float,
        collision: str,
        guides: bool = False,
    ) -> None:
        self.clearance, self._sms, self._client = clearance, sms, _Rows()
        mode = chosen_mode(sms) if collision == "auto" else collision
        shapes = [
            obstacle for obstacle in obstacles if obstacle.moves and (guides or obstacle.piece_of is None)
        ]
        self.radius = max((_radius(obstacle) for obstacle in shapes), default=0.0)
        moved = named("obstacles", [replace(obstacle, on=self._client) for obstacle in shapes])
        self._stack = BodyStack(sms, mode, clearance, obstacles=moved)
        margins = self._stack.margins
        self._shift = np.where(margins < 0.0, margins - np.minimum(0.0, clearance + margins), margins)
        hand = sms.tip_joint - 2
        self._others = self._stack.bodies[:, 0] != hand
        self.names = self._stack.names

    def distances(
        self, q: FloatArray, positions: FloatArray, attitudes: FloatArray, near: float = FAR
    ) -> FloatArray:
        """Return the distances (m, K) [m] of m pairs of bodies at K configurations `q` (K, nq).

        The client's poses are `positions` (K, 3) [m] and `attitudes` (K, 3, 3). Distances of `near` [m] or
        more may be lower bounds. An overlap of two bodies that plans permit in the grasp is added.
        """
        values = [
            self._stack.values(self._poses(*chunk), near)
            for chunk in _chunks(q, np.asarray(positions), np.asarray(attitudes))
        ]
        return np.concatenate(values, axis=1) + self._shift[:, None]

    def nearest(
        self,
        q: FloatArray,
        positions: FloatArray,
        attitudes: FloatArray,
        held: bool = False,
        near: float = FAR,
    ) -> LeastDistance:
        """Return the least distances at K configurations and client poses.

        If `held` is true, the client is grasped, and the distances of the link that carries the end effector
        are left out. For the other arguments see `distances`.
        """
        values = self.distances(q, positions, attitudes, near)
        if held:
            values[~self._others] = np.inf
        pair = values.argmin(axis=0)
        return LeastDistance(values[pair, np.arange(len(pair))], pair)

    def around(self) -> ClientDistances:
        """Return the distances from the bounding ball about the client's centre of mass."""
        ball = Obstacle(coal.Sphere(self.radius), on=self._client, name="client")
        return ClientDistances(self._sms, [ball], self.clearance, self._stack.mode)

    def at(self, q: FloatArray, pose: Any, held: bool = False) -> tuple[float, str]:
        """Return the least distance [m] and its pair of bodies at q (nq,) and a client pose."""
        nearest = self.nearest(q[None], pose.translation[None], pose.rotation[None], held)
        return float(nearest.distance[0]), self.names[int(nearest.pair[0])]

    def closing_speed(self, v: FloatArray, client_twist: FloatArray) -> float:
        """Return an upper bound of the closing speeds [m/s] of all pairs.

        `v` (6 + n,) is the servicer's velocity and `client_twist` (6,) the client's twist.
        """
        length = self._stack.arm.length + float(self._stack.sizes[:, 0].max())
        rates, turns = np.abs(v[6:]), self._sms.layout.turns
        turning = float(np.linalg.norm(v[3:6]) + rates[turns].sum())
        linear = float(np.linalg.norm(v[:3]) + rates[~turns].sum() + np.linalg.norm(client_twist[:3]))
        return linear + turning * length + self.radius * float(np.linalg.norm(client_twist[3:]))

    def flown(
        self, t: FloatArray, q: FloatArray, client_pose: FloatArray, latched: float = np.inf
    ) -> LeastClearance | None:
        """Return the least distance in a recording with rows at the times `t` (N,) [s].

        `q` (N, nq) are the servicer's configurations, `client_pose` (N, 7) the client's positions and
        quaternions (x, y, z, w). The client is grasped from the time `latched` [s] on. Return None if there
        is no pair of bodies, or only pairs with the gripper after the grasp.
        """
        if not self.names:
            return None
        places, attitudes = client_pose[:, :3], np.moveaxis(rotations(client_pose[:, 3:].T), -1, 0)
        free = t < latched - 1e-9
        nearest = [
            (rows, self.nearest(q[rows], places[rows], attitudes[rows], held))
            for rows, held in ((np.flatnonzero(free), False), (np.flatnonzero(~free), True))
            if rows.size
        ]
        rows, near = min(nearest, key=lambda entry: entry[1].distance.min())
        i = int(near.distance.argmin())
        k, pair = int(rows[i]), int(near.pair[i])
        if not np.isfinite(near.distance[i]):
            return None
        point = self._point(pair, q[k], places[k], attitudes[k])
        required = self.clearance + float(self._stack.margins[pair])
        return LeastClearance(float(near.distance[i]), self.names[pair], float(t[k]), required, point)

    def _poses(self, q: FloatArray, positions: FloatArray, attitudes: FloatArray) -> Poses:
        self._client.positions, self._client.attitudes = positions, attitudes
        layout = self._sms.layout
        joints = np.array([layout.positions(row) for row in q]).T
        R = np.ascontiguousarray(rotations(q[:, 3:7].T))
        return self._stack._among(joints, np.arange(len(q), dtype=np.float64), R, q[:, :3].T)

    def _point(
        self, pair: int, q: FloatArray, place: FloatArray, attitude: FloatArray
    ) -> tuple[float, float, float]:
        poses, where = self._poses(q[None], place[None], attitude[None]), (np.array([pair]), np.array([0]))
        _, placed = self._stack.slopes(poses, where, self._stack.nearest(poses, where))
        point = pin.XYZQUATToSE3(q[:7]).act(placed[0, :, 0])
        return float(point[0]), float(point[1]), float(point[2])


class _Rows:
    """A client whose pose at time k is row k of `positions` and `attitudes`."""

    positions, attitudes = np.zeros((1, 3)), np.eye(3)[None]

    def pose(self, t: float) -> Any:
        """Return the pose (pinocchio.SE3) of row t."""
        return pin.SE3(self.attitudes[int(t)], self.positions[int(t)])

    def poses(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the positions (K, 3) [m] and attitudes (K, 3, 3) of the rows `times` (K,)."""
        rows = np.asarray(times).astype(np.intp)
        return self.positions[rows], self.attitudes[rows]


def _chunks(*arrays: FloatArray) -> list[tuple[FloatArray, ...]]:
    count = len(arrays[0])
    return [tuple(a[k : k + _CHUNK] for a in arrays) for k in range(0, count, _CHUNK)]


def _radius(obstacle: Obstacle) -> float:
    """Return an upper bound of the distances [m] of an obstacle's points from the origin of its body."""
    shape = obstacle.shape
    shape.computeLocalAABB()
    low, high = (np.array(end) for end in (shape.aabb_local.min_, shape.aabb_local.max_))
    corners = np.array([np.where(side, high, low) for side in np.ndindex(2, 2, 2)])
    placed = corners @ obstacle.pose.rotation.T + obstacle.pose.translation
    return float(np.linalg.norm(placed, axis=1).max())
