"""The clearance of a grasped client to the servicer's other bodies and to obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.geometry.bodies import Body, BodyStack, chosen_mode, clearance_stack, robot_bodies
from ffsms_pin.geometry.convex_parts import part_of
from ffsms_pin.geometry.distances import ClearanceStack, Poses
from ffsms_pin.geometry.mechanism import ShapedMechanism
from ffsms_pin.geometry.obstacle import Obstacle, named
from ffsms_pin.system.dynamics import frame_pose

_STEPS, _FARTHEST = 40, 0.1  # steps of the search for a clear posture, and the largest step [rad or m]
_BESIDE = 5e-3  # [m] distance that the search adds to the requested distance


class HeldClient:
    """The shapes of a grasped client, and the distances of client, servicer and obstacles.

    The client is paired with the obstacles, and with all bodies of the servicer except the body that carries
    the end effector.

    Parameters
    ----------
    sms : ShapedMechanism
        The servicer.
    shapes : sequence of Obstacle
        The client's shapes, with poses in the client's axes.
    clearance, collision : float, str
        The requested distance [m] without the obstacles' margins, and the mode, as for `opt.Clearance`.
    q, pose : ndarray, shape (nq,), pinocchio.SE3
        The configuration of the servicer at the grasp, and the pose of the client.
    obstacles : sequence of Obstacle
        The obstacles in inertial space and on the base.
    """

    def __init__(
        self,
        sms: ShapedMechanism,
        shapes: Sequence[Obstacle],
        clearance: float,
        collision: str,
        q: FloatArray,
        pose: Any,
        obstacles: Sequence[Obstacle] = (),
    ) -> None:
        self.clearance, self._sms, self._q = clearance, sms, q
        in_link = sms.model.frames[sms.frame_id].placement * frame_pose(sms, q).inverse() * pose
        mode = chosen_mode(sms) if collision == "auto" else collision
        held = [(shape, in_link * shape.pose) for shape in named("shapes", shapes)]
        self._held, own = _HeldStack(sms, mode, held, obstacles), clearance_stack(sms, mode, clearance)
        self._stacks = [stack for stack in (self._held, own) if stack is not None and stack.names]

    def least(self, q: FloatArray) -> tuple[float, str]:
        """Return the least distance [m] at configurations (K, nq), and the name of its pair.

        The margins of the pairs are subtracted. A distance between two bodies of the servicer counts only if
        it is smaller than the requested distance.
        """
        nearest = [(np.inf, "")]
        for stack in self._stacks:
            each = zip(*(stack.at(row, 0.0) for row in q), strict=True)
            near = np.inf if stack is self._held else self.clearance
            least = stack.values(Poses(*(np.concatenate(arrays, axis=-1) for arrays in each)), near).min(
                axis=1
            )
            if near == np.inf or least.min() < near:
                nearest.append((float(least.min()), stack.names[int(np.argmin(least))]))
        return min(nearest)

    def away(self, joints: FloatArray, more: float = 0.0) -> FloatArray:
        """Search for a posture (n,) near `joints` with all distances at least 5 mm above the requested.

        `more` [m] is added to the requested distance, except between two bodies of the servicer. If the
        search fails, its last posture is returned.
        """
        limits, q = self._sms.limits, self._q.copy()
        for _ in range(_STEPS):
            slopes, deficits = [], []
            self._sms.layout.set_positions(q, joints)
            for stack in self._stacks:
                poses = stack.at(q, 0.0)
                requested = self.clearance + _BESIDE + (more if stack is self._held else 0.0)
                entries, violations = stack.below(poses, requested)
                slopes.append(stack.slopes(poses, entries, violations)[0])
                deficits.append(requested - violations.distance)
            if not sum(map(len, deficits)):
                break
            step = np.linalg.pinv(np.hstack(slopes).T, rcond=1e-3) @ np.concatenate(deficits)
            step *= min(1.0, _FARTHEST / float(np.abs(step).max(initial=_FARTHEST)))
            joints = np.clip(joints + step, limits.lower, limits.upper)
        return joints


class _HeldStack(BodyStack):
    """The pairs of robot and payload, of robot and obstacles, and of payload and obstacles."""

    def __init__(self, sms: ShapedMechanism, mode: str, held: list[Any], around: Sequence[Obstacle]) -> None:
        ClearanceStack.__init__(self, sms)
        self.mode, self._refines, self.obstacles = mode, False, named("obstacles", around)
        hand = sms.tip_joint - 2
        shapes = [Body.of(shape.name, part_of(shape.shape, hand, place, True)) for shape, place in held]
        own = [body for body in robot_bodies(sms, mode, []) if body.carrier != hand]
        others = BodyStack(sms, mode, obstacles=self.obstacles)._bodies if around else []
        met = {other.carrier: other for _, other in others}.values()
        self._take([*product(own, shapes), *others, *product(shapes, met)])
        self.margins[: len(own) * len(held)] = [shape.margin for shape, _ in held] * len(own)
